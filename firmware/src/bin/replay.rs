//! Replays a recorded run on the emulated board: reads the file named on the semihosting command line, feeds
//! the node with the recorded requests and sensor frames, and compares the actuator frames bit for bit.
//! Prints the executed instructions of the longest tick (with `-icount shift=0`: one instruction is one
//! nanosecond of virtual time).

#![no_std]
#![no_main]

use core::fmt::Write;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hio, syscall};
use tesaki::node::{Node, Replay, ReplayError};
use tesaki::protocol::LogRecord;
use tesaki::protocol::codec::Decoder;
use tesaki_firmware as _;

mod support;

static mut NODE: Node = Node::new();

#[entry]
fn main() -> ! {
    let mut out = hio::hstdout().expect("semihosting");
    // SAFETY: the only reference, in the only thread.
    let node = unsafe { &mut *core::ptr::addr_of_mut!(NODE) };
    let passed = match replay(node) {
        Ok(Run { ticks, longest }) => {
            writeln!(out, "replay: {ticks} ticks identical, the longest {longest} instructions").is_ok()
                && ticks > 0
        }
        Err(Failure::File) => {
            let _ = writeln!(out, "replay: cannot read the file");
            false
        }
        Err(Failure::Damaged) => {
            let _ = writeln!(out, "replay: the recording is damaged");
            false
        }
        Err(Failure::Replay(error)) => {
            let _ = writeln!(out, "replay: {error}");
            false
        }
    };
    debug::exit(if passed { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::nop();
    }
}

enum Failure {
    File,
    Damaged,
    Replay(ReplayError),
}

/// Result of a replay.
struct Run {
    ticks: u32,
    /// Instructions of the longest tick.
    longest: u32,
}

/// Starts the counter: 24 bits, down, 168 MHz.
fn start_counter() -> Option<SYST> {
    let mut counter = cortex_m::Peripherals::take()?.SYST;
    counter.set_clock_source(SystClkSource::Core);
    counter.set_reload(0xFF_FFFF);
    counter.clear_current();
    counter.enable_counter();
    Some(counter)
}

fn replay(node: &mut Node) -> Result<Run, Failure> {
    let _counter = start_counter();
    let file = open().ok_or(Failure::File)?;
    let mut replay = Replay::new(node);
    let mut decoder = Decoder::new();
    let mut run = Run { ticks: 0, longest: 0 };
    let mut buffer = [0_u8; 4096];
    loop {
        let length = read(file, &mut buffer);
        if length == 0 {
            return Ok(run);
        }
        let mut bytes = &buffer[..length];
        while decoder.take(&mut bytes) {
            let record = decoder.message().map_err(|_| Failure::Damaged)?;
            let before = SYST::get_current();
            run.ticks += u32::from(replay.feed(&record).map_err(Failure::Replay)?);
            let counts = before.wrapping_sub(SYST::get_current()) & 0xFF_FFFF;
            if let LogRecord::Sensors(_) = record {
                run.longest = run.longest.max(counts * 125 / 21);
            }
        }
    }
}

/// Opens the file named on the command line.
fn open() -> Option<usize> {
    let mut line = [0_u8; 512];
    let mut block = [line.as_mut_ptr() as usize, line.len()];
    // SAFETY: SYS_GET_CMDLINE (0x15) fills the buffer that the block describes.
    if unsafe { cortex_m_semihosting::syscall1(0x15, block.as_mut_ptr() as usize) } != 0 {
        return None;
    }
    // SAFETY: SYS_OPEN reads the name that the block describes, closed by a zero; mode 1 is "rb".
    let handle = unsafe { syscall!(OPEN, line.as_ptr() as usize, 1, block[1]) };
    (handle != usize::MAX).then_some(handle)
}

/// Reads from the file into the buffer. Returns the number of bytes.
fn read(file: usize, buffer: &mut [u8]) -> usize {
    // SAFETY: SYS_READ writes at most that many bytes into the buffer and returns how many it did *not* read.
    let missing = unsafe { syscall!(READ, file, buffer.as_mut_ptr() as usize, buffer.len()) };
    buffer.len().saturating_sub(missing)
}
