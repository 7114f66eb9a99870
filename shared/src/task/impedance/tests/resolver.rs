//! The damped least-squares inverse.

use core::f32::consts::FRAC_PI_2;

use nalgebra::{SVector, Vector6};

use super::fixture::{ArmFixture, POSTURES};
use crate::kinematics::Jacobian;
use crate::model::MAX_CHAIN_JOINTS;
use crate::task::impedance::redundancy::Resolver;

/// A resolver after convergence of the inverse iteration, and its smallest singular value.
fn converged(jacobian: Jacobian, driven: Option<usize>) -> (Resolver, f32) {
    let (mut left_singular_vector, mut sigma_min) = (Vector6::repeat(0.408), 0.0);
    for _ in 0..50 {
        let _ = Resolver::new(&jacobian, driven, &mut left_singular_vector, &mut sigma_min);
    }
    (Resolver::new(&jacobian, driven, &mut left_singular_vector, &mut sigma_min), sigma_min)
}

#[test]
fn away_from_singular_postures_the_inverse_is_exact() {
    let fixture = ArmFixture::new();
    let tool = Vector6::new(0.3, -0.5, 0.2, 1.0, -2.0, 0.7);
    for posture in &POSTURES[..3] {
        for driven in [None, Some(2)] {
            let jacobian = fixture.jacobian(posture);
            let (resolver, sigma_min) = converged(jacobian, driven);
            assert!(sigma_min > 0.06, "{posture:?}: {sigma_min}");
            let motion = resolver.solve(&tool);
            assert!((jacobian * motion - tool).norm() < 1e-4, "{posture:?} {driven:?}");
            assert!(driven.is_none_or(|driven| motion[driven] == 0.0));
            // Singular values without the column of the driven joint.
            let mut reduced = jacobian;
            driven.iter().for_each(|&driven| reduced.column_mut(driven).fill(0.0));
            let expected = reduced.transpose().svd(false, false).singular_values.min();
            assert!((sigma_min / expected - 1.0).abs() < 0.02, "{sigma_min} {expected}");
        }
    }
}

#[test]
fn null_space_motion_does_not_move_the_tool() {
    let fixture = ArmFixture::new();
    for posture in &POSTURES[..3] {
        let jacobian = fixture.jacobian(posture);
        let (resolver, _) = converged(jacobian, None);
        let any = SVector::from([1.0, -2.0, 0.5, 1.5, -1.0, 2.0, 0.3]);
        let motion = resolver.project_to_null_space(&any);
        assert!(motion.norm() > 0.1 && (jacobian * motion).norm() < 1e-4, "{posture:?}");
    }
}

/// With the damping λ² = 0.04² (1 − (σ/0.06)²) below σ = 0.06, a unit motion of the tool requires at most
/// σ/(σ² + λ²) of the joints, whose maximum is 16.7 at σ = 0.06.
#[test]
fn joint_motion_is_bounded_near_a_straight_elbow_and_a_folded_wrist() {
    let fixture = ArmFixture::new();
    let sweeps: [fn(f32) -> [f32; MAX_CHAIN_JOINTS]; 2] = [
        // The elbow through the straight arm; the wrist through 90°, where its first and last axes coincide.
        |offset| [0.9, 0.3, -0.4, 0.5 * offset, 0.3, 0.4, -0.2],
        |offset| [0.9, 0.3, -0.4, 1.2, 0.3, FRAC_PI_2 + 0.5 * offset, -0.2],
    ];
    for posture in sweeps {
        for driven in [None, Some(2)] {
            let (mut left_singular_vector, mut sigma_min) = (Vector6::repeat(0.408), 0.0);
            let mut min = f32::INFINITY;
            for step in -1000..=1000 {
                let jacobian = fixture.jacobian(&posture(step as f32 / 1000.0));
                // One iteration per step, as in a tick.
                let resolver = Resolver::new(&jacobian, driven, &mut left_singular_vector, &mut sigma_min);
                min = min.min(sigma_min);
                for axis in 0..6 {
                    let mut tool = Vector6::zeros();
                    tool[axis] = 1.0;
                    let size = resolver.solve(&tool).norm();
                    assert!(size < 20.0, "{step} {axis}: {size}");
                }
            }
            // Six joints are singular in both; the seventh resolves the wrist's singularity.
            assert!(driven.is_none() || min < 0.03, "{min}");
        }
    }
}

#[test]
fn a_wrench_is_recovered_from_its_joint_torques() {
    let fixture = ArmFixture::new();
    let wrench = Vector6::new(8.0, -5.0, 6.0, 0.3, 0.4, -0.5);
    for angles in &POSTURES {
        for driven in [None, Some(2)] {
            let jacobian = fixture.jacobian(angles);
            let (mut left_singular_vector, mut sigma_min) = (Vector6::repeat(0.4), 1.0);
            let resolver = Resolver::new(&jacobian, driven, &mut left_singular_vector, &mut sigma_min);
            let error = resolver.wrench(&jacobian.tr_mul(&wrench)) - wrench;
            assert!(error.amax() < 1e-3, "{error:?}");
        }
    }
}
