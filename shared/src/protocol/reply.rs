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

/// Maximum number of bytes in one [`Reply::Chunk`].
pub const EXPORT_CHUNK: usize = 192;

/// Messages of the board to the supervisor.
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

impl FromBoard {
    /// Position of [`FromBoard::Telemetry`].
    pub(super) const TELEMETRY: u8 = 1;
}

/// A log entry: input or output of the node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct LogEntry {
    /// Increments by one per entry. A larger step shows the number of lost entries.
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
        /// Identity of the board.
        identity: Identity,
    },
    /// 1: executed.
    Done,
    /// 2: refused; nothing has changed.
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
        /// Identifies the layout of the bytes: [`STATE_KEY`](crate::node::STATE_KEY) for a state,
        /// [`super::SCHEMA_KEY`] for a model.
        key: u64,
    },
    /// 6: answers [`Request::ReadExport`].
    Chunk {
        /// Offset of the chunk.
        offset: u32,
        /// The bytes; fewer than [`EXPORT_CHUNK`] at the end.
        data: Vec<u8, EXPORT_CHUNK>,
    },
    /// 7: answers [`Request::ReadTask`].
    Task(TaskReport),
}
