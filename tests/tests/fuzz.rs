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

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::arm::{ArmSettings, ElbowPoint, ForceSource, Law, PosePoint, Redundancy};
use tesaki::control::{Impedance, JointPoint, ServoMode};
use tesaki::kinematics::{Chain, Finger, TipPoint};
use tesaki::manipulation::{
    FINGERS, GraspCommand, GraspPlan, InternalForce, ObjectControl, Phase, WrenchGains,
};
use tesaki::model::RobotModel;
use tesaki::node::Node;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    ActuatorFrame, BoardStatus, FaultCause, FromBoard, Item, JointTelemetry, LogRecord, MODEL_CHUNK, Mode,
    Refusal, Reply, Request, RequestFrame, SCHEMA_KEY, SensorFlags, SensorFrame, SetPoint, Stream, Task,
};
use tesaki_description::robot::RobotFolder;

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

fn box_plan() -> GraspPlan {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3/grasps/box.toml");
    tesaki_description::grasp::load(&file).unwrap()
}

fn model() -> RobotModel {
    model_of("hand3")
}

fn model_of(robot: &str) -> RobotModel {
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots");
    RobotFolder::load(&robots.join(robot)).unwrap().model
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
                    *first %= 22;
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
    match random.below(27) {
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
            let task = match random.below(5) {
                0 | 1 => Task::Grasp,
                2 => Task::Impedance,
                3 => Task::JointServo(ServoMode::Pid),
                _ => Task::JointServo(ServoMode::Observer),
            };
            Request::Arm { task }
        }
        8 => Request::Disarm,
        9..12 => Request::SetPoint(SetPoint::Goal { positions: list(random) }),
        12 | 13 => Request::SetPoint(SetPoint::Stream { points: points(random, count) }),
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
        21 => Request::SetPoint(SetPoint::Keep),
        22 => {
            let torques = list(random).iter().map(|value| value * 0.4).collect();
            Request::SetPoint(SetPoint::Guide { points: points(random, count), torques })
        }
        23 if random.one_in(4) => Request::ReadGrasp,
        24 if random.one_in(4) => Request::ReadArm,
        24 => Request::Impedance(any_settings(random)),
        25 => any_pose(random, &REST),
        23 => Request::Grasp(any_command(random)),
        15 => Request::ReadStatus,
        16 => Request::ReadFaults,
        17 => Request::ClearFaults { total: random.below(5) as u32 },
        18 => Request::SetRate {
            stream: Stream::ALL[random.below(Stream::ALL.len())],
            every: random.next() as u16,
        },
        19 => Request::TakeCommand { by_force: random.one_in(2) },
        20 => Request::Export(if random.one_in(2) { Item::Model } else { Item::State }),
        _ if random.one_in(3) => Request::ReleaseCommand,
        _ => Request::ReadExport { offset: random.below(5000) as u32 },
    }
}

fn points(random: &mut Random, count: usize) -> heapless::Vec<JointPoint, 16> {
    let point = |random: &mut Random| JointPoint {
        position: random.value() / 20.0,
        velocity: random.value(),
        acceleration: random.value(),
    };
    (0..count).map(|_| point(random)).collect()
}

fn any_command(random: &mut Random) -> GraspCommand {
    let wild = random.one_in(4);
    let axes = |random: &mut Random, scale: f32| {
        [0; 3].map(|_| if wild { random.value() } else { (random.below(201) as f32 - 100.0) / 100.0 * scale })
    };
    match random.below(12) {
        0..5 => GraspCommand::Grasp(any_plan(random)),
        5..10 => GraspCommand::Move {
            translation: axes(random, 0.01),
            rotation: axes(random, 0.1),
            duration: if random.one_in(6) { random.value() } else { 1.0 + random.value().abs() },
        },
        10 => GraspCommand::PutDown,
        _ => GraspCommand::Open,
    }
}

