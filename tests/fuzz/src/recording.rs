//! Recordings, read and replayed as `tesaki replay` does.

use tesaki::control::ServoMode;
use tesaki::node::{Node, Replay, STATE_KEY};
use tesaki::protocol::codec::{Decoder, MAX_MESSAGE, checksum};
use tesaki::protocol::{
    BoardStatus, EXPORT_CHUNK, Item, LogRecord, LogStart, Reply, Request, RequestFrame, SCHEMA_KEY,
};
use tesaki::task::TaskConfig;
use tesaki_tests::set_up;

use crate::codec::framed;
use crate::input::Input;
use crate::node::machine::machines;

/// Runs an input, whose first byte says whether the others are a file, or records to be framed, each preceded
/// by its length. In a third kind, announced checksums are corrected and differences do not end the replay.
pub fn run(data: &[u8]) {
    let mut input = Input(data);
    let kind = input.byte() % 3;
    if kind == 0 {
        return replay(input.0, false);
    }
    let mut file = Vec::new();
    while !input.is_empty() {
        let length = usize::from(u16::from_le_bytes(input.bytes())) % (MAX_MESSAGE + 1);
        file.extend(framed(input.take(length)));
    }
    replay(&file, kind == 2);
}

/// Replays a file as `tesaki replay` does.
fn replay(file: &[u8], repaired: bool) {
    let mut node = Box::new(Node::new());
    let mut replay = Replay::new(&mut node);
    let mut decoder = Decoder::new();
    let mut bytes = file;
    let mut state = Vec::new();
    while decoder.take(&mut bytes) {
        let mut record = decoder.message::<LogRecord>();
        match &mut record {
            Ok(LogRecord::State { offset, data }) => {
                if *offset == 0 {
                    state.clear();
                }
                state.extend_from_slice(data);
            }
            Ok(LogRecord::Restore { length, checksum: announced, key }) if repaired => {
                *length = u32::try_from(state.len()).unwrap_or(u32::MAX);
                (*announced, *key) = (checksum(&state), STATE_KEY);
            }
            _ => {}
        }
        if let Err(error) = replay.feed(record.as_ref().unwrap_or(&LogRecord::Gap { missing: 0 })) {
            assert!(!error.to_string().is_empty());
            if !repaired {
                return;
            }
        }
    }
}

/// Returns recordings from the start, and from the middle of a run.
pub fn seeds() -> Vec<Vec<u8>> {
    let start = LogStart { schema: SCHEMA_KEY, ..LogStart::default() };
    let mut seeds = Vec::new();
    for machine in machines() {
        for from in [0, 3] {
            let mut node = Box::new(Node::new());
            let mut records = vec![LogRecord::Start(start)];
            let mut sequence = 0;
            let mut ask = |node: &mut Node, records: &mut Vec<LogRecord>, request: Request| {
                sequence += 1;
                let frame = RequestFrame { client: 1, sequence, request };
                node.handle(&frame, &BoardStatus::default());
                records.push(LogRecord::Request(frame));
            };
            for request in set_up(&machine.model) {
                ask(&mut node, &mut records, request);
            }
            let zeros: heapless::Vec<f32, 16> = machine.model.joints.iter().map(|_| 0.0).collect();
            let mut sensors = tesaki_tests::zero_sensors(&machine.model, machine.supply);
            for tick in 0..8 {
                if tick == 2 {
                    ask(&mut node, &mut records, Request::Home { positions: zeros.clone() });
                    ask(&mut node, &mut records, Request::Enable(TaskConfig::JointServo(ServoMode::Pid)));
                }
                if tick > 0 && tick == from {
                    records.truncate(1);
                    for request in set_up(&machine.model) {
                        let frame = RequestFrame { client: 1, sequence: 0, request };
                        records.push(LogRecord::Request(frame));
                    }
                    records.extend(state(&node));
                }
                sensors.sequence += 1;
                let actuators = node.tick(&sensors);
                records.extend([LogRecord::Sensors(sensors.clone()), LogRecord::Actuators(actuators)]);
            }
            let payloads = records.iter().filter_map(|record| postcard::to_stdvec(record).ok());
            let mut seed = Vec::new();
            for payload in payloads {
                seed.extend(u16::try_from(payload.len()).unwrap_or_default().to_le_bytes());
                seed.extend(payload);
            }
            seeds.extend([[&[1], &*seed].concat(), [&[2], &*seed].concat()]);
        }
    }
    seeds.push([&[0][..], &framed(&[0; 4]), &framed(&[6, 1])].concat());
    seeds
}

/// Returns the records that give a node the state of `node`.
fn state(node: &Node) -> Vec<LogRecord> {
    let mut node = Box::new(node.clone());
    let mut ask = |request| {
        let frame = RequestFrame { client: 1, sequence: 0, request };
        node.handle(&frame, &BoardStatus::default()).reply
    };
    ask(Request::Export(Item::State));
    let mut bytes = Vec::new();
    while let Reply::Chunk { data, .. } =
        ask(Request::ReadExport { offset: bytes.len().try_into().unwrap_or(0) })
        && !data.is_empty()
    {
        bytes.extend_from_slice(&data);
    }
    let chunks = (0..).step_by(EXPORT_CHUNK).zip(bytes.chunks(EXPORT_CHUNK));
    let chunk = |(offset, data)| LogRecord::State {
        offset,
        data: heapless::Vec::from_slice(data).unwrap_or_default(),
    };
    let length = u32::try_from(bytes.len()).unwrap_or_default();
    let restore = LogRecord::Restore { length, checksum: checksum(&bytes), key: STATE_KEY };
    chunks.map(chunk).chain([restore]).collect()
}
