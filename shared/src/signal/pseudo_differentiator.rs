use crate::{TICK, math};

/// Low-pass filtered derivative: `H(s) = s·ω/(s + ω)` (Hand3 section 4).
///
/// Ramp-invariant: `y⁺ = a·y + (1−a)·(u − u_prev)/T`, `a = e^(−ωT)`. On a ramp the slope is exact once the
/// filter has settled; the step-invariant form would read 15.7 % too much at ω = 30 rad/s and T = 10 ms.
///
/// The state is the output `y`; the caller keeps `u_prev` (a servo has it anyway).
#[derive(Clone, Copy, Debug)]
pub struct PseudoDifferentiator {
    a: f32,
    gain: f32,
}

impl PseudoDifferentiator {
    /// The differentiator with `cutoff` [rad/s], which must be positive and finite.
    pub fn new(cutoff: f32) -> Self {
        let a = math::exp(-cutoff * TICK);
        Self { a, gain: (1.0 - a) / TICK }
    }

    /// Takes the change of the input over one period; returns and stores the filtered derivative, per second.
    ///
    /// ```
    /// let h = tesaki::signal::PseudoDifferentiator::new(30.0);
    /// let mut derivative = 0.0;
    /// for _ in 0..100 {
    ///     h.update(&mut derivative, 0.02); // a ramp of 2 per second
    /// }
    /// assert!((derivative - 2.0).abs() < 1e-5);
    /// ```
    #[inline]
    pub const fn update(&self, derivative: &mut f32, change: f32) -> f32 {
        *derivative = self.a * *derivative + self.gain * change;
        *derivative
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_a_ramp_with_the_exact_exponential() {
        // H(s)/s² for slope 1: y(t) = 1 − e^(−ωt); after 5 periods of 10 ms at ω = 30 that is 1 − e^(−1.5).
        let h = PseudoDifferentiator::new(30.0);
        let mut y = 0.0;
        for _ in 0..5 {
            h.update(&mut y, 0.01);
        }
        assert!((y - 0.776_869_84).abs() < 1e-6);
    }

    #[test]
    fn matches_scipy_on_a_recorded_motion() {
        /// `(input, output)` per tick, from `tests/oracles/signal_filters.py` (`scipy.signal.cont2discrete`,
        /// method `foh`).
        const MOTION: &[(f32, f64)] = include!("../../../tests/oracles/data/pseudo_differentiator.in");
        let h = PseudoDifferentiator::new(30.0);
        let (mut y, mut previous) = (0.0, 0.0);
        for &(input, output) in MOTION {
            h.update(&mut y, input - previous);
            previous = input;
            assert!((f64::from(y) - output).abs() < 2e-5, "{y} {output}");
        }
    }
}
