//! Arbitrary bytes into the codec, arbitrary requests in arbitrary orders into the node. Five seconds in the checks;
//! `TESAKI_FUZZ_SECONDS=1800 cargo test --release -p tesaki-tests --test fuzz -- --nocapture` for longer. The seed of a
//! failure is in its message; `TESAKI_FUZZ_SEED` repeats it.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "tests"
)]

use std::path::Path;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::control::{JointPoint, ServoMode};
use tesaki::kinematics::TipPoint;
use tesaki::model::RobotModel;
use tesaki::node::Node;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    ActuatorFrame, BoardStatus, FromBoard, Item, LogRecord, MODEL_CHUNK, Mode, Reply, Request, RequestFrame,
    SCHEMA_KEY, SensorFlags, SensorFrame, SetPoint, Stream, Task,
};
use tesaki_supervisor::robot::RobotFolder;

/// A generator of Weyl and mix (splitmix64): fast, and the same everywhere.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit as u64) as usize
    }

    fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    /// Mostly an ordinary angle, sometimes a limit, sometimes anything.
    fn value(&mut self) -> f32 {
        match self.below(12) {
            0 => f32::from_bits(self.next() as u32),
            1 => [0.0, -0.0, f32::NAN, f32::INFINITY, f32::MIN, f32::MIN_POSITIVE, 1e30][self.below(7)],
            _ => (self.below(3001) as f32 - 1500.0) / 1000.0,
        }
    }
}

/// Runs `body` with seed after seed for as long as asked.
fn fuzz(name: &str, body: impl Fn(u64)) {
    let number = |variable: &str| std::env::var(variable).ok().and_then(|text| text.parse::<u64>().ok());
    if let Some(seed) = number("TESAKI_FUZZ_SEED") {
        return body(seed);
    }
    let duration = Duration::from_secs(number("TESAKI_FUZZ_SECONDS").unwrap_or(5));
    let start = Instant::now();
    // The short run takes the same seeds each time; the long one goes on where no other has been.
    let mut seed =
        if number("TESAKI_FUZZ_SECONDS").is_some() { u64::from(std::process::id()) << 32 } else { 0 };
    let first = seed;
    while start.elapsed() < duration {
        body(seed);
        seed += 1;
    }
    println!("{name}: {} runs from seed {first}", seed - first);
}

fn model() -> RobotModel {
    RobotFolder::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3")).unwrap().model
}

/// Whatever is accepted is a message: encoded again and decoded again, it is the same.
fn accepts<T: DeserializeOwned + Serialize>(bytes: &[u8], pieces: usize, seed: u64) -> u32 {
    let mut by_byte = Decoder::new();
    let mut one = Vec::new();
    for &byte in bytes {
        if let Some(result) = by_byte.push::<T>(byte) {
            one.push(result.map(|message| postcard::to_stdvec(&message).unwrap()));
        }
    }
    let mut decoder = Decoder::new();
    let mut other = Vec::new();
    for mut piece in bytes.chunks(pieces) {
        while decoder.take(&mut piece) {
            other.push(decoder.message::<T>().map(|message| postcard::to_stdvec(&message).unwrap()));
        }
    }
    assert_eq!((&one, by_byte.counts()), (&other, decoder.counts()), "seed {seed}");
    let mut fresh = Decoder::new();
    for message in one.iter().flatten() {
        let decoded: T = postcard::from_bytes(message).unwrap();
        let mut frame = [0; MAX_FRAME];
        let length = encode(&decoded, &mut frame).unwrap();
        let again = frame[..length].iter().find_map(|&byte| fresh.push::<T>(byte));
        assert_eq!(postcard::to_stdvec(&again.unwrap().unwrap()).unwrap(), *message, "seed {seed}");
    }
    decoder.counts().good
}

#[test]
fn the_codec_takes_any_bytes() {
    let model = model();
    fuzz("codec", |seed| {
        let mut random = Random(seed);
        let mut bytes = Vec::new();
        for _ in 0..random.below(6) {
            let mut frame = [0; MAX_FRAME];
            let request = any_request(&mut random, &model, &[]);
            let length = encode(&RequestFrame { client: 1, sequence: 2, request }, &mut frame).unwrap();
            bytes.extend_from_slice(&frame[..length]);
            if random.one_in(3) {
                // A valid checksum over any bytes: what a hostile sender would do.
                let mut payload: Vec<u8> = (0..random.below(200)).map(|_| random.next() as u8).collect();
                if let Some(first) = payload.first_mut() {
                    *first %= 20;
                }
                payload.extend_from_slice(&checksum(&payload).to_le_bytes());
                bytes.extend(cobs::encode_vec(&payload));
                bytes.push(0);
            }
            if random.one_in(2) {
                let noise = random.below(400);
                bytes.extend((0..noise).map(|_| random.next() as u8));
                bytes.push(0);
            }
        }
        for _ in 0..random.below(3) {
            let at = random.below(bytes.len().max(1));
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.below(8);
            }
        }
        let pieces = 1 + random.below(300);
        accepts::<RequestFrame>(&bytes, pieces, seed);
        accepts::<FromBoard>(&bytes, pieces, seed);
        accepts::<SensorFrame>(&bytes, pieces, seed);
        accepts::<ActuatorFrame>(&bytes, pieces, seed);
        accepts::<LogRecord>(&bytes, pieces, seed);
    });
}

