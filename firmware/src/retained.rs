//! Memory that a reset does not clear: the fault log, and the cause of a crash.
//!
//! After power-on its content is random; checksums detect that.

use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;

use tesaki::fault::{FaultCause, FaultLog};
use tesaki::protocol::codec::checksum;

/// Longest postcard encoding of a [`FaultLog`].
const LOG: usize = 320;
/// Maximum length of a retained message [bytes].
pub const MAX_TEXT: usize = 96;

#[repr(C)]
struct Retained {
    log_checksum: u32,
    log_length: u32,
    log: [u8; LOG],
    crash_checksum: u32,
    crash: Crash,
}

/// Cause of a crash.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Crash {
    /// Number of the [`FaultCause`].
    cause: u32,
    /// Line of the panic, or program counter of the CPU fault.
    pub place: u32,
    length: u32,
    text: [u8; MAX_TEXT],
}

#[unsafe(link_section = ".uninit.RETAINED")]
static mut RETAINED: MaybeUninit<Retained> = MaybeUninit::uninit();

fn with<R>(body: impl FnOnce(&mut Retained) -> R) -> R {
    cortex_m::interrupt::free(|_| {
        // SAFETY: one core, interrupts off, and `body` cannot call `with` again: the reference is unique.
        // Every field is made of integers, for which any bits are a value; the memory is always readable.
        body(unsafe { (*addr_of_mut!(RETAINED)).assume_init_mut() })
    })
}

/// Retains the fault log over a reset.
pub fn retain_faults(log: &FaultLog) {
    with(|retained| {
        if let Ok(bytes) = postcard::to_slice(log, &mut retained.log) {
            retained.log_length = bytes.len() as u32;
            retained.log_checksum = checksum(bytes);
        }
    });
}

/// The fault log from before the reset, if valid.
pub fn faults() -> Option<FaultLog> {
    with(|retained| {
        let bytes = retained.log.get(..retained.log_length as usize)?;
        (!bytes.is_empty() && checksum(bytes) == retained.log_checksum)
            .then(|| postcard::from_bytes(bytes).ok())?
    })
}

/// Retains the cause of a crash over the reset.
pub fn retain_crash(cause: FaultCause, place: u32, message: fmt::Arguments<'_>) {
    with(|retained| {
        let mut text = Text { bytes: [0; MAX_TEXT], length: 0 };
        // A longer text is truncated.
        let _ = text.write_fmt(message);
        let length = text.length as u32;
        retained.crash = Crash { cause: u32::from(cause.number()), place, length, text: text.bytes };
        retained.crash_checksum = retained.crash.checksum();
    });
}

/// The crash before this start, if any. Later calls return `None`.
pub fn take_crash() -> Option<Crash> {
    with(|retained| {
        let intact = retained.crash_checksum == retained.crash.checksum();
        retained.crash_checksum = !retained.crash.checksum();
        intact.then_some(retained.crash)
    })
}

impl Crash {
    /// Panic or CPU fault, as a fault cause.
    pub fn cause(&self) -> FaultCause {
        if self.cause == u32::from(FaultCause::Panic.number()) {
            FaultCause::Panic
        } else {
            FaultCause::HardFault
        }
    }

    /// The message.
    pub fn text(&self) -> &str {
        let bytes = self.text.get(..self.length as usize).unwrap_or_default();
        core::str::from_utf8(bytes).unwrap_or_default()
    }

    fn checksum(&self) -> u32 {
        checksum(&self.text)
            ^ self.cause.rotate_left(8)
            ^ self.place.rotate_left(16)
            ^ self.length
            ^ 0x7E5A_4B1D
    }
}

/// A text that is truncated to whole characters.
struct Text {
    bytes: [u8; MAX_TEXT],
    length: usize,
}

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let mut buffer = [0; 4];
            let encoded = character.encode_utf8(&mut buffer).as_bytes();
            let free = self.bytes.get_mut(self.length..self.length + encoded.len()).ok_or(fmt::Error)?;
            free.copy_from_slice(encoded);
            self.length += encoded.len();
        }
        Ok(())
    }
}
