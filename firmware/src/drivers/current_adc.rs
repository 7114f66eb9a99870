//! ADC1 to ADC3: one or two inputs each, the first ones at the same instant, triggered by TIM1.

use crate::pac;
use pac::{ADC_COMMON, ADC1, ADC2, ADC3, RCC, adc1};
use stm32f4xx_hal::rcc::Enable;

/// Counts of full scale.
pub const FULL_SCALE: u16 = 4095;

/// Injected conversions of three converters, all started by TIM1's trigger. Those of the first converter must
/// end last: their end raises the interrupt.
pub struct CurrentAdc(ADC1, ADC2, ADC3);

impl CurrentAdc {
    /// Starts the converters with their channels, at most two each. They run at 21 MHz: a conversion takes 27
    /// cycles, 1.3 µs, and one of a channel below 10 takes 40, 1.9 µs.
    pub fn start(
        converters: (ADC1, ADC2, ADC3, ADC_COMMON),
        rcc: &mut RCC,
        [first_channels, second_channels, third_channels]: [&[u8]; 3],
    ) -> Self {
        let (first, second, third, common) = converters;
        ADC1::enable(rcc);
        ADC2::enable(rcc);
        ADC3::enable(rcc);
        common.ccr().write(|w| w.adcpre().div4());
        sequence(&first, first_channels);
        sequence(&second, second_channels);
        sequence(&third, third_channels);
        first.cr1().modify(|_, w| w.jeocie().set_bit());
        Self(first, second, third)
    }

    /// Returns the last sample by converter and place in its sequence [counts], and clears the interrupt.
    /// Values beyond the end of a sequence are meaningless.
    pub fn sample(&mut self) -> [[u16; 2]; 3] {
        let Self(first, second, third) = self;
        // SAFETY: zeros clear flags in this register; the others stay.
        first.sr().write(|w| unsafe { w.bits(!JEOC) });
        let counts = |converter: &adc1::RegisterBlock| {
            [converter.jdr1().read().bits() as u16, converter.jdr2().read().bits() as u16]
        };
        [counts(first), counts(second), counts(third)]
    }
}

/// JEOC in ADC_SR: the injected conversions have ended.
const JEOC: u32 = 1 << 2;

/// Sets a converter up to convert `channels` one after another at each trigger.
fn sequence(converter: &adc1::RegisterBlock, channels: &[u8]) {
    converter.cr1().write(|w| w.scan().set_bit());
    for &channel in channels {
        if channel < 10 {
            converter.smpr2().modify(|_, w| w.smp(channel).cycles28());
        } else {
            converter.smpr1().modify(|_, w| w.smp(channel - 10).cycles15());
        }
    }
    // A sequence ends with the fourth entry, wherever it begins.
    let length = channels.len() as u32;
    let mut bits = (length - 1) << 20;
    for (entry, &channel) in (4 - length..).zip(channels) {
        bits |= u32::from(channel) << (5 * entry);
    }
    // SAFETY: entries of five bits, and above them their number minus 1, as in the reference manual.
    converter.jsqr().write(|w| unsafe { w.bits(bits) });
    converter.cr2().write(|w| w.adon().set_bit());
    converter.cr2().modify(|_, w| w.jextsel().tim1trgo().jexten().rising_edge());
}
