use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{TICK, math};

/// Smooths set-point steps into a reference: `G(s) = 1/(T_f s + 1)²` (Hand3 section 4).
///
/// Both states are discretised *jointly* and exactly for a held input, with `a = e^(−T/T_f)`:
/// `x₁⁺ = a·x₁ + (1−a)·u` and `x₂⁺ = a·x₂ + (T/T_f)·a·x₁ + (1 − a − (T/T_f)·a)·u`. Because the input is held
/// over a period, the reference's velocity and acceleration are known exactly, too.
///
/// ```
/// use tesaki::signal::{TrajectoryFilter, TrajectoryState};
/// let filter = TrajectoryFilter::new(0.2);
/// let mut state = TrajectoryState::at(0.0);
/// for _ in 0..20 {
///     filter.update(&mut state, 1.0);
/// }
/// // The step response of G(s) at t = T_f: 1 − 2/e.
/// assert!((state.position() - 0.264_241).abs() < 1e-5);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct TrajectoryFilter {
    a: f32,
    one_minus_a: f32,
    b: f32,
    c: f32,
    rate: f32,
}

/// State of a [`TrajectoryFilter`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct TrajectoryState {
    x1: f32,
    x2: f32,
}

impl TrajectoryState {
    /// The state at rest at `position`.
    pub const fn at(position: f32) -> Self {
        Self { x1: position, x2: position }
    }

    /// The state at `position` with `velocity` per second, for a filter with the time constant `filter_time`
    /// [s].
    pub const fn moving(position: f32, velocity: f32, filter_time: f32) -> Self {
        Self { x1: position + velocity * filter_time, x2: position }
    }

    /// The reference, in the unit of the input.
    pub const fn position(&self) -> f32 {
        self.x2
    }
}

impl TrajectoryFilter {
    /// A filter with time constant `filter_time` [s], which must be positive and finite. In single precision
    /// the reference stops short of a set-point by up to 2·10⁻⁵ of the way for each second of it.
    pub fn new(filter_time: f32) -> Self {
        let ratio = TICK / filter_time;
        let a = math::exp(-ratio);
        Self { a, one_minus_a: 1.0 - a, b: ratio * a, c: 1.0 - a - ratio * a, rate: 1.0 / filter_time }
    }

    /// Takes the set-point `input` for one period and returns the reference at its end.
    #[inline]
    pub const fn update(&self, state: &mut TrajectoryState, input: f32) -> f32 {
        let x2 = self.a * state.x2 + self.b * state.x1 + self.c * input;
        state.x1 = self.a * state.x1 + self.one_minus_a * input;
        state.x2 = x2;
        x2
    }

    /// First derivative of the reference, per second.
    #[inline]
    pub const fn velocity(&self, state: &TrajectoryState) -> f32 {
        (state.x1 - state.x2) * self.rate
    }

    /// Second derivative of the reference just after the last update, per second²; `input` as given there.
    #[inline]
    pub const fn acceleration(&self, state: &TrajectoryState, input: f32) -> f32 {
        (input - 2.0 * state.x1 + state.x2) * (self.rate * self.rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns: t [s], position, velocity, acceleration of the step response of `1/(0.2 s + 1)²`, from
    /// `tests/oracles/signal_filters.py` (`scipy.signal.step` of the continuous system).
    const STEP: &[(usize, f64, f64, f64)] = include!("../../../tests/oracles/data/trajectory_filter.in");

    #[test]
    fn follows_the_continuous_step_response_with_its_derivatives() {
        let filter = TrajectoryFilter::new(0.2);
        let mut state = TrajectoryState::default();
        let mut tick = 0;
        for &(at, position, velocity, acceleration) in STEP {
            while tick < at {
                filter.update(&mut state, 1.0);
                tick += 1;
            }
            assert!((f64::from(state.position()) - position).abs() < 3e-6, "tick {at}");
            assert!((f64::from(filter.velocity(&state)) - velocity).abs() < 2e-5, "tick {at}");
            assert!((f64::from(filter.acceleration(&state, 1.0)) - acceleration).abs() < 2e-4, "tick {at}");
        }
    }
}
