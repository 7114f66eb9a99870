//! A joint of the robot: its state, its servo and its stops.

mod encoder;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::state::State;
use crate::TICK;
use crate::control::{JointPoint, JointServoState, STALL_SPEED, ServoMode};
use crate::math::{self, abs};
use crate::model::MAX_JOINTS;
use crate::robot::{Efforts, JointConfig, JointSetpoint, JointTarget, Measured, Robot, Targets};

pub(super) use encoder::Situation;

/// Maximum compensated lag of a drive, as a fraction of the period. A larger one amplifies torque steps more.
const MAX_COMPENSATED_LAG: f32 = 0.3;
/// Special value of the tick counter: the encoder was found dead and has not moved since.
const FOUND_DEAD: i8 = i8::MIN;
/// Decay per period of the feed-forward torques under [`Reaction::Damp`](crate::model::Reaction::Damp): a
/// contact force falls by four fifths within 0.3 s. After a sudden release, an elastic contact would throw
/// the joints back. Torques that drive the robot balance no contact, and decay faster.
const FEEDFORWARD_DECAY: f32 = 0.95;
const DRIVING_DECAY: f32 = 0.5;
/// Decrease of the compensated share of the weight per rise of a damped joint [1/rad], and its maximum.
const LESS_WEIGHT: f32 = 4.0;
const MAX_UNCOMPENSATED: f32 = 0.4;
/// Relative error of the model's weight of a held joint, of masses and torque constants together.
const HELD_WEIGHT_ERROR: f32 = 0.25;

/// State of a joint: encoder and servo.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct JointState {
    /// Count at angle 0; valid once homed.
    zero: i32,
    homed: bool,
    count: i32,
    /// Change of the angle in the last tick [rad].
    pub change: f32,
    /// Torque of the last tick [N·m], and the effort: of a servo, its part beyond the feed-forward; of a
    /// joint under [`Actuation::Acceleration`](crate::robot::Actuation), the torque for its acceleration; of
    /// a damped joint, the damping; 0 of commanded torques.
    pub torque: f32,
    pub effort: f32,
    /// Angle at the last motion and its change in that tick [rad], and the effort then [N·m] (of a damped
    /// joint: the torque beyond the weight).
    moved_to: f32,
    last_change: f32,
    moving_effort: f32,
    /// Consecutive ticks without a change under a torque that must move the joint, negative if its effort has
    /// grown downwards; or [`FOUND_DEAD`].
    unchanged: i8,
    /// The last tick in which the joint gained speed, and the number of consecutive ticks up to it in which
    /// it did so against its effort.
    gained_in: u32,
    running_away: u8,
    /// The last tick in which the joint exceeded its velocity limit after a velocity step larger than its
    /// drive can make.
    leapt_in: u32,
    /// How far the joint has been lifted against its weight since a stop began [rad].
    pub rise: f32,
    /// Magnitude of the torque beyond the weight when a stop began, before or after subtracting the
    /// acceleration torque, whichever is larger [N·m].
    pub pressed: f32,
    /// Smallest torque beyond the weight under which a held joint has stood still since its last motion
    /// [N·m], and the angle there [rad].
    stood: f32,
    stood_at: f32,
    /// Whether a held joint presses on a gripped object.
    pub grips: bool,
    pub servo: JointServoState,
}

/// Configuration, state and targets of one joint.
pub(super) struct Joint<'a> {
    pub config: &'a JointConfig,
    pub state: &'a mut JointState,
    /// Measured angle [rad] and velocity [rad/s].
    pub position: &'a mut f32,
    pub velocity: &'a mut f32,
    pub reference: &'a mut JointPoint,
    pub target: &'a mut JointTarget,
}

/// Configuration, state and targets of all joints, as lists.
pub(super) struct Joints<'a> {
    pub robot: &'a Robot,
    pub states: &'a mut [JointState],
    pub measured: &'a mut Measured,
    pub references: &'a mut [JointPoint],
    pub targets: &'a mut Targets,
}

impl Efforts for [JointState; MAX_JOINTS] {
    fn effort(&self, joint: usize) -> f32 {
        self.get(joint).map_or(0.0, |state| state.effort)
    }
}

