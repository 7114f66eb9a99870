//! Panic, CPU fault, stopped crystal and low supply: switch the outputs off, retain the cause, reset.

use core::arch::naked_asm;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use stm32f4xx_hal::pac;
use tesaki::fault::FaultCause;
use tesaki_firmware::board::{Board, ThisBoard};
use tesaki_firmware::clock;
use tesaki_firmware::retained::{Word, retain_crash};
use tesaki_firmware::stack;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    ThisBoard::off();
    let (file, line) = info.location().map_or(("?", 0), |location| (location.file(), location.line()));
    // Without its message: that would need `core::fmt`.
    let words = [Word::Text("panicked at "), Word::Text(file), Word::Text(":"), Word::Decimal(line)];
    // SAFETY: nothing else runs any more.
    unsafe { retain_crash(FaultCause::Panic, line, &words) };
    SCB::sys_reset()
}

/// Bytes of the stack of [`hard_fault`], which retains one message.
const EMERGENCY: usize = 2048;

#[unsafe(link_section = ".uninit.EMERGENCY")]
static mut EMERGENCY_STACK: MaybeUninit<[u64; EMERGENCY / 8]> = MaybeUninit::uninit();

/// The first instructions after a CPU fault. They use no stack: after a stack overflow a push would fault
/// within the fault handler, which locks the CPU up with the outputs on.
#[unsafe(naked)]
#[unsafe(export_name = "HardFault")]
#[unsafe(link_section = ".HardFault.user")]
extern "C" fn enter_hard_fault() -> ! {
    naked_asm!(
        "mrs r0, MSP",
        "movw r1, #:lower16:({stack} + {size})",
        "movt r1, #:upper16:({stack} + {size})",
        "msr MSP, r1",
        "b {handler}",
        stack = sym EMERGENCY_STACK,
        size = const EMERGENCY,
        handler = sym hard_fault,
    )
}

/// Handles a CPU fault. `frame` is the stack pointer of the failed code, where the CPU has pushed its
/// registers if there was room.
extern "C" fn hard_fault(frame: usize) -> ! {
    cortex_m::interrupt::disable();
    ThisBoard::off();
    let (end, start) = stack::bounds();
    if (end..=start - 32).contains(&frame) && !failed_to_push() {
        // SAFETY: the frame lies in the stack: R0 to R3, R12, LR, PC, xPSR.
        let [lr, pc] = unsafe { *((frame + 20) as *const [u32; 2]) };
        let words = [
            Word::Text("CPU fault at pc "),
            Word::Hexadecimal(pc),
            Word::Text(", lr "),
            Word::Hexadecimal(lr),
        ];
        // SAFETY: nothing else runs any more.
        unsafe { retain_crash(FaultCause::HardFault, pc, &words) };
    } else {
        let size = Word::Decimal((start - end) as u32);
        let words = [Word::Text("stack overflow: "), size, Word::Text(" bytes are not enough")];
        // SAFETY: nothing else runs any more.
        unsafe { retain_crash(FaultCause::HardFault, 0, &words) };
    }
    SCB::sys_reset()
}

/// Returns whether the CPU could not push its registers at an exception: STKERR or MSTKERR.
fn failed_to_push() -> bool {
    const STACKING: u32 = 1 << 12 | 1 << 4;
    // SAFETY: reading this register has no effect.
    unsafe { (*SCB::PTR).cfsr.read() & STACKING != 0 }
}

/// The clock security system's interrupt, the only one of this kind on the chip: the crystal has stopped, and
/// the CPU runs on the internal oscillator without PLL.
#[exception]
// SAFETY: an exception handler of this kind must be unsafe, as it can interrupt everything; this one never
// returns.
unsafe fn NonMaskableInt() -> ! {
    ThisBoard::off();
    // SAFETY: one store to a register that nobody else uses now.
    unsafe { (*pac::RCC::ptr()).cir().modify(|_, w| w.cssc().clear()) };
    // SAFETY: nothing else runs any more.
    unsafe { retain_crash(FaultCause::CrystalStopped, 0, &[Word::Text("the crystal stopped")]) };
    SCB::sys_reset()
}

/// The supply of the microcontroller falls: some 10 to 100 µs later the CPU may read wrong instructions at
/// this clock. The internal oscillator is slow enough for every voltage at which the chip runs.
pub fn end_by_low_supply() -> ! {
    cortex_m::interrupt::disable();
    ThisBoard::off();
    clock::slow_down();
    let words = [Word::Text("the microcontroller's supply fell below 2.9 V")];
    // SAFETY: nothing else runs any more.
    unsafe { retain_crash(FaultCause::ChipSupplyLow, 1, &words) };
    SCB::sys_reset()
}
