//! Times of the inverse kinematics of the five-finger hand's thumb on this machine, for targets and starts in
//! a file; writes the angles to another one. `tests/oracles/peers_thumb.py` runs it beside a solver on
//! Pinocchio and checks the angles.

use std::fmt::Write;
use std::hint::black_box;
use std::time::Instant;

use nalgebra::Vector3;
use tesaki::kinematics::{Angles, FingertipTarget, FingertipTargets, HandOptions};
use tesaki::test_support::hand5;

fn main() {
    let names: Vec<_> = std::env::args().skip(1).collect();
    let [input, output] = names.as_slice() else { panic!("two files: targets, angles") };
    let text = std::fs::read_to_string(input).expect("readable");
    let (hand, options) = (hand5(), HandOptions::default());
    let read = |line: &str| -> (FingertipTargets, Angles) {
        let numbers: Vec<f32> = line.split_whitespace().map(|word| word.parse().expect("a number")).collect();
        let mut targets = FingertipTargets::default();
        let position = Vector3::from_column_slice(&numbers[..3]);
        targets[0] = Some(FingertipTarget { position, weight: 1.0, direction: None });
        let mut start = hand.center();
        start.iter_mut().zip(&numbers[3..]).for_each(|(angle, number)| *angle = *number);
        (targets, start)
    };
    let searches: Vec<_> = text.lines().map(read).collect();
    let mut solutions = String::new();
    for (block, searches) in searches.chunks(searches.len() / 3).enumerate() {
        let mut best = f64::INFINITY;
        let mut found = Vec::with_capacity(searches.len());
        for _ in 0..5 {
            found.clear();
            let mut angles = searches[0].1;
            let begin = Instant::now();
            for (targets, start) in searches {
                if block < 2 {
                    angles = *start;
                }
                hand.search(black_box(targets), &options, &mut angles);
                found.push(angles);
            }
            #[expect(clippy::cast_precision_loss, reason = "thousands")]
            let each = begin.elapsed().as_secs_f64() * 1e6 / searches.len() as f64;
            best = best.min(each);
        }
        println!("{best:.4}");
        for q in &found {
            writeln!(solutions, "{} {} {} {} {}", q[0], q[1], q[2], q[3], q[4]).expect("memory");
        }
    }
    std::fs::write(output, solutions).expect("writable");
}
