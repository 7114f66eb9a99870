//! Tests that require the emulated board. Prints one line per test, then `N passed, N failed`.

#![no_std]
#![no_main]

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use tesaki::fault::{Fault, FaultCause, FaultLog};
use tesaki::math;
use tesaki::protocol::codec::checksum;
use tesaki_firmware::link::{RECEIVE_QUEUE, Storage, Uart};
use tesaki_firmware::{retained, stack};

mod support;

/// Name of a test, and its function.
type Test = (&'static str, fn() -> bool);

#[entry]
fn main() -> ! {
    stack::paint();
    // The tests of retained memory need a reset: the second start checks what the first one retained.
    let second_start = retained::faults().is_some_and(|log| log.total == 2 && log.faults.len() == 2);
    if !second_start {
        let mut log = FaultLog::new();
        log.record(fault(FaultCause::EncoderJump, Some(4), 0.25));
        log.record(fault(FaultCause::CommandTimeout, None, 0.11));
        retained::retain_faults(&log);
        retained::retain_crash(
            FaultCause::Panic,
            77,
            format_args!(
                "a message that is {} characters long and more than fits into the place that is kept for the \
                 last words of the firmware",
                120
            ),
        );
        SCB::sys_reset();
    }
    let tests: &[Test] = &[
        ("faults survive a reset", faults_survive),
        ("the message of a crash survives a reset, truncated, and is returned once", crash_message_survives),
        ("sine and cosine have the bits that the host computed", sine_has_the_hosts_bits),
        ("square root and arc tangent have the bits that the host computed", libm_has_the_hosts_bits),
        ("the checksum is CRC-32", || checksum(b"123456789") == 0xcbf4_3926),
        ("a full receive queue counts what it loses", overflow_is_counted),
        ("noise on the line is counted", noise_is_counted),
        ("a frame that does not fit is not sent in part", no_partial_frames),
        ("the stack's use is measured", stack_is_measured),
    ];
    let mut failed = 0;
    for (name, test) in tests {
        let passed = test();
        hprintln!("test {} ... {}", name, if passed { "ok" } else { "FAILED" });
        failed += usize::from(!passed);
    }
    hprintln!("{} passed, {} failed", tests.len() - failed, failed);
    debug::exit(if failed == 0 { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::nop();
    }
}

fn fault(cause: FaultCause, joint: Option<u8>, value: f32) -> Fault {
    Fault { cause, joint, value, limit: 0.1, tick: 12 }
}

fn faults_survive() -> bool {
    retained::faults().is_some_and(|log| {
        log.faults[0] == fault(FaultCause::EncoderJump, Some(4), 0.25)
            && log.faults[1] == fault(FaultCause::CommandTimeout, None, 0.11)
    })
}

fn crash_message_survives() -> bool {
    let Some(crash) = retained::take_crash() else { return false };
    let start = "a message that is 120 characters long and more than fits";
    crash.cause() == FaultCause::Panic
        && crash.place == 77
        && crash.text().starts_with(start)
        && crash.text().len() == retained::MAX_TEXT
        && retained::take_crash().is_none()
}

/// Bits as computed on x86-64 by the same functions (see `tests/tests/target_bits.rs`).
fn sine_has_the_hosts_bits() -> bool {
    let mut hash = 0_u32;
    for index in 0..20_000_i32 {
        let (sine, cosine) = math::sin_cos(index as f32 * 0.731_3 - 7000.0);
        hash = hash.rotate_left(5) ^ sine.to_bits() ^ cosine.to_bits().rotate_left(16);
    }
    hash == SINE_HASH
}

fn libm_has_the_hosts_bits() -> bool {
    let mut hash = 0_u32;
    for index in 1..5_000_i32 {
        let x = index as f32 * 0.173;
        let bits =
            math::sqrt(x).to_bits() ^ math::atan2(x - 400.0, x * 0.7 - 200.0).to_bits().rotate_left(16);
        hash = hash.rotate_left(5) ^ bits ^ math::exp(-x * 0.01).to_bits().rotate_left(8);
    }
    hash == MATH_HASH
}

include!("../../../tests/target_bits.in");

/// A simulated UART that receives one byte repeatedly and is never ready to send.
struct FakeUart {
    next: u8,
    lost: bool,
}

impl Uart for FakeUart {
    fn receive(&mut self) -> (Option<u8>, bool) {
        (Some(self.next), self.lost)
    }
    fn ready(&self) -> bool {
        false
    }
    fn send(&mut self, _byte: u8) {}
    fn interrupt_when_ready(&mut self, _wanted: bool) {}
}

macro_rules! link {
    ($script:expr) => {{
        static mut STORAGE: Storage = Storage::new();
        // SAFETY: each test has a storage of its own and runs once.
        unsafe { &mut *core::ptr::addr_of_mut!(STORAGE) }.split($script)
    }};
}

fn overflow_is_counted() -> bool {
    let (mut isr, endpoint) = link!(FakeUart { next: 7, lost: false });
    for _ in 0..RECEIVE_QUEUE + 9 {
        isr.on_interrupt();
    }
    endpoint.statistics().receive_overflow == 10
}

fn noise_is_counted() -> bool {
    let (mut isr, mut endpoint) = link!(FakeUart { next: 0, lost: true });
    for _ in 0..3 {
        isr.on_interrupt();
    }
    endpoint.receive::<u8>().is_none() && endpoint.statistics().receive_errors == 3
}

fn no_partial_frames() -> bool {
    let (_isr, mut endpoint) = link!(FakeUart { next: 0, lost: false });
    // 128 bytes make a frame of some 140; seven fit into a queue that nobody empties.
    let message: heapless::Vec<u8, 128> = core::iter::repeat_n(1, 128).collect();
    let sent = (0..9).filter(|_| endpoint.send(&message)).count();
    sent == 7 && endpoint.statistics().send_overflow == 2
}

fn stack_is_measured() -> bool {
    let (before, size) = stack::usage();
    let deep = dig(40);
    let (after, _) = stack::usage();
    size == 52 * 1024 && after >= before + 4000 && after < size && deep > 0
}

#[inline(never)]
fn dig(depth: u32) -> u32 {
    let room = core::hint::black_box([depth; 32]);
    if depth == 0 { room[0] + 1 } else { dig(depth - 1) + room[3] }
}
