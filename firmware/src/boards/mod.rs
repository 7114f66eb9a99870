//! The boards: one file and one cargo feature each.
//!
//! | feature | board |
//! |---|---|
//! | `board-bare` (default) | the microcontroller alone, with the plant link |
//! | `board-emulated` | a joint in software, for tests in QEMU |
//! | `board-odrive` | ODrive v3.6: two brushed motors |
//! | `board-weact` | WeAct STM32F405 with three DRV8874: three brushed motors |

pub mod bare;
#[cfg(feature = "board-emulated")]
pub mod emulated;
#[cfg(feature = "board-odrive")]
pub mod odrive;
#[cfg(feature = "board-weact")]
pub mod weact;

#[cfg(not(any(
    feature = "board-bare",
    feature = "board-emulated",
    feature = "board-odrive",
    feature = "board-weact"
)))]
compile_error!("choose a board: one feature of those that firmware/src/boards/mod.rs lists");
#[cfg(all(feature = "board-odrive", feature = "board-weact"))]
compile_error!("choose one of the boards with motors: their pins differ");

/// The board of this image. A selected board replaces the default one.
#[cfg(not(any(feature = "board-emulated", feature = "board-odrive", feature = "board-weact")))]
pub type ThisBoard = bare::Bare;
/// The board of this image.
#[cfg(feature = "board-emulated")]
pub type ThisBoard = emulated::Emulated;
/// The board of this image.
#[cfg(all(feature = "board-weact", not(feature = "board-emulated")))]
pub type ThisBoard = weact::Weact;
/// The board of this image.
#[cfg(all(feature = "board-odrive", not(feature = "board-emulated")))]
pub type ThisBoard = odrive::Odrive;
