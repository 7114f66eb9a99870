//! Parts of the firmware: clock, links, retained memory, boards. `main.rs` is the RTIC application.
//!
//! RTIC tasks by priority, highest first:
//!
//! | priority | RTIC task | does |
//! |---|---|---|
//! | 7 | `PVD` | the microcontroller's supply falls: outputs off, reset ([`chip_supply`]) |
//! | 6 | `EXTI2`, `EXTI4` | [`board::Board::on_edge`]: power stages off where a trip line has no break input; or pends `EXTI3` for data |
//! | 5 | `TIM2` | 10 ms timer: latches the sensors, pends the control task |
//! | 4 | `ADC` | on boards with motors: the current loops, at 20 kHz; on `board-weact` at every second of its 40 kHz interrupts |
//! | 3 | `USART1`, `USART2`, `UART4` | bytes between UART and queue |
//! | 2 | `EXTI0`: control | one [`Node::tick`](tesaki::node::Node::tick) |
//! | 2 | `EXTI3`: data | on boards with a force sensor: a frame from its converter |
//! | 1 | `EXTI1`: supervisor | requests, replies, telemetry |
//! | 0 | idle | measuring the stack, sleep; tells that it runs; on the plant link, feeding the watchdog |
//!
//! The UARTs have a higher priority than the control task because they buffer a single byte: at 921 600 baud
//! the next one arrives after 10.8 µs, a fraction of a tick. Their handlers take some 70 instructions per
//! byte, 102 at most: a line that is full both ways takes 12 % of the time, and delays a tick by as much.
//!
//! Edge, latch and current loop can follow each other at once: together, all handlers above the UARTs must
//! take less than a byte.
//!
//! The control task also waits while the supervisor task handles a request, as both use the node. Sampling
//! does not wait: the timer's interrupt latches the sensors ([`board::Latch`]); only an edge at a trip line
//! or a data line can delay it, by a few instructions, or a control task that takes a sample a period late.
//! The boot places the instants where no current loop runs.

#![no_std]

pub mod board;
pub mod boards;
pub mod chip_supply;
pub mod clock;
pub mod control;
pub mod drivers;
pub mod identity;
pub mod link;
mod memory;
pub mod retained;
pub mod stack;
pub mod watchdog;

use defmt_rtt as _;
pub use stm32f4xx_hal::pac;
