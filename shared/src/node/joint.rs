use core::f32::consts::TAU;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::TICK;
use crate::control::{JointPoint, JointServo, JointServoState, ServoMode};
use crate::math::{self, abs};
use crate::model::{JointLimits, JointModel};
use crate::protocol::{FaultCause, Refusal};
use crate::signal::PseudoDifferentiator;

/// Cut-off of the velocity that is watched and shown [rad/s].
const VELOCITY_CUTOFF: f32 = 100.0;
/// Counts by which a sound encoder may err between two ticks.
const COUNT_NOISE: f32 = 2.0;
/// A motion this many times faster than the velocity limit is the encoder's, not the joint's.
const JUMP_FACTOR: f32 = 2.0;
/// A sensor may read a little beyond what the current loop was asked for.
const CURRENT_MARGIN: f32 = 1.25;
/// Most of a drive's lag that is made up for, as a share of the period.
const MOST_CARRY: f32 = 0.3;
/// Ticks without a change of the count under a torque that should move the joint.
const STUCK_TICKS: u16 = 10;

/// What a joint is, made ready for the tick.
#[derive(Clone, Debug)]
pub(super) struct JointConfig {
    pub servo: JointServo,
    limits: JointLimits,
    /// Signed.
    radians_per_count: f32,
    /// A current beyond it, in counts, is a fault.
    current_limit: f32,
    amperes_per_count: f32,
    /// A change of the angle beyond it in one tick is the encoder's, not the joint's [rad].
    jump: f32,
    /// Angles beyond these are a fault: the limits, and room for a permitted error of following [rad].
    lowest: f32,
    highest: f32,
    /// Count at angle 0 of an absolute encoder.
    zero: Option<i32>,
    velocity: PseudoDifferentiator,
    /// Torque beyond the feed-forward that surely moves the joint [N·m].
    breakaway: f32,
}

/// What a joint does.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct JointState {
    /// Count at angle 0; of meaning once homed.
    zero: i32,
    homed: bool,
    count: i32,
    /// Angle, velocity [rad, rad/s].
    pub position: f32,
    pub velocity: f32,
    /// Change of the angle in the last tick [rad].
    change: f32,
    /// Torque of the last tick [N·m], and the part of it that the feed-forward does not explain.
    pub torque: f32,
    pub effort: f32,
    /// Torque that the task adds for forces on an object [N·m]. It stays in [`Reaction::Hold`](crate::model::Reaction).
    pub feedforward: f32,
    /// Ticks since the count changed.
    still: u16,
    pub goal: f32,
    pub streamed: JointPoint,
    pub reference: JointPoint,
    pub servo: JointServoState,
}

impl JointConfig {
    pub fn new(joint: &JointModel) -> Self {
        let turn = TAU / joint.encoder.counts_per_turn;
        Self {
            servo: JointServo::new(joint),
            limits: joint.limits,
            radians_per_count: if joint.encoder.reversed { -turn } else { turn },
            current_limit: CURRENT_MARGIN * joint.motor.current_limit / joint.motor.current_resolution,
            amperes_per_count: joint.motor.current_resolution,
            jump: JUMP_FACTOR * joint.limits.velocity * TICK + COUNT_NOISE * turn,
            lowest: joint.limits.lower - joint.limits.following_error,
            highest: joint.limits.upper + joint.limits.following_error,
            zero: (!joint.encoder.relative).then_some(joint.encoder.zero),
            velocity: PseudoDifferentiator::new(VELOCITY_CUTOFF),
            breakaway: 2.0 * joint.friction.coulomb + 0.1 * joint.limits.torque,
        }
    }

    /// Whether the angle may be commanded.
    pub fn check_position(&self, joint: u8, value: f32) -> Result<(), Refusal> {
        let JointLimits { lower, upper, .. } = self.limits;
        if !value.is_finite() {
            Err(Refusal::NotFinite { joint })
        } else if value < lower || value > upper {
            Err(Refusal::OutsideLimits { joint, value, lower, upper })
        } else {
            Ok(())
        }
    }

