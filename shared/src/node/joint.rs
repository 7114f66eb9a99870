use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::TICK;
use crate::control::{JointPoint, JointServoState, STALL_SPEED, ServoMode};
use crate::fault::FaultCause;
use crate::math::{self, abs};
use crate::model::MAX_JOINTS;
use crate::robot::{
    CONFIRMED_SHARE, Efforts, JointConfig, JointSetpoint, JointTarget, Measured, Robot, Targets,
};

/// Maximum compensated lag of a drive, as a fraction of the period. A larger one amplifies torque steps more.
const MAX_COMPENSATED_LAG: f32 = 0.3;
/// Ticks without a change of the angle, under a torque that moves the joint, after which the encoder is
/// stuck. More ticks let a dead encoder accelerate the joint longer; fewer mistake quantisation for it.
const STUCK_TICKS: u8 = 2;
/// Share of the growth of an acceleration torque from which on the number of such ticks stays as it is.
const HYSTERESIS_SHARE: f32 = 0.4;
/// In place of a number of such ticks: the encoder was found dead, and has not moved since.
const FOUND_DEAD: u8 = u8::MAX;
/// Ticks in which a joint gains speed against its torque, after which it runs away. More ticks let it gain
/// more; fewer mistake a rebound for it.
const RUNAWAY_TICKS: u8 = 3;
/// Decay per period of the feed-forward torques under [`Reaction::Damp`](crate::model::Reaction::Damp): four
/// fifths of a contact force are released within 0.3 s. A step would let what is pressed whip the joints
/// back. Torques that drive the robot balance no contact, and decay faster.
const FEEDFORWARD_DECAY: f32 = 0.95;
const DRIVING_DECAY: f32 = 0.5;
/// Decrease of the compensated share of the weight per rise of a damped joint [1/rad], and largest one.
const LESS_WEIGHT: f32 = 4.0;
const MAX_UNCOMPENSATED: f32 = 0.4;
/// Fraction by which the model's weight of a held joint may be wrong: masses and torque constants by 10 % to
/// 15 % each.
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
    /// Torque of the last tick, and its part beyond the feed-forward [N·m].
    pub torque: f32,
    pub effort: f32,
    /// Where the joint was when it moved last, the change of the angle in that tick [rad], and the effort
    /// then; of a damped joint, the torque beyond the weight [N·m].
    moved_to: f32,
    last_change: f32,
    moving_effort: f32,
    /// Ticks in a row without a change under a torque that moves the joint, or [`FOUND_DEAD`].
    unchanged: u8,
    /// The last tick in which the joint gained speed, and the ticks in a row up to there in which it did so
    /// against its effort.
    gained_in: u32,
    running_away: u8,
    /// The last tick in which the joint exceeded its velocity limit by more than its drive is capable of.
    leapt_in: u32,
    /// How far the joint has been lifted against its weight since a stop began [rad].
    pub rise: f32,
    /// The torque beyond weight and acceleration when a stop began [N·m].
    pub pressed: f32,
    /// The least torque beyond the weight under which a held joint has stood since its count changed last
    /// [N·m], and where [rad].
    stood: f32,
    stood_at: f32,
    pub servo: JointServoState,
}

