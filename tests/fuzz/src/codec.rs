//! Frames and messages, in both directions.

use std::fmt::Debug;
use std::iter::repeat_n;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::control::JointPoint;
use tesaki::model::{MAX_JOINTS, RobotModel};
use tesaki::node::State;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, MAX_MESSAGE, checksum, encode};
use tesaki::protocol::{ActuatorFrame, FromBoard, LogRecord, Request, RequestFrame, SensorFrame};
use tesaki::task::TaskCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki_tests::{robot, set_up, zero_sensors};

use crate::input::Input;

/// Runs an input, whose first byte says what the others are: a stream of bytes, messages to be framed, or one
/// message.
pub fn run(data: &[u8]) {
    let mut input = Input(data);
    match input.byte() % 3 {
        0 => stream(usize::from(input.byte()) + 1, input.0),
        1 => {
            let pieces = usize::from(input.byte()) + 1;
            let mut bytes = Vec::new();
            while !input.is_empty() {
                let length = usize::from(u16::from_le_bytes(input.bytes())) % (MAX_MESSAGE + 8);
                bytes.extend(framed(input.take(length)));
            }
            stream(pieces, &bytes);
        }
        _ => {
            message::<RequestFrame>(input.0);
            message::<FromBoard>(input.0);
            message::<SensorFrame>(input.0);
            message::<ActuatorFrame>(input.0);
            message::<LogRecord>(input.0);
            message::<RobotModel>(input.0);
            message::<State>(input.0);
        }
    }
}

/// Frames `payload` with its checksum, by another implementation of COBS.
pub fn framed(payload: &[u8]) -> Vec<u8> {
    let mut frame = cobs::encode_vec(&[payload, &checksum(payload).to_le_bytes()].concat());
    frame.push(0);
    frame
}

fn stream(pieces: usize, bytes: &[u8]) {
    accepts::<RequestFrame>(pieces, bytes);
    accepts::<FromBoard>(pieces, bytes);
    accepts::<SensorFrame>(pieces, bytes);
    accepts::<ActuatorFrame>(pieces, bytes);
    accepts::<LogRecord>(pieces, bytes);
}

/// Checks that whatever is accepted is a message, and the same one whether fed byte by byte or in pieces.
fn accepts<T: DeserializeOwned + Serialize + Debug>(pieces: usize, bytes: &[u8]) {
    let encoded = |message: T| postcard::to_stdvec(&message).expect("a decoded message has an encoding");
    let mut by_byte = Decoder::new();
    let one: Vec<_> =
        bytes.iter().filter_map(|&byte| by_byte.push::<T>(byte)).map(|result| result.map(encoded)).collect();
    let mut in_pieces = Decoder::new();
    let mut other = Vec::new();
    for mut piece in bytes.chunks(pieces) {
        while in_pieces.take(&mut piece) {
            other.push(in_pieces.message::<T>().map(encoded));
        }
    }
    assert_eq!((&one, by_byte.counts()), (&other, in_pieces.counts()));
    for message in one.iter().flatten() {
        let decoded: T = postcard::from_bytes(message).expect("an encoded message can be decoded");
        let framed = in_a_frame(&decoded).expect("a message that came in a frame fits one");
        assert_eq!(encoded(framed), *message);
    }
}

/// Sends a message through a frame; `None` if it does not fit.
fn in_a_frame<T: DeserializeOwned + Serialize>(message: &T) -> Option<T> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(message, &mut frame).ok()?;
    let mut decoder = Decoder::new();
    let again = frame[..length].iter().find_map(|&byte| decoder.push::<T>(byte));
    Some(again.expect("a frame ends").expect("an encoded frame is intact"))
}

/// Checks that decoding, encoding and decoding again gives the same message, also through a frame.
fn message<T: DeserializeOwned + Serialize + Debug>(bytes: &[u8]) {
    let Ok((message, _)) = postcard::take_from_bytes::<T>(bytes) else { return };
    let encoded = postcard::to_stdvec(&message).expect("a decoded message has an encoding");
    let (again, rest) = postcard::take_from_bytes::<T>(&encoded).expect("an encoded message can be decoded");
    assert!(rest.is_empty(), "{} bytes too many", rest.len());
    assert_eq!(postcard::to_stdvec(&again).expect("it has an encoding"), encoded);
    if let Some(framed) = in_a_frame(&message) {
        assert_eq!(postcard::to_stdvec(&framed).expect("it has an encoding"), encoded);
    }
    // Formats everything that a log prints.
    let _ = format!("{message:?}");
}

/// Returns a message of each kind, as a stream and to be framed.
pub fn seeds() -> Vec<Vec<u8>> {
    let model = robot("arm7").model;
    let mut payloads: Vec<Vec<u8>> = Vec::new();
    let mut add = |bytes: Result<Vec<u8>, postcard::Error>| payloads.extend(bytes);
    // More bytes without a zero than one COBS code can span.
    let point = JointPoint { position: 0.1, velocity: 0.1, acceleration: 0.1 };
    let (points, torques) = (repeat_n(point, MAX_JOINTS).collect(), repeat_n(0.1, MAX_JOINTS).collect());
    let long = TaskCommand::JointServo(JointCommand::StreamTorques { points, torques });
    let others = [Request::Tare, Request::Stop, Request::Keep, Request::Task(long)];
    for request in set_up(&model).into_iter().take(5).chain(others) {
        let frame = RequestFrame { client: 1, sequence: 300, request };
        add(postcard::to_stdvec(&frame));
        add(postcard::to_stdvec(&LogRecord::Request(frame)));
    }
    let mut node = tesaki::node::Node::new();
    let sensors = zero_sensors(&model, 48_000);
    let actuators = node.tick(&sensors);
    add(postcard::to_stdvec(&FromBoard::Telemetry(node.telemetry())));
    add(postcard::to_stdvec(&FromBoard::Tips(node.tips())));
    add(postcard::to_stdvec(&FromBoard::Status(node.status(&tesaki::protocol::BoardStatus::default()))));
    add(postcard::to_stdvec(&sensors));
    add(postcard::to_stdvec(&LogRecord::Sensors(sensors)));
    add(postcard::to_stdvec(&actuators));
    add(postcard::to_stdvec(&LogRecord::Actuators(actuators)));
    add(postcard::to_stdvec(&model));
    let mut seeds = Vec::new();
    for payload in &payloads {
        seeds.push([&[2], &**payload].concat());
        if let Ok(length) = u16::try_from(payload.len())
            && payload.len() <= MAX_MESSAGE
        {
            seeds.push([&[1, 6][..], &length.to_le_bytes(), payload].concat());
            seeds.push([&[0, 9][..], &framed(payload)].concat());
        }
    }
    seeds
}
