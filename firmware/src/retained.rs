//! Memory that a reset does not clear: the fault log, and the cause of a crash.
//!
//! After power-on its content is random, and after an update it is another firmware's; checksums and a key
//! detect that.

use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::fault::{FaultCause, FaultLog};
use tesaki::protocol::codec::checksum;

/// Longest postcard encoding of a [`FaultLog`] and the checksum of its joints.
const LOG: usize = 328;
/// Maximum length of a retained message [bytes].
pub const MAX_TEXT: usize = 96;

#[repr(C)]
struct Retained {
    log: Record<LOG>,
    crash_checksum: u32,
    crash: Crash,
}

/// A value's postcard encoding, with the key of its layout.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Record<const N: usize> {
    key: u64,
    checksum: u32,
    length: u32,
    bytes: [u8; N],
}

impl<const N: usize> Record<N> {
    /// Encodes a value; `None` if it is too long.
    pub fn encode(value: &impl Serialize, key: u64) -> Option<Self> {
        let mut bytes = [0; N];
        let used = postcard::to_slice(value, &mut bytes).ok()?;
        let (length, checksum) = (used.len() as u32, checksum(used));
        Some(Self { key, checksum, length, bytes })
    }

    /// Decodes the value, if the record is intact and has this key.
    pub fn decode<T: DeserializeOwned>(&self, key: u64) -> Option<T> {
        let bytes = self.bytes.get(..self.length as usize)?;
        let intact = self.key == key && !bytes.is_empty() && checksum(bytes) == self.checksum;
        intact.then(|| postcard::from_bytes(bytes).ok())?
    }
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

/// Calls `body` with interrupts off. The UARTs lose a byte after 10.8 µs: it must only copy.
fn with<R>(body: impl FnOnce(&mut Retained) -> R) -> R {
    cortex_m::interrupt::free(|_| {
        // SAFETY: one core, interrupts off, and `body` cannot call `with` again: the reference is unique.
        // Every field is made of integers, for which any bits are a value; the memory is always readable.
        body(unsafe { (*addr_of_mut!(RETAINED)).assume_init_mut() })
    })
}

/// Retains the fault log over a reset, and the checksum of the joints that it numbers.
pub fn retain_faults(log: &FaultLog, joints: u32) {
    if let Some(record) = Record::encode(&(log, joints), FaultLog::KEY) {
        with(|retained| retained.log = record);
    }
}

/// The fault log from before the reset and the checksum of its joints, if valid.
pub fn faults() -> Option<(FaultLog, u32)> {
    with(|retained| retained.log).decode(FaultLog::KEY)
}

/// Retains the cause of a crash over the reset.
pub fn retain_crash(cause: FaultCause, place: u32, message: fmt::Arguments<'_>) {
    let mut text = Text { bytes: [0; MAX_TEXT], length: 0 };
    // A longer text is truncated.
    let _ = text.write_fmt(message);
    let length = text.length as u32;
    let crash = Crash { cause: u32::from(cause.number()), place, length, text: text.bytes };
    let checksum = crash.checksum();
    with(|retained| {
        retained.crash = crash;
        retained.crash_checksum = checksum;
    });
}

/// The crash before this start, if any. Later calls return `None`.
pub fn take_crash() -> Option<Crash> {
    let (crash, stored) = with(|retained| (retained.crash, retained.crash_checksum));
    let checksum = crash.checksum();
    with(|retained| retained.crash_checksum = !checksum);
    (stored == checksum).then_some(crash)
}

impl Crash {
    /// Panic, stopped crystal or CPU fault, as a fault cause.
    pub fn cause(&self) -> FaultCause {
        [FaultCause::Panic, FaultCause::CrystalStopped]
            .into_iter()
            .find(|cause| self.cause == u32::from(cause.number()))
            .unwrap_or(FaultCause::HardFault)
    }

    /// The message.
    pub fn text(&self) -> &str {
        let bytes = self.text.get(..self.length as usize).unwrap_or_default();
        core::str::from_utf8(bytes).unwrap_or_default()
    }

    /// With the key of the fault log, whose causes it names.
    fn checksum(&self) -> u32 {
        checksum(&self.text)
            ^ self.cause.rotate_left(8)
            ^ self.place.rotate_left(16)
            ^ self.length
            ^ FaultLog::KEY as u32
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
