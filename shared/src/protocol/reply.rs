use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::frame::LogRecord;
use super::refusal::Refusal;
use super::status::{Identity, Status};
use super::telemetry::{TaskReport, Telemetry, Tips};
#[cfg(doc)]
use super::{Request, RequestFrame};
use crate::fault::FaultLog;

/// Most bytes of an export in one [`Reply::Chunk`].
pub const EXPORT_CHUNK: usize = 192;

/// Everything that a board sends to the supervisor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum FromBoard {
    /// 0: the answer to a request.
    Reply(ReplyFrame),
    /// 1: the joints, at the rate of [`Request::SetRate`](super::Request::SetRate); may be lost.
    Telemetry(Telemetry),
    /// 2: the same as [`Reply::Status`], likewise.
    Status(Status),
    /// 3: an entry of the log, likewise.
    Log(LogEntry),
    /// 4: the tips, likewise.
    Tips(Tips),
    /// 5: the task, likewise.
    Task(TaskReport),
}

/// An entry of the log of what goes into the node and comes out of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct LogEntry {
    /// One more than that of the last entry. A step of more than one shows how many were lost on the way.
    pub index: u32,
    /// The entry.
    pub record: LogRecord,
}

/// A reply.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ReplyFrame {
    /// [`RequestFrame::client`] of the request.
    pub client: u32,
    /// [`RequestFrame::sequence`] of the request.
    pub sequence: u16,
    /// The last tick before the answer.
    pub tick: u32,
    /// The answer.
    pub reply: Reply,
}

/// The answer to a request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Reply {
    /// 0: answers [`Request::Hello`]. Its layout never changes.
    Hello {
        /// The board's [`super::SCHEMA_KEY`].
        schema: u64,
        /// What it runs on and what it can do.
        identity: Identity,
    },
    /// 1: done.
    Done,
    /// 2: not done, and nothing changed.
    Refused(Refusal),
    /// 3: answers [`Request::ReadStatus`].
    Status(Status),
    /// 4: answers [`Request::ReadFaults`].
    Faults(FaultLog),
    /// 5: answers [`Request::Export`].
    Exported {
        /// Length in bytes.
        length: u32,
        /// [`super::codec::checksum`] of the bytes.
        checksum: u32,
        /// [`LogEntry::index`] of the last entry before the copy was made.
        index: u32,
        /// Identifies the layout of the bytes: of a state [`STATE_KEY`](crate::node::STATE_KEY), of a model
        /// [`super::SCHEMA_KEY`].
        key: u64,
    },
    /// 6: answers [`Request::ReadExport`].
    Chunk {
        /// Where the piece begins.
        offset: u32,
        /// The bytes; fewer than [`EXPORT_CHUNK`] at the end.
        data: Vec<u8, EXPORT_CHUNK>,
    },
    /// 7: answers [`Request::ReadTask`].
    Task(TaskReport),
}
