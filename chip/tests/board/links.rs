//! The serial lines: nothing is lost while the current loops run, and a silent plant link does no harm.

use tesaki::protocol::codec::{Decoder, FrameCounts, MAX_FRAME, encode};
use tesaki::protocol::{ActuatorFrame, Item, LinkStatistics, Mode, Request, SensorFrame, Stream};
use tesaki_chip::SECOND;
use tesaki_chip::bench::Bench;
use tesaki_chip::client::Client;
use tesaki_chip::cpu::Machine;
use tesaki_chip::pins::Pin;

use crate::rig::{MOTOR, Rig, image};

/// Asserts that no byte of `link` was lost or damaged.
fn assert_whole(link: &LinkStatistics) {
    let LinkStatistics { frames, receive_overflow, receive_errors, .. } = *link;
    assert_eq!((receive_overflow, receive_errors), (0, 0), "{link:?}");
    let FrameCounts { overlong, framing, checksum, malformed, .. } = frames;
    assert_eq!([overlong, framing, checksum, malformed], [0; 4], "{link:?}");
}

/// Runs with both directions of the line, at 921 600 baud, as full as possible. `each` is called with the
/// bench and the millisecond. Returns the number of bytes that the board has sent.
pub fn run_with_full_lines(rig: &mut Rig, milliseconds: u64, each: fn(&mut Bench, u64)) -> usize {
    for stream in Stream::ALL {
        rig.client.demand(&mut rig.machine, Request::SetRate { stream, every: 1 }).unwrap();
    }
    let start = rig.machine.now();
    let mut received = 0;
    for millisecond in 0..milliseconds {
        // A millisecond has 92 bytes.
        while rig.machine.chip.supervisor().incoming.len() < 120 {
            rig.keep();
        }
        rig.machine.run(start + (millisecond + 1) * SECOND / 1000).unwrap();
        received += rig.machine.chip.supervisor().outgoing.len();
        rig.client.receive(&mut rig.machine);
        each(&mut rig.machine.chip.bench, millisecond);
    }
    // The board drops the replies while its queue is full.
    for stream in Stream::ALL {
        rig.client.send(&mut rig.machine, Request::SetRate { stream, every: 0 });
    }
    rig.run(0.1);
    received
}

/// For a second, while three joints move; then for a fault, which is retained.
#[test]
fn no_byte_is_lost_beside_the_current_loops() {
    let mut rig = Rig::enabled();
    rig.goal([0.3, -0.3, 0.15]);
    let sent = rig.status().board.supervisor_link.frames.good;
    let received = run_with_full_lines(&mut rig, 1000, |bench, millisecond| {
        bench.fault = (800..820).contains(&millisecond);
    });
    let status = rig.status();
    let frames = status.board.supervisor_link.frames.good - sent;
    eprintln!("{frames} frames to the board, {received} bytes from it in a second");
    assert_eq!(rig.machine.chip.supervisor().lost, 0);
    assert_eq!(rig.client.damaged, 0);
    assert_whole(&status.board.supervisor_link);
    assert_eq!(status.node.mode, Mode::Fault);
    assert!(frames > 5000 && received > 50_000, "{frames} {received}");
}

/// A client that always has another request waiting, each of which takes longer than its bytes, starves
/// neither telemetry nor watchdog.
#[test]
fn a_flood_of_requests_leaves_telemetry_its_turn() {
    let mut rig = Rig::enabled();
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Telemetry, every: 1 }).unwrap();
    let before = rig.client.telemetry;
    let start = rig.machine.now();
    for millisecond in 1..=1000 {
        while rig.machine.chip.supervisor().incoming.len() < 120 {
            rig.client.send(&mut rig.machine, Request::Export(Item::State));
        }
        rig.machine.run(start + millisecond * SECOND / 1000).unwrap();
        rig.client.receive(&mut rig.machine);
    }
    let telemetry = rig.client.telemetry - before;
    println!("{telemetry} messages of telemetry in a second of requests without a pause");
    assert!(telemetry > 90, "{telemetry}");
    assert_eq!(rig.machine.resets, Vec::<&str>::new());
    assert_eq!(rig.machine.chip.supervisor().lost, 0);
}

/// The host of a plant link may be stopped in a debugger: the board waits for an hour of its time, and then
/// continues.
#[test]
fn an_hour_of_silence_on_the_plant_link_resets_nothing() {
    let mut machine = Machine::load(&image("bare"), Bench::new([MOTOR; 3], 1));
    // The strap requests the plant link.
    machine.chip.gpio.drive(Pin(1, 12), false);
    machine.run(SECOND / 10).unwrap();
    let mut decoder = Decoder::new();
    let mut answered = |machine: &mut Machine, sequence: u32| {
        let mut frame = [0; MAX_FRAME];
        let length = encode(&SensorFrame::silent(sequence), &mut frame).unwrap();
        machine.chip.usart[1].incoming.extend(&frame[..length]);
        machine.run(machine.now() + SECOND / 100).unwrap();
        let answer = std::mem::take(&mut machine.chip.usart[1].outgoing);
        answer.into_iter().find_map(|byte| decoder.push::<ActuatorFrame>(byte))
    };
    let before = answered(&mut machine, 1).unwrap().unwrap();
    assert_eq!((before.sequence, before.enabled), (1, false));
    machine.run(machine.now() + 3600 * SECOND).unwrap();
    assert_eq!(machine.resets, Vec::<&str>::new());
    assert!(machine.chip.iwdg.end.is_some(), "the watchdog does not run");
    let after = answered(&mut machine, 2).unwrap().unwrap();
    assert_eq!((after.sequence, after.enabled), (2, false));
    let mut client = Client::default();
    client.demand(&mut machine, Request::Hello { schema: tesaki::protocol::SCHEMA_KEY }).unwrap();
    let link = client.status(&mut machine).unwrap().board.plant;
    assert_whole(&link);
    assert_eq!(link.frames.good, 2);
}
