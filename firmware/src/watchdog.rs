//! The independent watchdog: resets the board unless it is fed every 100 ms.
//!
//! With sensors and drives on the board, each control tick in its own period feeds it. On the plant link the
//! host controls time and may pause, so the idle loop feeds it, which shows that no RTIC task hangs.

use crate::pac;

/// A running watchdog. It cannot be stopped.
pub struct Watchdog(pac::IWDG);

impl Watchdog {
    /// Starts the watchdog: LSI (32 kHz) divided by 32, 100 counts.
    pub fn start(iwdg: pac::IWDG) -> Self {
        // SAFETY: these are the keys and values of the reference manual (RM0090, 21.4).
        unsafe {
            iwdg.kr().write(|w| w.bits(0x5555));
            iwdg.pr().write(|w| w.bits(0b011));
            iwdg.rlr().write(|w| w.bits(100));
            iwdg.kr().write(|w| w.bits(0xCCCC));
        }
        Self(iwdg)
    }

    /// Reloads the counter.
    pub fn feed(&self) {
        // SAFETY: the key that reloads the counter.
        self.0.kr().write(|w| unsafe { w.bits(0xAAAA) });
    }
}
