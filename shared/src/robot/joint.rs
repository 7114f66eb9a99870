use super::LimitRefusal;
use super::fault_thresholds::FaultThresholds;
use crate::TICK;
use crate::control::{JointPoint, JointServo};
use crate::math::{self, abs};
use crate::model::{JointLimits, JointModel};
use crate::signal::PseudoDifferentiator;

/// Cut-off frequency of the measured velocity [rad/s]. A higher one has less lag and more quantisation noise.
const VELOCITY_CUTOFF: f32 = 100.0;
/// Pole of the velocity filter, exp(−ωT) of [`VELOCITY_CUTOFF`]: the fraction of a velocity step that is
/// still missing after one period.
const VELOCITY_POLE: f32 = 0.367_879_44;

/// Largest share of a joint's velocity that damping removes in a period. The velocity is one period old:
/// above about one half, damping would oscillate.
const MAX_DAMPED_SHARE: f32 = 0.3;

/// A joint of a validated model, preprocessed for the tick.
#[derive(Clone, Debug)]
pub struct JointConfig {
    /// Its servo.
    pub servo: JointServo,
    /// Its limits.
    pub limits: JointLimits,
    /// Radians per encoder count; negative for a reversed encoder.
    pub(crate) radians_per_count: f32,
    pub(crate) amperes_per_count: f32,
    /// Count at angle 0 of an absolute encoder.
    pub(crate) zero: Option<i32>,
    pub(crate) differentiator: PseudoDifferentiator,
    /// Damping after a fault [N·m·s/rad].
    pub(crate) damping: f32,
    /// Inertia about the axis [kg·m²].
    pub(crate) inertia: f32,
    /// Coulomb friction of the model [N·m].
    pub(crate) coulomb: f32,
    pub(crate) thresholds: FaultThresholds,
}

impl JointConfig {
    /// Torque that moves the joint from rest by a number of counts within a time [N·m, s].
    #[inline]
    pub(crate) fn torque_for(&self, counts: f32, time: f32) -> f32 {
        self.inertia * (2.0 * counts * abs(self.radians_per_count) / (time * time))
    }

    /// `damping` is that of the robot after a fault [N·m·s/rad].
    pub(crate) fn new(joint: &JointModel, damping: f32) -> Self {
        let servo = JointServo::new(joint);
        Self {
            damping: damping.min(MAX_DAMPED_SHARE / (servo.acceleration(1.0) * TICK)),
            inertia: 1.0 / servo.acceleration(1.0),
            thresholds: FaultThresholds::new(joint, servo.torque_limit()),
            servo,
            limits: joint.limits,
            radians_per_count: joint.encoder.radians_per_count(),
            amperes_per_count: joint.motor.current_resolution,
            zero: (!joint.encoder.relative).then_some(joint.encoder.zero),
            differentiator: PseudoDifferentiator::new(VELOCITY_CUTOFF),
            coulomb: joint.friction.coulomb,
        }
    }

    /// The largest change of the angle in a period that is no jump of the encoder [rad], if the filtered
    /// velocity is `velocity` at its end [rad/s]. The filter has passed 63 % of a velocity step. The missing
    /// 37 % may be as large as the step that the largest torque makes in a period, so steps up to 2.7 times
    /// as large are accepted.
    pub(crate) fn max_leap(&self, velocity: f32) -> f32 {
        (abs(velocity) + self.largest_step()) * TICK
    }

    /// Change of the velocity by the largest torque in a period [rad/s].
    pub(crate) fn largest_step(&self) -> f32 {
        self.servo.acceleration(self.servo.torque_limit()) * TICK
    }

    /// Step of the velocity in the last period, from the `change` of the angle [rad] and the filtered
    /// `velocity` at its end [rad/s].
    pub(crate) fn velocity_step(&self, change: f32, velocity: f32) -> f32 {
        (change / TICK - velocity) / VELOCITY_POLE
    }

