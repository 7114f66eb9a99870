//! Memory that a reset leaves alone: the faults so far, and why the firmware died.
//!
//! After power-on it holds noise; checksums tell. Everything is copied out before anything is written.

use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;

use tesaki::fault::{FaultCause, FaultLog};
use tesaki::protocol::codec::checksum;

/// Longest postcard encoding of a [`FaultLog`].
const LOG: usize = 320;
/// Longest message that is kept.
pub const WORDS: usize = 96;

#[repr(C)]
struct Retained {
    log_checksum: u32,
    log_length: u32,
    log: [u8; LOG],
    death_checksum: u32,
    death: Death,
}

/// Why the firmware died.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Death {
    /// Number of the [`FaultCause`].
    cause: u32,
    /// Line of the panic, or program counter of the CPU fault.
    pub place: u32,
    length: u32,
    words: [u8; WORDS],
}

#[unsafe(link_section = ".uninit.RETAINED")]
static mut RETAINED: MaybeUninit<Retained> = MaybeUninit::uninit();

fn with<R>(body: impl FnOnce(&mut Retained) -> R) -> R {
    cortex_m::interrupt::free(|_| {
        // SAFETY: one core, interrupts off, and `body` cannot call `with` again: the reference is unique. Every field
        // is made of integers, for which any bits are a value; the memory is always readable.
        body(unsafe { (*addr_of_mut!(RETAINED)).assume_init_mut() })
    })
}

/// Keeps `log` for the time after a reset.
pub fn keep_faults(log: &FaultLog) {
    with(|retained| {
        if let Ok(bytes) = postcard::to_slice(log, &mut retained.log) {
            retained.log_length = bytes.len() as u32;
            retained.log_checksum = checksum(bytes);
        }
    });
}

/// The faults from before the reset, if there are any.
pub fn faults() -> Option<FaultLog> {
    with(|retained| {
        let bytes = retained.log.get(..retained.log_length as usize)?;
        (!bytes.is_empty() && checksum(bytes) == retained.log_checksum)
            .then(|| postcard::from_bytes(bytes).ok())?
    })
}

/// Keeps why the firmware is about to reset itself.
pub fn keep_death(cause: FaultCause, place: u32, words: fmt::Arguments<'_>) {
    with(|retained| {
        let mut text = Text { bytes: [0; WORDS], length: 0 };
        // Too long a text is cut, which is no error here.
        let _ = text.write_fmt(words);
        let length = text.length as u32;
        retained.death = Death { cause: u32::from(cause.number()), place, length, words: text.bytes };
        retained.death_checksum = retained.death.checksum();
    });
}

/// Why the firmware died before this start; told once.
pub fn take_death() -> Option<Death> {
    with(|retained| {
        let intact = retained.death_checksum == retained.death.checksum();
        retained.death_checksum = !retained.death.checksum();
        intact.then_some(retained.death)
    })
}

impl Death {
    /// Panic or CPU fault.
    pub fn cause(&self) -> FaultCause {
        if self.cause == u32::from(FaultCause::Panic.number()) {
            FaultCause::Panic
        } else {
            FaultCause::HardFault
        }
    }

    /// The message.
    pub fn words(&self) -> &str {
        let bytes = self.words.get(..self.length as usize).unwrap_or_default();
        core::str::from_utf8(bytes).unwrap_or_default()
    }

    fn checksum(&self) -> u32 {
        checksum(&self.words)
            ^ self.cause.rotate_left(8)
            ^ self.place.rotate_left(16)
            ^ self.length
            ^ 0x7E5A_4B1D
    }
}

/// As much of a text as fits, whole characters only.
struct Text {
    bytes: [u8; WORDS],
    length: usize,
}

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let mut buffer = [0; 4];
            let encoded = character.encode_utf8(&mut buffer).as_bytes();
            let place = self.bytes.get_mut(self.length..self.length + encoded.len()).ok_or(fmt::Error)?;
            place.copy_from_slice(encoded);
            self.length += encoded.len();
        }
        Ok(())
    }
}
