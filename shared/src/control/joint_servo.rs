use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::friction::STALL_SPEED;
use super::{
    ErrorObserver, FrictionFeedforward, FrictionState, JointPoint, ObserverState, Pid, PidState, ServoMode,
};
use crate::math;
use crate::model::JointModel;
use crate::signal::{RateLimiter, TrajectoryFilter, TrajectoryState};

/// Servo of one joint: trajectory filter, feed-forward, PID or observer, limits (Hand3 section 4, figure 6).
///
/// [`JointServo::approach`] or [`JointServo::follow`] computes the reference of a tick. The torque follows
/// once the model's torques for the references of all joints are known; this part is private to a
/// [`Node`](crate::node::Node), which sequences both. A program of one's own uses the servo for references,
/// for its limits and for its friction compensation, and has [`Pid`] and [`ErrorObserver`] for laws of its
/// own.
#[derive(Clone, Copy, Debug)]
pub struct JointServo {
    filter: TrajectoryFilter,
    filter_time: f32,
    pid: Pid,
    observer: ErrorObserver,
    friction: FrictionFeedforward,
    rotor_inertia: f32,
    rest_error: f32,
    torque_limit: f32,
    torque_rate: RateLimiter,
}

/// State of a [`JointServo`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct JointServoState {
    trajectory: TrajectoryState,
    pid: PidState,
    observer: ObserverState,
    friction: FrictionState,
    /// Torque of the last tick [N·m].
    torque: f32,
}

/// Output of a [`JointServo`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoOutput {
    /// Torque within every limit [N·m].
    pub torque: f32,
    /// The part of it beyond the feed-forward [N·m].
    pub effort: f32,
}

impl JointServoState {
    /// The state at rest at `position` [rad], without adapted friction or disturbance.
    pub const fn at(position: f32) -> Self {
        Self {
            trajectory: TrajectoryState::at(position),
            pid: PidState::at(position),
            observer: ObserverState::new(),
            friction: FrictionState::new(),
            torque: 0.0,
        }
    }

    /// Resets the servo at rest at `position` [rad]. Keeps the adapted friction, and the last torque, from
    /// which the rate limit continues.
    pub const fn restart_under_torque(&mut self, position: f32) {
        *self = Self { friction: self.friction, torque: self.torque, ..Self::at(position) };
    }

    /// The integrator of the PID carries `torque` [N·m].
    pub(crate) const fn carry(&mut self, torque: f32) {
        self.pid.hand_over(-torque);
    }

    /// Resets the rate limiter after the torque was switched off.
    pub const fn clear_torque(&mut self) {
        self.torque = 0.0;
    }
}

impl JointServo {
    /// Time constant of the trajectory filter [s].
    pub(crate) const fn filter_time(&self) -> f32 {
        self.filter_time
    }

    /// Acceleration [rad/s²] that `torque` [N·m] gives the joint's inertia.
    pub const fn acceleration(&self, torque: f32) -> f32 {
        self.observer.acceleration(torque)
    }

    /// The servo of a joint of a validated model.
    pub fn new(joint: &JointModel) -> Self {
        Self {
            filter: TrajectoryFilter::new(joint.servo.filter_time),
            filter_time: joint.servo.filter_time,
            pid: Pid::new(&joint.servo.pid),
            observer: ErrorObserver::new(&joint.servo.observer, &joint.motor),
            friction: FrictionFeedforward::new(&joint.friction),
            rotor_inertia: joint.motor.rotor_inertia,
            rest_error: joint.servo.rest_error,
            torque_limit: joint.torque_limit(),
            torque_rate: RateLimiter::new(joint.limits.torque_rate),
        }
    }

    /// The reference of this tick on the way to `goal` [rad], through the trajectory filter.
    #[inline]
    pub const fn approach(&self, state: &mut JointServoState, goal: f32) -> JointPoint {
        let position = self.filter.update(&mut state.trajectory, goal);
        JointPoint {
            position,
            velocity: self.filter.velocity(&state.trajectory),
            acceleration: self.filter.acceleration(&state.trajectory, goal),
        }
    }

    /// The reference of this tick is `point`. The trajectory filter is set to it, so that a later
    /// [`JointServo::approach`] continues without a jump.
    #[inline]
    pub const fn follow(&self, state: &mut JointServoState, point: JointPoint) -> JointPoint {
        state.trajectory = TrajectoryState::moving(point.position, point.velocity, self.filter_time);
        point
    }

    /// The torque that moves the joint, now at `measured` [rad], along `reference`. `model_torque` is the
    /// inverse dynamics of the links [N·m]; rotor and friction are added here. The disturbance estimate is
    /// adapted only if it `learns`. Not for [`ServoMode::BarePid`], for which [`bare_pid`](Self::bare_pid) is
    /// called instead: this function would feed the model forward.
    #[inline]
    pub(crate) fn compute(
        &self,
        state: &mut JointServoState,
        mode: ServoMode,
        reference: &JointPoint,
        measured: f32,
        model_torque: f32,
        learns: bool,
    ) -> ServoOutput {
        debug_assert!(mode != ServoMode::BarePid, "the bare PID is `bare_pid`");
        let feedforward = self.feedforward(state, reference, model_torque);
        let error = reference.position - measured;
        let at_rest =
            !learns || math::abs(reference.velocity) < STALL_SPEED && math::abs(error) < self.rest_error;
        match mode {
            ServoMode::Pid | ServoMode::BarePid => {
                let requested = feedforward + self.pid.output(&mut state.pid, reference, measured);
                let torque = self.limit(state, requested);
                self.pid.integrate(&mut state.pid, requested, torque, at_rest);
                let taken =
                    self.friction.learn(&mut state.friction, reference.velocity, state.pid.integral());
                state.pid.hand_over(taken);
                ServoOutput { torque, effort: torque - feedforward }
            }
            ServoMode::Observer => {
                let effort = self.observer.effort(&mut state.observer, error, at_rest);
                let torque = self.limit(state, feedforward + effort);
                self.observer.predict(&mut state.observer, torque - feedforward);
                let disturbance = state.observer.disturbance();
                let taken = self.friction.learn(&mut state.friction, reference.velocity, disturbance);
                state.observer.hand_over(taken);
                ServoOutput { torque, effort: torque - feedforward }
            }
        }
    }

