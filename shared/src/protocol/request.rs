use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::telemetry::Stream;
use crate::model::MAX_JOINTS;
use crate::task::{TaskCommand, TaskConfig};

/// Maximum number of bytes in one [`Request::ModelChunk`].
pub const MODEL_CHUNK: usize = 192;

/// A request with client and sequence number. The layout of these two numbers never changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct RequestFrame {
    /// Random number of the client program, repeated in its replies.
    pub client: u32,
    /// Incremented with each request of the client, unchanged when a request is repeated because its reply
    /// was lost. Repeated in the reply.
    pub sequence: u16,
    /// The request.
    pub request: Request,
}

/// Requests of the supervisor. Every request has one [`Reply`](super::Reply).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Request {
    /// 0: asks for the identity, before any other request of a client. Its layout never changes. Answered by
    /// [`Reply::Hello`](super::Reply::Hello).
    Hello {
        /// The sender's [`super::SCHEMA_KEY`].
        schema: u64,
    },
    /// 1: switches the outputs off. Always granted.
    Disable,
    /// 2: stops at once: fault [`FaultCause::Stop`](crate::fault::FaultCause::Stop) with the configured
    /// reaction. Always granted.
    Stop,
    /// 3: takes command. Granted without a commander, or when the commander has sent no request for
    /// [`super::LEASE`] and the node is not enabled.
    TakeCommand {
        /// Replaces another commander, unless the node is enabled.
        by_force: bool,
    },
    /// 4: releases command. Not while enabled.
    ReleaseCommand,
    /// 5: begins the transfer of a model. Only while disabled; the old model remains in use until the commit.
    ModelBegin {
        /// Length of the model's postcard encoding in bytes.
        length: u32,
        /// Its [`super::codec::checksum`].
        checksum: u32,
    },
    /// 6: a chunk of the model. Chunks are in order; repetitions are accepted.
    ModelChunk {
        /// Offset of the chunk.
        offset: u32,
        /// The bytes.
        data: Vec<u8, MODEL_CHUNK>,
    },
    /// 7: validates the model and takes it over.
    ModelCommit,
    /// 8: homes the joints: defines their present angles. Only while disabled.
    Home {
        /// Angle of each joint [rad].
        positions: Vec<f32, MAX_JOINTS>,
    },
    /// 9: tares the force sensors. Nothing may touch the tips.
    Tare,
    /// 10: starts a task at rest at the present position, and switches the outputs on. Only while disabled.
    Enable(TaskConfig),
    /// 11: a command to the running task. It may be repeated, and resets the command timeout.
    Task(TaskCommand),
    /// 12: resets the command timeout only.
    Keep,
    /// 13: reads the telemetry of the task. Answered by [`Reply::Task`](super::Reply::Task).
    ReadTask,
    /// 14: reads the status. Answered by [`Reply::Status`](super::Reply::Status).
    ReadStatus,
    /// 15: reads the faults. Answered by [`Reply::Faults`](super::Reply::Faults).
    ReadFaults,
    /// 16: leaves the fault mode. Requires the number of faults that were read.
    ClearFaults {
        /// [`FaultLog::total`](crate::fault::FaultLog::total) as read.
        total: u32,
    },
    /// 17: sets the period of a stream; 0 stops it. The rate is the same for all clients.
    SetRate {
        /// The stream.
        stream: Stream,
        /// Period [ticks].
        every: u16,
    },
    /// 18: copies an item, to be read in chunks. Answered by
    /// [`Reply::Exported`](super::Reply::Exported).
    Export(Item),
    /// 19: reads a chunk of the copy. Answered by [`Reply::Chunk`](super::Reply::Chunk).
    ReadExport {
        /// Offset of the chunk.
        offset: u32,
    },
}

/// Items for export.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Item {
    /// 0: the [`RobotModel`](crate::model::RobotModel) in use, as it was pushed.
    Model,
    /// 1: the node's [`State`](crate::node::State), from which a log can be replayed.
    State,
}
