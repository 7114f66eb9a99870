//! The independent watchdog: resets the board when nobody says for 100 ms that the control is well.
//!
//! On a board that owns its sensors and drives only a control tick that ran in its own period feeds it. On the plant
//! link the host decides when time passes, and may pause for as long as it likes; there the idle loop feeds it, which
//! shows that no task hangs.

use crate::pac;

/// Started once, never stopped.
pub struct Watchdog(pac::IWDG);

impl Watchdog {
    /// Starts it: LSI (32 kHz) through 32, 100 counts.
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

    /// All is well.
    pub fn feed(&self) {
        // SAFETY: the key that reloads the counter.
        self.0.kr().write(|w| unsafe { w.bits(0xAAAA) });
    }
}
