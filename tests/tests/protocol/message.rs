//! All kinds of messages on a wire.

use std::fmt::Debug;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::model::RobotModel;
use tesaki::protocol::codec::{Decoder, FrameError, MAX_FRAME, encode};
use tesaki::protocol::{ActuatorFrame, FromBoard, LogRecord, RequestFrame, SensorFrame};

fn encoded<T: Serialize>(message: &T) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(message, &mut frame).unwrap();
    frame[..length].to_vec()
}

fn decoded<T: DeserializeOwned>(bytes: &[u8]) -> Vec<Result<T, FrameError>> {
    let mut decoder = Decoder::new();
    bytes.iter().filter_map(|&byte| decoder.push(byte)).collect()
}

/// A message on a wire, by the prefix of its golden name.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "tests")]
pub enum Message {
    /// `request-`
    Request(RequestFrame),
    /// `board-`
    Board(FromBoard),
    /// `sensors`
    Sensors(SensorFrame),
    /// `actuators`
    Actuators(ActuatorFrame),
    /// `record-`
    Record(LogRecord),
    /// `model-`: not a frame, but the bytes that are transferred in a push.
    Model(RobotModel),
}

impl Message {
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::Request(message) => encoded(message),
            Self::Board(message) => encoded(message),
            Self::Sensors(message) => encoded(message),
            Self::Actuators(message) => encoded(message),
            Self::Record(message) => encoded(message),
            Self::Model(model) => postcard::to_stdvec(model).unwrap(),
        }
    }

    /// Decodes `bytes` as messages of the same kind as `self`.
    pub fn decode(&self, bytes: &[u8]) -> Vec<Result<Self, FrameError>> {
        fn all<T: DeserializeOwned>(
            bytes: &[u8],
            wrap: fn(T) -> Message,
        ) -> Vec<Result<Message, FrameError>> {
            decoded::<T>(bytes).into_iter().map(|result| result.map(wrap)).collect()
        }
        match self {
            Self::Request(_) => all(bytes, Self::Request),
            Self::Board(_) => all(bytes, Self::Board),
            Self::Sensors(_) => all(bytes, Self::Sensors),
            Self::Actuators(_) => all(bytes, Self::Actuators),
            Self::Record(_) => all(bytes, Self::Record),
            Self::Model(_) => match postcard::take_from_bytes(bytes) {
                Ok((model, [])) => vec![Ok(Self::Model(model))],
                _ => vec![Err(FrameError::Malformed)],
            },
        }
    }
}
