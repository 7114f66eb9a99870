//! The parts of the firmware: clock, links, retained memory, board. `main.rs` puts them together.
//!
//! Who may interrupt whom, highest first:
//!
//! | priority | task | does |
//! |---|---|---|
//! | 4 | `TIM2` | marks the 10 ms instant, wakes the control task |
//! | 3 | `USART1`, `USART2` | move bytes between UART and queue |
//! | 2 | `EXTI0`: control | one [`Node::tick`](tesaki::node::Node::tick) |
//! | 1 | `EXTI1`: supervisor | requests, replies, telemetry |
//! | 0 | idle | sleeps; on the plant link feeds the watchdog |
//!
//! The UARTs stand above the control task because they hold one byte and no more: at 921 600 baud the next one comes
//! after 10.8 µs, and a tick takes several times as long. Their handlers take a few dozen instructions a byte, which
//! delays a tick by less than 3 %; a tick above them would lose bytes. The instant of sampling is not delayed.

#![no_std]

pub mod board;
pub mod clock;
pub mod identity;
pub mod link;
pub mod retained;
pub mod stack;
pub mod watchdog;

use defmt_rtt as _;
pub use stm32f4xx_hal::pac;
