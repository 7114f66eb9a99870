//! The sign of a current of which only the magnitude is measured.

use tesaki::control::Winding;
use tesaki::math;

/// Forgetting factor of the costs: the cost of a period counts a tenth after 44 periods.
const MEMORY: f32 = 0.95;

/// Gives the magnitude that a power stage measures the sign that the current must have.
///
/// The direction of the voltage does not determine it: in a braking motor the current opposes the voltage. So
/// the current is predicted from the winding, exactly for a period at constant voltage: `i⁺ = a·i + (1 −
/// a)/R·(v − e)` with `a = e^(−R·T/L)` (Åström, Wittenmark, *Computer-Controlled Systems*, 2.3). All
/// combinations of the signs of the last current and of this one are compared with the prediction; the
/// sequence of signs with the lowest cost wins (the Viterbi algorithm with squared prediction errors). A sign
/// that was wrong while there was hardly any current is corrected as soon as a voltage changes the current:
/// the magnitude then grows where it should fall. A filter that only follows its own last sign would keep the
/// wrong one, and the current loop would run away.
#[derive(Clone, Copy, Debug)]
pub struct CurrentSign {
    remains: f32,
    gain: f32,
    back_emf: f32,
    magnitude: f32,
    /// Costs of a positive and of a negative current.
    costs: [f32; 2],
}

impl CurrentSign {
    /// Creates the filter for a winding whose current is sampled each `period` [s].
    pub fn new(winding: &Winding, period: f32) -> Self {
        let remains = math::exp(-winding.resistance * period / winding.inductance);
        let gain = (1.0 - remains) / winding.resistance;
        Self { remains, gain, back_emf: winding.back_emf, magnitude: 0.0, costs: [0.0; 2] }
    }

    /// Restarts the filter at zero current.
    pub const fn reset(&mut self) {
        self.magnitude = 0.0;
        self.costs = [0.0; 2];
    }

    /// Returns the current [A] from its measured `magnitude` [A], after a period of `voltage` [V] at a joint
    /// velocity [rad/s].
    pub fn resolve(&mut self, magnitude: f32, voltage: f32, velocity: f32) -> f32 {
        let [positive, negative] = self.costs;
        let remains = self.remains * self.magnitude;
        let added = self.gain * (voltage - self.back_emf * velocity);
        let cost = |current: f32| {
            let (from_positive, from_negative) = (remains + added - current, added - remains - current);
            let first = positive + from_positive * from_positive;
            let second = negative + from_negative * from_negative;
            MEMORY * if second < first { second } else { first }
        };
        let costs = [cost(magnitude), cost(-magnitude)];
        let is_negative = costs[1] < costs[0];
        let least = costs[usize::from(is_negative)];
        self.costs = costs.map(|cost| cost - least);
        self.magnitude = magnitude;
        if is_negative { -magnitude } else { magnitude }
    }
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, reason = "tests")]
mod tests {
    use super::*;

    const WINDING: Winding = Winding { resistance: 4.0, inductance: 1.6e-3, back_emf: 0.3 };
    const PERIOD: f32 = 50e-6;

    /// Simulates the winding in double precision and small steps, with parameters that differ by 20 %.
    fn wind(current: f64, voltage: f64, velocity: f64) -> f64 {
        (0..100).fold(current, |i, _| i + 50e-8 * (voltage - 4.8 * i - 0.3 * velocity) / 1.3e-3)
    }

    #[test]
    fn the_sign_is_right_in_all_four_quadrants() {
        let mut sign = CurrentSign::new(&WINDING, PERIOD);
        let mut current = 0.0_f64;
        let (mut against, mut worst) = (0, 0.0_f64);
        for period in 0..20_000_u32 {
            let time = f64::from(period) * 50e-6;
            // Current and velocity oscillate at different frequencies, so that all quadrants occur.
            let velocity = 20.0 * libm::sin(5.0 * time);
            let voltage = 6.0 * libm::sin(40.0 * time) + 0.3 * velocity;
            current = wind(current, voltage, velocity);
            against += u32::from(current * voltage < 0.0);
            // Half a millivolt of noise and 12 bits: about 1 mA.
            let magnitude = libm::fabs(current) + 1e-3 * libm::sin(f64::from(period) * 1.7);
            let found = sign.resolve(magnitude.max(0.0) as f32, voltage as f32, velocity as f32);
            worst = worst.max((f64::from(found) - current).abs());
        }
        assert!(against > 2000, "{against}");
        // Around the zero crossing the sign may be wrong by the change of the current in a period.
        assert!(worst < 0.02, "{worst}");
    }
}
