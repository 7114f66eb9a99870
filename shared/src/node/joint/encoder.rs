//! Fault detection from a joint's encoder and motion.

use super::{FOUND_DEAD, Joint, JointState};
use crate::TICK;
use crate::fault::{FaultCause, Finding};
use crate::math::{self, abs};
use crate::robot::HYSTERESIS_SHARE;

/// Ticks without a change of the angle, under a torque that must move the joint, after which the encoder
/// counts as stuck. With more ticks a joint with a dead encoder accelerates longer; with fewer, quantisation
/// is mistaken for a dead encoder.
const STUCK_TICKS: u8 = 2;
/// Share of `accelerating_growth` that suffices when the torque beyond the weight confirms it.
const CONFIRMED_SHARE: f32 = 0.75;
/// The effort of an acceleration must be able to move the joint from rest by this number of counts within
/// this time [s], that after which it shows a dead encoder: the effort also balances the inertia of other
/// links, and the error of a coarse encoder.
const MOVED_COUNTS: f32 = 24.0;
const MOVED_TIME: f32 = (STUCK_TICKS + 1) as f32 * TICK;
/// The growth of any other effort must be able to move it by this number of counts in the time without a
/// change: a heavy joint with a coarse encoder begins to move unnoticed.
const FEW_COUNTS: f32 = 3.0;
/// Consecutive ticks in which a joint gains speed against its torque, after which it runs away. With more
/// ticks it gains more speed; with fewer a rebound is mistaken for it.
const RUNAWAY_TICKS: u8 = 3;

/// Conditions that determine the effort that a joint at rest may have.
#[derive(Clone, Copy)]
pub struct Situation {
    /// The robot is brought to rest, and no joint has to press on anything.
    pub stops: bool,
    /// The efforts are those of accelerations, without weight and contact forces.
    pub accelerates: bool,
    /// The force sensor of the joint's chain reads a contact, which may hold the joint.
    pub presses: bool,
}

