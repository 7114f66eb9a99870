//! From motions of the tool to motions of the joints.

use core::f32::consts::FRAC_PI_2;

use nalgebra::{SVector, Vector6};

use super::machine::{Machine, POSTURES};
use crate::kinematics::Jacobian;
use crate::model::MAX_CHAIN_JOINTS;
use crate::task::impedance::redundancy::Resolver;

/// Solves for `tool` as often as it takes to know the weakest direction.
fn resolver(jacobian: Jacobian, driven: Option<usize>) -> (Resolver, f32) {
    let (mut direction, mut weakest) = (Vector6::repeat(0.408), 0.0);
    for _ in 0..50 {
        let _ = Resolver::new(jacobian, driven, &mut direction, &mut weakest);
    }
    (Resolver::new(jacobian, driven, &mut direction, &mut weakest), weakest)
}

#[test]
fn away_from_singular_postures_the_tool_moves_exactly_as_told() {
    let machine = Machine::new();
    let tool = Vector6::new(0.3, -0.5, 0.2, 1.0, -2.0, 0.7);
    for posture in &POSTURES[..3] {
        for driven in [None, Some(2)] {
            let jacobian = machine.jacobian(posture);
            let (resolver, weakest) = resolver(jacobian, driven);
            assert!(weakest > 0.06, "{posture:?}: {weakest}");
            let motion = resolver.solve(&tool);
            assert!((jacobian * motion - tool).norm() < 1e-4, "{posture:?} {driven:?}");
            assert!(driven.is_none_or(|driven| motion[driven] == 0.0));
            // The smallest singular value of the columns that are left.
            let mut left = jacobian;
            driven.iter().for_each(|&driven| left.column_mut(driven).fill(0.0));
            let smallest = left.transpose().svd(false, false).singular_values.min();
            assert!((weakest / smallest - 1.0).abs() < 0.02, "{weakest} {smallest}");
        }
    }
}

#[test]
fn a_null_motion_leaves_the_tool_where_it_is() {
    let machine = Machine::new();
    for posture in &POSTURES[..3] {
        let jacobian = machine.jacobian(posture);
        let (resolver, _) = resolver(jacobian, None);
        let any = SVector::from([1.0, -2.0, 0.5, 1.5, -1.0, 2.0, 0.3]);
        let null = resolver.null(&any);
        assert!(null.norm() > 0.1 && (jacobian * null).norm() < 1e-4, "{posture:?}");
    }
}

/// Damped by λ² = 0.04² (1 − (σ/0.06)²) below σ = 0.06, a unit motion of the tool takes at most σ/(σ² + λ²)
/// of the joints, which is 16.7 at σ = 0.06 and more nowhere.
#[test]
fn near_a_straight_elbow_and_a_folded_wrist_the_joints_stay_calm() {
    let machine = Machine::new();
    let sweeps: [fn(f32) -> [f32; MAX_CHAIN_JOINTS]; 2] = [
        // The elbow through straight, and the wrist through 90°, where its first axis meets its last.
        |way| [0.9, 0.3, -0.4, 0.5 * way, 0.3, 0.4, -0.2],
        |way| [0.9, 0.3, -0.4, 1.2, 0.3, FRAC_PI_2 + 0.5 * way, -0.2],
    ];
    for posture in sweeps {
        for driven in [None, Some(2)] {
            let (mut direction, mut weakest) = (Vector6::repeat(0.408), 0.0);
            let mut least = f32::INFINITY;
            for step in -1000..=1000 {
                let jacobian = machine.jacobian(&posture(step as f32 / 1000.0));
                // One iteration a step, as in the loop.
                let resolver = Resolver::new(jacobian, driven, &mut direction, &mut weakest);
                least = least.min(weakest);
                for axis in 0..6 {
                    let mut tool = Vector6::zeros();
                    tool[axis] = 1.0;
                    let size = resolver.solve(&tool).norm();
                    assert!(size < 20.0, "{step} {axis}: {size}");
                }
            }
            // With a joint driven by itself both are singular; the seventh joint helps over the wrist.
            assert!(driven.is_none() || least < 0.03, "{least}");
        }
    }
}

#[test]
fn a_wrench_is_found_in_its_joint_torques() {
    let machine = Machine::new();
    let wrench = Vector6::new(8.0, -5.0, 6.0, 0.3, 0.4, -0.5);
    for angles in &POSTURES {
        for driven in [None, Some(2)] {
            let jacobian = machine.jacobian(angles);
            let (mut direction, mut weakest) = (Vector6::repeat(0.4), 1.0);
            let resolver = Resolver::new(jacobian, driven, &mut direction, &mut weakest);
            let error = resolver.wrench(&jacobian.tr_mul(&wrench)) - wrench;
            assert!(error.amax() < 1e-3, "{error:?}");
        }
    }
}
