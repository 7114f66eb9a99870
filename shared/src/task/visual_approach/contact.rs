//! Contact of the hand, estimated from the torques of the joints.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::reference::GuidedArm;
use crate::TICK;
use crate::kinematics::Posture;
use crate::math::{Ldlt, norm};
use crate::model::MAX_CHAIN_JOINTS;
use crate::robot::Efforts;

/// Time constants with which a change of the force is attributed to model errors: while the hand moves, and
/// while it stands; the latter is also that of learning the efforts before the first motion [s].
const MOVING_TIME: f32 = 1.0;
const STANDING_TIME: f32 = 0.15;
/// Share of the contact force that may be attributed to model errors, which change with the posture and the
/// direction of friction: 7.5 N of 15 N. Masses that are wrong by 20 % appear as 5 N on robots/knob-arm.
pub const LEARNABLE: f32 = 0.5;
/// Damping of the inverse Jacobian [m, rad]. Forces along directions that move the joints less are
/// underestimated.
const DAMPING: f32 = 0.05;

/// Learning mode of the estimate in a period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Learning {
    /// The efforts without contact: the hand has not moved yet.
    Unloaded,
    /// Errors of the model, while the hand stands.
    Standing,
    /// Errors of the model, while it moves: slow changes of a small force.
    Moving,
    /// Nothing: the hand may carry a load.
    Nothing,
}

/// Estimates the force on the hand from the efforts of the arm's joints: their torques beyond the model,
/// minus those before the first motion.
///
/// Later changes are attributed to model errors up to [`LEARNABLE`] of the contact force, however long they
/// last. A force that grows by more than `LEARNABLE · limit / MOVING_TIME` (7.5 N/s of 15 N) is therefore not
/// learnt once it exceeds that share, and one that grows more slowly is detected at `(1 + LEARNABLE) · limit`
/// at the latest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ContactEstimate {
    /// Efforts before the first motion [N·m].
    unloaded: [f32; MAX_CHAIN_JOINTS],
    /// Force since then that is attributed to model errors, in base axes [N].
    learnt: [f32; 3],
}

/// Sensitivity of the joint torques to forces on the hand, in one posture.
pub struct Sense {
    /// Factors of `J Jᵀ + λ²`.
    factors: Ldlt<6>,
}

impl Sense {
    /// The sensitivity of the arm at `posture`.
    pub fn new(arm: &GuidedArm<'_>, posture: &Posture) -> Self {
        let jacobian = arm.jacobian(posture);
        let damped = jacobian * jacobian.transpose() + Matrix6::from_diagonal_element(DAMPING * DAMPING);
        Self { factors: Ldlt::new(&damped, 1e-9) }
    }

    /// Share of a force along this unit vector that the estimate shows: 1 far from singular postures, 0 if
    /// the structure bears it without joint torques. By duality the damped inverse keeps the same share of a
    /// motion along it.
    pub fn shown(&self, direction: &Vector3<f32>) -> f32 {
        let force = Vector6::new(direction.x, direction.y, direction.z, 0.0, 0.0, 0.0);
        // fᵀ (J Jᵀ + λ²)⁻¹ J Jᵀ f
        1.0 - DAMPING * DAMPING * force.dot(&self.factors.solve(&force))
    }

    /// Whether the estimate shows at least the share `min` of a force in every direction.
    pub fn shows(&self, min: f32) -> bool {
        let mut shares = Matrix3::from_diagonal_element(1.0 - min);
        for axis in 0..3 {
            let hidden = self.factors.solve(&Vector6::ith(axis, DAMPING * DAMPING));
            for row in 0..3 {
                shares[(row, axis)] -= hidden[row];
            }
        }
        // Sylvester's criterion for a positive definite matrix.
        let minor = shares.m11 * shares.m22 - shares.m12 * shares.m21;
        shares.m11 > 0.0 && minor > 0.0 && shares.determinant() > 0.0
    }
}

impl ContactEstimate {
    pub const NONE: Self = Self { unloaded: [0.0; MAX_CHAIN_JOINTS], learnt: [0.0; 3] };

    /// Updates and returns the force on the hand in the last period, in base axes [N], at `posture`. `limit`
    /// is the contact force [N].
    pub fn update(
        &mut self,
        arm: &GuidedArm<'_>,
        posture: &Posture,
        sense: &Sense,
        efforts: &dyn Efforts,
        learning: Learning,
        limit: f32,
    ) -> Vector3<f32> {
        let mut beyond = nalgebra::SVector::<f32, MAX_CHAIN_JOINTS>::zeros();
        for (index, own) in arm.indices() {
            // The drives balance the force: opposite sign.
            beyond[own] = self.unloaded[own] - efforts.effort(index);
            if learning == Learning::Unloaded {
                self.unloaded[own] -= beyond[own] * (TICK / STANDING_TIME);
            }
        }
        let wrench = sense.factors.solve(&(arm.jacobian(posture) * beyond));
        let learnt = Vector3::from(self.learnt);
        let force = wrench.fixed_rows::<3>(0).into_owned() - learnt;
        let time = match learning {
            Learning::Standing => STANDING_TIME,
            Learning::Moving if force.norm_squared() < LEARNABLE * LEARNABLE * limit * limit => MOVING_TIME,
            Learning::Moving | Learning::Unloaded | Learning::Nothing => return force,
        };
        let learnt = learnt + force * (TICK / time);
        let size = norm(&learnt);
        let max = LEARNABLE * limit;
        self.learnt = if size > max { learnt * (max / size) } else { learnt }.into();
        force
    }
}
