use core::f64::consts::TAU;

use super::values::InnerLoop;

/// The torque behind a drive's current loop. It follows its target as a first-order lag; a new target takes
/// effect after a delay. Exact for every step size.
#[derive(Clone, Debug)]
pub struct Lag {
    /// Corner frequency [rad/s].
    rate: f64,
    output: f64,
    target: f64,
    next_target: f64,
    /// Time until `next_target` takes effect [s]; 0 or negative once it has.
    wait: f64,
    /// Length of the last step [s], and the fraction of a difference that remains after it.
    decay: (f64, f64),
}

impl Lag {
    pub fn new(values: &InnerLoop) -> Self {
        let rate = TAU * values.bandwidth;
        Self { rate, output: 0.0, target: 0.0, next_target: 0.0, wait: 0.0, decay: (0.0, 1.0) }
    }

    /// Sets a new target, which takes effect after `delay`. The previous one must have taken effect.
    pub const fn set(&mut self, target: f64, delay: f64) {
        self.target = self.next_target;
        self.next_target = target;
        self.wait = delay;
    }

    /// Advances by `time` and returns the mean output over it.
    pub fn advance(&mut self, time: f64) -> f64 {
        let before = self.wait.clamp(0.0, time);
        let mut area = 0.0;
        if before > 0.0 {
            area += self.follow(before);
        }
        self.wait -= time;
        if before < time {
            self.target = self.next_target;
            area += self.follow(time - before);
        }
        area / time
    }

    /// Returns the output after `time`, in which no new target takes effect.
    pub fn ahead(&self, time: f64) -> f64 {
        self.target + (self.output - self.target) * libm::exp(-self.rate * time)
    }

    /// Follows the target for `time` and returns the integral.
    fn follow(&mut self, time: f64) -> f64 {
        // Most sub-steps have the same length, so the factor is kept.
        if self.decay.0.to_bits() != time.to_bits() {
            self.decay = (time, libm::exp(-self.rate * time));
        }
        let end = self.target + (self.output - self.target) * self.decay.1;
        let area = self.target * time + (self.output - end) / self.rate;
        self.output = end;
        area
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOOP: InnerLoop = InnerLoop { bandwidth: 300.0, delay: 0.0003 };

    #[test]
    fn a_step_has_risen_to_63_percent_one_time_constant_after_the_delay() {
        let tau = 1.0 / (TAU * 300.0);
        assert!((tau - 0.53e-3).abs() < 1e-6);
        let mut lag = Lag::new(&LOOP);
        lag.set(2.0, LOOP.delay);
        assert!(lag.advance(LOOP.delay).abs() < 1e-12);
        lag.advance(tau);
        assert!((lag.ahead(0.0) - 2.0 * (1.0 - libm::exp(-1.0))).abs() < 1e-12);
    }

    #[test]
    fn the_step_size_does_not_matter() {
        let run = |steps: u32| {
            let mut lag = Lag::new(&LOOP);
            lag.set(1.0, 0.0);
            lag.advance(0.0001);
            lag.set(-1.0, 0.00033);
            let time = 0.002 / f64::from(steps);
            let area: f64 = (0..steps).map(|_| lag.advance(time) * time).sum();
            (area, lag.ahead(0.0))
        };
        let (once, often) = (run(1), run(1000));
        assert!((once.0 - often.0).abs() < 1e-15 && (once.1 - often.1).abs() < 1e-12, "{once:?} {often:?}");
    }
}
