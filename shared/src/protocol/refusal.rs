use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::status::Mode;
use crate::fault::Fault;
use crate::model::ModelError;
use crate::robot::{Concerns, LimitRefusal};
use crate::task::{TaskKind, TaskRefusal};

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// 0: the client has sent no hello with the board's schema key.
    SchemaMismatch {
        /// The board's key.
        board: u64,
        /// The board's firmware version.
        firmware: [u8; 3],
    },
    /// 1: not possible in this mode.
    WrongMode(Mode),
    /// 2: another client commands.
    Commanded {
        /// The commander.
        by: u32,
    },
    /// 3: the request requires command, and there is no commander.
    NotCommander,
    /// 4: the commander has sent a later request: this one is late or repeated.
    Stale {
        /// Sequence number of the later one.
        latest: u16,
    },
    /// 5: not all faults have been read.
    FaultsUnread {
        /// Their number since power-on.
        total: u32,
    },
    /// 6: the board has no robot model.
    NoModel,
    /// 7: the model is invalid.
    Model(ModelError),
    /// 8: the chunk does not continue a transfer.
    ModelTransfer {
        /// Bytes received so far.
        received: u32,
        /// Bytes announced.
        announced: u32,
    },
    /// 9: the model arrived damaged.
    ModelChecksum {
        /// Checksum of the received bytes.
        received: u32,
        /// Checksum announced.
        announced: u32,
    },
    /// 10: the model is longer than the board can hold, or is not a model of this schema.
    ModelUnreadable {
        /// Bytes.
        length: u32,
        /// Maximum number of bytes.
        limit: u32,
    },
    /// 11: the last sensor frame is missing or invalid; for a tare, also: a force sensor has no valid
    /// reading, or the joints were homed less than 1 s ago.
    NoSensors,
    /// 12: the last sensor frame shows a condition that would be a fault while enabled.
    Unsafe(Fault),
    /// 13: the zero of a relative encoder is unknown: not homed since power-on or since a new model, or lost
    /// by a jump of its count.
    NotHomed {
        /// The joint.
        joint: u8,
    },
    /// 14: no chain of the robot has a force sensor.
    NoForceSensor,
    /// 15: the export has no such chunk.
    NotExported {
        /// Bytes of the export; 0 without one.
        length: u32,
    },
    /// 16: a joint limit.
    Limit(LimitRefusal),
    /// 17: no task was enabled since the commit of the model.
    NoTask,
    /// 18: the command is for another task than the running one.
    OtherTask(TaskKind),
    /// 19: the task refuses.
    Task(TaskRefusal),
}

impl Concerns for Refusal {
    fn joint(&self) -> Option<u8> {
        match self {
            Self::Model(ModelError { joint, .. }) | Self::Unsafe(Fault { joint, .. }) => *joint,
            Self::NotHomed { joint } => Some(*joint),
            Self::Limit(refusal) => refusal.joint(),
            Self::Task(refusal) => refusal.joint(),
            _ => None,
        }
    }

    fn chain(&self) -> Option<u8> {
        if let Self::Task(refusal) = self { refusal.chain() } else { None }
    }
}

impl From<LimitRefusal> for Refusal {
    fn from(refusal: LimitRefusal) -> Self {
        Self::Limit(refusal)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SchemaMismatch { board, .. } if *board == super::SCHEMA_KEY => write!(
                f,
                "the board does not know this client: it has sent no hello, or none since the board was reset; \
                 send one first"
            ),
            Self::SchemaMismatch { board, firmware: [major, minor, patch] } => write!(
                f,
                "board and supervisor speak different versions of the protocol (board: firmware \
                 {major}.{minor}.{patch}, schema {board:016x}; here: {}.{}.{}, schema {:016x}): flash the firmware of \
                 this version, or use the tool of the board's version",
                crate::VERSION[0],
                crate::VERSION[1],
                crate::VERSION[2],
                super::SCHEMA_KEY
            ),
            Self::WrongMode(mode) => write!(f, "not possible while the board is {mode}"),
            Self::Commanded { by } => write!(
                f,
                "another client ({by:08x}) commands this board: wait until it is done, or take over by force while \
                 the board is not enabled"
            ),
            Self::NotCommander => write!(f, "this client does not command the board: take command first"),
            Self::Stale { latest } => {
                write!(f, "the request came late or twice: request {latest} was answered already")
            }
            Self::FaultsUnread { total } => write!(
                f,
                "{total} faults since power-on, not all of them read: read the faults, then clear them"
            ),
            Self::NoModel => write!(f, "the board has no robot model: push one first"),
            Self::Model(error) => write!(f, "the robot model was refused: {error}"),
            Self::ModelTransfer { received, announced } => write!(
                f,
                "model transfer out of step ({received} of {announced} bytes arrived): begin it again"
            ),
            Self::ModelChecksum { received, announced } => write!(
                f,
                "the model arrived damaged (checksum {received:08x}, announced {announced:08x}): push it \
                 again"
            ),
            Self::ModelUnreadable { length, limit } => {
                write!(f, "{length} bytes are not a robot model of this version (at most {limit} bytes)")
            }
            Self::NoSensors => write!(
                f,
                "no valid sensor readings: check encoders and supply; to tare, wait 1 s after homing"
            ),
            Self::Unsafe(fault) => write!(f, "the sensors show {fault}"),
            Self::NotHomed { joint } => write!(
                f,
                "joint {joint} is not homed: its encoder is relative, so the board must be told the joint's angle \
                 after power-on, and again after the encoder leaps, which it also does when the joint falls or is \
                 turned fast; home it first"
            ),
            Self::NoForceSensor => write!(f, "the robot has no force sensor: there is nothing to tare"),
            Self::NotExported { length } => {
                write!(f, "there is no such piece: the export has {length} bytes; export first")
            }
            Self::Limit(refusal) => refusal.fmt(f),
            Self::NoTask => write!(f, "no task was enabled yet: there is nothing to read"),
            Self::OtherTask(task) => write!(f, "the board runs another task: {task}"),
            Self::Task(refusal) => refusal.fmt(f),
        }
    }
}

impl core::error::Error for Refusal {}
