use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::telemetry::Stream;
use crate::model::MAX_JOINTS;
use crate::task::{TaskCommand, TaskConfig};

/// Most bytes of a model in one [`Request::ModelChunk`].
pub const MODEL_CHUNK: usize = 192;

/// A request, who asks, and the number by which its reply is known. Like [`Request::Hello`], the two numbers never
/// change their layout.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct RequestFrame {
    /// Chosen at random by each program that talks to the board, and repeated in its replies.
    pub client: u32,
    /// One more than that of the client's last request; the same when a request is sent again because its reply did
    /// not come. Repeated in the reply.
    pub sequence: u16,
    /// The request.
    pub request: Request,
}

/// What the supervisor asks of the board. Every request has one [`Reply`](super::Reply).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Request {
    /// 0: who are you? Its layout never changes. Answered by [`Reply::Hello`](super::Reply::Hello).
    Hello {
        /// The sender's [`super::SCHEMA_KEY`].
        schema: u64,
    },
    /// 1: outputs off. Always granted.
    Disable,
    /// 2: stop now: fault [`FaultCause::Stop`](crate::fault::FaultCause::Stop) with the configured reaction. Always granted.
    Stop,
    /// 3: be the one that commands. Granted when nobody commands, or when the commander has been silent for
    /// [`super::LEASE`] and the node is not enabled.
    TakeCommand {
        /// Also when another commands, unless the node is enabled.
        by_force: bool,
    },
    /// 4: command no longer. Not while enabled.
    ReleaseCommand,
    /// 5: a robot model follows in chunks. Only while disabled; the model in use stays until the commit.
    ModelBegin {
        /// Length of the model's postcard encoding in bytes.
        length: u32,
        /// Its [`super::codec::checksum`].
        checksum: u32,
    },
    /// 6: a piece of the model; pieces come in order, and one that came already may come again.
    ModelChunk {
        /// Where it belongs.
        offset: u32,
        /// The bytes.
        data: Vec<u8, MODEL_CHUNK>,
    },
    /// 7: check the model and use it from now on.
    ModelCommit,
    /// 8: the joints stand at these angles now [rad]. Homes relative encoders; only while disabled.
    Home {
        /// An angle for each joint.
        positions: Vec<f32, MAX_JOINTS>,
    },
    /// 9: nothing touches the tips: what their force sensors read now is what they read without contact.
    Tare,
    /// 10: start a task, at rest where the robot is; outputs on. Only while disabled.
    Enable(TaskConfig),
    /// 11: what the running task should do. Says all of it, so it may be repeated; it also tells the node that the
    /// supervisor lives.
    Task(TaskCommand),
    /// 12: go on as before: only tells that the supervisor lives.
    Keep,
    /// 13: answered by [`Reply::Task`](super::Reply::Task).
    ReadTask,
    /// 14: answered by [`Reply::Status`](super::Reply::Status).
    ReadStatus,
    /// 15: answered by [`Reply::Faults`](super::Reply::Faults).
    ReadFaults,
    /// 16: leave the fault mode. Needs proof that the faults were read.
    ClearFaults {
        /// [`FaultLog::total`](crate::fault::FaultLog::total) as read.
        total: u32,
    },
    /// 17: send a stream every so many ticks; 0 stops it. For all clients: the last word counts.
    SetRate {
        /// Which.
        stream: Stream,
        /// Ticks from one message to the next.
        every: u16,
    },
    /// 18: keep a copy of what the node has, to be read piece by piece. Answered by
    /// [`Reply::Exported`](super::Reply::Exported).
    Export(Item),
    /// 19: a piece of the copy. Answered by [`Reply::Chunk`](super::Reply::Chunk).
    ReadExport {
        /// Where the piece begins.
        offset: u32,
    },
}

/// What can be exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Item {
    /// 0: the [`RobotModel`](crate::model::RobotModel) in use, as it was pushed.
    Model,
    /// 1: the node's [`State`](crate::node::State), from which a log can be replayed.
    State,
}