    /// Whether the streamed point may follow `reference`.
    pub fn check_point(&self, joint: u8, point: &JointPoint, reference: &JointPoint) -> Result<(), Refusal> {
        self.check_position(joint, point.position)?;
        if !point.velocity.is_finite() || !point.acceleration.is_finite() {
            return Err(Refusal::NotFinite { joint });
        }
        if abs(point.velocity) > self.limits.velocity {
            return Err(Refusal::TooFast { joint, value: point.velocity, limit: self.limits.velocity });
        }
        let limit = self.servo.acceleration(self.limits.torque);
        if abs(point.acceleration) > limit {
            return Err(Refusal::TooMuchAcceleration { joint, value: point.acceleration, limit });
        }
        let distance = abs(point.position - reference.position);
        if distance > self.limits.following_error {
            return Err(Refusal::Jump { joint, value: distance, limit: self.limits.following_error });
        }
        Ok(())
    }
}

impl JointState {
    pub const fn new() -> Self {
        const REST: JointPoint = JointPoint { position: 0.0, velocity: 0.0, acceleration: 0.0 };
        Self {
            zero: 0,
            homed: false,
            count: 0,
            position: 0.0,
            velocity: 0.0,
            change: 0.0,
            torque: 0.0,
            effort: 0.0,
            feedforward: 0.0,
            still: 0,
            goal: 0.0,
            streamed: REST,
            reference: REST,
            servo: JointServoState::at(0.0),
        }
    }

    /// The state with the longest encoding.
    #[cfg(test)]
    pub fn extreme() -> Self {
        let most = JointPoint { position: f32::MIN, velocity: f32::MIN, acceleration: f32::MIN };
        let (goal, streamed, reference) = (f32::MIN, most, most);
        let feedforward = f32::MIN;
        let still = u16::MAX;
        Self { zero: i32::MIN, count: i32::MIN, still, goal, streamed, reference, feedforward, ..Self::new() }
    }

    /// A joint that was just given its model. It stays homed if it is `the_same` joint with the same encoder.
    pub fn configured(&self, config: &JointConfig, the_same: bool) -> Self {
        let (zero, homed) = match config.zero {
            Some(zero) => (zero, true),
            None if the_same => (self.zero, self.homed),
            None => (0, false),
        };
        Self { zero, homed, ..Self::new() }
    }

    /// Whether the angle is known.
    pub const fn is_homed(&self) -> bool {
        self.homed
    }

