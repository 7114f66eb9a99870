//! Forward kinematics, Jacobian and bias acceleration against Pinocchio, for arms and hands of different
//! make.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, UnitVector3, Vector3, Vector6};

use super::{Chain, InvalidChain};
use crate::model::{Inertial, Pose};

type Joint = ([f32; 3], [f32; 4], [f32; 3]);
type Tip = ([f32; 3], [f32; 4]);
/// Angles, velocities; position, rotation (by rows), Jacobian (by rows) and bias acceleration of the tip.
type State = (&'static [f32], &'static [f32], [f64; 3], [f64; 9], &'static [f64], [f64; 6]);

/// Sixteen chains (`tests/oracles/kinematics.py`).
pub const CASES: &[(&str, &[Joint], Tip, &[State])] = include!("../../../tests/oracles/data/kinematics.in");

/// The chain of this name.
pub fn chain_of(name: &str) -> Chain {
    let (_, joints, tip, _) = CASES.iter().find(|case| case.0 == name).unwrap();
    chain(joints, tip)
}

fn chain(joints: &[Joint], &(translation, rotation): &Tip) -> Chain {
    let none = Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] };
    let origins: Vec<Pose> =
        joints.iter().map(|&(translation, rotation, _)| Pose { translation, rotation }).collect();
    let links = origins.iter().zip(joints).map(|(origin, (_, _, axis))| (origin, axis, &none));
    Chain::of_links(links, &Pose { translation, rotation })
}

/// Largest difference, as a share of the largest expected value, or of `least` if that is larger.
fn difference(got: impl IntoIterator<Item = f32>, expected: &[f64], least: f64) -> f64 {
    let scale = expected.iter().fold(least, |scale, value| scale.max(value.abs()));
    let got: Vec<f32> = got.into_iter().collect();
    assert_eq!(got.len(), expected.len());
    got.iter()
        .zip(expected)
        .map(|(&got, expected)| (f64::from(got) - expected).abs() / scale)
        .fold(0.0, f64::max)
}

#[test]
fn agrees_with_pinocchio_on_arms_and_hands_of_different_make() {
    assert!(CASES.len() >= 16);
    for (name, joints, tip, states) in CASES {
        let chain = chain(joints, tip);
        let n = joints.len();
        for (number, (q, qd, position, rotation, jacobian, bias)) in states.iter().enumerate() {
            let posture = chain.posture(q);
            let check = |what, difference: f64| {
                assert!(difference < 1e-5, "{name}, state {number}: {what} off by {difference:e}");
            };
            check("position", difference(posture.tip().translation.vector.iter().copied(), position, 0.1));
            let matrix = posture.tip().rotation.matrix().transpose();
            check("rotation", difference(matrix.iter().copied(), rotation, 1.0));
            let got = posture.jacobian();
            let (linear, angular) = jacobian.split_at(3 * n);
            let rows = |from: usize| {
                (from..from + 3).flat_map(move |row| (0..n).map(move |column| got[(row, column)]))
            };
            check("linear Jacobian", difference(rows(0), linear, 0.1));
            check("angular Jacobian", difference(rows(3), angular, 1.0));
            let got = posture.bias_acceleration(qd);
            check("linear bias", difference(got.iter().copied().take(3), &bias[..3], 0.1));
            check("angular bias", difference(got.iter().copied().skip(3), &bias[3..], 0.1));
            assert!(posture.jacobian().columns(n, 7 - n).iter().all(|&value| value == 0.0));
        }
    }
}