fn any_request(random: &mut Random, model: &RobotModel, pushed: &[u8]) -> Request {
    let count = if random.one_in(10) { random.below(17) } else { model.joints.len() };
    let list = |random: &mut Random| (0..count).map(|_| random.value()).collect::<heapless::Vec<f32, 16>>();
    match random.below(22) {
        0 => Request::Hello { schema: if random.one_in(5) { random.next() } else { SCHEMA_KEY } },
        1 => {
            let length = if random.one_in(4) { random.next() as u32 } else { pushed.len() as u32 };
            Request::ModelBegin { length, checksum: checksum(pushed) }
        }
        2 | 3 => {
            let offset = random.below(pushed.len() + 1).min(random.below(4) * MODEL_CHUNK);
            let end = pushed.len().min(offset + random.below(MODEL_CHUNK + 1));
            let data = heapless::Vec::from_slice(pushed.get(offset..end).unwrap_or_default()).unwrap();
            Request::ModelChunk { offset: offset as u32, data }
        }
        4 => Request::ModelCommit,
        5 => Request::Home { positions: list(random) },
        6 | 7 => {
            let servo = if random.one_in(2) { ServoMode::Pid } else { ServoMode::Observer };
            Request::Arm { task: Task::JointServo(servo) }
        }
        8 => Request::Disarm,
        9..12 => Request::SetPoint(SetPoint::Goal { positions: list(random) }),
        12 | 13 => {
            let point = |random: &mut Random| JointPoint {
                position: random.value() / 20.0,
                velocity: random.value(),
                acceleration: random.value(),
            };
            Request::SetPoint(SetPoint::Stream { points: (0..count).map(|_| point(random)).collect() })
        }
        14 if random.one_in(2) => {
            let axes = |random: &mut Random, scale: f32| [0; 3].map(|_| random.value() * scale);
            let tip = |random: &mut Random| TipPoint {
                position: axes(random, 0.05),
                velocity: axes(random, 0.1),
                acceleration: axes(random, 1.0),
            };
            let tips = 1 + random.below(4);
            Request::SetPoint(SetPoint::Reach { tips: (0..tips).map(|_| tip(random)).collect() })
        }
        14 => Request::Stop,
        15 if random.one_in(2) => Request::Tare,
        15 => Request::ReadStatus,
        16 => Request::ReadFaults,
        17 => Request::ClearFaults { total: random.below(5) as u32 },
        18 => Request::SetRate { stream: Stream::ALL[random.below(3)], every: random.next() as u16 },
        19 => Request::TakeCommand { by_force: random.one_in(2) },
        20 => Request::Export(if random.one_in(2) { Item::Model } else { Item::State }),
        _ if random.one_in(3) => Request::ReleaseCommand,
        _ => Request::ReadExport { offset: random.below(5000) as u32 },
    }
}

/// A node with a model, commanded by client 1, homed.
fn prepared(model: &RobotModel) -> (Box<Node>, u32) {
    let mut node = Box::new(Node::new());
    let board = BoardStatus::default();
    let mut sequence = 0;
    let mut ask = |node: &mut Node, request| {
        sequence += 1;
        let reply = node.handle(&RequestFrame { client: 1, sequence, request }, &board).reply;
        assert!(!matches!(reply, Reply::Refused(_)), "{reply:?}");
    };
    ask(&mut node, Request::Hello { schema: SCHEMA_KEY });
    ask(&mut node, Request::TakeCommand { by_force: false });
    let bytes = postcard::to_stdvec(model).unwrap();
    ask(&mut node, Request::ModelBegin { length: bytes.len() as u32, checksum: checksum(&bytes) });
    for (offset, data) in (0..).step_by(MODEL_CHUNK).zip(bytes.chunks(MODEL_CHUNK)) {
        ask(&mut node, Request::ModelChunk { offset, data: heapless::Vec::from_slice(data).unwrap() });
    }
    ask(&mut node, Request::ModelCommit);
    (node, sequence.into())
}