/// Mostly possible: the grasp of a box in another way.
fn any_plan(random: &mut Random) -> GraspPlan {
    let mut plan = box_plan();
    plan.friction = [None, Some(0.5), Some(random.value().abs())][random.below(3)];
    plan.feedback = !random.one_in(4);
    plan.touch_force = if random.one_in(2) { 0.1 } else { random.value().abs() };
    plan.internal = match random.below(4) {
        0 => InternalForce::Normal { strength: 2.0 * random.value().abs() },
        1 => InternalForce::Pairwise { strengths: [0; 3].map(|_| 2.0 * random.value().abs()) },
        _ => plan.internal,
    };
    plan.control = match random.below(3) {
        0 => ObjectControl::Differential(ServoMode::Pid),
        1 => ObjectControl::Wrench(WrenchGains {
            position: [100.0 * random.value().abs(), 500.0 * random.value().abs()],
            orientation: [random.value().abs(), random.value().abs()],
            damping: 0.1 * random.value().abs(),
            compensated: random.one_in(2),
        }),
        _ => plan.control,
    };
    if random.one_in(8) {
        let contact = &mut plan.contacts[random.below(FINGERS)];
        contact.position[random.below(3)] += 0.02 * random.value();
        contact.normal[random.below(3)] += 0.5 * random.value();
    }
    plan
}

const REST: PosePoint = PosePoint {
    position: [0.0; 3],
    rotation: [0.0, 0.0, 0.0, 1.0],
    velocity: [0.0; 6],
    acceleration: [0.0; 6],
};

/// Mostly possible.
fn any_settings(random: &mut Random) -> ArmSettings {
    let wild = random.one_in(4);
    let between = |random: &mut Random, least: f32, most: f32| {
        if wild && random.one_in(4) {
            random.value()
        } else {
            // Small ones more often.
            let share = random.below(1001) as f32 / 1000.0;
            least + (most - least) * share * share * share
        }
    };
    let mut impedance = Impedance { mass: [0.0; 6], damping: [0.0; 6], stiffness: [0.0; 6] };
    for axis in 0..6 {
        let mass = between(random, 0.001, 10.0);
        impedance.mass[axis] = mass;
        impedance.damping[axis] = mass * between(random, 0.1, 100.0);
        impedance.stiffness[axis] = mass * between(random, 1.0, 2500.0);
    }
    ArmSettings {
        impedance,
        law: if random.one_in(3) { Law::Printed } else { Law::Following },
        redundancy: [
            Redundancy::None,
            Redundancy::Driven { joint: random.below(8) as u8 },
            Redundancy::ArmAngle,
        ][random.below(3)],
        elbow_bandwidth: between(random, 0.1, 50.0),
        force: if random.one_in(3) {
            ForceSource::Observer { bandwidth: between(random, 10.0, 50.0) }
        } else {
            ForceSource::Sensor
        },
        contact_force: between(random, 0.1, 100.0),
        reach: [between(random, 0.01, 1.0), between(random, 0.1, 3.0)],
    }
}

