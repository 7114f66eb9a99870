//! The microcontroller's own supply, nominally 3.3 V.
//!
//! At 168 MHz with five wait states the chip needs 2.7 V (RM0090, table 10): below that the CPU reads wrong
//! instructions from its flash memory, with whatever outputs are on. Two things are there against it. The
//! voltage detector, set to 2.85 to 2.99 V, interrupts at the highest priority; the handler switches the
//! outputs off and resets. And the brown-out reset, which needs no instruction, at 2.75 to 2.88 V; it is an
//! option byte, off as chips are delivered, and this code only reads it: writing option bytes while the
//! supply may bounce could lock the chip.

use crate::pac;
use crate::watchdog::Watchdog;

/// PLS in PWR_CR: 2.85 to 2.99 V falling, 2.96 to 3.10 V rising (STM32F405 datasheet, table 19). The next
/// level rises at 3.21 V, which a supply of 3.3 V with a tolerance of 3 % need not reach.
const LEVEL: u8 = 6;
/// The detector's line of EXTI, which rises when the voltage falls. Boards keep it in the mask.
pub const LINE: u32 = 1 << 16;
/// Time until the detector's output counts, 0.1 ms at 16 MHz [cycles]; the manual gives none.
const SETTLING: u32 = 1_600;
/// Polls until the supply counts as too low: 0.6 to 1 s at 16 MHz and 12 to 20 cycles per poll.
const POLLS: u32 = 800_000;

/// Starts the detector, and waits for a sufficient supply, at most a second. Returns whether it came:
/// then every drop raises the interrupt `PVD` from now on. Without it the chip may only run at 16 MHz, for
/// which 1.8 V are enough.
pub fn start(rcc: &pac::RCC, pwr: &pac::PWR, exti: &pac::EXTI, watchdog: &Watchdog) -> bool {
    rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    // Without this the next access may be lost (erratum 2.1.13), and the supply would not be watched.
    cortex_m::asm::dsb();
    // SAFETY: a level of three bits.
    pwr.cr().modify(|_, w| unsafe { w.pls().bits(LEVEL).pvde().set_bit() });
    // SAFETY: the bit of a line that the chip has.
    exti.rtsr().modify(|r, w| unsafe { w.bits(r.bits() | LINE) });
    cortex_m::asm::delay(SETTLING);
    for _ in 0..POLLS {
        watchdog.feed();
        // An edge before the next line is that of the rising supply; a later one is kept.
        // SAFETY: ones clear bits in this register; the others stay.
        exti.pr().write(|w| unsafe { w.bits(LINE) });
        if pwr.csr().read().pvdo().bit_is_clear() {
            // SAFETY: the bit of a line that the chip has.
            exti.imr().modify(|r, w| unsafe { w.bits(r.bits() | LINE) });
            return true;
        }
    }
    false
}

/// Level of the brown-out reset that 168 MHz need.
pub const NEEDED_LEVEL: u32 = 3;

/// Returns the level of the brown-out reset, 0 when it is off.
pub fn brown_out_level(flash: &pac::FLASH) -> u32 {
    // BOR_LEV in FLASH_OPTCR: 0b00 is level 3, 0b11 is off (RM0090, 3.9.10).
    3 - (flash.optcr().read().bits() >> 2 & 3)
}
