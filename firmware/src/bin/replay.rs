//! Repeats a recorded run on the emulated board: reads the file named on the semihosting command line, gives the node
//! the recorded requests and sensor frames, and compares each actuator frame with the recorded one, bit for bit.

#![no_std]
#![no_main]

use core::fmt::Write;

use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hio, syscall};
use tesaki::node::Node;
use tesaki::protocol::codec::Decoder;
use tesaki::protocol::{ActuatorFrame, BoardStatus, LogRecord};
use tesaki_firmware as _;

mod support;

static mut NODE: Node = Node::new();

#[entry]
fn main() -> ! {
    let mut out = hio::hstdout().expect("semihosting");
    // SAFETY: the only reference, in the only thread.
    let node = unsafe { &mut *core::ptr::addr_of_mut!(NODE) };
    let passed = match replay(node) {
        Ok(ticks) => writeln!(out, "replay: {ticks} ticks identical").is_ok() && ticks > 0,
        Err(Failure::File) => {
            let _ = writeln!(out, "replay: cannot read the file");
            false
        }
        Err(Failure::Damaged) => {
            let _ = writeln!(out, "replay: the recording is damaged");
            false
        }
        Err(Failure::Different { sequence, joint, recorded, computed }) => {
            let _ = writeln!(
                out,
                "replay: tick {sequence}, joint {joint}: recorded {recorded:#010x}, computed {computed:#010x}"
            );
            false
        }
    };
    debug::exit(if passed { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {}
}

enum Failure {
    File,
    Damaged,
    Different { sequence: u32, joint: usize, recorded: u32, computed: u32 },
}

fn replay(node: &mut Node) -> Result<u32, Failure> {
    let file = open().ok_or(Failure::File)?;
    let board = BoardStatus::default();
    let mut decoder = Decoder::new();
    let mut computed: Option<ActuatorFrame> = None;
    let mut ticks = 0;
    let mut buffer = [0_u8; 4096];
    loop {
        let length = read(file, &mut buffer);
        if length == 0 {
            return Ok(ticks);
        }
        for &byte in &buffer[..length] {
            match decoder.push::<LogRecord>(byte) {
                None => {}
                Some(Err(_)) => return Err(Failure::Damaged),
                Some(Ok(LogRecord::Request(request))) => {
                    node.handle(&request, &board);
                }
                Some(Ok(LogRecord::Sensors(sensors))) => computed = Some(node.tick(&sensors)),
                Some(Ok(LogRecord::Actuators(recorded))) => {
                    let computed = computed.take().ok_or(Failure::Damaged)?;
                    compare(&recorded, &computed)?;
                    ticks += 1;
                }
            }
        }
    }
}

fn compare(recorded: &ActuatorFrame, computed: &ActuatorFrame) -> Result<(), Failure> {
    let pairs = recorded.torques.iter().zip(&computed.torques);
    for (joint, (recorded_torque, computed_torque)) in pairs.enumerate() {
        let (recorded_bits, computed_bits) = (recorded_torque.to_bits(), computed_torque.to_bits());
        if recorded_bits != computed_bits {
            let sequence = recorded.sequence;
            return Err(Failure::Different {
                sequence,
                joint,
                recorded: recorded_bits,
                computed: computed_bits,
            });
        }
    }
    let same = recorded.sequence == computed.sequence
        && recorded.enabled == computed.enabled
        && recorded.torques.len() == computed.torques.len();
    let sequence = recorded.sequence;
    if same {
        Ok(())
    } else {
        Err(Failure::Different { sequence, joint: usize::MAX, recorded: 0, computed: 0 })
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

/// Fills the buffer from the file; returns how much of it.
fn read(file: usize, buffer: &mut [u8]) -> usize {
    // SAFETY: SYS_READ writes at most that many bytes into the buffer and returns how many it did *not* read.
    let missing = unsafe { syscall!(READ, file, buffer.as_mut_ptr() as usize, buffer.len()) };
    buffer.len().saturating_sub(missing)
}