impl<'a> Joints<'a> {
    /// The joints of `robot` with their `state`.
    pub const fn of(robot: &'a Robot, state: &'a mut State) -> Self {
        Self {
            robot,
            states: &mut state.joints,
            measured: &mut state.measured,
            references: &mut state.references,
            targets: &mut state.targets,
        }
    }

    /// Gravity torques at the measured angles [N·m].
    #[cold]
    #[inline(never)]
    pub fn weight(&self) -> [f32; MAX_JOINTS] {
        self.robot.gravity_torques(self.measured.angles(0..self.robot.joints().len()))
    }

    /// Iterates over all joints.
    #[inline]
    pub fn each(&mut self) -> impl Iterator<Item = Joint<'_>> {
        self.range(0, self.robot.joints().len())
    }

    /// Iterates over `length` joints from joint `first`.
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
            moved_to: 0.0,
            last_change: 0.0,
            moving_effort: 0.0,
            unchanged: 0,
            gained_in: 0,
            running_away: 0,
            leapt_in: 0,
            rise: 0.0,
            pressed: 0.0,
            stood: 0.0,
            stood_at: 0.0,
            grips: false,
            servo: JointServoState::at(0.0),
        }
    }

    /// The state with the longest encoding.
    #[cfg(test)]
    pub fn extreme() -> Self {
        Self {
            zero: i32::MIN,
            count: i32::MIN,
            unchanged: i8::MIN,
            gained_in: u32::MAX,
            leapt_in: u32::MAX,
            ..Self::new()
        }
    }

    /// The state under a new model. The joint stays homed if name and encoder are unchanged.
    pub fn configured(&self, config: &JointConfig, unchanged: bool) -> Self {
        let (zero, homed) = match config.zero {
            Some(zero) => (zero, true),
            None if unchanged => (self.zero, self.homed),
            None => (0, false),
        };
        Self { zero, homed, ..Self::new() }
    }

    /// The compensated share of the model's weight under damping. If masses or torque constants are wrong, an
    /// overcompensated joint rises by at most 0.1 rad, and an undercompensated one sinks against the damping.
    pub fn borne_weight(&self) -> f32 {
        1.0 - math::clamp(LESS_WEIGHT * self.rise, 0.0, MAX_UNCOMPENSATED)
    }

    /// Begins a stop in which the torque beyond the weight is `excess` [N·m].
    pub fn begin_hold(&mut self, excess: f32) {
        (self.stood, self.stood_at) = (abs(excess), self.moved_to);
    }

    /// Marks a relative encoder as not homed: its zero is lost.
    #[cold]
    pub const fn lose_zero(&mut self, config: &JointConfig) {
        self.homed &= config.zero.is_some();
    }

    /// Whether the encoder now reads the previous value of `other`'s, after a jump that no joint can make.
    #[cold]
    pub fn reads_that_of(&self, config: &JointConfig, other: &Self, of_other: &JointConfig) -> bool {
        let leaps = abs(self.change) > config.limits.velocity * TICK;
        #[expect(clippy::cast_precision_loss, reason = "a difference of angles")]
        let counts = self.count.wrapping_sub(other.count) as f32;
        let moved = counts + other.change / of_other.radians_per_count;
        leaps && abs(moved * config.radians_per_count) <= config.thresholds.fast
    }

    /// Whether the angle is known.
    pub const fn is_homed(&self) -> bool {
        self.homed
    }

    fn angle(&self, config: &JointConfig, count: i32) -> f32 {
        #[expect(clippy::cast_precision_loss, reason = "exact up to 2²⁴ counts from zero, then to 24 bits")]
        let counts = count.wrapping_sub(self.zero) as f32;
        counts * config.radians_per_count
    }

    /// Sets the torque to 0.
    pub fn release(&mut self) {
        (self.torque, self.effort) = (0.0, 0.0);
        self.servo.clear_torque();
    }

    /// Resets the servo, with all that it has learnt. It starts again when the joint is enabled.
    #[cold]
    pub fn forget(&mut self) {
        self.servo = JointServoState::at(0.0);
    }
}

