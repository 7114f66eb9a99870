//! The chip's own supply: the voltage detector of PWR, the brown-out reset of the option bytes, and the clock
//! that the flash memory allows (STM32F405 datasheet, tables 14, 19; RM0090, 3.5.1, 5.4).

/// Nominal thresholds of the voltage detector by PLS, for a falling supply [V]; a rising one needs 0.1 V
/// more.
const DETECTOR: [f64; 8] = [2.04, 2.19, 2.35, 2.51, 2.66, 2.84, 2.93, 3.03];
const HYSTERESIS: f64 = 0.1;
/// The reset value of FLASH_OPTCR as chips are delivered, without BOR_LEV.
const OPTIONS: u32 = 0x0FFF_AAE1;

const PVDE: u32 = 1 << 4;
const PVDO: u32 = 1 << 2;

pub struct Supply {
    /// [V].
    pub volts: f64,
    /// Level of the brown-out reset in the option bytes; 0: off, as chips are delivered.
    pub brown_out_level: u32,
    control: u32,
    /// The detector's output: the supply is too low.
    is_low: bool,
}

impl Supply {
    pub(crate) fn new() -> Self {
        Self { volts: 3.3, brown_out_level: 3, control: 0x4000, is_low: false }
    }

    pub(crate) fn reset(&mut self) {
        (self.control, self.is_low) = (0x4000, false);
    }

    /// Updates and returns the detector's output.
    pub(crate) fn is_low(&mut self) -> bool {
        let threshold = DETECTOR[(self.control >> 5 & 7) as usize];
        let threshold = if self.is_low { threshold + HYSTERESIS } else { threshold };
        self.is_low = self.control & PVDE != 0 && self.volts < threshold;
        self.is_low
    }

    /// Returns the largest clock of the CPU with these wait states [Hz].
    pub(crate) fn clock(&self, wait_states: u64) -> u64 {
        let step = match self.volts {
            2.7.. => 30_000_000,
            2.4..2.7 => 24_000_000,
            2.1..2.4 => 22_000_000,
            _ => 20_000_000,
        };
        step * (wait_states + 1)
    }

    /// Returns FLASH_OPTCR.
    pub(crate) fn options(&self) -> u32 {
        OPTIONS | (3 - self.brown_out_level) << 2
    }

    pub(crate) fn read(&mut self, offset: u32) -> Option<u32> {
        match offset {
            0 => Some(self.control),
            4 => Some(if self.is_low() { PVDO } else { 0 }),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0 => self.control = value,
            4 => {}
            _ => return None,
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_detector_has_a_hysteresis() {
        let mut supply = Supply::new();
        let mut told = |volts: f64, control: u32| {
            supply.volts = volts;
            supply.write(0, control);
            supply.read(4) == Some(PVDO)
        };
        assert!(!told(2.0, 6 << 5), "it is off");
        let on = 6 << 5 | PVDE;
        assert_eq!([2.94, 2.92, 3.02, 3.04].map(|volts| told(volts, on)), [false, true, true, false]);
    }

    /// As delivered the options are 0x0FFF AAED (RM0090, 3.9.10).
    #[test]
    fn options_hold_the_level_of_the_brown_out_reset() {
        let mut supply = Supply::new();
        supply.brown_out_level = 0;
        assert_eq!(supply.options(), 0x0FFF_AAED);
        assert_eq!(supply.clock(5), 180_000_000);
        supply.volts = 2.69;
        assert_eq!(supply.clock(5), 144_000_000);
    }
}
