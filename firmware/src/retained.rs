//! Memory that a reset does not clear: the fault log, and the cause of a crash.
//!
//! After power-on its content is random, and after an update it is that of another firmware. Checksums and a
//! key detect both, and also a write that a reset interrupted.

use core::mem::MaybeUninit;
use core::num::NonZero;
use core::ptr;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::fault::{FaultCause, FaultLog};
use tesaki::protocol::{codec::checksum, to_slice};

/// Bytes of the longest postcard encoding of a [`FaultLog`] and the checksum of its joints: 16 faults of 16
/// bytes, their number and two of 5 bytes, rounded up.
const LOG: usize = 272;
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
        let length = to_slice(value, &mut bytes).ok()?;
        let checksum = checksum(bytes.get(..length)?);
        Some(Self { key, checksum, length: length as u32, bytes })
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
    /// Line of the panic, program counter of the CPU fault, or [value of the fault of a low
    /// supply](FaultCause::ChipSupplyLow).
    pub place: u32,
    length: u32,
    text: [u8; MAX_TEXT],
}

#[unsafe(link_section = ".uninit.RETAINED")]
static mut RETAINED: MaybeUninit<Retained> = MaybeUninit::uninit();

/// Returns the memory. All accesses are volatile: to the compiler its content is undefined after a start, and
/// it must not conclude anything from that.
fn retained() -> *mut Retained {
    (&raw mut RETAINED).cast()
}

/// Reads by words in a loop; a volatile read of the whole is unrolled to one of each byte.
///
/// # Safety
/// The memory at `place` is there, is aligned to words, and any bits are a valid `T` of whole words.
unsafe fn load<T: Copy>(place: *const T) -> T {
    const { assert!(size_of::<T>().is_multiple_of(size_of::<u32>()) && align_of::<T>() >= align_of::<u32>()) };
    let mut value = MaybeUninit::<T>::uninit();
    for word in 0..size_of::<T>() / size_of::<u32>() {
        // SAFETY: both are as long as `T`; the caller guarantees the rest.
        unsafe {
            value.as_mut_ptr().cast::<u32>().add(word).write(place.cast::<u32>().add(word).read_volatile())
        }
    }
    // SAFETY: all words are written, and any bits are valid.
    unsafe { value.assume_init() }
}

/// Writes by words in a loop.
///
/// # Safety
/// The memory at `place` is there and aligned to words, and `T` consists of whole words without padding.
unsafe fn store<T: Copy>(place: *mut T, value: &T) {
    const { assert!(size_of::<T>().is_multiple_of(size_of::<u32>()) && align_of::<T>() >= align_of::<u32>()) };
    for word in 0..size_of::<T>() / size_of::<u32>() {
        // SAFETY: both are as long as `T`; the caller guarantees the rest.
        unsafe {
            place.cast::<u32>().add(word).write_volatile((&raw const *value).cast::<u32>().add(word).read())
        }
    }
}

/// Retains the fault log, and the checksum of the joints that it numbers, over a reset. Interrupts stay on:
/// all callers hold the node's lock, so there is only one at a time.
pub fn retain_faults(log: &FaultLog, joints: u32) {
    if let Some(record) = Record::encode(&(log, joints), FaultLog::KEY) {
        // SAFETY: the memory is there and aligned, and nobody else accesses the log now, see above.
        unsafe { store(&raw mut (*retained()).log, &record) }
    }
}

/// Returns the fault log from before the reset and the checksum of its joints, if valid. The memory may also
/// keep it through a short loss of power.
pub fn faults() -> Option<(FaultLog, u32)> {
    // SAFETY: the memory is there and aligned; any bits are valid integers.
    unsafe { load(&raw const (*retained()).log) }.decode(FaultLog::KEY)
}

/// A part of the message of a crash.
// Without `core::fmt`, which would take 3 KiB of flash for these messages alone, and thousands of instructions
// while the supply falls.
#[derive(Clone, Copy, Debug)]
pub enum Word<'a> {
    /// As it is.
    Text(&'a str),
    /// `0x` and eight digits.
    Hexadecimal(u32),
    /// Without leading zeros.
    Decimal(u32),
}

/// Retains the cause of a crash over the reset, with a message, which is truncated if it is too long. The
/// caller must have interrupts off, or be an interrupt that nothing else can interrupt.
pub fn retain_crash(cause: FaultCause, place: u32, message: &[Word<'_>]) {
    let mut crash = Crash { cause: u32::from(cause.number()), place, length: 0, text: [0; MAX_TEXT] };
    for word in message {
        match *word {
            Word::Text(text) => crash.append(text.as_bytes()),
            Word::Hexadecimal(value) => {
                crash.append(b"0x");
                crash.append(digits(value, const { NonZero::new(16).unwrap() }).get(2..).unwrap_or_default());
            }
            Word::Decimal(value) => {
                let digits = digits(value, const { NonZero::new(10).unwrap() });
                let first = digits.iter().position(|&digit| digit != b'0').unwrap_or(digits.len() - 1);
                crash.append(digits.get(first..).unwrap_or_default());
            }
        }
    }
    let checksum = crash.checksum();
    // SAFETY: as for the log; nothing else runs any more.
    unsafe {
        store(&raw mut (*retained()).crash, &crash);
        ptr::write_volatile(&raw mut (*retained()).crash_checksum, checksum);
    }
}

/// Returns the digits of a number, with leading zeros.
fn digits(mut value: u32, radix: NonZero<u32>) -> [u8; 10] {
    let mut digits = [0; 10];
    for place in digits.iter_mut().rev() {
        let digit = (value % radix) as u8;
        *place = if digit < 10 { b'0' + digit } else { b'a' - 10 + digit };
        value /= radix;
    }
    digits
}

/// Returns the crash before this start, if any. Later calls return `None`.
pub fn take_crash() -> Option<Crash> {
    // SAFETY: as for the log; it is called before the first interrupt.
    let (crash, stored) = unsafe {
        (load(&raw const (*retained()).crash), ptr::read_volatile(&raw const (*retained()).crash_checksum))
    };
    let checksum = crash.checksum();
    // SAFETY: the same.
    unsafe { ptr::write_volatile(&raw mut (*retained()).crash_checksum, !checksum) };
    (stored == checksum).then_some(crash)
}

impl Crash {
    /// Returns the fault cause: panic, stopped crystal, low supply of the chip, or CPU fault.
    pub fn cause(&self) -> FaultCause {
        [FaultCause::Panic, FaultCause::CrystalStopped, FaultCause::ChipSupplyLow]
            .into_iter()
            .find(|cause| self.cause == u32::from(cause.number()))
            .unwrap_or(FaultCause::HardFault)
    }

    /// Adds as much to the message as there is place for.
    fn append(&mut self, text: &[u8]) {
        let free = self.text.get_mut(self.length as usize..).unwrap_or_default();
        for (place, byte) in free.iter_mut().zip(text) {
            *place = *byte;
            self.length += 1;
        }
    }

    /// Returns the message, without a character that was truncated.
    pub fn text(&self) -> &str {
        let bytes = self.text.get(..self.length as usize).unwrap_or_default();
        bytes.utf8_chunks().next().map_or("", |chunk| chunk.valid())
    }

    /// Computes the checksum. It includes the key of the fault log, as that fixes the numbers of the causes.
    fn checksum(&self) -> u32 {
        checksum(&self.text)
            ^ self.cause.rotate_left(8)
            ^ self.place.rotate_left(16)
            ^ self.length
            ^ FaultLog::KEY as u32
    }
}
