//! Times of the dynamics of the Franka Panda on this machine:
//! `cargo run --release -p tesaki --example dynamics_speed`. `tests/oracles/peers_dynamics.py` runs it beside
//! Pinocchio on the same arm and prints the ratios.

#![allow(clippy::type_complexity, reason = "a measurement")]

use std::hint::black_box;
use std::time::Instant;

use nalgebra::{Vector3, Vector6};
use tesaki::kinematics::Chain;
use tesaki::model::{Inertial, Pose};

type Joint = ([f32; 3], [f32; 4], [f32; 3], f32, [f32; 3], [f32; 6], f32);
type Numbers = &'static [f32];
type Motion = (Numbers, Numbers, Numbers, [f32; 6], Numbers, Numbers, Numbers, Numbers);

const CASES: &[(&str, [f32; 3], &[Joint], ([f32; 3], [f32; 4]), &[Motion])] =
    include!("../../tests/oracles/data/inverse_dynamics.in");

/// Prints the nanoseconds of one call, the best of several rounds.
fn time(name: &str, mut body: impl FnMut()) {
    const CALLS: u32 = 20_000;
    let mut best = f64::INFINITY;
    for _ in 0..50 {
        let start = Instant::now();
        (0..CALLS).for_each(|_| body());
        best = best.min(start.elapsed().as_secs_f64() * 1e9 / f64::from(CALLS));
    }
    println!("{name} {best:.1}");
}

fn main() {
    let (_, gravity, joints, tip, motions) =
        CASES.iter().find(|case| case.0 == "franka_panda").expect("the arm");
    let parts: Vec<_> = joints
        .iter()
        .map(|&(translation, rotation, axis, mass, center_of_mass, inertia, _)| {
            (Pose { translation, rotation }, axis, Inertial { mass, center_of_mass, inertia })
        })
        .collect();
    let links = parts.iter().map(|(origin, axis, link)| (origin, axis, link));
    let arm = Chain::from_links(links, &Pose { translation: tip.0, rotation: tip.1 })
        .expect("a valid chain")
        .with_rotor_inertia(joints.iter().map(|joint| joint.6));
    let (q, qd, qdd, wrench, ..) = motions[0];
    let (gravity, wrench) = (Vector3::from(*gravity), Vector6::from(wrench));
    let mut torques = [0.0; 7];
    time("rnea", || {
        arm.inverse_dynamics(black_box(&gravity), black_box(q), qd, qdd, &mut torques);
        black_box(&torques);
    });
    time("rnea_wrench", || {
        arm.inverse_dynamics_with_wrench(&gravity, black_box(&wrench), black_box(q), qd, qdd, &mut torques);
        black_box(&torques);
    });
    time("mass_matrix", || {
        black_box(arm.mass_matrix(black_box(q)));
    });
    time("jacobian_and_bias", || {
        let posture = arm.posture(black_box(q));
        black_box((posture.jacobian(), posture.bias_acceleration(black_box(qd))));
    });
    let posture = arm.posture(q);
    time("bias", || {
        black_box(black_box(&posture).bias_acceleration(black_box(qd)));
    });
}
