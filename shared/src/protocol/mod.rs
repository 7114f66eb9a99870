//! Messages of both links, and their framing.
//!
//! The *supervisor link* carries [`RequestFrame`]s to the board and [`FromBoard`] messages back. The *plant
//! link* carries [`SensorFrame`]s to the board and [`ActuatorFrame`]s back, in lock step; on a board with its
//! own sensors and drives the same two types connect drivers and node.
//!
//! One message is one frame, see [`codec`]. An enumeration is sent as the position of the variant, which each
//! variant's documentation states: variants are added at the end, never reordered, and a number is never
//! reused. [`SCHEMA_KEY`] changes with any change of a message; only the layout of [`Request::Hello`] never
//! changes.

pub mod codec;
mod encoding;
mod fault_log;
mod frame;
mod longest;
mod refusal;
mod reply;
mod request;
mod status;
mod telemetry;

pub use encoding::to_slice;
pub use frame::{ActuatorFrame, ForceSensorFault, LogRecord, LogStart, SensorFlags, SensorFrame};
pub use longest::longest;
pub use refusal::Refusal;
pub use reply::{EXPORT_CHUNK, FromBoard, LogEntry, Reply, ReplyFrame};
pub use request::{Item, MODEL_CHUNK, Request, RequestFrame};
pub use status::{BoardStatus, ClockSource, Identity, LinkStatistics, Mode, NodeStatus, ResetCause, Status};
pub use telemetry::{JointTelemetry, Stream, TaskReport, Telemetry, TipTelemetry, Tips};

/// Ticks without a request after which a commander can be replaced while the node is not enabled: 1 s.
pub const LEASE: u32 = 100;

/// Identifies the layout of all messages. Programs with different keys can exchange only [`Request::Hello`],
/// `Disable` and `Stop`.
pub const SCHEMA_KEY: u64 = {
    const fn key<T: postcard_schema::Schema>() -> u64 {
        u64::from_le_bytes(postcard_schema::key::Key::for_path::<T>("tesaki").to_bytes())
    }
    // The model is the payload of chunks and therefore included. The state has its own key.
    key::<RequestFrame>()
        ^ key::<FromBoard>().rotate_left(13)
        ^ key::<SensorFrame>().rotate_left(26)
        ^ key::<ActuatorFrame>().rotate_left(39)
        ^ key::<crate::model::RobotModel>().rotate_left(52)
};
