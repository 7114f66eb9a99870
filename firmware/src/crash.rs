//! Panic and CPU fault: switch the outputs off, retain the cause, reset.

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use tesaki::fault::FaultCause;
use tesaki_firmware::board::{Board, ThisBoard};
use tesaki_firmware::retained::retain_crash;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    ThisBoard::outputs_off();
    let (file, line) = info.location().map_or(("?", 0), |location| (location.file(), location.line()));
    retain_crash(FaultCause::Panic, line, format_args!("{} ({file}:{line})", info.message()));
    SCB::sys_reset()
}

#[exception]
// SAFETY: an exception handler must be unsafe; this one only reads its frame.
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    cortex_m::interrupt::disable();
    ThisBoard::outputs_off();
    retain_crash(
        FaultCause::HardFault,
        frame.pc(),
        format_args!("CPU fault at pc {:#010x}, lr {:#010x}", frame.pc(), frame.lr()),
    );
    SCB::sys_reset()
}
