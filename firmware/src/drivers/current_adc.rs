//! ADC1 to ADC3: three currents at the same instant, triggered by TIM1, and the supply right after.

use crate::pac;
use pac::{ADC_COMMON, ADC1, ADC2, ADC3, adc1};
use stm32f4xx_hal::rcc::{Enable, Rcc};

/// Counts of full scale.
pub const FULL_SCALE: u16 = 4095;

/// Injected conversions of three converters, each started by TIM1's fourth channel. Those of the first one
/// end last, with an interrupt.
pub struct CurrentAdc(ADC1, ADC2, ADC3);

/// A sample [counts].
pub struct Sample {
    /// The three currents.
    pub currents: [u16; 3],
    /// The supply.
    pub supply: u16,
}

impl CurrentAdc {
    /// Starts the converters: `currents` are the channels of ADC1 to ADC3, and `supply` is one of ADC1. All
    /// are between 10 and 18. The converters run at 21 MHz: a conversion takes 27 cycles, 1.3 µs.
    pub fn start(
        converters: (ADC1, ADC2, ADC3, ADC_COMMON),
        rcc: &mut Rcc,
        currents: [u8; 3],
        supply: u8,
    ) -> Self {
        let (first, second, third, common) = converters;
        ADC1::enable(rcc);
        ADC2::enable(rcc);
        ADC3::enable(rcc);
        common.ccr().write(|w| w.adcpre().div4());
        sequence(&first, [currents[0], supply]);
        sequence(&second, [currents[1]]);
        sequence(&third, [currents[2]]);
        first.cr1().modify(|_, w| w.jeocie().set_bit());
        Self(first, second, third)
    }

    /// The last sample. It clears the interrupt.
    pub fn sample(&mut self) -> Sample {
        let Self(first, second, third) = self;
        // SAFETY: zeros clear flags in this register; the others stay.
        first.sr().write(|w| unsafe { w.bits(!JEOC) });
        let count = |register: &adc1::JDR| register.read().bits() as u16;
        Sample {
            currents: [count(first.jdr1()), count(second.jdr1()), count(third.jdr1())],
            supply: count(first.jdr2()),
        }
    }
}

/// JEOC in ADC_SR: the injected conversions have ended.
const JEOC: u32 = 1 << 2;

/// Converts `channels` one after another at each trigger.
fn sequence<const N: usize>(converter: &adc1::RegisterBlock, channels: [u8; N]) {
    converter.cr1().write(|w| w.scan().set_bit());
    for channel in channels {
        converter.smpr1().modify(|_, w| w.smp(channel - 10).cycles15());
    }
    // A sequence ends with the fourth entry, wherever it begins.
    let first = 4 - N as u32;
    let mut bits = (N as u32 - 1) << 20;
    for (entry, channel) in (first..).zip(channels) {
        bits |= u32::from(channel) << (5 * entry);
    }
    // SAFETY: entries of five bits, and their number less 1 behind them, as the reference manual says.
    converter.jsqr().write(|w| unsafe { w.bits(bits) });
    converter.cr2().write(|w| w.adon().set_bit());
    converter.cr2().modify(|_, w| w.jextsel().tim1trgo().jexten().rising_edge());
}