impl Joint<'_> {
    /// Whether the joint gains speed in a way that [`check_speed`](Self::check_speed) has to judge: against
    /// its effort, or beyond its velocity limit. (The filtered velocity lags: it exceeds the limit only after
    /// the unfiltered one.)
    #[inline]
    pub fn gains_speed(&self) -> bool {
        let (config, state) = (self.config, &self.state);
        let change = abs(state.change);
        change > config.thresholds.fast
            && change >= abs(*self.velocity) * TICK
            && (self.is_opposed() || change > config.limits.velocity * TICK)
    }

    /// Whether the effort of the last tick opposes the motion and exceeds the breakaway torque.
    #[inline]
    fn is_opposed(&self) -> bool {
        let (effort, change) = (self.state.effort, self.state.change);
        (if change > 0.0 { -effort } else { effort }) > self.config.thresholds.breakaway
    }

    /// Checks the measurements.
    #[inline]
    pub fn check_measurement(&self, current: i16) -> Option<Finding> {
        let (config, state, position) = (self.config, &self.state, *self.position);
        let thresholds = &config.thresholds;
        let current = f32::from(current);
        if abs(current) > thresholds.current {
            let scale = config.amperes_per_count;
            return Some(Finding {
                cause: FaultCause::OverCurrent,
                value: current * scale,
                limit: thresholds.current * scale,
            });
        }
        if state.homed && position < thresholds.min_angle {
            return Some(Finding {
                cause: FaultCause::PositionLimit,
                value: position,
                limit: config.limits.lower,
            });
        }
        if state.homed && position > thresholds.max_angle {
            return Some(Finding {
                cause: FaultCause::PositionLimit,
                value: position,
                limit: config.limits.upper,
            });
        }
        None
    }

    /// Checks a joint that [gains speed](Self::gains_speed): whether its encoder jumps, it runs away against
    /// the effort of the last tick, or it exceeds its velocity limit. If the reference `follows` the joint,
    /// the tracking error carries no information.
    pub fn check_speed(&mut self, follows: bool, tick: u32) -> Option<Finding> {
        let is_opposed = self.is_opposed();
        let (config, state) = (self.config, &mut *self.state);
        let thresholds = &config.thresholds;
        let jumps = |state: &mut JointState, limit: f32| {
            state.lose_zero(config);
            Some(Finding { cause: FaultCause::EncoderJump, value: state.change, limit })
        };
        if abs(state.change) > thresholds.jump {
            return jumps(state, thresholds.jump);
        }
        let deviates = follows || abs(self.reference.position - *self.position) > thresholds.deviation;
        let ticks = if state.gained_in.wrapping_add(1) == tick { state.running_away } else { 0 };
        state.running_away = if deviates && is_opposed { ticks.saturating_add(1) } else { 0 };
        state.gained_in = tick;
        if state.running_away >= RUNAWAY_TICKS {
            return Some(Finding {
                cause: FaultCause::Runaway,
                value: state.effort,
                limit: thresholds.breakaway,
            });
        }
        let (velocity, limit) = (*self.velocity, config.limits.velocity);
        if abs(velocity) <= limit {
            return None;
        }
        // Neither the drive nor a push can accelerate a joint so much in one tick.
        let leap = config.max_leap(velocity);
        if abs(state.change) > leap {
            return jumps(state, leap);
        }
        if abs(config.velocity_step(state.change, velocity)) > config.largest_step() {
            state.leapt_in = tick;
        }
        Some(Finding { cause: FaultCause::VelocityLimit, value: velocity, limit })
    }

    /// Checks whether the excessive velocity of the last tick was an encoder jump. A push may accelerate the
    /// joint more than its drive can, but then the joint does not stop again within one tick.
    pub fn check_leap(&mut self, tick: u32) -> Option<Finding> {
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
        Some(Finding {
            cause: FaultCause::EncoderJump,
            value: step * TICK,
            limit: config.largest_step() * TICK,
        })
    }

    /// Checks the control.
    #[inline]
    pub fn check_control(&self) -> Option<Finding> {
        let error = self.reference.position - *self.position;
        let limit = self.config.limits.following_error;
        if abs(error) <= limit {
            return None;
        }
        Some(if self.runs_away() {
            Finding {
                cause: FaultCause::Runaway,
                value: self.state.effort,
                limit: self.config.thresholds.breakaway,
            }
        } else {
            Finding { cause: FaultCause::FollowingError, value: error, limit }
        })
    }

    /// Whether the joint moves against its effort and away from its reference: a servo that is only too weak,
    /// or obstructed, lags behind the reference; one whose encoder or drive is reversed moves the other way.
    /// If the reference is at rest, the joint must also gain speed, because a joint that was pushed away
    /// slows down.
    #[cold]
    fn runs_away(&self) -> bool {
        let (velocity, lead) = (*self.velocity, self.reference.velocity * *self.velocity);
        let leaves = (self.reference.position - *self.position) * velocity < 0.0;
        let gains = abs(self.state.change) > abs(self.state.last_change) + self.config.thresholds.flicker;
        let astray = lead < 0.0 || lead == 0.0 && leaves && gains;
        abs(velocity) * TICK > self.config.thresholds.moving && astray && self.is_opposed()
    }

    /// Whether the angle stands still although the effort has grown by more than can hold the joint. A
    /// contact force or a model error may balance a constant effort, but not its growth: any contact yields
    /// by some counts.
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

    /// The result of [`resists`](Self::resists) in this tick.
    #[inline]
    pub fn has_resisted(&self) -> bool {
        abs(self.state.effort - self.state.moving_effort) > self.config.thresholds.min_growth
    }

    /// Whether the joint has moved. One count back and forth is no motion: a dead encoder may flicker.
    #[inline(always)]
    fn moves(&mut self) -> bool {
        let (position, state) = (*self.position, &mut *self.state);
        let distance = position - state.moved_to;
        if distance * state.last_change <= 0.0 && abs(distance) < self.config.thresholds.flicker {
            return false;
        }
        (state.moved_to, state.last_change) = (position, state.change);
        true
    }

    /// Checks the encoder of a joint that [resists](Self::resists) a growing `effort`; `excess` is its torque
    /// beyond the weight [N·m]. `docs/fault-schedules.md` reports how reliably this detects dead encoders.
    pub fn check_encoder(&mut self, effort: f32, excess: f32, situation: Situation) -> Option<Finding> {
        let growth = self.growth_that_holds(situation) + 2.0 * self.friction_against(excess);
        let (thresholds, state) = (&self.config.thresholds, &mut *self.state);
        let grown = effort - state.moving_effort;
        let limit = if situation.stops { thresholds.stop_excess } else { thresholds.excess };
        let pushes = abs(excess) > limit && grown * excess > 0.0;
        // In a moving arm the torque of a joint also balances the inertial forces of the other links, without
        // moving that joint.
        let is_balance = situation.accelerates && !situation.stops;
        let may_move = !is_balance && pushes && abs(grown) > growth;
        // Accelerations are noisy. If the torque confirms them, a smaller growth and one tick less suffice.
        let (share, ticks) = if pushes { (CONFIRMED_SHARE, STUCK_TICKS) } else { (1.0, STUCK_TICKS + 1) };
        // A joint that has braked to rest stays there while its effort falls below friction: falling efforts
        // do not count.
        let should_accelerate = situation.accelerates
            && abs(grown) > share * thresholds.accelerating_growth
            && abs(effort)
                > math::max(0.5 * thresholds.growth, self.config.torque_for(MOVED_COUNTS, MOVED_TIME))
            && grown * effort > 0.0;
        // A weaker sign for one tick, as at the start of a contact, does not reset the counter.
        let keeps_count = situation.accelerates
            && pushes
            && abs(grown) > HYSTERESIS_SHARE * thresholds.accelerating_growth
            && grown * effort > 0.0;
        let shows = may_move || should_accelerate;
        // An effort that swings, as with a coarse encoder, pushes the joint nowhere, unless the torque does.
        let pushing = if abs(excess) > limit { excess } else { grown };
        let direction = if pushing > 0.0 { 1 } else { -1 };
        let before = if state.unchanged.signum() == direction { state.unchanged } else { 0 };
        state.unchanged = match (shows, keeps_count) {
            // Not as far as the mark of a dead encoder.
            (true, _) => before.saturating_add(direction).max(-i8::MAX),
            (false, true) => before,
            (false, false) => 0,
        };
        let unchanged = state.unchanged.unsigned_abs();
        if !shows || unchanged < ticks {
            return None;
        }
        let should_move =
            may_move && abs(grown) > self.config.torque_for(FEW_COUNTS, f32::from(unchanged) * TICK);
        if !should_move && !should_accelerate {
            return None;
        }
        self.mark_dead();
        let (value, limit) =
            if should_move { (excess, limit) } else { (grown, thresholds.accelerating_growth) };
        Some(Finding { cause: FaultCause::EncoderStuck, value, limit })
    }

    /// Torque beyond the model that the last motion needed [N·m]. It may be friction, which then also holds
    /// the joint against an `excess` in the opposite direction.
    fn friction_against(&self, excess: f32) -> f32 {
        let (config, state) = (self.config, &self.state);
        let max_friction = config.thresholds.max_friction;
        let along = if state.last_change > 0.0 { state.moving_effort } else { -state.moving_effort };
        // The torque that stopped the joint's inertia within one period may be friction too, unless it is too
        // large.
        let stopping = along + config.inertia * abs(state.last_change) / (TICK * TICK);
        let shown = if stopping > max_friction + config.coulomb { along } else { stopping };
        let reverses = state.last_change * excess < 0.0;
        if reverses { math::clamp(shown, 0.0, max_friction) } else { 0.0 }
    }

    /// How much the effort of a joint at rest may grow before the joint must move [N·m], apart from that
    /// friction.
    fn growth_that_holds(&self, situation: Situation) -> f32 {
        let (thresholds, last_change) = (&self.config.thresholds, self.state.last_change);
        if situation.presses {
            // The contact balances the feed-forward force only with an error, which adds to the growth.
            if self.target.feedforward == 0.0 { thresholds.breakaway } else { 2.0 * thresholds.breakaway }
        } else if abs(last_change) >= thresholds.moving || situation.stops {
            thresholds.growth
        } else if last_change == 0.0 {
            // It has not moved since it was enabled: the torque that holds it is unknown.
            thresholds.breakaway
        } else {
            thresholds.held_growth
        }
    }

    /// Marks the encoder as dead, as reported by the board. Returns the finding.
    #[cold]
    pub fn find_dead(&mut self) -> Finding {
        self.mark_dead();
        Finding { cause: FaultCause::EncoderStuck, value: self.state.torque, limit: 0.0 }
    }

    /// Marks the encoder as dead at the present angle. A relative one has not counted the motion since it
    /// died, so its zero is lost.
    #[cold]
    fn mark_dead(&mut self) {
        (self.state.unchanged, self.state.moved_to) = (FOUND_DEAD, *self.position);
        self.state.lose_zero(self.config);
    }

    /// Removes the mark of an encoder that has moved since it was found dead, before the angle that it was
    /// found at is lost.
    #[cold]
    pub fn trust_again(&mut self) {
        if self.state.unchanged == FOUND_DEAD && self.check_still_dead().is_none() {
            self.state.unchanged = 0;
        }
    }

    /// [`check_encoder`](Self::check_encoder) of a damped joint, whose effort is the `excess`.
    pub fn check_damped_encoder(&mut self, excess: f32) -> Option<Finding> {
        if self.moves() {
            (self.state.moving_effort, self.state.unchanged) = (excess, 0);
            return None;
        }
        self.check_encoder(excess, excess, Situation { stops: true, accelerates: false, presses: false })
    }

    /// Returns a finding if the encoder was found dead and has not moved since: the angle is then invalid,
    /// and so is the weight computed from it. It has no value: the drive is off, and there is no torque.
    #[cold]
    pub fn check_still_dead(&self) -> Option<Finding> {
        let moved = abs(*self.position - self.state.moved_to) > self.config.thresholds.flicker;
        let is_dead = self.state.unchanged == FOUND_DEAD && !moved;
        is_dead.then_some(Finding { cause: FaultCause::EncoderStuck, value: 0.0, limit: 0.0 })
    }
}