impl Joint<'_> {
    /// Homes the joint: its present angle is `position` [rad].
    pub fn home(&mut self, position: f32) {
        self.trust_again();
        #[expect(
            clippy::cast_possible_truncation,
            reason = "saturates; the angle was checked against the limits"
        )]
        let counts = libm::roundf(position / self.config.radians_per_count) as i32;
        self.state.zero = self.state.count.wrapping_sub(counts);
        self.state.homed = true;
        *self.position = self.state.angle(self.config, self.state.count);
        self.hold_still();
    }

    /// Prepares for the first reading since power-on, a new model, or a silence of so many periods. After a
    /// silence the joint has moved with its mean velocity, otherwise with the one that it had: the position
    /// is set to that of one period ago.
    pub fn first_read(&mut self, count: i32, silence: Option<f32>) {
        let position = self.state.angle(self.config, count);
        if let Some(periods) = silence {
            let max = self.config.limits.velocity;
            *self.velocity = math::clamp((position - *self.position) / (periods * TICK), -max, max);
        }
        *self.position = position;
        self.trust_again();
        *self.position -= *self.velocity * TICK;
        self.state.change = 0.0;
        self.hold_still();
    }

    /// Prepares for a tick that comes several periods after the last one: estimates position and velocity one
    /// period ago, under the constant acceleration of a joint whose drive was off.
    pub fn catch_up(&mut self, count: i32, periods: f32) {
        let (before, max) = (*self.velocity, self.config.limits.velocity);
        let position = self.state.angle(self.config, count);
        let mean = (position - *self.position) / (periods * TICK);
        let now = math::clamp(2.0 * mean - before, -max, max);
        let last = now + (before - now) / periods;
        *self.position = position - 0.5 * (last + now) * TICK;
        *self.velocity = last;
    }

    /// Whether the joint cannot have moved from its last position to `count` in so many periods.
    #[cold]
    pub fn leaps_to(&self, count: i32, periods: f32) -> bool {
        let change = self.state.angle(self.config, count) - *self.position;
        abs(change) > self.config.thresholds.jump * periods
    }

    /// Reads the encoder in a tick.
    #[inline]
    pub fn read(&mut self, count: i32) {
        let state = &mut *self.state;
        state.count = count;
        let position = state.angle(self.config, count);
        state.change = position - *self.position;
        *self.position = position;
        self.config.differentiator.update(self.velocity, state.change);
    }

    /// Computes the reference of this tick from the target; goals pass the trajectory filter. Returns `false`
    /// for targets that need [`advance_far_or_braking`](Self::advance_far_or_braking) instead.
    #[inline]
    pub fn advance(&mut self) -> bool {
        if self.target.restart {
            self.target.restart = false;
            self.state.servo.restart_under_torque(*self.position);
        }
        *self.reference = match self.target.setpoint {
            JointSetpoint::Goal(goal) => self.config.servo.approach(&mut self.state.servo, goal),
            JointSetpoint::Point(point) => self.config.servo.follow(&mut self.state.servo, point),
            JointSetpoint::FarGoal(_) | JointSetpoint::Brake => return false,
        };
        true
    }

    /// Computes the reference of this tick for a far goal or while braking.
    pub fn advance_far_or_braking(&mut self) {
        let servo = &self.config.servo;
        *self.reference = match self.target.setpoint {
            JointSetpoint::FarGoal(goal) => {
                let (ahead, max) = (goal - self.reference.position, self.config.max_goal_distance());
                let near = if abs(ahead) > max {
                    self.reference.position + math::clamp(ahead, -max, max)
                } else {
                    self.target.setpoint = JointSetpoint::Goal(goal);
                    goal
                };
                servo.approach(&mut self.state.servo, near)
            }
            JointSetpoint::Brake => {
                let point = self.config.brake(self.reference);
                if point.velocity == 0.0 && point.acceleration == 0.0 {
                    self.target.setpoint = JointSetpoint::Goal(point.position);
                }
                servo.follow(&mut self.state.servo, point)
            }
            JointSetpoint::Goal(_) | JointSetpoint::Point(_) => return,
        };
    }

    /// Computes the torque of the servo, which adapts its disturbance estimate only if it `learns`.
    /// `model_torque` is the inverse dynamics at the reference [N·m].
    #[inline]
    pub fn control(&mut self, mode: ServoMode, model_torque: f32, learns: bool) {
        let feedforward = model_torque + self.target.feedforward;
        let Self { config, state, reference, position, .. } = self;
        let output = config.servo.compute(&mut state.servo, mode, reference, **position, feedforward, learns);
        self.state.torque = output.torque;
        self.state.effort = output.effort;
    }

    /// As [`control`](Self::control) for [`ServoMode::BarePid`].
    pub fn control_bare(&mut self, model_torque: f32, learns: bool) {
        let Self { config, state, reference, position, target, .. } = self;
        let (servo, contact) = (&mut state.servo, target.feedforward);
        let output = config.servo.bare_pid(servo, reference, **position, model_torque, contact, learns);
        self.state.torque = output.torque;
        self.state.effort = output.effort;
    }

    /// Bounds the torque of a joint that is held after a fault; `before` is the torque of the last tick
    /// [N·m]. Beyond its `weight` [N·m] and the error of that, the joint may press
    ///
    /// - at most as hard as when the stop began: it must not press harder against an obstacle;
    /// - while it stands still, at most with the smallest torque under which it has stood still since its
    ///   last motion: a new load moves the count of a working encoder, whereas behind a dead one the servo
    ///   would drive the joint on.
    ///
    /// Exceptions:
    ///
    /// - the joint grips: feed-forward forces act on a gripped object, so the second bound does not apply;
    /// - the torque is `against` the motion: it may be that of a damper;
    /// - it also `brakes`, that is, the joint slows down: it may stop the joint's inertia within a period;
    /// - `begins`, part of `brakes`: in the first ticks of a stop, also if the motion does not slow down yet,
    ///   because other joints that brake may drive this one;
    /// - `follows`: the reference still moves, and the joint stands still or moves against the torque: if the
    ///   encoder is dead, the torque shows it.
    pub fn bound_hold(&mut self, before: f32, weight: f32, begins: bool) {
        let (config, state, velocity) = (self.config, &mut *self.state, *self.velocity);
        let excess = state.torque - weight;
        let weight_error = HELD_WEIGHT_ERROR * abs(weight);
        let moved = abs(state.moved_to - state.stood_at) > 0.0;
        (state.stood, state.stood_at) =
            (if moved { abs(excess) } else { state.stood.min(abs(excess)) }, state.moved_to);
        let pressed = state.pressed + config.coulomb;
        let max = weight_error + if state.grips { pressed } else { pressed.min(state.stood) };
        let is_led = abs(self.reference.velocity) >= STALL_SPEED;
        // If the motion does not slow down, the opposing torque balances a push, or the encoder drifts.
        let slows = is_led || begins || abs(state.change) + config.thresholds.flicker < abs(velocity) * TICK;
        let follows = is_led && state.change * excess <= 0.0;
        let against = excess * velocity < 0.0;
        let brakes = slows && against && abs(velocity) * TICK > config.thresholds.moving;
        let max = match (brakes, against) {
            (true, _) => max + config.inertia * abs(velocity) / TICK,
            (false, true) => math::max(max, config.damping * abs(velocity)),
            (false, false) => max,
        };
        if abs(excess) <= max || follows {
            return;
        }
        let bounded =
            config.servo.limit_after(&mut state.servo, before, weight + math::clamp(excess, -max, max));
        state.effort += bounded - state.torque;
        state.torque = bounded;
    }

    /// Computes the torque without the servo: feed-forward, damping and, if `compensated`, gravity and
    /// friction compensation.
    #[inline(never)]
    pub fn push(&mut self, damping: f32, compensated: bool, model_torque: f32) {
        let compensation = if compensated {
            model_torque + self.config.servo.friction(&self.state.servo, self.reference.velocity)
        } else {
            0.0
        };
        let effort = self.target.feedforward - damping * *self.velocity;
        self.state.torque = self.config.servo.limit(&mut self.state.servo, compensation + effort);
        // A contact may balance the feed-forward torque, so a count that stands still is no sign of a dead
        // encoder.
        self.state.effort = 0.0;
    }

    /// Computes the torque from the inverse dynamics of the `links` [N·m], with a fraction of the `friction`
    /// fed forward. Returns the mean torque until the next tick [N·m], and the acceleration that the limits
    /// added [rad/s²].
    #[inline(never)]
    pub fn accelerate(&mut self, friction: f32, links: f32) -> [f32; 2] {
        let servo = &self.config.servo;
        let of_friction = friction * servo.friction(&self.state.servo, self.reference.velocity);
        let desired =
            links + servo.rotor_torque(self.reference.acceleration) + of_friction + self.target.feedforward;
        // Lag compensation: the last torque still acts for a fraction of the period. The mean becomes the
        // desired torque.
        let (before, lag) =
            (self.state.torque, math::clamp(servo.delay_fraction(), 0.0, MAX_COMPENSATED_LAG));
        let ahead = desired + (desired - before) * (lag / (1.0 - lag));
        self.state.torque = servo.limit(&mut self.state.servo, ahead);
        self.state.effort = self.config.inertia * self.reference.acceleration;
        let mean = self.state.torque + lag * (before - self.state.torque);
        [mean, servo.acceleration(mean - desired)]
    }

    /// Computes the torque of a damped joint: damping, the compensated part of the `gravity` torque [N·m],
    /// and a feed-forward torque that decays, faster if the feed-forward of all joints together is `driving`
    /// the robot. When damping `begins`, the feed-forward becomes the torque that has balanced a load so far,
    /// such as a contact force, or 0 if it was `driving` the robot.
    pub fn damp(&mut self, gravity: f32, begins: bool, driving: bool) {
        if begins {
            // The load so far is no sign of a dead encoder: growth counts from here on.
            self.state.moving_effort = self.state.torque - gravity;
        }
        let gravity = self.state.borne_weight() * gravity;
        if begins && driving {
            self.target.feedforward = 0.0;
        } else if begins {
            let acceleration = self.config.acceleration(self.state.change, *self.velocity);
            self.target.feedforward = self.state.torque - gravity - self.config.inertia * acceleration;
        }
        self.target.feedforward *= if driving { DRIVING_DECAY } else { FEEDFORWARD_DECAY };
        *self.reference = JointPoint { position: *self.position, ..JointPoint::default() };
        let effort = -self.config.damping * *self.velocity;
        let desired = gravity + self.target.feedforward + effort;
        self.state.torque = self.config.servo.limit(&mut self.state.servo, desired);
        // The damping that acts: the torque rate, or a feed-forward along the motion, may leave less of it.
        let applied = self.state.torque - gravity;
        self.state.effort = math::clamp(applied, math::min(effort, 0.0), math::max(effort, 0.0));
    }

    /// Prepares for a task: at rest at the present position. Requires an encoder that is not
    /// [dead](Self::check_still_dead).
    pub fn begin(&mut self) {
        self.state.unchanged = 0;
        self.hold_still();
    }

    /// Sets target and reference to the present position at rest. Keeps the adapted friction, and the present
    /// torque, from which the rate limit continues.
    pub fn hold_still(&mut self) {
        let position = *self.position;
        *self.target = JointTarget::at(position);
        *self.reference = JointPoint { position, ..JointPoint::default() };
        let state = &mut *self.state;
        state.servo.restart_under_torque(position);
        state.moved_to = position;
        (state.effort, state.last_change, state.moving_effort) = (0.0, 0.0, 0.0);
        state.running_away = 0;
        if state.unchanged != FOUND_DEAD {
            state.unchanged = 0;
        }
    }

    /// Brings the joint to rest: from its measured state if it has left its reference or `where_it_is` is
    /// set, else along the reference. Keeps the feed-forward torque. In the first case the reference is that
    /// of the time `ago` before the reading [s], and the disturbance estimate is reset, because it may be the
    /// force of pressing on an obstacle, to the `weight` that it has to carry [N·m].
    pub fn hold(&mut self, where_it_is: bool, weight: f32, ago: f32) {
        let error = self.reference.position - *self.position;
        if where_it_is || abs(error) > self.config.limits.following_error {
            let max = self.config.limits.velocity;
            let velocity = math::clamp(*self.velocity, -max, max);
            let position = *self.position - velocity * ago;
            *self.reference = JointPoint { position, velocity, acceleration: 0.0 };
            self.state.servo.restart_under_torque(*self.position);
            self.state.servo.carry(weight);
        }
        self.target.setpoint = JointSetpoint::Brake;
    }
}
