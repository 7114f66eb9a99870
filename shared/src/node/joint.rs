use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::control::{JointPoint, JointServoState, ServoMode};
use crate::fault::FaultCause;
use crate::math::{self, abs};
use crate::robot::{JointConfig, JointSetpoint, JointTarget, Measured, Robot, Targets};

/// Largest lag of a drive that is compensated, as a fraction of the period.
const MAX_CARRY: f32 = 0.3;
/// Ticks without a change of the count under a torque that should move the joint.
const STUCK_TICKS: u16 = 10;

/// Encoder and servo of a joint.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct JointState {
    /// Count at angle 0; of meaning once homed.
    zero: i32,
    homed: bool,
    count: i32,
    /// Change of the angle in the last tick [rad].
    change: f32,
    /// Torque of the last tick [N·m], and the part of it that the feed-forward does not explain.
    pub torque: f32,
    pub effort: f32,
    /// Ticks since the count changed.
    still: u16,
    pub servo: JointServoState,
}

/// All that belongs to one joint.
pub(super) struct Joint<'a> {
    pub config: &'a JointConfig,
    pub state: &'a mut JointState,
    /// Measured angle [rad] and velocity [rad/s].
    pub position: &'a mut f32,
    pub velocity: &'a mut f32,
    pub reference: &'a mut JointPoint,
    pub target: &'a mut JointTarget,
}

/// What the joints of a robot need in a tick, list by list.
pub(super) struct Joints<'a> {
    pub robot: &'a Robot,
    pub states: &'a mut [JointState],
    pub measured: &'a mut Measured,
    pub references: &'a mut [JointPoint],
    pub targets: &'a mut Targets,
}

impl Joints<'_> {
    /// All joints, one after the other.
    #[inline]
    pub fn each(&mut self) -> impl Iterator<Item = Joint<'_>> {
        self.range(0, self.robot.joints().len())
    }

    /// The joints from number `first` on, so many.
    #[inline]
    pub fn range(&mut self, first: usize, length: usize) -> impl Iterator<Item = Joint<'_>> {
        let range = first..first + length;
        let configs = self.robot.joints().get(range.clone()).unwrap_or_default();
        let states = self.states.get_mut(range.clone()).unwrap_or_default();
        let positions = self.measured.positions.get_mut(range.clone()).unwrap_or_default();
        let velocities = self.measured.velocities.get_mut(range.clone()).unwrap_or_default();
        let references = self.references.get_mut(range.clone()).unwrap_or_default();
        let targets = self.targets.joints.get_mut(range).unwrap_or_default();
        let measured = positions.iter_mut().zip(velocities);
        let commanded = references.iter_mut().zip(targets);
        configs.iter().zip(states).zip(measured.zip(commanded)).map(
            |((config, state), ((position, velocity), (reference, target)))| Joint {
                config,
                state,
                position,
                velocity,
                reference,
                target,
            },
        )
    }
}

impl JointState {
    pub const fn new() -> Self {
        Self {
            zero: 0,
            homed: false,
            count: 0,
            change: 0.0,
            torque: 0.0,
            effort: 0.0,
            still: 0,
            servo: JointServoState::at(0.0),
        }
    }

    /// The state with the longest encoding.
    #[cfg(test)]
    pub fn extreme() -> Self {
        Self { zero: i32::MIN, count: i32::MIN, still: u16::MAX, ..Self::new() }
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

    fn angle(&self, config: &JointConfig, count: i32) -> f32 {
        #[expect(
            clippy::cast_precision_loss,
            reason = "exact up to 2²⁴ counts from zero, and no joint turns further"
        )]
        let counts = count.wrapping_sub(self.zero) as f32;
        counts * config.radians_per_count
    }

    /// No torque.
    pub fn release(&mut self) {
        (self.torque, self.effort) = (0.0, 0.0);
        self.servo.clear_torque();
    }
}

