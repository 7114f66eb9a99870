//! Register-level drivers of peripherals that the HAL cannot use as motor drives need them.
//!
//! The HAL's PWM has no break input, switches `AOE` on, so that outputs return by themselves after a trip,
//! and requires the main pin of a channel together with its complementary one; the HAL's ADC has no injected
//! conversions, and its SPI waits without a bound.

pub mod current_adc;
pub mod half_bridges;
pub mod pulses;
pub mod spi;
