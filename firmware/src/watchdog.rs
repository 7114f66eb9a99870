//! The independent watchdog: resets the board unless it is fed.
//!
//! Its oscillator (LSI) nominally has 32 kHz, but can have between 17 and 47 kHz (datasheet): the timeout is
//! nominally 100 ms, between 68 ms and 188 ms.
//!
//! With sensors and drives on the board, each healthy control tick feeds it, as long as the code of lower
//! priorities runs, too ([`Background`]): if a request hung, no further one could stop the robot. On the
//! plant link the host controls time and may pause, so the idle loop feeds it, which shows that no RTIC task
//! hangs; the timer wakes it.

use core::sync::atomic::{AtomicU32, Ordering};

use crate::pac;

/// Timeout in steps of 32 periods of the oscillator: 3200 of 32 kHz are 100 ms.
const STEPS: u16 = 100;
/// Polls until the settings have arrived in the watchdog: at least five periods of its counter, 9.4 ms at 17
/// kHz, also if a poll took only five cycles of 168 MHz. It runs at 16 MHz: without the watchdog's oscillator
/// the start is delayed by 0.1 s or more.
const MAX_POLLS: u32 = 320_000;

/// Control periods for which the code of lower priorities may be silent: half a second. A request takes
/// milliseconds.
const MAX_SILENCE: u32 = 50;

static SIGNS_OF_LIFE: AtomicU32 = AtomicU32::new(0);

/// The idle loop, and the supervisor's task before each request, tell that they run. Under requests without a
/// pause the idle loop does not run.
pub fn tell_alive() {
    SIGNS_OF_LIFE.fetch_add(1, Ordering::Relaxed);
}

/// Watches the code that calls [`tell_alive`].
#[derive(Debug, Default)]
pub struct Background {
    seen: u32,
    silent: u32,
}

impl Background {
    /// Creates the state at the start.
    pub const fn new() -> Self {
        Self { seen: 0, silent: 0 }
    }

    /// Runs one control period. Returns whether that code has run lately.
    pub fn is_alive(&mut self) -> bool {
        let seen = SIGNS_OF_LIFE.load(Ordering::Relaxed);
        self.silent = if seen == self.seen { self.silent.saturating_add(1) } else { 0 };
        self.seen = seen;
        self.silent <= MAX_SILENCE
    }
}

/// A running watchdog. It cannot be stopped.
pub struct Watchdog(pac::IWDG);

impl Watchdog {
    /// Starts the watchdog and reloads it: the counter begins with 4 s and takes the new timeout only at a
    /// reload.
    pub fn start(iwdg: pac::IWDG) -> Self {
        let watchdog = Self(iwdg);
        let registers = &watchdog.0;
        // SAFETY: these are the keys and values of the reference manual (RM0090, 21.3 and 21.4), in its
        // order.
        unsafe {
            registers.kr().write(|w| w.bits(0xCCCC));
            registers.kr().write(|w| w.bits(0x5555));
            registers.pr().write(|w| w.bits(0b011));
            registers.rlr().write(|w| w.bits(STEPS - 1));
        }
        for _ in 0..MAX_POLLS {
            if registers.sr().read().bits() == 0 {
                break;
            }
        }
        watchdog.feed();
        watchdog
    }

    /// Reloads the counter.
    pub fn feed(&self) {
        // SAFETY: the key that reloads the counter.
        self.0.kr().write(|w| unsafe { w.bits(0xAAAA) });
    }
}