impl Joint<'_> {
    /// The joint stands at `position` [rad] now.
    pub fn home(&mut self, position: f32) {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "saturates; the angle was checked against the limits"
        )]
        let counts = libm::roundf(position / self.config.radians_per_count) as i32;
        self.state.zero = self.state.count.wrapping_sub(counts);
        self.state.homed = true;
        self.restart();
    }

    /// Takes the encoder's count for the first time, or anew after a pause: no change, no velocity.
    pub fn first_read(&mut self, count: i32) {
        self.state.count = count;
        self.restart();
    }

    fn restart(&mut self) {
        *self.position = self.state.angle(self.config, self.state.count);
        *self.velocity = 0.0;
        (self.state.change, self.state.still) = (0.0, 0);
        self.hold_still();
    }

    /// Takes the encoder's count of this tick.
    #[inline]
    pub fn read(&mut self, count: i32) {
        let state = &mut *self.state;
        state.still = if count == state.count { state.still.saturating_add(1) } else { 0 };
        state.count = count;
        let position = state.angle(self.config, count);
        state.change = position - *self.position;
        *self.position = position;
        self.config.velocity.update(self.velocity, state.change);
    }

    /// What is wrong with the joint's readings, if anything: cause, value, limit.
    #[inline]
    pub fn inspect(&self, current: i16) -> Option<(FaultCause, f32, f32)> {
        let (config, state, position) = (self.config, &self.state, *self.position);
        if abs(state.change) > config.jump {
            return Some((FaultCause::EncoderJump, state.change, config.jump));
        }
        let current = f32::from(current);
        if abs(current) > config.current_limit {
            let scale = config.amperes_per_count;
            return Some((FaultCause::OverCurrent, current * scale, config.current_limit * scale));
        }
        if abs(*self.velocity) > config.limits.velocity {
            return Some((FaultCause::VelocityLimit, *self.velocity, config.limits.velocity));
        }
        if state.homed && position < config.lowest {
            return Some((FaultCause::PositionLimit, position, config.limits.lower));
        }
        if state.homed && position > config.highest {
            return Some((FaultCause::PositionLimit, position, config.limits.upper));
        }
        None
    }

    /// What is wrong with the joint under control, if anything: cause, value, limit.
    #[inline]
    pub fn supervise(&self) -> Option<(FaultCause, f32, f32)> {
        let (config, state) = (self.config, &self.state);
        let error = self.reference.position - *self.position;
        if abs(error) > config.limits.following_error {
            return Some((FaultCause::FollowingError, error, config.limits.following_error));
        }
        // A joint that presses on an object stands still under torque.
        let presses = self.target.feedforward != 0.0;
        if state.still >= STUCK_TICKS && abs(state.effort) > config.breakaway && !presses {
            return Some((FaultCause::EncoderStuck, state.effort, config.breakaway));
        }
        None
    }

    /// Takes the target of this tick for the reference, by way of the trajectory filter where it is a goal.
    #[inline]
    pub fn advance(&mut self) {
        if self.target.restart {
            self.target.restart = false;
            self.state.servo.restart(*self.position);
        }
        *self.reference = match self.target.setpoint {
            JointSetpoint::Goal(goal) => self.config.servo.approach(&mut self.state.servo, goal),
            JointSetpoint::Point(point) => self.config.servo.follow(&mut self.state.servo, point),
        };
    }

    /// The torque of this tick by the servo, given the model's torque for the reference [N·m].
    #[inline]
    pub fn control(&mut self, mode: ServoMode, model_torque: f32) {
        let known = model_torque + self.target.feedforward;
        let servo = &mut self.state.servo;
        let output = self.config.servo.update(servo, mode, self.reference, *self.position, known);
        self.state.torque = output.torque;
        self.state.effort = output.effort;
    }

    /// The torque of this tick without the servo: the task's own and damping, and for `compensated` links the model's.
    #[inline(never)]
    pub fn push(&mut self, damping: f32, compensated: bool, model_torque: f32) {
        let known = if compensated {
            model_torque + self.config.servo.friction(&self.state.servo, self.reference.velocity)
        } else {
            0.0
        };
        let desired = known + self.target.feedforward - damping * *self.velocity;
        self.state.torque = self.config.servo.limit(&mut self.state.servo, desired);
        self.state.effort = 0.0;
    }

    /// The torque of this tick from the torque of the chain's links for the reference, with this fraction of the friction fed
    /// forward. Returns the acceleration that the limits added [rad/s²], and the mean torque until the next tick [N·m].
    #[inline(never)]
    pub fn accelerate(&mut self, friction: f32, links: f32) -> [f32; 2] {
        let servo = &self.config.servo;
        let of_friction = friction * servo.friction(&self.state.servo, self.reference.velocity);
        let desired =
            links + servo.rotor_torque(self.reference.acceleration) + of_friction + self.target.feedforward;
        // The rest of the last torque is compensated, so that the mean over the period is the desired torque.
        let (before, carry) = (self.state.torque, math::clamp(servo.delay_fraction(), 0.0, MAX_CARRY));
        let ahead = desired + (desired - before) * (carry / (1.0 - carry));
        self.state.torque = servo.limit(&mut self.state.servo, ahead);
        self.state.effort = 0.0;
        let mean = self.state.torque + carry * (before - self.state.torque);
        [servo.acceleration(mean - desired), mean]
    }

    /// The torque against the motion.
    pub fn damp(&mut self, damping: f32) {
        self.state.torque = self.config.servo.limit(&mut self.state.servo, -damping * *self.velocity);
        self.state.effort = 0.0;
    }

    /// At rest where the joint is, everything learnt but the friction forgotten.
    pub fn hold_still(&mut self) {
        let position = *self.position;
        *self.target = JointTarget::at(position);
        *self.reference = JointPoint { position, ..JointPoint::default() };
        let state = &mut *self.state;
        state.servo.restart(position);
        (state.torque, state.effort, state.still) = (0.0, 0.0, 0);
    }

    /// Comes to rest: where the joint is, or else along the reference. The task's torque stays.
    pub fn hold(&mut self, at_once: bool) {
        let goal = if at_once { *self.position } else { self.state.servo.resting_point() };
        self.target.setpoint = JointSetpoint::Goal(goal);
        if at_once {
            self.state.servo.restart_reference(*self.position);
        }
    }
}