    /// The joint stands at `position` now.
    pub fn home(&mut self, config: &JointConfig, position: f32) {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "saturates; the angle was checked against the limits"
        )]
        let counts = libm::roundf(position / config.radians_per_count) as i32;
        self.zero = self.count.wrapping_sub(counts);
        self.homed = true;
        self.restart(config);
    }

    /// Takes the encoder's count for the first time, or anew after a pause: no change, no velocity.
    pub fn first_read(&mut self, config: &JointConfig, count: i32) {
        self.count = count;
        self.restart(config);
    }

    fn restart(&mut self, config: &JointConfig) {
        self.position = self.angle(config, self.count);
        (self.change, self.velocity, self.still) = (0.0, 0.0, 0);
        self.hold_still();
    }

    /// Takes the encoder's count of this tick.
    pub fn read(&mut self, config: &JointConfig, count: i32) {
        self.still = if count == self.count { self.still.saturating_add(1) } else { 0 };
        self.count = count;
        let position = self.angle(config, count);
        self.change = position - self.position;
        self.position = position;
        config.velocity.update(&mut self.velocity, self.change);
    }

    fn angle(&self, config: &JointConfig, count: i32) -> f32 {
        #[expect(
            clippy::cast_precision_loss,
            reason = "exact up to 2²⁴ counts from zero, and no joint turns further"
        )]
        let counts = count.wrapping_sub(self.zero) as f32;
        counts * config.radians_per_count
    }

    /// What is wrong with the joint's readings, if anything.
    pub fn inspect(&self, config: &JointConfig, current: i16) -> Option<(FaultCause, f32, f32)> {
        if abs(self.change) > config.jump {
            return Some((FaultCause::EncoderJump, self.change, config.jump));
        }
        let current = f32::from(current);
        if abs(current) > config.current_limit {
            let scale = config.amperes_per_count;
            return Some((FaultCause::OverCurrent, current * scale, config.current_limit * scale));
        }
        if abs(self.velocity) > config.limits.velocity {
            return Some((FaultCause::VelocityLimit, self.velocity, config.limits.velocity));
        }
        if self.homed && self.position < config.lowest {
            return Some((FaultCause::PositionLimit, self.position, config.limits.lower));
        }
        if self.homed && self.position > config.highest {
            return Some((FaultCause::PositionLimit, self.position, config.limits.upper));
        }
        None
    }

    /// What is wrong with the joint under control, if anything.
    pub fn supervise(&self, config: &JointConfig) -> Option<(FaultCause, f32, f32)> {
        let error = self.reference.position - self.position;
        if abs(error) > config.limits.following_error {
            return Some((FaultCause::FollowingError, error, config.limits.following_error));
        }
        // A joint that presses on an object stands still under torque.
        let presses = self.feedforward != 0.0;
        if self.still >= STUCK_TICKS && abs(self.effort) > config.breakaway && !presses {
            return Some((FaultCause::EncoderStuck, self.effort, config.breakaway));
        }
        None
    }

    /// The reference of this tick.
    pub fn advance(&mut self, config: &JointConfig, streaming: bool) {
        self.reference = if streaming {
            let point = self.streamed;
            // A point that no other follows is one to stand at.
            self.streamed = JointPoint { velocity: 0.0, acceleration: 0.0, ..point };
            config.servo.follow(&mut self.servo, point)
        } else {
            config.servo.approach(&mut self.servo, self.goal)
        };
    }

    /// The torque of this tick, given the model's torque for the reference.
    pub fn control(&mut self, config: &JointConfig, mode: ServoMode, model_torque: f32) {
        let known = model_torque + self.feedforward;
        let output = config.servo.update(&mut self.servo, mode, &self.reference, self.position, known);
        self.torque = output.torque;
        self.effort = output.effort;
    }

    /// The torque of this tick without the servo: the task's own and damping, and for `compensated` fingers the model's.
    #[inline(never)]
    pub fn push(&mut self, config: &JointConfig, damping: f32, compensated: bool, model_torque: f32) {
        let known = if compensated {
            model_torque + config.servo.friction(&self.servo, self.reference.velocity)
        } else {
            0.0
        };
        self.torque = config.servo.limit(&mut self.servo, known + self.feedforward - damping * self.velocity);
        self.effort = 0.0;
    }

    /// The torque of this tick from the torque of the arm's links for the reference. Returns the acceleration that the
    /// limits leave undone [rad/s²], and the mean torque until the next tick [N·m].
    #[inline(never)]
    pub fn accelerate(&mut self, config: &JointConfig, friction: f32, links: f32) -> [f32; 2] {
        let of_friction = friction * config.servo.friction(&self.servo, self.reference.velocity);
        let wanted =
            links + config.servo.rotor_torque(self.reference.acceleration) + of_friction + self.feedforward;
        // What is left of the last torque is made up for, so that the mean over the period is what is wanted.
        let (before, carry) = (self.torque, math::clamp(config.servo.delay_fraction(), 0.0, MOST_CARRY));
        let ahead = wanted + (wanted - before) * (carry / (1.0 - carry));
        self.torque = config.servo.limit(&mut self.servo, ahead);
        self.effort = 0.0;
        let mean = self.torque + carry * (before - self.torque);
        [config.servo.acceleration(mean - wanted), mean]
    }

    /// Whether the task may add this torque.
    pub fn check_torque(config: &JointConfig, joint: u8, value: f32) -> Result<(), Refusal> {
        let limit = config.servo.torque_limit();
        if !value.is_finite() {
            Err(Refusal::NotFinite { joint })
        } else if abs(value) > limit {
            Err(Refusal::TooMuchTorque { joint, value, limit })
        } else {
            Ok(())
        }
    }

    /// The torque against the motion.
    pub fn damp(&mut self, config: &JointConfig, damping: f32) {
        self.torque = config.servo.limit(&mut self.servo, -damping * self.velocity);
        self.effort = 0.0;
    }

    /// No torque.
    pub fn release(&mut self) {
        (self.torque, self.effort, self.feedforward) = (0.0, 0.0, 0.0);
        self.servo.clear_torque();
    }

    /// At rest where the joint is, everything learnt forgotten.
    pub fn hold_still(&mut self) {
        self.goal = self.position;
        self.reference = JointPoint { position: self.position, ..JointPoint::default() };
        self.streamed = self.reference;
        self.servo.restart(self.position);
        (self.torque, self.effort, self.feedforward, self.still) = (0.0, 0.0, 0.0, 0);
    }

    /// Comes to rest: where the joint is, or else along the reference.
    pub fn hold(&mut self, at_once: bool) {
        self.goal = if at_once { self.position } else { self.servo.resting_point() };
        if at_once {
            self.servo.restart_reference(self.position);
        }
    }
}
