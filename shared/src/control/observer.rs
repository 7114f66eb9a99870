use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::model::{Motor, ObserverGains};
use crate::{TICK, math};

/// State feedback on an observer of error, error velocity and disturbance: the model-based alternative to
/// PID.
///
/// The feed-forward moves the nominal joint exactly along its reference. The observer models the remaining
/// error `e = reference − angle` with `J·ë = d − u`:
/// `u` is the *effort*, the torque beyond the feed-forward, and `d` the disturbance (unmodelled friction,
/// gravity, inertia, coupling). An observer of the error adds no lag to the reference.
///
/// - Observer: one prediction with the effort that actually acted (after every limit, shifted by the delay of
///   the motor's inner loop), then a correction with three equal poles at `e^(−ω_o·T)`, the critically damped
///   fading-memory filter (Morrison 1969).
/// - Feedback: `u = d + J·(k₁·e + k₂·ė)` with two equal poles at `γ = e^(−ω·T)` for the held-input double
///   integrator: `k₁ = (1−γ)²/T²`, `k₂ = (1−γ)(3+γ)/(2T)`.
#[derive(Clone, Copy, Debug)]
pub struct ErrorObserver {
    /// `T/J`.
    velocity_per_effort: f32,
    /// Corrections of error, velocity and disturbance by the innovation.
    correction: [f32; 3],
    proportional: f32,
    derivative: f32,
    /// Fraction of the last period's effort that still acts in this one: delay and lag of the current loop.
    delay_fraction: f32,
}

/// State of an [`ErrorObserver`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct ObserverState {
    /// Predicted error [rad] and its velocity [rad/s] at the next tick.
    error: f32,
    velocity: f32,
    /// Estimated disturbance [N·m].
    disturbance: f32,
    /// Effort of the last tick [N·m].
    effort: f32,
}

impl ObserverState {
    /// No error and no disturbance.
    pub const fn new() -> Self {
        Self { error: 0.0, velocity: 0.0, disturbance: 0.0, effort: 0.0 }
    }

    /// Resets error, velocity and effort, for a reference that restarts at the joint's position. Keeps the
    /// disturbance.
    pub const fn reset_motion(&mut self) {
        (self.error, self.velocity, self.effort) = (0.0, 0.0, 0.0);
    }

    /// Subtracts `torque` [N·m] from the disturbance: the feed-forward supplies it from now on.
    pub const fn hand_over(&mut self, torque: f32) {
        self.disturbance -= torque;
    }

    /// The estimated error [rad] and its velocity [rad/s].
    pub const fn error(&self) -> [f32; 2] {
        [self.error, self.velocity]
    }

    /// The estimated disturbance torque [N·m].
    pub const fn disturbance(&self) -> f32 {
        self.disturbance
    }
}

impl ErrorObserver {
    /// Acceleration [rad/s²] that `torque` [N·m] gives the inertia that the feedback assumes.
    pub const fn acceleration(&self, torque: f32) -> f32 {
        torque * self.velocity_per_effort / TICK
    }

    /// The observer with the gains and the motor of a validated model.
    pub fn new(gains: &ObserverGains, motor: &Motor) -> Self {
        let lag = motor.delay + 1.0 / (core::f32::consts::TAU * motor.bandwidth);
        Self::with_lag(gains, lag)
    }

    /// The observer with these gains, for efforts that act after a `lag` [s].
    pub fn with_lag(gains: &ObserverGains, lag: f32) -> Self {
        let inertia = gains.inertia;
        let beta = math::exp(-gains.observer_bandwidth * TICK);
        let gamma = math::exp(-gains.bandwidth * TICK);
        let (b, g) = (1.0 - beta, 1.0 - gamma);
        Self {
            velocity_per_effort: TICK / inertia,
            correction: [
                1.0 - beta * beta * beta,
                1.5 * b * b * (1.0 + beta) / TICK,
                b * b * b * inertia / (TICK * TICK),
            ],
            proportional: inertia * g * g / (TICK * TICK),
            derivative: inertia * g * (3.0 + gamma) / (2.0 * TICK),
            delay_fraction: math::clamp(lag / TICK, 0.0, 1.0),
        }
    }

    /// Fraction of the last period's effort that still acts in this one: delay and lag of the current loop.
    pub const fn delay_fraction(&self) -> f32 {
        self.delay_fraction
    }

    /// Measurement update with the measured error [rad]; returns the effort [N·m] before limits. `resting`
    /// freezes the disturbance estimate: stiction hides the disturbance of a joint at rest.
    #[inline]
    pub const fn effort(&self, state: &mut ObserverState, error: f32, resting: bool) -> f32 {
        self.correct(state, error, if resting { 0.0 } else { 1.0 });
        self.feedback(state)
    }

    /// Measurement update with the measured error [rad], the first half of
    /// [`ErrorObserver::effort`]. `learning`, 0 to 1, scales the gain of the disturbance estimate.
    #[inline]
    pub const fn correct(&self, state: &mut ObserverState, error: f32, learning: f32) {
        let innovation = error - state.error;
        let [c0, c1, c2] = self.correction;
        state.error += c0 * innovation;
        state.velocity += c1 * innovation;
        state.disturbance += learning * c2 * innovation;
    }

    /// State feedback: the effort [N·m] before limits, the second half of [`ErrorObserver::effort`].
    #[inline]
    pub const fn feedback(&self, state: &ObserverState) -> f32 {
        state.disturbance + self.proportional * state.error + self.derivative * state.velocity
    }

    /// Time update: predicts the next tick from the effort `applied` after all limits [N·m].
    #[inline]
    pub const fn predict(&self, state: &mut ObserverState, applied: f32) {
        let acting = applied + self.delay_fraction * (state.effort - applied);
        let change = self.velocity_per_effort * (state.disturbance - acting);
        state.error += TICK * (state.velocity + 0.5 * change);
        state.velocity += change;
        state.effort = applied;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `(error, effort)` per tick of a joint under this feedback, with an initial error of 1 mrad and a
    /// disturbance of 5 mN·m; from `tests/oracles/observer.py` (matrix exponential and Ackermann's formula).
    const RESPONSE: &[(f64, f64)] = include!("../../../tests/oracles/data/observer.in");

    #[test]
    #[expect(clippy::cast_possible_truncation, reason = "the observer works in single precision")]
    fn closes_the_loop_as_designed_by_ackermann() {
        let inertia = 2.1e-4;
        let gains = ObserverGains { inertia, bandwidth: 50.0, observer_bandwidth: 120.0 };
        // An inner loop without lag, as in the oracle.
        let motor = Motor { bandwidth: 1e9, delay: 0.0, ..crate::test_support::joint("joint").motor };
        let observer = ErrorObserver::new(&gains, &motor);
        let mut state = ObserverState::new();
        for &(error, effort) in RESPONSE {
            let computed = observer.effort(&mut state, error as f32, false);
            observer.predict(&mut state, computed);
            assert!((f64::from(computed) - effort).abs() < 2e-6, "{computed} {effort}");
        }
        assert!((state.disturbance() - 0.005).abs() < 1e-5);
        assert!(RESPONSE[39].0.abs() < 1e-8);
    }

    #[test]
    fn counts_the_lag_of_the_inner_loop() {
        // 0.3 ms and 1/(2π·300 Hz) = 0.5305 ms of 10 ms.
        let joint = crate::test_support::joint("joint");
        let observer = ErrorObserver::new(&joint.servo.observer, &joint.motor);
        assert!((observer.delay_fraction - 0.083_05).abs() < 1e-5);
    }
}