/// Velocity of the tip by `J q̇` in double precision, straight from the joints' frames.
fn tip_velocity(joints: &[Joint], tip: &Tip, q: &[f64], qd: &[f32]) -> Vector6<f64> {
    let place = |&(xyz, [x, y, z, w]): &Tip| {
        let rotation = Quaternion::new(w, x, y, z).cast::<f64>();
        Isometry3::from_parts(Vector3::from(xyz).cast().into(), UnitQuaternion::from_quaternion(rotation))
    };
    let (mut here, mut axes) = (Isometry3::identity(), Vec::new());
    for (&(xyz, rotation, axis), &q) in joints.iter().zip(q) {
        here *= place(&(xyz, rotation));
        let axis = UnitVector3::new_normalize(Vector3::from(axis).cast());
        axes.push((here * axis, here.translation.vector));
        here *= UnitQuaternion::from_axis_angle(&axis, q);
    }
    let tip = (here * place(tip)).translation.vector;
    axes.iter().zip(qd).fold(Vector6::zeros(), |sum, ((axis, origin), &qd)| {
        let (linear, angular) = (axis.cross(&(tip - origin)), axis.into_inner());
        let column = Vector6::from_iterator(linear.iter().chain(&angular).copied());
        sum + column * f64::from(qd)
    })
}

#[test]
fn the_bias_acceleration_is_the_change_of_the_jacobian_also_far_from_the_base() {
    const STEP: f64 = 1e-4;
    for (name, near, tip, states) in CASES {
        for distance in [0.0, 10.0] {
            let mut joints = near.to_vec();
            let [x, y, z] = joints[0].0;
            joints[0].0 = [x + distance, y - distance, z + distance];
            let chain = chain(&joints, tip);
            for (number, (q, qd, ..)) in states.iter().enumerate() {
                let velocity = |time: f64| {
                    let q: Vec<f64> =
                        q.iter().zip(*qd).map(|(&q, &qd)| f64::from(q) + f64::from(qd) * time).collect();
                    tip_velocity(&joints, tip, &q, qd)
                };
                let expected = (velocity(STEP) - velocity(-STEP)) / (2.0 * STEP);
                let posture = chain.posture(q);
                let got = posture.bias_acceleration(qd);
                let near = self::chain(near, tip).posture(q);
                assert_eq!((near.jacobian(), near.bias_acceleration(qd)), (posture.jacobian(), got));
                for (rows, what) in [(0, "linear"), (3, "angular")] {
                    let got = got.iter().copied().skip(rows).take(3);
                    let difference = difference(got, &expected.as_slice()[rows..rows + 3], 0.1);
                    assert!(
                        difference < 1e-5,
                        "{name} at {distance} m, state {number}: {what} bias off by {difference:e}"
                    );
                }
            }
        }
    }
}

#[test]
fn an_axis_that_is_hardly_tilted_is_tilted_all_the_same() {
    // About k = (3e-4, 0, 1) half a turn takes x to −x + 2 k (k·x) = (−1 + 1.8e-7, 0, 6e-4); about (3e-4, 0,
    // −1) to (−1 + 1.8e-7, 0, −6e-4).
    for (up, height) in [(1.0, 6e-4), (-1.0, -6e-4)] {
        let joint = ([0.0; 3], [0.0, 0.0, 0.0, 1.0], [3e-4, 0.0, up]);
        let chain = chain(&[joint], &([1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]));
        let tip = chain.posture(&[core::f32::consts::PI]).tip().translation.vector;
        let expected = Vector3::new(-1.0, 0.0, height);
        assert!((tip - expected).norm() < 4e-7, "{tip}");
    }
}

#[test]
fn a_chain_of_too_many_links_or_with_an_axis_that_is_no_unit_vector_is_refused() {
    let none = Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] };
    let chain = |axes: &[[f32; 3]]| {
        let links = axes.iter().map(|axis| (&Pose::IDENTITY, axis, &none));
        Chain::from_links(links, &Pose::IDENTITY).map(|chain| chain.len())
    };
    assert_eq!(chain(&[[0.0, 0.0, 1.0]; 7]), Ok(7));
    assert_eq!(chain(&[[0.0, 0.0, 1.0]; 8]), Err(InvalidChain::TooMany));
    let long = [[1.0, 0.0, 0.0], [0.0, 1.5, 0.0]];
    assert_eq!(chain(&long), Err(InvalidChain::Axis { joint: 1, length: 1.5 }));
    assert!(matches!(chain(&[[f32::NAN; 3]]), Err(InvalidChain::Axis { joint: 0, .. })));
}
