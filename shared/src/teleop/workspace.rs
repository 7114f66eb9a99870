use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::signal::MotionLimits;
use crate::{TICK, math};

/// Fraction of the distance to the border that the set-point may cover in one period, near the border.
const APPROACH: f32 = 0.25;

/// A box that a set-point does not leave, in axes of the arm's base [m].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Workspace {
    /// Minimum of x, y and z.
    pub lower: [f32; 3],
    /// Maximum of x, y and z.
    pub upper: [f32; 3],
}

impl Workspace {
    /// Whether a position [m] is inside or at the border.
    pub fn contains(&self, position: &[f32; 3]) -> bool {
        let mut axes = position.iter().zip(self.lower.iter().zip(&self.upper));
        axes.all(|(value, (lower, upper))| (lower..=upper).contains(&value))
    }

    /// Limits the acceleration, held for one period, so that the set-point stays in the box: along each axis
    /// it approaches the border no faster than the speed from which half of the acceleration limit brakes in
    /// time. Outside the box it can only return.
    pub(super) fn limit(
        &self,
        limits: &MotionLimits,
        position: &Vector3<f32>,
        velocity: &Vector3<f32>,
        acceleration: &Vector3<f32>,
    ) -> Vector3<f32> {
        let mut limited = *acceleration;
        let borders = self.lower.iter().zip(&self.upper);
        let states = position.iter().zip(velocity.iter()).zip(borders);
        for (acceleration, ((&position, &velocity), (&lower, &upper))) in limited.iter_mut().zip(states) {
            let next = position + velocity * TICK;
            // Comparisons, so that an acceleration that stays inside keeps its exact bits.
            let max = (max_speed(limits, upper - next) - velocity) * (1.0 / TICK);
            let min = (-max_speed(limits, next - lower) - velocity) * (1.0 / TICK);
            if *acceleration > max {
                *acceleration = max;
            } else if *acceleration < min {
                *acceleration = min;
            }
        }
        limited
    }
}

/// Maximum speed towards a border at this distance [m/s].
fn max_speed(limits: &MotionLimits, distance: f32) -> f32 {
    if distance > 0.0 {
        math::sqrt(limits.acceleration * distance).min(distance * (APPROACH / TICK))
    } else {
        0.0
    }
}
