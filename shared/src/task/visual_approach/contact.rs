//! Contact of the hand, as the torques of the joints show it.

use nalgebra::{Matrix6, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::reference::Arm;
use crate::TICK;
use crate::kinematics::Posture;
use crate::math::Ldlt;
use crate::model::MAX_CHAIN_JOINTS;
use crate::robot::Efforts;

/// Times in which changes of the efforts are learnt while the hand moves and while it stands [s]: errors of the weight,
/// which the posture changes, and what the servos learn.
const LEARNING_TIME: [f32; 2] = [1.0, 0.15];
/// Damping of the inverse Jacobian [m, rad]: near a singular posture the force cannot be known.
const DAMPING: f32 = 0.05;

/// Estimates the force on the hand from the efforts of the arm's joints: what their drives do beyond what the
/// model explains. What they do while the hand stands, and slow changes of a small force while it moves, are taken for
/// errors of the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ContactEstimate {
    /// Efforts without contact [N·m].
    baseline: [f32; MAX_CHAIN_JOINTS],
}

impl ContactEstimate {
    pub const NONE: Self = Self { baseline: [0.0; MAX_CHAIN_JOINTS] };

    /// The force on the hand in base axes [N], as of the last period, at `posture`. Moving, forces below half of `limit`
    /// [N] are learnt.
    pub fn update(
        &mut self,
        arm: &Arm<'_>,
        posture: &Posture,
        efforts: &dyn Efforts,
        stands: bool,
        limit: f32,
    ) -> Vector3<f32> {
        let jacobian = arm.jacobian(posture);
        let mut beyond = nalgebra::SVector::<f32, MAX_CHAIN_JOINTS>::zeros();
        for (index, own) in arm.indices() {
            let effort = efforts.effort(index);
            // What the drives do balances the force.
            beyond[own] = self.baseline[own] - effort;
        }
        let damped = jacobian * jacobian.transpose() + Matrix6::from_diagonal_element(DAMPING * DAMPING);
        let wrench = Ldlt::new(&damped, 1e-9).solve(&(jacobian * beyond));
        let force: Vector3<f32> = wrench.fixed_rows::<3>(0).into_owned();
        if stands || force.norm_squared() < 0.25 * limit * limit {
            let time = LEARNING_TIME[usize::from(stands)];
            for (_, own) in arm.indices() {
                self.baseline[own] -= beyond[own] * (TICK / time);
            }
        }
        force
    }
}
