//! Replay of recordings, bit for bit.

use heapless::Vec;

use super::rig::{Rig, model};
use crate::node::STATE_KEY;
use crate::node::{Difference, Node, Replay, ReplayError};
use crate::protocol::{
    EXPORT_CHUNK, Item, LogRecord, LogStart, Mode, Request, RequestFrame, SCHEMA_KEY, codec,
};

#[test]
fn a_recording_that_starts_during_motion_replays_bit_for_bit() {
    let mut rig = Rig::enabled(&model());
    rig.goal([0.01, 0.2, -0.1]);
    let step = |rig: &mut Rig, index: i32| {
        rig.sensors.encoders[1] = index * 7 % 50;
        rig.tick()
    };
    (0..8).for_each(|index| drop(step(&mut rig, index)));
    let (state, index) = rig.export(Item::State);
    // The requests that read the chunks come after the copy, so they belong to the recording.
    let mut records = std::vec![];
    for (offset, data) in (0..).step_by(EXPORT_CHUNK).zip(state.chunks(EXPORT_CHUNK)) {
        records.push(LogRecord::State { offset, data: Vec::from_slice(data).unwrap() });
    }
    let (length, checksum) = (state.len() as u32, codec::checksum(&state));
    records.push(LogRecord::Restore { length, checksum, key: STATE_KEY });
    for at in (0..state.len() as u32).step_by(EXPORT_CHUNK) {
        let sequence =
            rig.sequence - state.len().div_ceil(EXPORT_CHUNK) as u16 + 1 + at as u16 / EXPORT_CHUNK as u16;
        let request = RequestFrame { client: 7, sequence, request: Request::ReadExport { offset: at } };
        records.push(LogRecord::Request(request));
    }
    for index in 8..60 {
        let actuators = step(&mut rig, index);
        records.push(LogRecord::Sensors(rig.sensors.clone()));
        records.push(LogRecord::Actuators(actuators));
    }
    assert_eq!(rig.node.mode(), Mode::Fault, "command timeout");
    assert_eq!(rig.node.records() - index, records.iter().filter(|record| counted(record)).count() as u32);

    let replay = |records: &[LogRecord]| {
        let mut node = Node::new();
        let mut ready = Rig::ready(&model());
        core::mem::swap(&mut node, &mut ready.node);
        let mut replay = Replay::new(&mut node);
        let mut compared = 0;
        for record in records {
            compared += u32::from(replay.feed(record)?);
        }
        Ok::<u32, ReplayError>(compared)
    };
    assert_eq!(replay(&records), Ok(52));
    let LogRecord::Actuators(last) = records.last_mut().unwrap() else { panic!() };
    last.torques[1] = f32::from_bits(last.torques[1].to_bits() ^ 1);
    let Err(ReplayError::Different { tick, difference }) = replay(&records) else { panic!() };
    assert_eq!(tick, rig.sensors.sequence);
    assert!(matches!(difference, Difference::Torque { joint: 1, .. }), "{difference:?}");
    // Without the state the same frames give other torques.
    let middle: std::vec::Vec<LogRecord> = records.iter().filter(|record| counted(record)).cloned().collect();
    assert!(matches!(replay(&middle), Err(ReplayError::Different { .. })));
    // After a gap nothing is compared until the next state.
    let mut gap = std::vec![LogRecord::Gap { missing: 3 }];
    gap.extend(middle);
    assert_eq!(replay(&gap), Ok(0));
    // A start resets the node: no model.
    let start = LogRecord::Start(LogStart { schema: SCHEMA_KEY, ..LogStart::default() });
    let reset = [std::vec![start], gap.split_off(1)].concat();
    let Err(ReplayError::Different { difference, .. }) = replay(&reset) else { panic!() };
    assert_eq!(difference, Difference::Enabled { computed: false });
}

fn counted(record: &LogRecord) -> bool {
    matches!(record, LogRecord::Request(_) | LogRecord::Sensors(_) | LogRecord::Actuators(_))
}