#[test]
fn the_node_keeps_its_limits_whatever_it_is_asked() {
    let model = model();
    fuzz("node", |seed| {
        let mut random = Random(seed);
        let (mut node, start) = prepared(&model);
        let board = BoardStatus::default();
        let mut sequences = [start, 0, 0];
        // Another model: valid, or spoilt in one byte.
        let mut other = model.clone();
        for joint in &mut other.joints {
            joint.limits.torque *= 0.5;
        }
        let mut pushed = postcard::to_stdvec(&other).unwrap();
        if random.one_in(2) {
            let at = random.below(pushed.len());
            pushed[at] ^= 1 << random.below(8);
        }
        let mut sensors = SensorFrame {
            sequence: 0,
            flags: SensorFlags(0),
            supply: 24_000,
            encoders: model.joints.iter().map(|_| 0).collect(),
            currents: model.joints.iter().map(|_| 0).collect(),
            forces: model.chains.iter().filter_map(|chain| chain.force_sensor).map(|_| [0; 6]).collect(),
        };
        let mut last: Vec<f32> = vec![0.0; model.joints.len()];
        let mut records = Vec::new();
        let mut twin = prepared(&model).0;
        for _ in 0..random.below(400) {
            if random.one_in(2) {
                let who = if random.one_in(6) { random.below(3) } else { 0 };
                // Late and repeated requests come, too.
                sequences[who] = match random.below(12) {
                    0 => sequences[who],
                    1 => sequences[who].wrapping_sub(random.below(5) as u32),
                    _ => sequences[who].wrapping_add(1),
                };
                let request = any_request(&mut random, &model, &pushed);
                let frame = RequestFrame { client: 1 + who as u32, sequence: sequences[who] as u16, request };
                let before = (node.mode(), node.telemetry(), node.robot().map(|robot| robot.model().clone()));
                let reply = node.handle(&frame, &board).reply;
                if matches!(reply, Reply::Refused(_)) {
                    let after =
                        (node.mode(), node.telemetry(), node.robot().map(|robot| robot.model().clone()));
                    assert_eq!(format!("{before:?}"), format!("{after:?}"), "seed {seed}: refused {frame:?}");
                }
                records.push(LogRecord::Request(frame));
                continue;
            }
            sensors.sequence = sensors.sequence.wrapping_add(if random.one_in(200) { 3 } else { 1 });
            for count in &mut sensors.encoders {
                *count = count.wrapping_add(random.below(41) as i32 - 20);
            }
            if random.one_in(60) {
                let at = random.below(sensors.encoders.len().max(1));
                if let Some(count) = sensors.encoders.get_mut(at) {
                    *count = random.next() as i32;
                }
            }
            for counts in &mut sensors.forces {
                counts[random.below(6)] = random.below(2000) as i32 - 1000;
                if random.one_in(300) {
                    counts[random.below(6)] = random.next() as i32;
                }
            }
            sensors.flags = SensorFlags(u8::from(random.one_in(300)));
            sensors.supply = if random.one_in(300) { random.next() as u16 } else { 24_000 };
            let mut frame = sensors.clone();
            if random.one_in(300) {
                frame.encoders.truncate(random.below(9));
            }
            if random.one_in(300) {
                frame.currents.iter_mut().for_each(|current| *current = random.next() as i16);
            }
            let actuators = node.tick(&frame);
            let robot = node.robot().unwrap().model();
            assert_eq!(actuators.torques.len(), robot.joints.len());
            for ((torque, joint), last) in actuators.torques.iter().zip(&robot.joints).zip(&mut last) {
                assert!(torque.is_finite() && torque.abs() <= joint.limits.torque, "seed {seed}: {torque}");
                assert!(actuators.enabled || *torque == 0.0, "seed {seed}");
                let rate = joint.limits.torque_rate * 0.01 * 1.0001;
                assert!(
                    *torque == 0.0 || (torque - *last).abs() <= rate,
                    "seed {seed}: from {last} to {torque}"
                );
                *last = *torque;
            }
            assert!(!(actuators.enabled && node.mode() == Mode::Disarmed), "seed {seed}");
            records.push(LogRecord::Sensors(frame));
            records.push(LogRecord::Actuators(actuators));
        }
        // The same again gives the same again.
        let mut replay = tesaki::node::Replay::new(&mut twin);
        for record in &records {
            replay.feed(record).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        }
    });
}
