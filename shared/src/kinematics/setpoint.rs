use nalgebra::{Quaternion, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{TICK, math};

/// Set-point of a tool in the base frame: pose, twist, and its derivative.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PosePoint {
    /// Position [m].
    pub position: [f32; 3],
    /// Orientation as a unit quaternion, `[x, y, z, w]`.
    pub rotation: [f32; 4],
    /// `[v; ω]` [m/s, rad/s].
    pub velocity: [f32; 6],
    /// Its derivative [m/s², rad/s²].
    pub acceleration: [f32; 6],
}

/// Set-point of the elbow: angle of the driven joint, or the arm angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ElbowSetpoint {
    /// Angle [rad].
    pub angle: f32,
    /// Its first derivative [rad/s].
    pub velocity: f32,
    /// Its second derivative [rad/s²].
    pub acceleration: f32,
}

/// Decay of the velocity per period without a new set-point: it comes to rest within 0.2 s. A larger one
/// coasts farther; a smaller one brakes harder.
const COAST_DECAY: f32 = 0.8;
/// Time at the present velocity that takes a set-point as far as it coasts [s].
pub(crate) const COAST_TIME: f32 = TICK / (1.0 - COAST_DECAY);

impl PosePoint {
    /// The set-point displaced by `[p; r]` [m, rad], a vector and a rotation vector in the base frame.
    #[must_use]
    pub(crate) fn moved_by(&self, displacement: &Vector6<f32>) -> Self {
        let [linear, angular] = math::halves(displacement);
        let rotation = math::rotated_by(&math::orientation(self.rotation), &angular);
        let position = Vector3::from(self.position) + linear;
        Self { position: position.into(), rotation: rotation.coords.into(), ..*self }
    }

    /// The set-point after one period without a successor: it coasts to rest.
    #[must_use]
    pub(crate) fn coasted(&self) -> Self {
        let mut next = Self { acceleration: [0.0; 6], ..self.advanced(TICK) };
        next.velocity.iter_mut().for_each(|speed| *speed *= COAST_DECAY);
        next
    }

    /// The set-point after a time [s] with its velocity, which it keeps.
    fn advanced(&self, time: f32) -> Self {
        let mut next = *self;
        let [vx, vy, vz, wx, wy, wz] = self.velocity;
        next.position.iter_mut().zip([vx, vy, vz]).for_each(|(position, speed)| *position += speed * time);
        if [wx, wy, wz].iter().any(|rate| *rate != 0.0) {
            // First-order integration of the quaternion, normalised: the rotation is small.
            let rotation = math::quaternion(self.rotation);
            let change = Quaternion::new(0.0, wx, wy, wz) * rotation * (0.5 * time);
            let rotated = rotation + change;
            let scale = 1.0 / math::sqrt(rotated.norm_squared());
            next.rotation = (rotated * scale).coords.into();
        }
        next
    }

    /// Where the set-point coasts to after one period of its acceleration, with the velocity at its start.
    #[must_use]
    pub(crate) fn coasted_to_rest(&self) -> Self {
        let mut next = *self;
        let speeds = next.velocity.iter_mut().zip(&self.acceleration);
        speeds.for_each(|(speed, acceleration)| *speed += acceleration * TICK);
        next.advanced(COAST_TIME)
    }
}

impl ElbowSetpoint {
    /// The set-point after one period without a successor: it coasts to rest.
    #[must_use]
    pub(crate) const fn coasted(&self) -> Self {
        Self {
            angle: self.angle + self.velocity * TICK,
            velocity: COAST_DECAY * self.velocity,
            acceleration: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_displacement_rotates_by_its_whole_angle() {
        let point = PosePoint {
            position: [0.1, 0.2, 0.3],
            rotation: [0.0, 0.0, 0.0, 1.0],
            velocity: [0.0; 6],
            acceleration: [0.0; 6],
        };
        let moved = point.moved_by(&Vector6::new(0.01, 0.0, -0.02, 0.0, 1.0, 0.0));
        // sin 0.5 and cos 0.5.
        let expected = [0.11, 0.2, 0.28, 0.0, 0.479_425_54, 0.0, 0.877_582_6];
        let found = moved.position.iter().chain(&moved.rotation);
        assert!(found.zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6), "{moved:?}");
    }
}