#[cfg(all(test, feature = "test-support"))]
mod tests {
    use super::*;
    use crate::control::JointPoint;
    use crate::robot::{JointConfig, JointTarget};

    const ACCELERATES: Situation = Situation { stops: false, accelerates: true, presses: false };

    /// The tick in which these efforts of a joint that stands still show a dead encoder, if its torque beyond
    /// the weight is `excess` [N·m].
    fn found_in(counts_per_turn: f32, excess: f32, efforts: &[f32]) -> Option<usize> {
        found_as(ACCELERATES, counts_per_turn, excess, efforts)
    }

    fn found_as(situation: Situation, counts_per_turn: f32, excess: f32, efforts: &[f32]) -> Option<usize> {
        let mut model = crate::test_support::joint("joint");
        model.encoder.counts_per_turn = counts_per_turn;
        let config = JointConfig::new(&model, 0.1);
        let (mut position, mut velocity) = (0.0, 0.0);
        let mut joint = Joint {
            config: &config,
            state: &mut JointState::new(),
            position: &mut position,
            velocity: &mut velocity,
            reference: &mut JointPoint::default(),
            target: &mut JointTarget::at(0.0),
        };
        let mut is_dead = |&effort: &f32| joint.check_encoder(effort, excess, situation).is_some();
        let found = efforts.iter().position(&mut is_dead);
        assert_eq!(joint.check_still_dead().is_some(), found.is_some());
        found
    }

