//! The wire, byte by byte, against frames that a script made without any of this code
//! (`tests/oracles/protocol.py`), and against the page that shows them.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::collections::BTreeMap;
use std::fmt::Debug;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::control::{JointPoint, ServoMode};
use tesaki::protocol::codec::{Decoder, FrameError, MAX_FRAME, encode};
use tesaki::protocol::{
    ActuatorFrame, Fault, FaultCause, FaultLog, FromBoard, Identity, Item, JointTelemetry, LogEntry,
    LogRecord, Mode, Refusal, Reply, ReplyFrame, Request, RequestFrame, SensorFlags, SensorFrame, SetPoint,
    Stream, Task, Telemetry,
};

const FRAMES: &str = include_str!("../oracles/data/protocol_frames.in");
const PAGE: &str = include_str!("../../docs/protocol.md");

fn list<T: Clone, const N: usize>(values: &[T]) -> heapless::Vec<T, N> {
    heapless::Vec::from_slice(values).unwrap()
}

fn golden() -> BTreeMap<&'static str, Vec<u8>> {
    FRAMES.lines().map(parse).collect()
}

/// `name: bytes`.
fn parse(line: &'static str) -> (&'static str, Vec<u8>) {
    let (name, bytes) = line.split_once(": ").unwrap_or_else(|| panic!("{line:?}"));
    (name, bytes.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect())
}

fn requests() -> Vec<(&'static str, RequestFrame)> {
    let frame = |sequence, request| RequestFrame { client: 1, sequence, request };
    let arm = |servo| Request::Arm { task: Task::JointServo(servo) };
    let goal = SetPoint::Goal { positions: list(&[0.1, 0.2, 0.3]) };
    let point = JointPoint { position: 0.1, velocity: 0.5, acceleration: -2.0 };
    vec![
        ("hello", frame(1, Request::Hello { schema: 0x0123_4567_89ab_cdef })),
        ("take_command", frame(2, Request::TakeCommand { by_force: false })),
        ("model_begin", frame(3, Request::ModelBegin { length: 1800, checksum: 0xdead_beef })),
        ("model_chunk", frame(4, Request::ModelChunk { offset: 192, data: list(&[7, 0, 9]) })),
        ("model_commit", frame(5, Request::ModelCommit)),
        ("home", frame(6, Request::Home { positions: list(&[0.0, 0.5, -0.25]) })),
        ("arm_pid", frame(7, arm(ServoMode::Pid))),
        ("arm_observer", frame(7, arm(ServoMode::Observer))),
        ("disarm", frame(9, Request::Disarm)),
        ("goal", frame(10, Request::SetPoint(goal))),
        ("stream", frame(11, Request::SetPoint(SetPoint::Stream { points: list(&[point]) }))),
        ("stop", frame(12, Request::Stop)),
        ("read_status", frame(13, Request::ReadStatus)),
        ("read_faults", frame(14, Request::ReadFaults)),
        ("clear_faults", frame(15, Request::ClearFaults { total: 3 })),
        ("set_rate", frame(16, Request::SetRate { stream: Stream::Telemetry, every: 5 })),
        ("release_command", frame(17, Request::ReleaseCommand)),
        ("export_model", frame(18, Request::Export(Item::Model))),
        ("export_state", frame(18, Request::Export(Item::State))),
        ("read_export", frame(19, Request::ReadExport { offset: 192 })),
    ]
}

/// Fails to compile when a request is added, as a reminder that it wants a golden frame and a line on the page.
const fn number(request: &Request) -> u8 {
    match request {
        Request::Hello { .. } => 0,
        Request::ModelBegin { .. } => 1,
        Request::ModelChunk { .. } => 2,
        Request::ModelCommit => 3,
        Request::Home { .. } => 4,
        Request::Arm { .. } => 5,
        Request::Disarm => 6,
        Request::SetPoint(_) => 7,
        Request::Stop => 8,
        Request::ReadStatus => 9,
        Request::ReadFaults => 10,
        Request::ClearFaults { .. } => 11,
        Request::SetRate { .. } => 12,
        Request::TakeCommand { .. } => 13,
        Request::ReleaseCommand => 14,
        Request::Export(_) => 15,
        Request::ReadExport { .. } => 16,
    }
}

