//! Constants of the power stage DRV8874 (Texas Instruments, SLVSF66) in its PH/EN mode, slow decay.
//!
//! `EN` high drives in the direction of `PH`; `EN` low turns both low sides on, which shorts the motor.
//! `nSLEEP` low turns everything off, and the motor coasts. `IPROPI` is a current proportional to the sum of
//! the currents through the low sides from drain to source: while the motor is shorted, that is the magnitude
//! of its current, whatever its direction.

/// Current at `IPROPI` per current of the motor: 450 µA/A.
pub const MIRROR: f32 = 450e-6;
/// Maximum time from `nSLEEP` high to working outputs [s].
pub const WAKE: f32 = 1e-3;
/// Largest supply [V].
pub const SUPPLY_MAX: f32 = 37.0;

/// A converter that measures the voltage at the resistor from `IPROPI` to ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentSense {
    /// The resistor [Ω].
    pub resistor: f32,
    /// Full scale of the converter [V].
    pub reference: f32,
    /// Counts of full scale.
    pub counts: u16,
}

impl CurrentSense {
    /// Returns the motor current per count [A].
    pub fn resolution(&self) -> f32 {
        self.reference / f32::from(self.counts) / (MIRROR * self.resistor)
    }

    /// Returns the motor current at full scale [A].
    pub const fn range(&self) -> f32 {
        self.reference / (MIRROR * self.resistor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: 450 µA/A · 2.49 kΩ = 1.1205 V/A; 3.3 V are 2.945 A, a count of 4095 is 0.7192 mA.
    #[test]
    fn the_resistor_sets_range_and_resolution() {
        let sense = CurrentSense { resistor: 2490.0, reference: 3.3, counts: 4095 };
        assert!((sense.range() - 2.9451).abs() < 1e-3);
        assert!((sense.resolution() - 0.719_2e-3).abs() < 1e-6);
    }
}
