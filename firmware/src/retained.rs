//! Memory that a reset does not clear: the fault log, and the cause of a crash.
//!
//! After power-on its content is random, and after an update it is that of another firmware. Checksums and a
//! key detect both, and also a write that a reset interrupted.

use core::mem::MaybeUninit;
use core::num::NonZero;
use core::ptr;

use heapless::{String, Vec};
use tesaki::fault::{FaultCause, FaultLog};
use tesaki::protocol::codec::checksum;

/// Maximum length of a retained message [bytes].
pub const MAX_TEXT: usize = 96;
/// Bytes of a crash: the number of its cause, its place, each as a word, and its message.
const CRASH: usize = 8 + MAX_TEXT;

#[repr(C)]
struct Retained {
    log: Record<{ FaultLog::MAX_BYTES }>,
    crash: Record<CRASH>,
}

/// Up to `N` bytes, a multiple of four, under a key of their layout.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Record<const N: usize> {
    checksum: u32,
    length: u32,
    bytes: [u8; N],
}

impl<const N: usize> Record<N> {
    /// Creates a record; `None` if there are too many bytes.
    pub fn new(bytes: &[u8], key: u64) -> Option<Self> {
        let mut record =
            Self { checksum: checksum_of(bytes, key), length: bytes.len() as u32, bytes: [0; N] };
        record.bytes.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(record)
    }

    /// Returns the bytes, if they are intact and have this key.
    pub fn contents(&self, key: u64) -> Option<&[u8]> {
        self.bytes.get(..self.length as usize).filter(|bytes| checksum_of(bytes, key) == self.checksum)
    }
}

fn checksum_of(bytes: &[u8], key: u64) -> u32 {
    checksum(bytes) ^ key as u32 ^ (key >> 32) as u32
}

/// A crash.
#[derive(Clone, Debug)]
pub struct Crash {
    /// Panic, stopped crystal, low supply of the chip, or CPU fault.
    pub cause: FaultCause,
    /// Line of the panic, program counter of the CPU fault, or [value of the fault of a low
    /// supply](FaultCause::ChipSupplyLow).
    pub place: u32,
    /// The message.
    pub text: String<MAX_TEXT>,
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

/// Retains the fault log, and the checksum of the joints that it numbers, over a reset. Interrupts may be on.
///
/// # Safety
/// No other function of the log runs meanwhile.
pub unsafe fn retain_faults(log: &FaultLog, joints: u32) {
    let mut buffer = [0; FaultLog::MAX_BYTES];
    if let Some(record) =
        log.to_bytes(joints, &mut buffer).and_then(|bytes| Record::new(bytes, FaultLog::KEY))
    {
        // SAFETY: the memory is there and aligned; the caller guarantees that nobody else accesses it.
        unsafe { store(&raw mut (*retained()).log, &record) }
    }
}

/// Returns the fault log from before the reset and the checksum of its joints, if valid. The memory may also
/// keep it through a short loss of power.
///
/// # Safety
/// No other function of the log runs meanwhile.
pub unsafe fn faults() -> Option<(FaultLog, u32)> {
    // SAFETY: the memory is there and aligned, and any bits are valid integers; the caller guarantees that
    // nobody else accesses it.
    let record = unsafe { load(&raw const (*retained()).log) };
    FaultLog::from_bytes(record.contents(FaultLog::KEY)?)
}

/// A part of the message of a crash.
// Without `core::fmt`, which would take 3 KiB of flash for these messages alone, and thousands of
// instructions while the supply falls.
#[derive(Clone, Copy, Debug)]
pub enum Word<'a> {
    /// As it is.
    Text(&'a str),
    /// `0x` and eight digits.
    Hexadecimal(u32),
    /// Without leading zeros.
    Decimal(u32),
}

/// Retains a crash over the reset, with a message, which is truncated if it is too long.
///
/// # Safety
/// No other function of the crash runs meanwhile, as when interrupts are off, or in an interrupt that nothing
/// else can interrupt.
pub unsafe fn retain_crash(cause: FaultCause, place: u32, message: &[Word<'_>]) {
    let mut bytes = Vec::<u8, CRASH>::new();
    let mut append = |part: &[u8]| {
        for byte in part {
            // Too much is left out.
            let _ = bytes.push(*byte);
        }
    };
    append(&u32::from(cause.number()).to_le_bytes());
    append(&place.to_le_bytes());
    for word in message {
        match *word {
            Word::Text(text) => append(text.as_bytes()),
            Word::Hexadecimal(value) => {
                append(b"0x");
                append(digits(value, const { NonZero::new(16).unwrap() }).get(2..).unwrap_or_default());
            }
            Word::Decimal(value) => {
                let digits = digits(value, const { NonZero::new(10).unwrap() });
                let first = digits.iter().position(|&digit| digit != b'0').unwrap_or(digits.len() - 1);
                append(digits.get(first..).unwrap_or_default());
            }
        }
    }
    // The key of the fault log fixes the numbers of the causes.
    if let Some(record) = Record::new(&bytes, FaultLog::KEY) {
        // SAFETY: as for the log.
        unsafe { store(&raw mut (*retained()).crash, &record) }
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
///
/// # Safety
/// No other function of the crash runs meanwhile.
pub unsafe fn take_crash() -> Option<Crash> {
    // SAFETY: as for the log.
    let record = unsafe { load(&raw const (*retained()).crash) };
    let bytes = record.contents(FaultLog::KEY)?;
    // SAFETY: as for the log.
    unsafe { ptr::write_volatile(&raw mut (*retained()).crash.checksum, !record.checksum) };
    let (cause, rest) = bytes.split_first_chunk()?;
    let (place, text) = rest.split_first_chunk()?;
    let cause = [FaultCause::Panic, FaultCause::CrystalStopped, FaultCause::ChipSupplyLow]
        .into_iter()
        .find(|known| u32::from(known.number()) == u32::from_le_bytes(*cause))
        .unwrap_or(FaultCause::HardFault);
    // A character that was truncated is left out.
    let text = text.utf8_chunks().next().and_then(|chunk| chunk.valid().try_into().ok()).unwrap_or_default();
    Some(Crash { cause, place: u32::from_le_bytes(*place), text })
}
