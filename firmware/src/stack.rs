//! Stack usage: the stack is painted at boot, and overwritten paint was used.

use core::ptr::{addr_of, read_volatile, write_volatile};

const PAINT: u32 = 0x5AC4_0FF5;
/// Unpainted margin below the stack pointer, for an interrupt during painting [bytes].
const MARGIN: usize = 256;

unsafe extern "C" {
    // From memory.x; only the addresses are meaningful.
    static _stack_start: u32;
    static _stack_end: u32;
}

fn bounds() -> (usize, usize) {
    (addr_of!(_stack_end) as usize, addr_of!(_stack_start) as usize)
}

/// Paints the free stack. Call it once, before interrupts are enabled.
pub fn paint() {
    let (end, _) = bounds();
    let here = cortex_m::register::msp::read() as usize;
    for address in (end..here.saturating_sub(MARGIN)).step_by(4) {
        // SAFETY: below the stack pointer, within the region that memory.x keeps for the stack alone.
        unsafe { write_volatile(address as *mut u32, PAINT) };
    }
}

/// Maximum number of bytes used so far, and the size of the stack.
pub fn usage() -> (u32, u32) {
    let (end, start) = bounds();
    // SAFETY: the stack's own region, aligned; reading words in use is harmless.
    let painted = |address: &usize| unsafe { read_volatile(*address as *const u32) } == PAINT;
    let free = (end..start).step_by(4).take_while(painted).count() * 4;
    ((start - end - free) as u32, (start - end) as u32)
}
