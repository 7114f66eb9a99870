use nalgebra::SVector;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{TICK, math};

/// Bandwidth of the set-point's tracking loop [rad/s], close to the limit of the control period. A lower one
/// adds delay to that of the link.
const BANDWIDTH: f32 = 120.0;

/// Limits of a set-point's motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MotionLimits {
    /// Maximum speed [m/s, rad/s].
    pub speed: f32,
    /// Maximum acceleration [m/s², rad/s²].
    pub acceleration: f32,
}

/// The target relative to the set-point, with its derivatives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MotionTarget<const N: usize> {
    /// Displacement from the set-point to the target [m, rad].
    pub offset: SVector<f32, N>,
    pub velocity: SVector<f32, N>,
    pub acceleration: SVector<f32, N>,
}

impl MotionLimits {
    /// The acceleration, held for one control period, that moves a set-point with `velocity` towards its
    /// target.
    ///
    /// Close to the target: state feedback with two equal poles at `γ = e^(−ω·T)`, as in
    /// [`ErrorObserver`](crate::control::ErrorObserver). Far away: the speed from which half of the
    /// acceleration limit brakes in time.
    pub(crate) fn acceleration<const N: usize>(
        &self,
        velocity: &SVector<f32, N>,
        target: &MotionTarget<N>,
    ) -> SVector<f32, N> {
        let [of_offset, of_speed] = gains();
        let distance = math::norm(&target.offset);
        let approach = of_offset / of_speed;
        let max_speed = math::sqrt(self.acceleration * distance);
        let approach = if approach * distance > max_speed { max_speed / distance } else { approach };
        let desired =
            target.acceleration + (target.velocity - velocity + target.offset * approach) * of_speed;
        let next = velocity + limited(&desired, self.acceleration) * TICK;
        (limited(&next, self.speed) - velocity) * (1.0 / TICK)
    }

    /// From a set-point with `velocity`, the offset of the nearest target that it reaches without overshoot.
    pub(crate) fn way_to_rest<const N: usize>(&self, velocity: &SVector<f32, N>) -> SVector<f32, N> {
        let [of_offset, of_speed] = gains();
        velocity * math::max(of_speed / of_offset, math::norm(velocity) / self.acceleration)
    }

    /// The acceleration that brings the set-point to rest.
    pub(crate) fn stop<const N: usize>(&self, velocity: &SVector<f32, N>) -> SVector<f32, N> {
        limited(&(velocity * (-0.25 / TICK)), self.acceleration)
    }
}

/// Gains of the state feedback close to the target, for its offset [1/s²] and its relative velocity [1/s].
fn gains() -> [f32; 2] {
    let gap = 1.0 - math::exp(-BANDWIDTH * TICK);
    [gap * gap / (TICK * TICK), gap * (4.0 - gap) / (2.0 * TICK)]
}

fn limited<const N: usize>(vector: &SVector<f32, N>, max: f32) -> SVector<f32, N> {
    let square = vector.norm_squared();
    if square > max * max { vector * (max / math::sqrt(square)) } else { *vector }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector1;

    use super::*;

    const LIMITS: MotionLimits = MotionLimits { speed: 1.0, acceleration: 8.0 };

    /// Step response from rest to a target at rest: settling time to 0.1 % and relative overshoot.
    fn step_response(distance: f32) -> (f32, f32) {
        let (mut position, mut velocity, mut overshoot, mut time) = (0.0, 0.0, 0.0_f32, None);
        for tick in 0..400_u16 {
            let zero = Vector1::new(0.0);
            let target = MotionTarget {
                offset: Vector1::new(distance - position),
                velocity: zero,
                acceleration: zero,
            };
            let acceleration = LIMITS.acceleration(&Vector1::new(velocity), &target).x;
            assert!(
                acceleration.abs() < LIMITS.acceleration * 1.0001 && velocity.abs() < LIMITS.speed * 1.0001
            );
            position += velocity * TICK + 0.5 * acceleration * TICK * TICK;
            velocity += acceleration * TICK;
            overshoot = overshoot.max(position - distance);
            let settled = (distance - position).abs() < 1e-3 * distance;
            time = if settled { time.or(Some(f32::from(tick) * TICK)) } else { None };
        }
        (time.unwrap_or(f32::NAN), overshoot / distance)
    }

    #[test]
    fn the_way_to_rest_needs_no_overshoot() {
        // 1 m/s and half of 8 m/s²: 125 mm.
        let mut velocity = Vector1::new(1.0);
        let mut left = LIMITS.way_to_rest(&velocity).x;
        assert!((left - 0.125).abs() < 1e-6, "{left}");
        for _ in 0..100 {
            let (offset, zero) = (Vector1::new(left), Vector1::zeros());
            let target = MotionTarget { offset, velocity: zero, acceleration: zero };
            let acceleration = LIMITS.acceleration(&velocity, &target);
            left -= (velocity.x + 0.5 * acceleration.x * TICK) * TICK;
            velocity += acceleration * TICK;
            assert!(left > -1e-4 && velocity.x > -1e-3, "{left} m left, {velocity}");
        }
        assert!(left.abs() < 1e-4 && velocity.x.abs() < 1e-3, "{left} m left, {velocity}");
    }

    #[test]
    fn the_target_is_reached_within_the_limits_and_without_overshoot() {
        // Half a metre: 0.13 s to reach 1 m/s, 0.31 s at that speed, 0.25 s to brake with half of 8 m/s²:
        // 0.69 s.
        let (time, overshoot) = step_response(0.5);
        assert!((0.62..0.72).contains(&time) && overshoot < 2e-3, "{time} {overshoot}");
        let (time, overshoot) = step_response(1e-5);
        assert!(time < 0.12 && overshoot < 1e-3, "{time} {overshoot}");
    }
}