/// What a standing joint's effort is judged by.
#[derive(Clone, Copy)]
pub(super) struct Situation {
    /// The robot is brought to rest, and nothing has to press.
    pub stops: bool,
    /// The efforts are those of accelerations, without weight and contact forces.
    pub accelerates: bool,
    /// The force sensor of the joint's chain reads a contact, which may hold the joint.
    pub presses: bool,
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

impl Joints<'_> {
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
            servo: JointServoState::at(0.0),
        }
    }

    /// The state with the longest encoding.
    #[cfg(test)]
    pub fn extreme() -> Self {
        Self {
            zero: i32::MIN,
            count: i32::MIN,
            unchanged: u8::MAX,
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

    /// The share of the model's weight that damping bears. Masses and torque constants may be wrong by 20 %
    /// each: a joint that bears too much rises by 0.1 rad at most, one that bears too little sinks against
    /// the damping.
    pub fn borne_weight(&self) -> f32 {
        1.0 - math::clamp(LESS_WEIGHT * self.rise, 0.0, MAX_UNCOMPENSATED)
    }

    /// Begins a stop in which the torque beyond the weight is `excess` [N·m].
    pub fn begin_hold(&mut self, excess: f32) {
        (self.stood, self.stood_at) = (abs(excess), self.moved_to);
    }

    /// An encoder that counts from where it was switched on has lost its zero.
    #[cold]
    pub const fn lose_zero(&mut self, config: &JointConfig) {
        self.homed &= config.zero.is_some();
    }

    /// Whether the encoder reads what that of `other` has read before, after a leap that no joint is capable
    /// of.
    #[cold]
    pub fn reads_that_of(&self, config: &JointConfig, other: &Self, of_other: &JointConfig) -> bool {
        let leaps = abs(self.change) > config.limits.velocity * TICK;
        #[expect(clippy::cast_precision_loss, reason = "a difference of angles")]
        let counts = self.count.wrapping_sub(other.count) as f32;
        let moved = counts + other.change / of_other.radians_per_count;
        leaps && abs(moved * config.radians_per_count) <= config.fast
    }

    /// Whether the angle is known.
    pub const fn is_homed(&self) -> bool {
        self.homed
    }

    fn angle(&self, config: &JointConfig, count: i32) -> f32 {
        #[expect(
            clippy::cast_precision_loss,
            reason = "exact up to 2²⁴ counts from zero, beyond the range of a joint"
        )]
        let counts = count.wrapping_sub(self.zero) as f32;
        counts * config.radians_per_count
    }

    /// Sets the torque to 0.
    pub fn release(&mut self) {
        (self.torque, self.effort) = (0.0, 0.0);
        self.servo.clear_torque();
    }

    /// Forgets what the servo has learnt. It begins anew when the joint is enabled.
    #[cold]
    pub fn forget(&mut self) {
        self.servo = JointServoState::at(0.0);
    }
}