    /// [`ServoMode::BarePid`]: only the torque of the PID and that for `contact` forces [N·m]. As in the
    /// other modes, the effort is the torque beyond the model.
    #[inline(never)]
    pub(crate) fn bare_pid(
        &self,
        state: &mut JointServoState,
        reference: &JointPoint,
        measured: f32,
        model_torque: f32,
        contact: f32,
        learns: bool,
    ) -> ServoOutput {
        let requested = contact + self.pid.output(&mut state.pid, reference, measured);
        let torque = self.limit(state, requested);
        self.pid.integrate(&mut state.pid, requested, torque, !learns);
        let explained = self.feedforward(state, reference, model_torque + contact);
        ServoOutput { torque, effort: torque - explained }
    }

    /// Torque for the motion of `reference` [N·m]; `model_torque` is that of the inverse dynamics.
    #[inline]
    fn feedforward(&self, state: &JointServoState, reference: &JointPoint, model_torque: f32) -> f32 {
        model_torque
            + self.rotor_inertia * reference.acceleration
            + self.friction.torque(&state.friction, reference.velocity)
    }

    /// Maximum torque [N·m].
    pub const fn torque_limit(&self) -> f32 {
        self.torque_limit
    }

    /// Fraction of the last period's torque that still acts in this one: delay and lag of the current loop.
    pub const fn delay_fraction(&self) -> f32 {
        self.observer.delay_fraction()
    }

    /// Torque that gives rotor and gear an acceleration [rad/s²], [N·m].
    pub const fn rotor_torque(&self, acceleration: f32) -> f32 {
        self.rotor_inertia * acceleration
    }

    /// Friction compensation at a reference `velocity` [rad/s], from the model and its adaptation [N·m].
    pub const fn friction(&self, state: &JointServoState, velocity: f32) -> f32 {
        self.friction.torque(&state.friction, velocity)
    }

    /// The torque [N·m] nearest to `requested` within torque, current and torque-rate limits. Every torque
    /// passes through this function last.
    #[inline]
    pub const fn limit(&self, state: &mut JointServoState, requested: f32) -> f32 {
        let requested = math::clamp(requested, -self.torque_limit, self.torque_limit);
        state.torque = self.torque_rate.limit(state.torque, requested);
        state.torque
    }

    /// As [`limit`](Self::limit), for a second torque in the same tick; `before` is the torque of the last
    /// tick [N·m].
    pub(crate) const fn limit_after(&self, state: &mut JointServoState, before: f32, requested: f32) -> f32 {
        state.torque = before;
        self.limit(state, requested)
    }
}

#[cfg(all(test, feature = "test-support"))]
mod tests {
    use super::*;
    use crate::model::PidGains;

    /// The three ticks that the test of [`Pid`] calculates by hand: 2, 2.004 082 and 1.968 463 N·m. The
    /// model's torque of 5 N·m is not fed forward, the contact's 0.25 N·m is.
    #[test]
    fn the_bare_pid_adds_nothing_but_the_contact_torque() {
        let mut joint = crate::test_support::joint("joint");
        joint.servo.pid = PidGains { proportional: 2.0, integral: 5.0, derivative: 0.1, cutoff: 30.0 };
        (joint.limits.torque, joint.limits.torque_rate, joint.motor.current_limit) = (10.0, 1e4, 20.0);
        let servo = JointServo::new(&joint);
        let mut state = JointServoState::at(0.0);
        let reference = JointPoint { position: 1.0, velocity: 0.0, acceleration: 30.0 };
        for (measured, expected) in [(0.0, 2.25), (0.01, 2.254_082), (0.03, 2.218_463)] {
            let output = servo.bare_pid(&mut state, &reference, measured, 5.0, 0.25, true);
            assert!((output.torque - expected).abs() < 1e-5, "{measured}: {}", output.torque);
        }
    }

    /// An error of 0.1 mrad is in the dead band of our PID, 0.5 mrad, but is integrated by the bare one:
    /// after 100 ticks it gives 5·0.01·100·1e-4 = 0.5 mN·m, in addition to 2·1e-4 N·m.
    #[test]
    fn the_bare_pid_has_no_dead_band() {
        let mut joint = crate::test_support::joint("joint");
        joint.servo.pid = PidGains { proportional: 2.0, integral: 5.0, derivative: 0.0, cutoff: 30.0 };
        let servo = JointServo::new(&joint);
        let reference = JointPoint { position: 1e-4, velocity: 0.0, acceleration: 0.0 };
        let (mut bare, mut ours) = (JointServoState::at(0.0), JointServoState::at(0.0));
        let mut torques = [f32::NAN; 2];
        for _ in 0..=100 {
            torques = [
                servo.bare_pid(&mut bare, &reference, 0.0, 0.0, 0.0, true).torque,
                servo.compute(&mut ours, ServoMode::Pid, &reference, 0.0, 0.0, true).torque,
            ];
        }
        for (torque, expected) in torques.into_iter().zip([7e-4, 2e-4]) {
            assert!((torque - expected).abs() < 1e-6, "{torque}, expected {expected}");
        }
    }
}
