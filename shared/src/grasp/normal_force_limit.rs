use core::fmt;

use nalgebra::{Matrix3, Vector3};

use crate::math;
use crate::zip::zip;

/// A joint is at its torque limit without a contact force, or a value is not finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NormalForceLimitError {
    /// The joint of the finger, 0 to 2.
    pub joint: u8,
}

/// Maximum normal force [N] of a finger's contact: for any force inside the friction cone with a smaller
/// normal part, each joint torque `used + (D_Fi J_Fi)ᵀ f` (Hand3 eq. 16) stays within its limit. Infinite if
/// the contact loads no joint. Use the smaller of this and the limits of sensor and tip for a
/// [`Contact`](super::Contact).
///
/// - `block`: `D_Fi J_Fi` [m/rad], see [`ThreeFingers::blocks`](super::ThreeFingers::blocks).
/// - `normal`: unit vector into the object; `friction`: coefficient, reduced by the margin of the
///   [`LeastGrip`](super::LeastGrip).
/// - `used`, `limits`: joint torques for gravity and motion, and maximum joint torques [N·m].
///
/// Let `c` and `s` be the normal and tangential parts of column j of the block. Forces with normal part `a`
/// load joint j with `a (c − μ s)` to `a (c + μ s)`, both attained, so each joint limits `a` by a quotient.
///
/// The limit is conservative for forces other than the worst of the cone. If joint j, loaded in the direction
/// of `c`, sets the limit, a force along the normal could be up to `1 + μ s/|c|` times as large, and the best
/// force of the cone `(|c| + μ s)/(|c| − μ s)` times. There is no such bound if `|c| ≤ μ s`, or if the joint
/// is loaded in the opposite direction.
///
/// # Errors
/// A joint is at its limit without a contact force, or a value is NaN.
pub fn normal_force_limit(
    block: &Matrix3<f32>,
    normal: &Vector3<f32>,
    friction: f32,
    used: &Vector3<f32>,
    limits: &Vector3<f32>,
) -> Result<f32, NormalForceLimitError> {
    let mut max_force = f32::INFINITY;
    for (joint, column, used, limit) in zip((0.., block.data.0.map(Vector3::from), used, limits)) {
        let along = column.dot(normal);
        let across = friction * math::norm(&(column - normal * along));
        for (rate, headroom) in [(across + along, limit - used), (across - along, limit + used)] {
            // NaN fails both.
            if !(headroom > 0.0 && rate.is_finite()) {
                return Err(NormalForceLimitError { joint });
            }
            if rate > 0.0 && headroom < max_force * rate {
                max_force = headroom / rate;
            }
        }
    }
    Ok(max_force)
}

impl fmt::Display for NormalForceLimitError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "joint {} of the finger is at its torque limit without a contact force", self.joint + 1)
    }
}

impl core::error::Error for NormalForceLimitError {}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Block by rows, normal, friction, torques used, limits; the largest normal force and the force that
    /// attains it, by brute force (`tests/oracles/push.py`).
    #[allow(clippy::type_complexity)]
    const CASES: &[([f32; 9], [f32; 3], f32, [f32; 3], [f32; 3], f32, [f32; 3])] =
        include!("../../../tests/oracles/data/push.in");

    #[test]
    fn is_what_sampling_of_the_whole_cone_finds() {
        for &(block, normal, friction, used, limits, expected, force) in CASES {
            let block = Matrix3::from_row_slice(&block);
            let (normal, used, limits) = (normal.into(), used.into(), Vector3::from(limits));
            let push = normal_force_limit(&block, &normal, friction, &used, &limits).unwrap();
            // Safe: no sampled force is larger. Attained: this one, inside the cone, is as large.
            assert!(push <= expected * (1.0 + 1e-5), "{push} {expected}");
            assert!(push >= expected * (1.0 - 1e-4), "{push} {expected}");
            let force = Vector3::from(force);
            let along = normal.dot(&force);
            assert!((along / push - 1.0).abs() < 1e-4);
            assert!((force - normal * along).norm() <= friction * along + 1e-5 * force.norm());
            let torques = used + block.tr_mul(&force);
            let fraction = torques.abs().component_div(&limits).max();
            assert!((fraction - 1.0).abs() < 1e-4, "{fraction}");
        }
    }

    #[test]
    fn is_the_one_worked_by_hand() {
        // Joint 1 has a lever of 0.1 m for normal forces, joint 2 for tangential ones, joint 3 none.
        let block = Matrix3::from_diagonal(&Vector3::new(0.1, 0.1, 0.0));
        let (normal, limits) = (Vector3::x(), Vector3::new(1.0, 0.3, 1e-3));
        let push = |used: [f32; 3]| normal_force_limit(&block, &normal, 0.5, &used.into(), &limits);
        // 0.3 N·m over 0.5 × 0.1 m.
        assert!((push([0.0; 3]).unwrap() - 6.0).abs() < 1e-5);
        // Gravity adds to the push, or opposes it; its sign does not matter for joint 2.
        assert!((push([0.5, 0.0, 0.0]).unwrap() - 5.0).abs() < 1e-5);
        assert!((push([-0.5, 0.0, 0.0]).unwrap() - 6.0).abs() < 1e-5);
        for used in [0.1, -0.1] {
            assert!((push([0.0, used, 0.0]).unwrap() - 4.0).abs() < 1e-5);
        }
        assert_eq!(push([0.0, 0.3, 0.0]), Err(NormalForceLimitError { joint: 1 }));
        assert_eq!(push([0.0, 0.0, f32::NAN]), Err(NormalForceLimitError { joint: 2 }));
        let nothing = normal_force_limit(&Matrix3::zeros(), &normal, 0.5, &Vector3::zeros(), &limits);
        assert_eq!(nothing, Ok(f32::INFINITY));
        for (block, friction) in [(block * f32::NAN, 0.5), (block, f32::NAN)] {
            let refused = normal_force_limit(&block, &normal, friction, &Vector3::zeros(), &limits);
            assert_eq!(refused, Err(NormalForceLimitError { joint: 0 }));
        }
    }
}
