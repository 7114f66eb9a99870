//! Stack usage: the stack is painted at boot; where the paint is gone, the stack was used.

use core::ptr::{addr_of, read_volatile, write_volatile};
use core::sync::atomic::{AtomicUsize, Ordering};

const PAINT: u32 = 0x5AC4_0FF5;
/// Unpainted margin below the stack pointer, for the painting itself [bytes].
const MARGIN: usize = 256;
/// Words that one scan examines.
const CHUNK: usize = 256;

/// Lowest address known to have been used; 0 before [`paint`].
static MARK: AtomicUsize = AtomicUsize::new(0);
/// Where the next scan begins.
static CURSOR: AtomicUsize = AtomicUsize::new(0);

unsafe extern "C" {
    // From memory.x; only the addresses are meaningful.
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Returns the lowest address of the stack, and the address above it.
pub fn bounds() -> (usize, usize) {
    (addr_of!(_stack_end) as usize, addr_of!(_stack_start) as usize)
}

/// Paints the free stack.
///
/// # Safety
/// Interrupts are off.
pub unsafe fn paint() {
    let (end, _) = bounds();
    let here = cortex_m::register::msp::read() as usize;
    let painted = end..here.saturating_sub(MARGIN);
    MARK.store(painted.end, Ordering::Relaxed);
    CURSOR.store(end, Ordering::Relaxed);
    for address in painted.step_by(4) {
        // SAFETY: below the stack pointer and what this function may push, within the region that memory.x
        // keeps for the stack alone; the caller guarantees that nothing else uses it now.
        unsafe { write_volatile(address as *mut u32, PAINT) };
    }
}

/// Examines the next part of the stack that is not known to be used. Only the idle loop calls it: 52 short
/// calls cover the whole stack.
pub fn scan() {
    let (end, _) = bounds();
    let mark = MARK.load(Ordering::Relaxed);
    let from = Some(CURSOR.load(Ordering::Relaxed)).filter(|&from| from < mark).unwrap_or(end);
    let to = mark.min(from + 4 * CHUNK);
    // SAFETY: the stack's own region, aligned; reading words in use is harmless.
    let used = |address: &usize| unsafe { read_volatile(*address as *const u32) } != PAINT;
    let found = (from..to).step_by(4).find(used);
    if let Some(found) = found {
        MARK.store(found, Ordering::Relaxed);
    }
    CURSOR.store(if found.is_some() { end } else { to }, Ordering::Relaxed);
}

/// Returns the maximum number of bytes used so far, as far as [`scan`] has seen, and the size of the stack.
pub fn usage() -> (u32, u32) {
    let (end, start) = bounds();
    ((start - MARK.load(Ordering::Relaxed).clamp(end, start)) as u32, (start - end) as u32)
}
