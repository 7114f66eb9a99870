//! A simulated STM32F405 that runs the flashed image: Unicorn executes the instructions, this crate models
//! the registers that the image uses, and the motors of the boards `board-weact` and `board-odrive` are at
//! the pins. Deterministic: time advances with the instructions.
//!
//! Limitations: every instruction takes 1.5 cycles; there are no analogue effects, no errata, no DMA, no SPI
//! but SPI1 and SPI3, no check of CPACR, no write buffers, and no PVU and RVU of the watchdog.

pub mod adc;
pub mod ads131m06;
pub mod bench;
pub mod chip;
pub mod client;
pub mod cpu;
pub mod drv8301;
pub mod exti;
pub mod force_sensor;
pub mod gpio;
pub mod iwdg;
pub mod mistake;
pub mod nvic;
pub mod odrive;
pub mod pins;
pub mod rcc;
pub mod server;
pub mod spi;
pub mod supply;
pub mod tim1;
pub mod timer;
pub mod usart;

/// A second in picoseconds.
pub const SECOND: u64 = 1_000_000_000_000;
