//! Torques and mass matrices against Pinocchio, for arms of different make.

use nalgebra::{Vector3, Vector6};

use super::MassMatrix;
use crate::kinematics::Chain;
use crate::model::{Inertial, Pose};
use crate::test_support::joint as test_joint;

/// Frame, axis, mass, centre of mass, inertia, rotor inertia.
type Joint = ([f32; 3], [f32; 4], [f32; 3], f32, [f32; 3], [f32; 6], f32);
/// Angles, velocities, accelerations, wrench; torques without it, with it, without accelerations; mass matrix
/// by rows.
type Motion = (
    &'static [f32],
    &'static [f32],
    &'static [f32],
    [f32; 6],
    &'static [f32],
    &'static [f32],
    &'static [f32],
    &'static [f32],
);
type Case = (&'static str, [f32; 3], &'static [Joint], ([f32; 3], [f32; 4]), &'static [Motion]);

/// Random chains and real arms (`tests/oracles/inverse_dynamics.py`).
const CASES: &[Case] = include!("../../../tests/oracles/data/inverse_dynamics.in");

fn chain(joints: &[Joint], &(translation, rotation): &([f32; 3], [f32; 4])) -> Chain {
    let parts: Vec<_> = joints
        .iter()
        .map(|&(translation, rotation, axis, mass, center_of_mass, inertia, _)| {
            (Pose { translation, rotation }, axis, Inertial { mass, center_of_mass, inertia })
        })
        .collect();
    let links = parts.iter().map(|(origin, axis, link)| (origin, axis, link));
    Chain::of_links(links, &Pose { translation, rotation })
        .with_rotor_inertia(joints.iter().map(|joint| joint.6))
}

/// Largest difference, as a share of the largest expected value.
fn difference(got: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(got.len(), expected.len());
    let scale = expected.iter().fold(0.0_f32, |scale, value| scale.max(value.abs()));
    let differences = got.iter().zip(expected).map(|(got, expected)| (got - expected).abs());
    differences.fold(0.0_f32, |worst, difference| worst.max(difference / scale))
}

#[test]
fn agrees_with_pinocchio_on_random_chains_and_real_arms() {
    let mut worst = [0.0_f32; 4];
    for (name, gravity, joints, tip, motions) in CASES {
        let (chain, gravity, n) = (chain(joints, tip), Vector3::from(*gravity), joints.len());
        for (number, (q, qd, qdd, wrench, free, loaded, nonlinear, mass)) in motions.iter().enumerate() {
            let mut check = |which: usize, what, got: &[f32], expected: &[f32]| {
                let difference = difference(got, expected);
                worst[which] = worst[which].max(difference);
                assert!(difference <= 1e-5, "{name}, motion {number}: {what} off by {difference:e}");
            };
            let mut torques = vec![0.0; n];
            chain.inverse_dynamics(&gravity, q, qd, qdd, &mut torques);
            check(0, "torque", &torques, free);
            let wrench = Vector6::from(*wrench);
            chain.inverse_dynamics_with_wrench(&gravity, &wrench, q, qd, qdd, &mut torques);
            check(1, "torque under a wrench", &torques, loaded);
            chain.inverse_dynamics(&gravity, q, qd, &vec![0.0; n], &mut torques);
            check(2, "torque without acceleration", &torques, nonlinear);
            let matrix = chain.mass_matrix(q);
            let rows: Vec<f32> = (0..n * n).map(|k| matrix[(k / n, k % n)]).collect();
            check(3, "mass matrix", &rows, mass);
            assert_eq!(matrix, matrix.transpose());
            let padding = MassMatrix::from_fn(|row, column| f32::from(u8::from(row == column && row >= n)));
            assert!(
                (matrix + padding).cholesky().is_some(),
                "{name}, motion {number}: not positive definite"
            );
            assert!(matrix.view_range(n.., ..).iter().all(|&value| value == 0.0));
        }
    }
    println!("largest share of the largest: {worst:?}");
}

#[test]
fn the_place_of_the_base_and_the_first_angle_change_no_bit_of_the_mass_matrix() {
    for (_, _, joints, tip, motions) in CASES {
        let mut far = joints.to_vec();
        far[0].0 = [10.0, -20.0, 30.0];
        for (q, ..) in *motions {
            let mut turned = q.to_vec();
            turned[0] += 1.0;
            assert_eq!(chain(joints, tip).mass_matrix(q), chain(&far, tip).mass_matrix(&turned));
        }
    }
}

#[test]
fn rotors_count_only_where_they_are_given() {
    let joints = [test_joint("a"), test_joint("b")];
    let bare = Chain::new(&joints, &Pose::IDENTITY);
    let geared = bare.clone().with_rotor_inertia([0.25, 0.5, 9.0]);
    let torques = |chain: &Chain| {
        let mut torques = [0.0; 2];
        chain.inverse_dynamics(&Vector3::zeros(), &[0.1, 0.2], &[0.0; 2], &[2.0, -2.0], &mut torques);
        torques
    };
    let [[a, b], [geared_a, geared_b]] = [torques(&bare), torques(&geared)];
    assert_eq!([geared_a, geared_b], [a + 0.5, b - 1.0]);
    let difference = geared.mass_matrix(&[0.1, 0.2]) - bare.mass_matrix(&[0.1, 0.2]);
    assert!(
        (difference.diagonal() - nalgebra::SVector::from([0.25, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])).norm() < 1e-6
    );
    assert_eq!(difference.sum(), difference.trace());
}

#[test]
fn values_that_are_missing_leave_out_joints_and_the_wrench() {
    let (_, gravity, joints, tip, motions) = CASES[1];
    let chain = chain(joints, &tip);
    let (q, qd, qdd, wrench, ..) = motions[0];
    let gravity = Vector3::from(gravity);
    let (mut alone, mut loaded, mut none) = ([9.0; 7], [9.0; 7], [0.0_f32; 0]);
    chain.inverse_dynamics(&gravity, &q[..4], qd, qdd, &mut alone);
    chain.inverse_dynamics_with_wrench(&gravity, &Vector6::from(wrench), &q[..4], qd, qdd, &mut loaded);
    assert_eq!(alone, loaded);
    assert_eq!(alone[4..], [9.0; 3]);
    chain.inverse_dynamics_with_wrench(&gravity, &Vector6::from(wrench), q, qd, qdd, &mut none);
    chain.inverse_dynamics(&gravity, &[], qd, qdd, &mut alone);
    assert_eq!(alone, loaded);
}

#[test]
fn holds_a_pendulum_against_gravity() {
    // 2 kg, 0.5 m from a horizontal axis, hanging at 30° from the vertical: 2 · 9.81 · 0.5 · sin 30° = 4.905
    // N·m; its inertia is 2 · 0.5² = 0.5 kg·m².
    let pendulum = crate::model::JointModel {
        axis: [0.0, 1.0, 0.0],
        link: Inertial { mass: 2.0, center_of_mass: [0.0, 0.0, -0.5], inertia: [0.0; 6] },
        ..test_joint("pendulum")
    };
    let (chain, angle) = (Chain::new(&[pendulum], &Pose::IDENTITY), [core::f32::consts::FRAC_PI_6]);
    let mut torque = [0.0];
    chain.inverse_dynamics(&Vector3::new(0.0, 0.0, -9.81), &angle, &[0.0], &[0.0], &mut torque);
    assert!((torque[0] - 4.905).abs() < 1e-5, "{torque:?}");
    assert!((chain.mass_matrix(&angle)[(0, 0)] - 0.5).abs() < 1e-7);
}
