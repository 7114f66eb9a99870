//! Register-level drivers of peripherals that the HAL cannot use as motor drives need them.
//!
//! The HAL's PWM has no break input, switches `AOE` on, so that outputs return by themselves after a trip,
//! and requires the main pin of a channel together with its complementary one; the HAL's ADC has no injected
//! conversions, and its SPI waits without a bound.

/// Largest rate of the counts of an encoder behind [`filter_encoders`](crate::filter_encoders) [1/s]: its
/// levels last 1 µs then.
pub const COUNT_RATE: f32 = 1e6;

/// Filters both inputs of encoders' timers, as the HAL does not: a level counts after six equal samples at an
/// eighth of 84 MHz, 0.57 µs. Switching edges of the power stages on an encoder's cable are shorter; encoders
/// may give up to [`COUNT_RATE`].
#[macro_export]
macro_rules! filter_encoders {
    ($($timer:ident),+) => {$(
        // SAFETY: only the encoder, which the caller has set up, uses this register.
        unsafe {
            (*pac::$timer::ptr())
                .ccmr1_input()
                .modify(|_, w| w.ic1f().fdts_div8_n6().ic2f().fdts_div8_n6());
        }
    )+};
}

pub mod current_adc;
pub mod half_bridges;
pub mod pulses;
pub mod spi;