    /// The change of the filtered velocity in the last period, as an acceleration [rad/s²], from the `change`
    /// of the angle [rad] and the filtered `velocity` at its end [rad/s].
    pub(crate) fn acceleration(&self, change: f32, velocity: f32) -> f32 {
        (1.0 - VELOCITY_POLE) * self.velocity_step(change, velocity) / TICK
    }

    /// How far a goal may be ahead of the reference [rad]. The trajectory filter follows a goal that stays
    /// `d` ahead at the velocity `d/(2 T_f)`.
    pub(crate) fn max_goal_distance(&self) -> f32 {
        2.0 * self.limits.planned_speed() * self.servo.filter_time()
    }

    /// The reference one period after `reference`, from there on braking with half of the torque, or more
    /// near a joint limit.
    pub fn brake(&self, reference: &JointPoint) -> JointPoint {
        let here = reference.next();
        let JointPoint { position, velocity, .. } = here;
        let max = self.servo.acceleration(self.servo.torque_limit());
        let distance =
            if velocity > 0.0 { self.limits.upper - position } else { position - self.limits.lower };
        let required = if distance > 0.0 { velocity * velocity / (2.0 * distance) } else { max };
        let change = math::clamp(required, 0.5 * max, max) * TICK;
        let next = velocity - math::clamp(velocity, -change, change);
        JointPoint { acceleration: (next - velocity) / TICK, ..here }
    }

    /// Checks an angle [rad] of joint `joint`.
    ///
    /// # Errors
    /// It is not finite, or outside the limits.
    pub fn check_position(&self, joint: u8, value: f32) -> Result<(), LimitRefusal> {
        let JointLimits { lower, upper, .. } = self.limits;
        if !value.is_finite() {
            Err(LimitRefusal::NotFinite { joint })
        } else if value < lower || value > upper {
            Err(LimitRefusal::OutsideLimits { joint, value, lower, upper })
        } else {
            Ok(())
        }
    }

    /// Checks a streamed point of joint `joint` after `reference`.
    ///
    /// # Errors
    /// The first limit that the point exceeds.
    pub fn check_point(
        &self,
        joint: u8,
        point: &JointPoint,
        reference: &JointPoint,
    ) -> Result<(), LimitRefusal> {
        self.check_position(joint, point.position)?;
        if !point.velocity.is_finite() || !point.acceleration.is_finite() {
            return Err(LimitRefusal::NotFinite { joint });
        }
        if abs(point.velocity) > self.limits.velocity {
            return Err(LimitRefusal::TooFast { joint, value: point.velocity, limit: self.limits.velocity });
        }
        let limit = self.servo.acceleration(self.servo.torque_limit());
        if abs(point.acceleration) > limit {
            return Err(LimitRefusal::TooMuchAcceleration { joint, value: point.acceleration, limit });
        }
        let distance = abs(point.position - reference.position);
        if distance > self.limits.following_error {
            return Err(LimitRefusal::Jump { joint, value: distance, limit: self.limits.following_error });
        }
        Ok(())
    }

    /// Checks a feed-forward torque [N·m] of joint `joint`.
    ///
    /// # Errors
    /// It is not finite, or exceeds the torque limit.
    pub fn check_torque(&self, joint: u8, value: f32) -> Result<(), LimitRefusal> {
        let limit = self.servo.torque_limit();
        if !value.is_finite() {
            Err(LimitRefusal::NotFinite { joint })
        } else if abs(value) > limit {
            Err(LimitRefusal::TooMuchTorque { joint, value, limit })
        } else {
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_filter_leaves_out_is_that_of_its_cutoff() {
        assert!(abs(VELOCITY_POLE - math::exp(-VELOCITY_CUTOFF * TICK)) < 1e-7);
        // Hence the step follows from the change of the angle and the filtered velocity.
        let config = JointConfig::new(&crate::test_support::joint("joint"), 0.1);
        let mut velocity = 2.0;
        config.differentiator.update(&mut velocity, 5.0 * TICK);
        assert!(abs(config.velocity_step(5.0 * TICK, velocity) - 3.0) < 1e-5);
    }
}