fn from_board() -> Vec<(&'static str, FromBoard)> {
    let reply = |sequence, tick, reply| FromBoard::Reply(ReplyFrame { client: 1, sequence, tick, reply });
    let refused = |sequence, refusal| reply(sequence, 300, Reply::Refused(refusal));
    let mut faults = FaultLog::new();
    faults.record(Fault {
        cause: FaultCause::CommandTimeout,
        joint: None,
        value: 0.11,
        limit: 0.1,
        tick: 1277,
    });
    let identity =
        Identity { firmware: [0, 1, 0], image: [1, 2, 3, 4, 5, 6, 7, 8], board: [0; 12], capabilities: 5 };
    let joint =
        |position, velocity, reference, torque| JointTelemetry { position, velocity, reference, torque };
    let telemetry = Telemetry {
        tick: 300,
        mode: Mode::Armed(Task::JointServo(ServoMode::Observer)),
        faults: 0,
        joints: list(&[joint(0.1, 0.0, 0.1, 0.02), joint(-0.2, 0.5, -0.19, -0.01)]),
    };
    vec![
        ("reply_hello", reply(1, 0, Reply::Hello { schema: 0x0123_4567_89ab_cdef, identity })),
        ("reply_done", reply(2, 300, Reply::Done)),
        ("reply_refused_no_model", refused(7, Refusal::NoModel)),
        ("reply_refused_not_homed", refused(7, Refusal::NotHomed { joint: 4 })),
        (
            "reply_refused_limits",
            refused(10, Refusal::OutsideLimits { joint: 2, value: 9.0, lower: -1.0, upper: 1.0 }),
        ),
        ("reply_refused_commanded", refused(10, Refusal::Commanded { by: 0xcafe })),
        ("reply_refused_stale", refused(10, Refusal::Stale { latest: 11 })),
        ("reply_faults", reply(14, 1277, Reply::Faults(faults))),
        (
            "reply_exported",
            reply(18, 300, Reply::Exported { length: 1500, checksum: 0x1234_5678, index: 4000 }),
        ),
        ("reply_chunk", reply(19, 300, Reply::Chunk { offset: 192, data: list(&[1, 2]) })),
        ("telemetry", FromBoard::Telemetry(telemetry)),
        ("log_sensors", FromBoard::Log(LogEntry { index: 77, record: LogRecord::Sensors(sensors(0)) })),
    ]
}

fn sensors(flags: u8) -> SensorFrame {
    let (encoders, currents) = (list(&[-5, 65_536]), list(&[3, -400]));
    SensorFrame { sequence: 300, flags: SensorFlags(flags), supply: 24_000, encoders, currents }
}

fn encoded<T: Serialize>(message: &T) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(message, &mut frame).unwrap();
    frame[..length].to_vec()
}

fn decoded<T: DeserializeOwned>(bytes: &[u8]) -> Vec<Result<T, FrameError>> {
    let mut decoder = Decoder::new();
    bytes.iter().filter_map(|&byte| decoder.push(byte)).collect()
}

/// The frame is the golden one, both ways; flipped in any bit or cut anywhere it is nothing.
fn check<T: Serialize + DeserializeOwned + Debug + PartialEq>(name: &str, message: &T) {
    let frames = golden();
    let good = frames.get(name).unwrap_or_else(|| panic!("{name} has no golden frame"));
    assert_eq!(encoded(message), *good, "{name}");
    let back: Vec<T> = decoded(good).into_iter().map(Result::unwrap).collect();
    assert_eq!(back.iter().collect::<Vec<_>>(), [message], "{name}");
    for at in 0..good.len() {
        for bit in 0..8 {
            let mut bad = good.clone();
            bad[at] ^= 1 << bit;
            bad.push(0);
            assert!(decoded::<T>(&bad).iter().all(Result::is_err), "{name}: byte {at}, bit {bit}");
        }
        let mut short = good[..at].to_vec();
        short.push(0);
        if at + 1 < good.len() {
            assert!(decoded::<T>(&short).iter().all(Result::is_err), "{name}: cut at {at}");
        }
    }
}

#[test]
fn every_message_has_the_bytes_that_an_independent_script_makes_and_no_damaged_one_passes() {
    let mut checked = std::collections::BTreeSet::new();
    let mut kinds = std::collections::BTreeSet::new();
    for (name, request) in requests() {
        check(name, &request);
        checked.insert(name);
        kinds.insert(number(&request.request));
    }
    assert_eq!(kinds.len(), 17, "a request without a golden frame");
    for (name, message) in from_board() {
        check(name, &message);
        checked.insert(name);
    }
    check("sensors", &sensors(1));
    check("actuators", &ActuatorFrame { sequence: 300, enabled: true, torques: list(&[0.0, -0.25, 0.5]) });
    checked.extend(["sensors", "actuators"]);
    assert_eq!(checked, golden().into_keys().collect());
}

#[test]
fn the_page_shows_the_bytes_that_are_sent() {
    let frames = golden();
    let mut shown = 0;
    for block in PAGE.split("```frames\n").skip(1) {
        for line in block.split("```").next().unwrap().lines() {
            let (name, bytes) = parse(line);
            assert_eq!(frames.get(name), Some(&bytes), "{name} on the page");
            shown += 1;
        }
    }
    assert!(shown >= 20, "only {shown} examples on the page");
}

#[test]
fn the_page_names_every_fault_with_its_number() {
    for cause in causes() {
        let row = format!("| {} | {} |", cause.number(), cause.description());
        assert!(PAGE.contains(&row), "not on the page: {row}");
    }
}

fn causes() -> Vec<FaultCause> {
    (0..=17_u8).map(|number| postcard::from_bytes(&[number]).unwrap()).collect()
}
