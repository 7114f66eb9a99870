//! An STM32F405 for the image that is flashed: the instruction set by Unicorn, the registers that the image
//! uses by models of this crate, and at the pins the motors of the boards `board-weact` and `board-odrive`.
//! Deterministic: time passes with the instructions.
//!
//! What it does not show: an instruction is taken for 1.5 cycles, whatever it is; no analogue effects, no
//! errata, no DMA, of SPI only SPI1 and SPI3; no check of CPACR, no write buffers; PVU and RVU of the
//! watchdog.

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
pub mod tim1;
pub mod timer;
pub mod usart;

/// A second in picoseconds.
pub const SECOND: u64 = 1_000_000_000_000;
