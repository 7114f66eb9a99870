//! Unit tests on the emulated board: what a host cannot show. Prints a line a test, and `N passed, N failed` at the end.

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

/// What is tested, and whether it passes.
type Test = (&'static str, fn() -> bool);

#[entry]
fn main() -> ! {
    stack::paint();
    // The tests of the retained memory need a reset between their halves; the second start finds what the first left.
    let second_start = retained::faults().is_some_and(|log| log.total == 2 && log.faults.len() == 2);
    if !second_start {
        let mut log = FaultLog::new();
        log.record(fault(FaultCause::EncoderJump, Some(4), 0.25));
        log.record(fault(FaultCause::CommandTimeout, None, 0.11));
        retained::keep_faults(&log);
        retained::keep_death(
            FaultCause::Panic,
            77,
            format_args!(
                "a message that is {} characters long and more than fits into the place that is kept for the last words of the firmware",
                120
            ),
        );
        SCB::sys_reset();
    }
    let tests: &[Test] = &[
        ("faults survive a reset", faults_survive),
        ("the last words survive a reset, cut to what fits, and are told once", last_words_survive),
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

fn last_words_survive() -> bool {
    let Some(death) = retained::take_death() else { return false };
    let start = "a message that is 120 characters long and more than fits";
    death.cause() == FaultCause::Panic
        && death.place == 77
        && death.words().starts_with(start)
        && death.words().len() == retained::WORDS
        && retained::take_death().is_none()
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

/// A UART that reads what a test puts there and is never ready to send.
struct Script {
    next: u8,
    lost: bool,
}

impl Uart for Script {
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
    let (mut port, endpoint) = link!(Script { next: 7, lost: false });
    for _ in 0..RECEIVE_QUEUE + 9 {
        port.on_interrupt();
    }
    endpoint.statistics().receive_overflow == 10
}

fn noise_is_counted() -> bool {
    let (mut port, mut endpoint) = link!(Script { next: 0, lost: true });
    for _ in 0..3 {
        port.on_interrupt();
    }
    endpoint.receive::<u8>().is_none() && endpoint.statistics().receive_errors == 3
}

fn no_partial_frames() -> bool {
    let (_port, mut endpoint) = link!(Script { next: 0, lost: false });
    // 128 bytes make a frame of some 140; seven fit into a queue that nobody empties.
    let message: heapless::Vec<u8, 128> = core::iter::repeat_n(1, 128).collect();
    let sent = (0..9).filter(|_| endpoint.send(&message)).count();
    sent == 7 && endpoint.statistics().send_overflow == 2
}

fn stack_is_measured() -> bool {
    let (before, size) = stack::usage();
    let deep = dig(40);
    let (after, _) = stack::usage();
    size == 56 * 1024 && after >= before + 4000 && after < size && deep > 0
}

#[inline(never)]
fn dig(depth: u32) -> u32 {
    let room = core::hint::black_box([depth; 32]);
    if depth == 0 { room[0] + 1 } else { dig(depth - 1) + room[3] }
}
