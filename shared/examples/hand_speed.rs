//! Accuracy and times of the inverse kinematics of a five-finger hand on this machine: `cargo run --release
//! -p tesaki --features test-support --example hand_speed`. With any argument only the times.

#![allow(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "a measurement")]

use std::hint::black_box;
use std::time::Instant;

use tesaki::kinematics::{Angles, FingertipTarget, FingertipTargets, Hand, HandOptions};
use tesaki::teleop::{OperatorFingertips, RetargetSettings, Retargeting};
use tesaki::test_support::{HAND5_LIMITS, hand5};
use tesaki_rng::Rng;

const TARGETS: u32 = 100_000;

fn random_angles(rng: &mut Rng) -> Angles {
    let mut angles = Angles::zeros();
    for (angle, (lower, upper)) in angles.iter_mut().zip(HAND5_LIMITS) {
        *angle = lower + (upper - lower) * rng.uniform() as f32;
    }
    angles
}

/// The tips at `angles`, as targets of the fingers in `fingers`.
fn targets(hand: &Hand, angles: &Angles, fingers: core::ops::Range<usize>) -> FingertipTargets {
    core::array::from_fn(|finger| {
        let (position, _) = hand.tip(finger, angles).filter(|_| fingers.contains(&finger))?;
        Some(FingertipTarget { position, weight: 1.0, direction: None })
    })
}

/// Tips made from joint angles, each search from the middle of the ranges.
fn accuracy(name: &str, hand: &Hand, fingers: core::ops::Range<usize>) {
    let mut rng = Rng::new(1, 0);
    let (mut worst, mut missed, mut evaluations, mut most) = (0.0_f32, 0, 0, 0);
    let start = Instant::now();
    for _ in 0..TARGETS {
        let goal = random_angles(&mut rng);
        let mut angles = hand.center();
        let targets = targets(hand, &goal, fingers.clone());
        let report = hand.search(&targets, &HandOptions::default(), &mut angles);
        let error = fingers.clone().map(|finger| report.distance(finger)).fold(0.0, f32::max);
        worst = worst.max(error);
        missed += u32::from(error > 5e-5);
        evaluations += u32::from(report.evaluations);
        most = most.max(report.evaluations);
    }
    let each = start.elapsed().as_secs_f64() * 1e6 / f64::from(TARGETS);
    println!(
        "{name:12} cold: worst {:.4} mm, {missed} of {TARGETS} missed by more than 0.05 mm, {:.1} evaluations \
         (at most {most}), {each:.2} µs",
        1e3 * worst,
        f64::from(evaluations) / f64::from(TARGETS)
    );
}

/// A smooth path of the joints from one random posture to the next, half a second each, 100 samples a second.
fn path(seed: u64) -> Vec<Angles> {
    let mut rng = Rng::new(seed, 0);
    let mut path = Vec::new();
    let (mut from, mut to) = (random_angles(&mut rng), random_angles(&mut rng));
    for frame in 0..4000_u16 {
        if frame % 50 == 0 {
            (from, to) = (to, random_angles(&mut rng));
        }
        let s = f32::from(frame % 50) / 50.0;
        path.push(from + (to - from) * (s * s * (3.0 - 2.0 * s)));
    }
    path
}

/// Follows a smooth path of the joints; the step is that of a hand at 100 samples a second.
fn tracking(name: &str, hand: &Hand, fingers: core::ops::Range<usize>) {
    let path: Vec<_> = path(2).iter().map(|angles| targets(hand, angles, fingers.clone())).collect();
    let (mut best, mut worst, mut evaluations, mut reached) = (f64::INFINITY, 0.0_f32, 0, 0);
    for round in 0..20 {
        let mut angles = hand.center();
        hand.search(&path[0], &HandOptions::default(), &mut angles);
        let start = Instant::now();
        for targets in &path {
            let report = hand.solve(black_box(targets), &HandOptions::default(), &mut angles);
            if round == 0 {
                let error = fingers.clone().map(|finger| report.distance(finger)).fold(0.0, f32::max);
                worst = worst.max(error);
                reached += u32::from(error < 5e-5);
                evaluations += u32::from(report.evaluations);
            }
        }
        best = best.min(start.elapsed().as_secs_f64() * 1e6 / path.len() as f64);
    }
    println!(
        "{name:12} warm: worst {:.4} mm, {reached} of {} within 0.05 mm, {:.2} evaluations, {best:.3} µs",
        1e3 * worst,
        path.len(),
        f64::from(evaluations) / path.len() as f64
    );
}

/// Retargets an operator whose hand is larger and moves smoothly, at 100 samples a second.
fn retargeting(hand: &Hand, scale: f32) {
    let settings = RetargetSettings { speeds: [1e3; 16], ..RetargetSettings::DEFAULT };
    settings.validate(hand).expect("valid");
    let retargeting = Retargeting { hand, settings: &settings };
    let tips = |angles: &Angles| OperatorFingertips {
        positions: core::array::from_fn(|finger| Some(hand.tip(finger, angles)?.0 * scale)),
        directions: [None; 5],
    };
    let path: Vec<_> = path(3).iter().map(tips).collect();
    let (mut best, mut evaluations, mut most, mut reached, mut largest) = (f64::INFINITY, 0, 0, 0, 0.0_f32);
    for round in 0..20 {
        let mut state = retargeting.begin(&hand.center(), &nalgebra::Vector3::zeros());
        let _ = retargeting.update(&mut state, &path[0], 0.01);
        let start = Instant::now();
        for tips in &path {
            let before = state.angles();
            let Ok(report) = retargeting.update(&mut state, black_box(tips), 0.01) else { continue };
            if round == 0 {
                reached += u32::from(report.missed == 0);
                evaluations += u32::from(report.evaluations);
                most = most.max(report.evaluations);
                largest = largest.max((state.angles() - before).amax());
            }
        }
        best = best.min(start.elapsed().as_secs_f64() * 1e6 / path.len() as f64);
    }
    println!(
        "retargeting, operator's hand {scale} times as large: {reached} of {} frames reproduced, {:.1} evaluations (at \
         most {most}), {best:.2} µs a frame, largest step {largest:.2} rad",
        path.len(),
        f64::from(evaluations) / path.len() as f64
    );
}

fn main() {
    let hand = hand5();
    let names = ["thumb", "index", "middle", "ring", "little"];
    for (finger, name) in names.iter().enumerate() {
        if std::env::args().len() < 2 {
            accuracy(name, &hand, finger..finger + 1);
        }
        tracking(name, &hand, finger..finger + 1);
    }
    if std::env::args().len() < 2 {
        accuracy("all fingers", &hand, 0..5);
    }
    tracking("all fingers", &hand, 0..5);
    retargeting(&hand, 1.0);
    retargeting(&hand, 1.1);
}
