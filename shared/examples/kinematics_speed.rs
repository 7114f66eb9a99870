//! Times and success rates of the kinematics on this machine:
//! `cargo run --release -p tesaki --example kinematics_speed`. `tests/oracles/peers_kinematics.py` measures
//! other libraries on the same arms.

#![allow(
    clippy::type_complexity,
    clippy::cast_possible_truncation,
    clippy::unwrap_used,
    reason = "a measurement"
)]

use std::hint::black_box;
use std::time::Instant;

use tesaki::kinematics::{Chain, InverseKinematics, SolverOptions, Target};
use tesaki::model::{Inertial, Pose};
use tesaki_rng::Rng;

type Joint = ([f32; 3], [f32; 4], [f32; 3]);
type State = (&'static [f32], &'static [f32], [f64; 3], [f64; 9], &'static [f64], [f64; 6]);

const CASES: &[(&str, &[Joint], ([f32; 3], [f32; 4]), &[State])] =
    include!("../../tests/oracles/data/kinematics.in");

fn chain(name: &str) -> Chain {
    let (_, joints, tip, _) = CASES.iter().find(|case| case.0 == name).expect("a known chain");
    let none = Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] };
    let origins: Vec<Pose> =
        joints.iter().map(|&(translation, rotation, _)| Pose { translation, rotation }).collect();
    let links = origins.iter().zip(joints.iter()).map(|(origin, (_, _, axis))| (origin, axis, &none));
    Chain::from_links(links, &Pose { translation: tip.0, rotation: tip.1 }).expect("a valid chain")
}

/// Nanoseconds per call over `count` calls; the minimum of several rounds.
fn time(count: u32, mut body: impl FnMut(u32)) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..15 {
        let start = Instant::now();
        (0..count).for_each(&mut body);
        best = best.min(start.elapsed().as_secs_f64() * 1e9 / f64::from(count));
    }
    best
}

fn between(rng: &mut Rng, lower: f32, upper: f32) -> f32 {
    lower + (upper - lower) * rng.uniform() as f32
}

fn inverse(name: &str, start: &[f32], limit: f32, position_only: bool, singular: &[usize]) {
    let chain = chain(name);
    let n = chain.len();
    let limits = vec![(-limit, limit); n];
    let mut rng = Rng::new(7, 0);
    let goals: Vec<Vec<f32>> =
        (0..1000).map(|_| (0..n).map(|_| between(&mut rng, -limit, limit)).collect()).collect();
    let goals: Vec<Vec<f32>> = goals
        .into_iter()
        .map(|mut q| {
            singular.iter().for_each(|&joint| q[joint] *= 0.003);
            q
        })
        .collect();
    let targets: Vec<Target> = goals
        .iter()
        .map(|q| {
            let pose = *chain.posture(q).tip();
            if position_only { Target::Position(pose.translation.vector) } else { Target::Pose(pose) }
        })
        .collect();
    let near: Vec<Vec<f32>> = goals
        .iter()
        .map(|q| q.iter().map(|q| (q + between(&mut rng, -0.1, 0.1)).clamp(-limit, limit)).collect())
        .collect();
    for (label, restarts) in [("fixed start, no restart", 0), ("fixed start", 100), ("near start", 100)] {
        let solver = InverseKinematics::try_new(&limits)
            .expect("limits")
            .with_options(SolverOptions { restarts, ..SolverOptions::default() })
            .expect("options");
        let from = |index: usize| if label == "near start" { near[index].clone() } else { start.to_vec() };
        let mut reached = 0;
        let mut iterations = 0;
        let mut times = Vec::new();
        for (index, target) in targets.iter().enumerate() {
            let mut q = from(index);
            let result = solver.solve(&chain, target, &mut q);
            reached += u32::from(result.is_ok());
            if let Ok(solved) = result {
                iterations += solved.iterations;
            }
            times.push(time(1, |_| {
                let mut q = from(index);
                let _ = black_box(solver.solve(&chain, black_box(target), &mut q));
            }));
        }
        times.sort_by(f64::total_cmp);
        let mean = times.iter().sum::<f64>() / 1000.0;
        println!(
            "{name:<16} {label:<24} {:>6.1} % reached, median {:>6.2} us, mean {:>6.2} us, 99 % {:>7.2} us, \
             {:.1} iterations",
            f64::from(reached) / 10.0,
            times[500] / 1e3,
            mean / 1e3,
            times[990] / 1e3,
            f64::from(iterations) / 1000.0
        );
    }
}

fn main() {
    let arm = chain("franka_panda");
    let q = [0.1, -0.5, 0.3, -1.5, 0.2, 1.2, 0.4_f32];
    let forward = time(100_000, |_| {
        let posture = arm.posture(black_box(&q));
        black_box((posture.tip(), posture.jacobian()));
    });
    println!("forward kinematics and Jacobian, 7 joints: {forward:.0} ns");
    let posture = arm.posture(&q);
    let bias = time(100_000, |_| {
        black_box(black_box(&posture).bias_acceleration(black_box(&q)));
    });
    println!("bias acceleration, 7 joints: {bias:.0} ns");
    inverse("ur5e", &[0.0, -1.2, 1.2, -1.5, -1.5, 0.0], 3.1, false, &[]);
    println!("elbow straight, wrist folded:");
    inverse("ur5e", &[0.0, -1.2, 1.2, -1.5, -1.5, 0.0], 3.1, false, &[2, 4]);
    inverse("franka_panda", &[0.0, -0.5, 0.0, -1.5, 0.0, 1.5, 0.0], 2.8, false, &[]);
    inverse("allegro_thumb", &[0.5, 0.5, 0.5, 0.5], 1.2, true, &[]);
}