/// Mostly near `place`, at a speed.
fn any_pose(random: &mut Random, place: &PosePoint) -> Request {
    let wild = random.one_in(4);
    let mut spoil = |value: f32, scale: f32| {
        if wild && random.one_in(8) {
            random.value()
        } else {
            value + scale * (random.below(2001) as f32 / 1000.0 - 1.0)
        }
    };
    let mut rotation = place.rotation.map(|part| spoil(part, 0.02));
    let norm = tesaki::math::sqrt(rotation.iter().map(|part| part * part).sum());
    rotation.iter_mut().for_each(|part| *part /= norm);
    let point = PosePoint {
        position: place.position.map(|place| spoil(place, 0.02)),
        rotation,
        velocity: [0; 6].map(|_| spoil(0.0, 0.3)),
        acceleration: [0; 6].map(|_| spoil(0.0, 3.0)),
    };
    let elbow =
        ElbowPoint { angle: spoil(0.0, 0.2), velocity: spoil(0.0, 0.5), acceleration: spoil(0.0, 3.0) };
    Request::SetPoint(SetPoint::Pose { point, elbow })
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

/// Angles with the tips some way in front of the contacts of [`box_plan`].
fn before_the_box(model: &RobotModel) -> heapless::Vec<f32, 16> {
    let plan = box_plan();
    let mut angles = heapless::Vec::new();
    for ((chain, range), contact) in model.chains.iter().zip(model.chain_ranges()).zip(&plan.contacts) {
        let joints = &model.joints[range];
        let limits = [0, 1, 2].map(|joint| (joints[joint].limits.lower, joints[joint].limits.upper));
        let finger = Finger::try_new(&Chain::new(joints, &chain.tip), limits).unwrap();
        let place = [0, 1, 2].map(|axis| contact.position[axis] - 0.03 * contact.normal[axis]);
        angles.extend(finger.nearest(&place.into(), &[0.0, 0.3, 0.7]).unwrap());
    }
    angles
}

/// What the encoders and the force sensors of a hand read whose joints do what they are told, roughly, and whose tips
/// feel what they want to feel, roughly and not always.
fn feel(
    random: &mut Random,
    node: &Node,
    (model, home): (&RobotModel, &[f32]),
    plan: &GraspPlan,
    sensors: &mut SensorFrame,
) {
    let joints = node.telemetry().joints;
    let mut angles = Vec::new();
    let all = sensors.encoders.iter_mut().zip(&joints).zip(&model.joints).zip(home);
    for (((count, joint), config), home) in all {
        let sign = if config.encoder.reversed { -1.0 } else { 1.0 };
        let wanted = (joint.reference - home) / std::f32::consts::TAU * config.encoder.counts_per_turn * sign;
        *count = if random.one_in(2000) {
            random.next() as i32
        } else {
            wanted as i32 + random.below(5) as i32 - 2
        };
        angles.push(joint.reference);
    }
    let grasp = node.grasp();
    let faint = random.one_in(100);
    for (finger, (counts, chain)) in sensors.forces.iter_mut().zip(&model.chains).enumerate() {
        let range = 3 * finger..3 * finger + 3;
        let posture = Chain::new(&model.joints[range.clone()], &chain.tip).posture(&angles[range]);
        let push = match grasp.phase {
            Phase::Ready | Phase::Approach => [0.0; 3],
            Phase::Touch if random.one_in(20) => plan.contacts[finger].normal.map(|axis| 3.0 * axis),
            Phase::Touch if grasp.tick % 100 > 50 => plan.contacts[finger].normal,
            Phase::Touch => [0.0; 3],
            _ if faint => [0.0; 3],
            _ => grasp.wanted[finger].map(|force| force * (1.0 + 0.05 * (random.below(3) as f32 - 1.0))),
        };
        // The sensors read what acts on the tip.
        let force: [f32; 3] = posture.tip().rotation.inverse_transform_vector(&push.into()).into();
        for (count, force) in counts.iter_mut().zip(force) {
            *count = (force * -1000.0) as i32 + random.below(21) as i32 - 10;
        }
        if random.one_in(500) {
            counts[random.below(6)] = random.next() as i32;
        }
    }
}

#[test]
fn a_hand_that_grasps_keeps_its_limits_whatever_it_feels() {
    let model = model();
    let home = before_the_box(&model);
    let phases = RefCell::new(BTreeSet::new());
    let runs = RefCell::new(0);
    fuzz("hand", |seed| {
        *runs.borrow_mut() += 1;
        let mut random = Random(seed);
        let (mut node, start) = prepared(&model);
        let mut twin = prepared(&model).0;
        let board = BoardStatus::default();
        let mut records = Vec::new();
        let mut sequence = start as u16;
        let mut ask = |node: &mut Node, records: &mut Vec<LogRecord>, request| {
            sequence = sequence.wrapping_add(1);
            let frame = RequestFrame { client: 1, sequence, request };
            let reply = node.handle(&frame, &board).reply;
            records.push(LogRecord::Request(frame));
            reply
        };
        let mut sensors = SensorFrame {
            sequence: 0,
            flags: SensorFlags(0),
            supply: 24_000,
            encoders: model.joints.iter().map(|_| 0).collect(),
            currents: model.joints.iter().map(|_| 0).collect(),
            forces: model.chains.iter().map(|_| [0; 6]).collect(),
        };
        let plan = if random.one_in(4) { any_plan(&mut random) } else { box_plan() };
        let mut last = vec![0.0_f32; model.joints.len()];
        for tick in 0..random.below(1500) {
            feel(&mut random, &node, (&model, &home), &plan, &mut sensors);
            if tick < 2 {
                sensors.encoders.iter_mut().for_each(|count| *count = 0);
                sensors.forces.iter_mut().for_each(|counts| *counts = [0; 6]);
            }
            sensors.sequence += 1;
            let actuators = node.tick(&sensors);
            for ((torque, joint), last) in actuators.torques.iter().zip(&model.joints).zip(&mut last) {
                assert!(torque.is_finite() && torque.abs() <= joint.limits.torque, "seed {seed}: {torque}");
                assert!(actuators.enabled || *torque == 0.0, "seed {seed}");
                let rate = joint.limits.torque_rate * 0.01 * 1.0001;
                assert!(
                    *torque == 0.0 || (torque - *last).abs() <= rate,
                    "seed {seed}: from {last} to {torque}"
                );
                *last = *torque;
            }
            records.push(LogRecord::Sensors(sensors.clone()));
            records.push(LogRecord::Actuators(actuators));
            if tick == 1 {
                let home = Request::Home { positions: home.clone() };
                // Some are one board of several that hold an object together.
                let guided = random.one_in(4);
                let task = if guided { Task::JointServo(ServoMode::Observer) } else { Task::Grasp };
                let arm = Request::Arm { task };
                for request in [home, Request::Tare, arm, Request::Grasp(GraspCommand::Grasp(plan))] {
                    let reply = ask(&mut node, &mut records, request);
                    let begun = matches!(reply, Reply::Done | Reply::Refused(Refusal::Unable(_)));
                    assert!(begun || guided, "seed {seed}: {reply:?}");
                }
            }
            let grasp = node.grasp();
            let numbers = [&grasp.position[..], &grasp.orientation, &grasp.load, grasp.wanted.as_flattened()];
            assert!(numbers.concat().iter().all(|number| number.is_finite()), "seed {seed}: {grasp:?}");
            phases.borrow_mut().insert(format!("{:?}", grasp.phase));
            let request = match random.below(400) {
                0 => any_request(&mut random, &model, &[]),
                1..8 => Request::Grasp(any_command(&mut random)),
                8..80 if node.mode() == Mode::Armed(Task::JointServo(ServoMode::Observer)) => {
                    let small = |random: &mut Random| random.below(201) as f32 / 1000.0 - 0.1;
                    let near = |joint: &JointTelemetry| JointPoint {
                        position: joint.reference + 0.05 * small(&mut random),
                        velocity: small(&mut random),
                        acceleration: small(&mut random),
                    };
                    let points = node.telemetry().joints.iter().map(near).collect();
                    let mut torques: heapless::Vec<f32, 16> =
                        home.iter().map(|_| 6.0 * small(&mut random)).collect();
                    if random.one_in(4) {
                        torques[random.below(home.len())] = random.value();
                    }
                    Request::SetPoint(SetPoint::Guide { points, torques })
                }
                8..200 => Request::SetPoint(SetPoint::Keep),
                _ => continue,
            };
            ask(&mut node, &mut records, request);
        }
        let mut replay = tesaki::node::Replay::new(&mut twin);
        for record in &records {
            replay.feed(record).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        }
    });
    let phases = phases.into_inner();
    println!("hand: {phases:?}");
    // A single seed, or a slow machine, does not come far.
    assert!(runs.into_inner() < 1000 || phases.len() == 9, "{phases:?}");
}

#[test]
fn an_arm_that_yields_keeps_its_limits_whatever_pushes_it() {
    const LONGEST_STATE: u32 = 5120;
    let model = model_of("arm7");
    let seen = RefCell::new(BTreeSet::new());
    let runs = RefCell::new(0);
    fuzz("arm", |seed| {
        *runs.borrow_mut() += 1;
        let mut random = Random(seed);
        let (mut node, start) = prepared(&model);
        let mut twin = prepared(&model).0;
        let board = BoardStatus::default();
        let mut records = Vec::new();
        let mut sequence = start as u16;
        let mut ask = |node: &mut Node, records: &mut Vec<LogRecord>, request| {
            sequence = sequence.wrapping_add(1);
            let frame = RequestFrame { client: 1, sequence, request };
            let reply = node.handle(&frame, &board).reply;
            records.push(LogRecord::Request(frame));
            reply
        };
        // The machine: joints that go where their reference is, roughly, and what the sensor reads.
        let mut angles: Vec<f32> = (0..7).map(|_| random.below(1001) as f32 / 2000.0).collect();
        angles[3] += 1.0;
        let mut sensors = SensorFrame {
            sequence: 0,
            flags: SensorFlags(0),
            supply: 48_000,
            encoders: model.joints.iter().map(|_| 0).collect(),
            currents: model.joints.iter().map(|_| 0).collect(),
            forces: [[0; 6]].into_iter().collect(),
        };
        let mut push = [0_i32; 6];
        let mut last = vec![0.0_f32; model.joints.len()];
        for tick in 0..random.below(1000) {
            for ((count, angle), joint) in sensors.encoders.iter_mut().zip(&angles).zip(&model.joints) {
                let counts = angle / std::f32::consts::TAU * joint.encoder.counts_per_turn;
                *count = if tick > 1 && random.one_in(5000) {
                    random.next() as i32
                } else {
                    (counts as i32).wrapping_add(random.below(3) as i32)
                };
            }
            if tick > 1 && random.one_in(50) {
                push = [0; 6].map(|_| if random.one_in(3) { random.below(4001) as i32 - 2000 } else { 0 });
            }
            sensors.forces[0] = push.map(|count| count + random.below(11) as i32 - 5);
            if tick > 1 && random.one_in(1000) {
                sensors.forces[0][random.below(6)] = random.next() as i32;
            }
            sensors.sequence += 1;
            let actuators = node.tick(&sensors);
            for ((torque, joint), last) in actuators.torques.iter().zip(&model.joints).zip(&mut last) {
                assert!(torque.is_finite() && torque.abs() <= joint.limits.torque, "seed {seed}: {torque}");
                assert!(actuators.enabled || *torque == 0.0, "seed {seed}");
                let rate = joint.limits.torque_rate * 0.01 * 1.0001;
                assert!(
                    *torque == 0.0 || (torque - *last).abs() <= rate,
                    "seed {seed}: from {last} to {torque}"
                );
                *last = *torque;
            }
            records.push(LogRecord::Sensors(sensors.clone()));
            records.push(LogRecord::Actuators(actuators));
            for (angle, joint) in angles.iter_mut().zip(&node.telemetry().joints) {
                *angle = joint.reference;
            }
            if tick == 1 {
                let settings = any_settings(&mut random);
                let possible = settings.validate(7).is_ok();
                assert_eq!(ask(&mut node, &mut records, Request::Tare), Reply::Done, "seed {seed}");
                let reply = ask(&mut node, &mut records, Request::Impedance(settings));
                assert_eq!(reply == Reply::Done, possible, "seed {seed}: {reply:?}");
                let reply = ask(&mut node, &mut records, Request::Arm { task: Task::Impedance });
                assert_eq!(reply == Reply::Done, possible, "seed {seed}: {reply:?}");
            }
            if node.mode() == Mode::Armed(Task::Impedance) {
                seen.borrow_mut()
                    .insert(if node.tool().unwrap().contact { "contact" } else { "free" }.to_owned());
            }
            if let Some(fault) = node.faults().faults.last() {
                seen.borrow_mut().insert(format!("{:?}", fault.cause));
                // What is accepted, an arm can follow without losing count.
                assert!(fault.cause != FaultCause::NotFinite, "seed {seed}: {fault}");
            }
            let tool = node.tool().unwrap();
            let place = PosePoint { position: tool.position, rotation: tool.rotation, ..REST };
            if tick < 2 {
                continue;
            }
            let request = match random.below(400) {
                0 => any_request(&mut random, &model, &[]),
                1..6 => Request::Impedance(any_settings(&mut random)),
                6 => Request::Export(Item::State),
                7 => Request::Arm { task: Task::Impedance },
                8..80 => any_pose(&mut random, &place),
                80..200 => Request::SetPoint(SetPoint::Keep),
                _ => continue,
            };
            if let Reply::Exported { length, .. } = ask(&mut node, &mut records, request) {
                assert!(length <= LONGEST_STATE, "seed {seed}: {length} bytes");
            }
        }
        let mut replay = tesaki::node::Replay::new(&mut twin);
        for record in &records {
            replay.feed(record).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        }
    });
    let seen = seen.into_inner();
    println!("arm: {seen:?}");
    let all = ["contact", "free", "ToolAway", "ToolTurned"];
    assert!(runs.into_inner() < 400 || all.iter().all(|name| seen.contains(*name)), "{seen:?}");
}