    #[test]
    fn an_effort_that_swings_is_no_sign_of_a_dead_encoder() {
        assert_eq!(found_in(1e6, 0.0, &[0.4; 9]), Some(2));
        assert_eq!(found_in(1e6, 0.0, &[-0.4; 9]), Some(2));
        assert_eq!(found_in(1e6, 0.0, &[0.4, -0.4, 0.4, 0.4, -0.4, -0.4, 0.4]), None);
        // The torque pushes in one direction all the same: 0.1 N·m of 0.02 · 2 + 0.08 · 0.6 N·m.
        assert_eq!(found_in(1e6, -0.1, &[0.4, -0.4, -0.4]), Some(1));
    }

    /// 2·3·2π/(counts·(20 ms)²) = 9.4e4/counts rad/s² in two ticks: of 2.1e-4 kg·m², 20/counts N·m; in four
    /// ticks a quarter of that.
    #[test]
    fn a_heavy_joint_with_a_coarse_encoder_begins_to_move_unnoticed() {
        let situation = Situation { accelerates: false, ..ACCELERATES };
        for (counts, found) in [(1e6, Some(1)), (80.0, Some(1)), (60.0, Some(2)), (20.0, Some(3))] {
            assert_eq!(found_as(situation, counts, 0.3, &[0.3; 9]), found, "{counts}");
            assert_eq!(found_as(situation, counts, -0.3, &[-0.3; 9]), found, "{counts}");
        }
        // However long it takes, the count of the ticks does not become the mark of a dead encoder.
        assert_eq!(found_as(situation, 1e-3, -0.3, &[-0.3; 300]), None);
    }

    /// 2·24·2π/(counts·(30 ms)²) = 3.35e5/counts rad/s²: of 2.1e-4 kg·m², 70/counts N·m.
    #[test]
    fn an_effort_that_moves_a_joint_by_a_few_counts_is_no_sign_of_a_dead_encoder() {
        for (counts, effort, found) in [(256.0, 0.3, Some(2)), (256.0, 0.25, None), (1e6, 0.25, Some(2))] {
            assert_eq!(found_in(counts, 0.0, &[effort; 9]), found, "{counts}, {effort} N·m");
        }
    }
}