impl Joint<'_> {
    /// Homes the joint: its present angle is `position` [rad].
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

    /// Reads the encoder for the first time, without change and velocity.
    pub fn first_read(&mut self, count: i32) {
        self.state.count = count;
        self.restart();
    }

    fn restart(&mut self) {
        *self.position = self.state.angle(self.config, self.state.count);
        *self.velocity = 0.0;
        self.state.change = 0.0;
        self.hold_still();
    }

    /// Prepares for a tick that comes several periods after the last one: position and velocity become those
    /// of one period ago, at the constant acceleration of a joint whose drive was off.
    pub fn catch_up(&mut self, count: i32, periods: f32) {
        let (before, max) = (*self.velocity, self.config.limits.velocity);
        let position = self.state.angle(self.config, count);
        let mean = (position - *self.position) / (periods * TICK);
        let now = math::clamp(2.0 * mean - before, -max, max);
        let last = now + (before - now) / periods;
        *self.position = position - 0.5 * (last + now) * TICK;
        *self.velocity = last;
    }

    /// Reads the encoder in a tick.
    #[inline]
    pub fn read(&mut self, count: i32) {
        let state = &mut *self.state;
        state.count = count;
        let position = state.angle(self.config, count);
        state.change = position - *self.position;
        *self.position = position;
        self.config.velocity.update(self.velocity, state.change);
    }

    /// Whether the joint gains speed in a way that [`check_speed`](Self::check_speed) has to judge: against
    /// its effort, or beyond its velocity limit. (The filtered velocity lags behind one that grows, and
    /// exceeds the limit only after a change has.)
    #[inline]
    pub fn gains_speed(&self) -> bool {
        let (config, state) = (self.config, &self.state);
        let change = abs(state.change);
        change > config.fast
            && change >= abs(*self.velocity) * TICK
            && (self.is_opposed() || change > config.limits.velocity * TICK)
    }

    /// Whether the effort of the last tick, one that moves the joint, is against its motion.
    #[inline]
    fn is_opposed(&self) -> bool {
        let (effort, change) = (self.state.effort, self.state.change);
        (if change > 0.0 { -effort } else { effort }) > self.config.breakaway
    }

    /// Checks the measurements. Returns a fault: cause, value, limit.
    #[inline]
    pub fn check_measurement(&self, current: i16) -> Option<(FaultCause, f32, f32)> {
        let (config, state, position) = (self.config, &self.state, *self.position);
        let current = f32::from(current);
        if abs(current) > config.current_limit {
            let scale = config.amperes_per_count;
            return Some((FaultCause::OverCurrent, current * scale, config.current_limit * scale));
        }
        if state.homed && position < config.min_angle {
            return Some((FaultCause::PositionLimit, position, config.limits.lower));
        }
        if state.homed && position > config.max_angle {
            return Some((FaultCause::PositionLimit, position, config.limits.upper));
        }
        None
    }

    /// Checks a joint that [gains speed](Self::gains_speed): does its encoder jump, does it run away against
    /// the effort of the last tick, does it exceed its velocity limit? Where the reference `follows` the
    /// joint, its error says nothing. Returns a fault: cause, value, limit.
    pub fn check_speed(&mut self, follows: bool, tick: u32) -> Option<(FaultCause, f32, f32)> {
        let is_opposed = self.is_opposed();
        let (config, state) = (self.config, &mut *self.state);
        let jumps = |state: &mut JointState, limit: f32| {
            state.lose_zero(config);
            Some((FaultCause::EncoderJump, state.change, limit))
        };
        if abs(state.change) > config.jump {
            return jumps(state, config.jump);
        }
        let deviates = follows || abs(self.reference.position - *self.position) > config.deviation;
        let ticks = if state.gained_in.wrapping_add(1) == tick { state.running_away } else { 0 };
        state.running_away = if deviates && is_opposed { ticks.saturating_add(1) } else { 0 };
        state.gained_in = tick;
        if state.running_away >= RUNAWAY_TICKS {
            return Some((FaultCause::Runaway, state.effort, config.breakaway));
        }
        let (velocity, limit) = (*self.velocity, config.limits.velocity);
        if abs(velocity) <= limit {
            return None;
        }
        // Neither its drive nor a push makes a joint so fast in one tick.
        let leap = config.max_leap(velocity);
        if abs(state.change) > leap {
            return jumps(state, leap);
        }
        if abs(config.velocity_step(state.change, velocity)) > config.largest_step() {
            state.leapt_in = tick;
        }
        Some((FaultCause::VelocityLimit, velocity, limit))
    }

    /// Whether what made the joint too fast in the last tick was an encoder that jumped: a push may be
    /// stronger than the drive, but then the joint does not stop at once. Returns a fault: cause, value,
    /// limit.
    pub fn check_leap(&mut self, tick: u32) -> Option<(FaultCause, f32, f32)> {
        let (config, state) = (self.config, &mut *self.state);
        let step = config.velocity_step(state.change, *self.velocity);
        let before = state.change / TICK - step;
        let is_back = state.leapt_in.wrapping_add(1) == tick
            && abs(before) > config.limits.velocity
            && before * step < 0.0
            && abs(step) > config.largest_step();
        if !is_back {
            return None;
        }
        state.lose_zero(config);
        Some((FaultCause::EncoderJump, step * TICK, config.largest_step() * TICK))
    }

    /// Checks the control. Returns a fault: cause, value, limit.
    #[inline]
    pub fn check_control(&self) -> Option<(FaultCause, f32, f32)> {
        let error = self.reference.position - *self.position;
        let limit = self.config.limits.following_error;
        if abs(error) <= limit {
            return None;
        }
        Some(if self.runs_away() {
            (FaultCause::Runaway, self.state.effort, self.config.breakaway)
        } else {
            (FaultCause::FollowingError, error, limit)
        })
    }

    /// Whether the joint moves against its effort, away from its reference, which does not lead it there: a
    /// servo that is only too weak, or hindered, falls behind; one whose encoder or drive is reversed goes
    /// the other way. A reference at rest may have been left by a push, which slows down.
    #[cold]
    fn runs_away(&self) -> bool {
        let (velocity, lead) = (*self.velocity, self.reference.velocity * *self.velocity);
        let leaves = (self.reference.position - *self.position) * velocity < 0.0;
        let gains = abs(self.state.change) > abs(self.state.last_change) + self.config.flicker;
        let astray = lead < 0.0 || lead == 0.0 && leaves && gains;
        abs(velocity) * TICK > self.config.moving && astray && self.is_opposed()
    }

    /// Whether the angle stands still while the effort has grown by what moves the joint. A contact force, or
    /// an error of the model, may balance an effort, but not its growth: what it presses on yields by some
    /// counts.
    #[inline]
    pub fn resists(&mut self) -> bool {
        let effort = self.state.effort;
        if self.moves() {
            self.state.moving_effort = effort;
        } else if self.has_resisted() {
            return true;
        }
        self.state.unchanged = 0;
        false
    }

    /// What [`resists`](Self::resists) found in this tick.
    #[inline]
    pub fn has_resisted(&self) -> bool {
        abs(self.state.effort - self.state.moving_effort) > self.config.least_growth
    }

    /// Whether the joint has moved on. A count that comes and goes is no motion: a dead encoder may flicker.
    #[inline(always)]
    fn moves(&mut self) -> bool {
        let (position, state) = (*self.position, &mut *self.state);
        let distance = position - state.moved_to;
        if distance * state.last_change <= 0.0 && abs(distance) < self.config.flicker {
            return false;
        }
        (state.moved_to, state.last_change) = (position, state.change);
        true
    }

    /// Checks the encoder of a joint that [resists](Self::resists) a growing `effort`: its torque was
    /// `excess` beyond the weight [N·m]. Returns a fault: cause, value, limit.
    pub fn check_encoder(
        &mut self,
        effort: f32,
        excess: f32,
        situation: Situation,
    ) -> Option<(FaultCause, f32, f32)> {
        let (config, state) = (self.config, &mut *self.state);
        let grown = effort - state.moving_effort;
        let moved = abs(state.last_change) >= config.moving;
        // What the joint took beyond the model along its last motion may be friction, which then holds it
        // against the opposite torque as well.
        let along = if state.last_change > 0.0 { state.moving_effort } else { -state.moving_effort };
        // So may what has stopped its inertia within a period, unless that is more than friction.
        let stopping = along + config.inertia * abs(state.last_change) / (TICK * TICK);
        let shown = if stopping > config.max_friction + config.coulomb { along } else { stopping };
        let reverses = state.last_change * excess < 0.0;
        let friction = if reverses { math::clamp(shown, 0.0, config.max_friction) } else { 0.0 };
        let growth = if situation.presses {
            // Forces that are fed forward are balanced with an error of their own.
            if self.target.feedforward == 0.0 { config.breakaway } else { 2.0 * config.breakaway }
        } else if moved || situation.stops {
            config.growth
        } else if state.last_change == 0.0 {
            // It has not moved since it was enabled: what holds it is not known.
            config.breakaway
        } else {
            config.held_growth
        };
        let limit = if situation.stops { config.stop_excess } else { config.excess };
        // An arm in motion balances the inertia of its other links: a torque that does so moves no joint.
        let is_balance = situation.accelerates && !situation.stops;
        let pushes = abs(excess) > limit && grown * excess > 0.0;
        let moves = !is_balance && pushes && abs(grown) > growth + 2.0 * friction;
        // Accelerations are noisy: less of them, and a tick less, will do where the torque shows the same.
        let (share, ticks) = if pushes { (CONFIRMED_SHARE, STUCK_TICKS) } else { (1.0, STUCK_TICKS + 1) };
        // A joint that brakes to rest stays there while its effort falls to what friction bears.
        let accelerates = situation.accelerates
            && abs(grown) > share * config.accelerating_growth
            && abs(effort) > 0.5 * config.growth
            && grown * effort > 0.0;
        // What shows less for a tick, such as when a contact begins, does not count anew.
        let keeps_count = situation.accelerates
            && pushes
            && abs(grown) > HYSTERESIS_SHARE * config.accelerating_growth
            && grown * effort > 0.0;
        let shows = moves || accelerates;
        state.unchanged = match (shows, keeps_count) {
            (true, _) => state.unchanged.saturating_add(1),
            (false, true) => state.unchanged,
            (false, false) => 0,
        };
        if !shows || state.unchanged < ticks {
            return None;
        }
        state.unchanged = FOUND_DEAD;
        let (value, limit) = if moves { (excess, limit) } else { (grown, config.accelerating_growth) };
        Some((FaultCause::EncoderStuck, value, limit))
    }

    /// The encoder is dead, as the board has found. Returns the fault: cause, value, limit.
    #[cold]
    pub fn find_dead(&mut self) -> (FaultCause, f32, f32) {
        (self.state.unchanged, self.state.moved_to) = (FOUND_DEAD, *self.position);
        (FaultCause::EncoderStuck, self.state.torque, 0.0)
    }

    /// [`check_encoder`](Self::check_encoder) of a damped joint, whose effort is the `excess`.
    pub fn check_damped_encoder(&mut self, excess: f32) -> Option<(FaultCause, f32, f32)> {
        if self.moves() {
            (self.state.moving_effort, self.state.unchanged) = (excess, 0);
            return None;
        }
        self.check_encoder(excess, excess, Situation { stops: true, accelerates: false, presses: false })
    }

    /// Computes the reference of this tick from the target; goals pass the trajectory filter. Returns `false`
    /// for targets that [`advance_far_or_braking`](Self::advance_far_or_braking) has to advance.
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

    /// Computes the reference of this tick on the way to a goal that is far, or to rest.
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
                if point.velocity == 0.0 {
                    self.target.setpoint = JointSetpoint::Goal(point.position);
                }
                servo.follow(&mut self.state.servo, point)
            }
            JointSetpoint::Goal(_) | JointSetpoint::Point(_) => return,
        };
    }

    /// Computes the torque by the servo, which goes on learning the disturbance if it `LEARNS`.
    /// `model_torque` is the inverse dynamics at the reference [N·m].
    #[inline]
    pub fn control<const LEARNS: bool>(&mut self, mode: ServoMode, model_torque: f32) {
        let feedforward = model_torque + self.target.feedforward;
        let Self { config, state, reference, position, .. } = self;
        let output =
            config.servo.compute::<LEARNS>(&mut state.servo, mode, reference, **position, feedforward);
        self.state.torque = output.torque;
        self.state.effort = output.effort;
    }

    /// As [`control`](Self::control) for [`ServoMode::BarePid`].
    pub fn control_bare<const LEARNS: bool>(&mut self, model_torque: f32) {
        let Self { config, state, reference, position, target, .. } = self;
        let (servo, contact) = (&mut state.servo, target.feedforward);
        let output = config.servo.bare_pid::<LEARNS>(servo, reference, **position, model_torque, contact);
        self.state.torque = output.torque;
        self.state.effort = output.effort;
    }

    /// Bounds the torque of a joint that is held after a fault, `before` in the last tick. Beside its
    /// `weight` [N·m] and the error of that, it may press
    ///
    /// - with no more than when the stop began: against an obstacle it must not press harder;
    /// - where it stands, also with no more than the least torque under which it has stood since: a new load
    ///   moves the count of a living encoder, and after a dead one the servo would drive the joint on.
    ///
    /// Exceptions:
    ///
    /// - `grips`: forces that are fed forward act on what the joint grips, so the second bound does not hold;
    /// - `brakes`: the torque slows the joint down;
    /// - `begins`, part of `brakes`: in the first ticks of a stop also against a motion that goes on, as the
    ///   joint must withstand the others that brake;
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
        let grips = self.target.feedforward != 0.0;
        let max = weight_error + if grips { pressed } else { pressed.min(state.stood) };
        let is_led = abs(self.reference.velocity) >= STALL_SPEED;
        // A torque against a motion that goes on balances a push, or an encoder drifts.
        let slows = is_led || begins || abs(state.change) + config.flicker < abs(velocity) * TICK;
        let follows = is_led && state.change * excess <= 0.0;
        let brakes = slows && abs(velocity) * TICK > config.moving && excess * velocity < 0.0;
        if abs(excess) <= max || brakes || follows {
            return;
        }
        let bounded =
            config.servo.limit_after(&mut state.servo, before, weight + math::clamp(excess, -max, max));
        state.effort += bounded - state.torque;
        state.torque = bounded;
    }

    /// Computes the torque without servo: feed-forward, damping and, if `compensated`, gravity and friction
    /// compensation.
    #[inline(never)]
    pub fn push(&mut self, damping: f32, compensated: bool, model_torque: f32) {
        let compensation = if compensated {
            model_torque + self.config.servo.friction(&self.state.servo, self.reference.velocity)
        } else {
            0.0
        };
        let effort = self.target.feedforward - damping * *self.velocity;
        self.state.torque = self.config.servo.limit(&mut self.state.servo, compensation + effort);
        // Contact forces balance what is fed forward: a count that stands still says nothing.
        self.state.effort = 0.0;
    }

    /// Computes the torque from the inverse dynamics of the `links` [N·m], with a fraction of the `friction`
    /// fed forward. Returns the acceleration that the limits added [rad/s²], and the mean torque until the
    /// next tick [N·m].
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
        [servo.acceleration(mean - desired), mean]
    }

    /// Computes a damping torque, beside the compensated part of the `gravity` torque [N·m] and the
    /// feed-forward, which fades, and faster if the feed-forward of all joints together is `driving` the
    /// robot. When damping `begins`, the feed-forward becomes what the torque has balanced so far, such as a
    /// contact force; nothing of it if that was `driving` the robot.
    pub fn damp(&mut self, gravity: f32, begins: bool, driving: bool) {
        if begins {
            // What the joint has balanced so far is no sign of a dead encoder: growth counts from here on.
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
        self.state.effort = effort;
    }

    /// Whether the encoder was found dead and has not moved since: the angle says nothing then, not even the
    /// weight. Returns the fault that the joint would be enabled with: cause, value, limit.
    #[cold]
    pub fn check_still_dead(&self) -> Option<(FaultCause, f32, f32)> {
        let moved = abs(*self.position - self.state.moved_to) > self.config.flicker;
        let is_dead = self.state.unchanged == FOUND_DEAD && !moved;
        is_dead.then_some((FaultCause::EncoderStuck, self.state.torque, self.config.excess))
    }

    /// Prepares for a task: at rest where the joint is. Its encoder is not [dead](Self::check_still_dead).
    pub fn begin(&mut self) {
        self.state.unchanged = 0;
        self.hold_still();
    }

    /// Sets target and reference to the present position at rest. Keeps the adapted friction, and the torque
    /// of outputs that are on: its rate counts from there.
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

    /// Brings the joint to rest: where it is, if it has left its reference, else along the reference. Keeps
    /// the feed-forward torque. A joint that has left its reference forgets the disturbance torque, which may
    /// be that of pressing on something.
    pub fn hold(&mut self, where_it_is: bool) {
        let error = self.reference.position - *self.position;
        if where_it_is || abs(error) > self.config.limits.following_error {
            let max = self.config.limits.velocity;
            let velocity = math::clamp(*self.velocity, -max, max);
            *self.reference = JointPoint { position: *self.position, velocity, acceleration: 0.0 };
            self.state.servo.restart_under_torque(*self.position);
        }
        self.target.setpoint = JointSetpoint::Brake;
    }
}
