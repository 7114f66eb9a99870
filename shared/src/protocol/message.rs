use core::fmt;

use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::codec::FrameCounts;
use super::fault::{Fault, FaultLog};
use super::frame::LogRecord;
use crate::arm::{ArmError, ArmSettings, ArmTelemetry, BadSettings, ElbowPoint, PosePoint};
use crate::control::{JointPoint, ServoMode};
use crate::kinematics::TipPoint;
use crate::manipulation::{GraspCommand, GraspTelemetry, Unable};
use crate::model::{MAX_CHAINS, MAX_JOINTS, MAX_NAME, ModelError};

/// Most bytes of a model in one [`Request::ModelChunk`].
pub const MODEL_CHUNK: usize = 192;

/// Most bytes of an export in one [`Reply::Chunk`].
pub const EXPORT_CHUNK: usize = 192;

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

/// What the supervisor asks of the board. Every request has one [`Reply`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Request {
    /// 0: who are you? Its layout never changes. Answered by [`Reply::Hello`].
    Hello {
        /// The sender's [`super::SCHEMA_KEY`].
        schema: u64,
    },
    /// 1: a robot model follows in chunks. Only while disarmed; the model in use stays until the commit.
    ModelBegin {
        /// Length of the model's postcard encoding in bytes.
        length: u32,
        /// Its [`super::codec::checksum`].
        checksum: u32,
    },
    /// 2: a piece of the model; pieces come in order, and one that came already may come again.
    ModelChunk {
        /// Where it belongs.
        offset: u32,
        /// The bytes.
        data: Vec<u8, MODEL_CHUNK>,
    },
    /// 3: check the model and use it from now on.
    ModelCommit,
    /// 4: the joints stand at these angles now [rad]. Homes relative encoders; only while disarmed.
    Home {
        /// An angle for each joint.
        positions: Vec<f32, MAX_JOINTS>,
    },
    /// 5: start a task; the joints hold where they are until a set-point comes.
    Arm {
        /// The task.
        task: Task,
    },
    /// 6: outputs off. Always granted.
    Disarm,
    /// 7: where to go. Says the whole aim, so it may be repeated; it also tells the node that the supervisor lives.
    SetPoint(SetPoint),
    /// 8: stop now: fault [`super::FaultCause::Stop`] with the configured reaction. Always granted.
    Stop,
    /// 9: answered by [`Reply::Status`].
    ReadStatus,
    /// 10: answered by [`Reply::Faults`].
    ReadFaults,
    /// 11: leave the fault mode. Needs proof that the faults were read.
    ClearFaults {
        /// [`FaultLog::total`] as read.
        total: u32,
    },
    /// 12: send a stream every so many ticks; 0 stops it. For all clients: the last word counts.
    SetRate {
        /// Which.
        stream: Stream,
        /// Ticks from one message to the next.
        every: u16,
    },
    /// 13: be the one that commands. Granted when nobody commands, or when the commander has been silent for
    /// [`super::LEASE`] and the node is not armed.
    TakeCommand {
        /// Also when another commands, unless the node is armed.
        by_force: bool,
    },
    /// 14: command no longer. Not while armed.
    ReleaseCommand,
    /// 15: keep a copy of what the node has, to be read piece by piece. Answered by [`Reply::Exported`].
    Export(Item),
    /// 16: a piece of the copy. Answered by [`Reply::Chunk`].
    ReadExport {
        /// Where the piece begins.
        offset: u32,
    },
    /// 17: nothing touches the tips: what their force sensors read now is what they read without contact.
    Tare,
    /// 18: what a hand armed for [`Task::Grasp`] is to do next. Like a set-point it tells that the supervisor lives.
    Grasp(GraspCommand),
    /// 19: answered by [`Reply::Grasp`].
    ReadGrasp,
    /// 20: how an arm is to behave under [`Task::Impedance`]; also while it does.
    Impedance(ArmSettings),
    /// 21: answered by [`Reply::Arm`].
    ReadArm,
}

/// What a board sends unasked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stream {
    /// 0: [`FromBoard::Telemetry`].
    Telemetry,
    /// 1: [`FromBoard::Status`].
    Status,
    /// 2: [`FromBoard::Log`]: everything that goes into the node and comes out of it. Complete whatever the rate is,
    /// unless that is 0.
    Log,
    /// 3: [`FromBoard::Tips`].
    Tips,
    /// 4: [`FromBoard::Grasp`].
    Grasp,
    /// 5: [`FromBoard::Arm`].
    Arm,
}

impl Stream {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Telemetry, Self::Status, Self::Log, Self::Tips, Self::Grasp, Self::Arm];
}

/// What can be exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Item {
    /// 0: the [`crate::model::RobotModel`] in use, as it was pushed.
    Model,
    /// 1: the [`crate::node::State`], from which a log can be replayed.
    State,
}

/// What an armed node does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Task {
    /// 0: every joint follows its own set-point.
    JointServo(ServoMode),
    /// 1: three fingers grasp and move an object ([`crate::manipulation`]), told by [`Request::Grasp`].
    Grasp,
    /// 2: an arm yields at its tool ([`crate::arm`]) as [`Request::Impedance`] said.
    Impedance,
}

/// Where the joints are to go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum SetPoint {
    /// 0: angles [rad], approached through the trajectory filter.
    Goal {
        /// An angle for each joint.
        positions: Vec<f32, MAX_JOINTS>,
    },
    /// 1: one point of a trajectory that the sender shapes itself, past the trajectory filter. One a tick.
    Stream {
        /// A point for each joint.
        points: Vec<JointPoint, MAX_JOINTS>,
    },
    /// 2: the same for the tips of fingers: the node finds the joint angles, in closed form, nearest to those before.
    Reach {
        /// A point for the tip of each chain.
        tips: Vec<TipPoint, MAX_CHAINS>,
    },
    /// 3: as before: only tells that the supervisor lives. For any task.
    Keep,
    /// 4: as 1, with a torque for each joint besides: for forces on an object that several boards hold together.
    Guide {
        /// A point for each joint.
        points: Vec<JointPoint, MAX_JOINTS>,
        /// Torques that the servo does not make up for as long as nothing moves [N·m].
        torques: Vec<f32, MAX_JOINTS>,
    },
    /// 5: where the tool of an arm under [`Task::Impedance`] should be, and its elbow. Coasts to rest until another comes.
    Pose {
        /// The tool.
        point: PosePoint,
        /// The elbow.
        elbow: ElbowPoint,
    },
}

/// Everything that a board sends to the supervisor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum FromBoard {
    /// 0: the answer to a request.
    Reply(ReplyFrame),
    /// 1: the joints, at the rate of [`Request::SetRate`]; may be lost.
    Telemetry(Telemetry),
    /// 2: the same as [`Reply::Status`], likewise.
    Status(Status),
    /// 3: an entry of the log, likewise.
    Log(LogEntry),
    /// 4: the tips, likewise.
    Tips(Tips),
    /// 5: the object in the hand, likewise.
    Grasp(GraspTelemetry),
    /// 6: the arm, likewise.
    Arm(ArmTelemetry),
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
    },
    /// 6: answers [`Request::ReadExport`].
    Chunk {
        /// Where the piece begins.
        offset: u32,
        /// The bytes; fewer than [`EXPORT_CHUNK`] at the end.
        data: Vec<u8, EXPORT_CHUNK>,
    },
    /// 7: answers [`Request::ReadGrasp`].
    Grasp(GraspTelemetry),
    /// 8: answers [`Request::ReadArm`].
    Arm(ArmTelemetry),
}

/// Who a board is. Its layout never changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity {
    /// Version of the firmware: major, minor, patch.
    pub firmware: [u8; 3],
    /// The first bytes of the image's build id, a hash of the whole image; 0 for a node that is in no image.
    pub image: [u8; 8],
    /// The microcontroller's unique number; 0 when it has none.
    pub board: [u8; 12],
    /// Bit 0: sensors and drives are on the plant link. Bit 1: the board has power stages of its own. Bit 2: joint
    /// servo. Bit 3: [`Task::Grasp`]. Bit 4: [`Task::Impedance`]. The others are 0.
    pub capabilities: u32,
}

impl Identity {
    /// See [`Identity::capabilities`].
    pub const PLANT_LINK: u32 = 1;
    /// See [`Identity::capabilities`].
    pub const POWER_STAGES: u32 = 2;
    /// See [`Identity::capabilities`].
    pub const JOINT_SERVO: u32 = 4;
    /// See [`Identity::capabilities`].
    pub const GRASP: u32 = 8;
    /// See [`Identity::capabilities`].
    pub const IMPEDANCE: u32 = 16;
    /// The tasks that every node can do.
    pub const TASKS: u32 = Self::JOINT_SERVO | Self::GRASP | Self::IMPEDANCE;
}

/// Why a request was refused, with what it takes to mend it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// 0: no hello with the board's own schema key came from this client.
    SchemaMismatch {
        /// The board's key.
        board: u64,
        /// The board's firmware version.
        firmware: [u8; 3],
    },
    /// 1: the board has no robot model.
    NoModel,
    /// 2: the model holds nonsense.
    Model(ModelError),
    /// 3: a chunk that does not continue the transfer, or none was begun.
    ModelTransfer {
        /// Bytes received so far.
        received: u32,
        /// Bytes announced.
        announced: u32,
    },
    /// 4: the model arrived damaged.
    ModelChecksum {
        /// Checksum of what arrived.
        received: u32,
        /// Checksum announced.
        announced: u32,
    },
    /// 5: the model is longer than the board can hold, or is not a model of this schema.
    ModelUnreadable {
        /// Bytes.
        length: u32,
        /// Most bytes.
        limit: u32,
    },
    /// 6: not in this mode.
    WrongMode(Mode),
    /// 7: a relative encoder that was not homed since power-on.
    NotHomed {
        /// The joint.
        joint: u8,
    },
    /// 8: there are faults that were not read.
    FaultsUnread {
        /// Their number since power-on.
        total: u32,
    },
    /// 9: a list with the wrong number of joints.
    JointCount {
        /// Joints in the request.
        got: u8,
        /// Joints of the robot.
        expected: u8,
    },
    /// 10: a number that is not finite.
    NotFinite {
        /// The joint.
        joint: u8,
    },
    /// 11: an angle outside the limits [rad].
    OutsideLimits {
        /// The joint.
        joint: u8,
        /// The angle.
        value: f32,
        /// Smallest.
        lower: f32,
        /// Largest.
        upper: f32,
    },
    /// 12: a speed beyond the limit [rad/s].
    TooFast {
        /// The joint.
        joint: u8,
        /// The speed.
        value: f32,
        /// The limit.
        limit: f32,
    },
    /// 13: a streamed point too far from the reference so far [rad].
    Jump {
        /// The joint.
        joint: u8,
        /// The distance.
        value: f32,
        /// The limit.
        limit: f32,
    },
    /// 14: no sensor frame has come yet.
    NoSensors,
    /// 15: the last sensor frame shows a state that would be a fault at once.
    Unsafe(Fault),
    /// 16: another client commands.
    Commanded {
        /// Which.
        by: u32,
    },
    /// 17: only the commander may ask for this, and nobody commands.
    NotCommander,
    /// 18: the commander has sent a later request already: this one came late, or twice.
    Stale {
        /// Sequence number of the later one.
        latest: u16,
    },
    /// 19: nothing was exported, or not so much.
    NotExported {
        /// Bytes of the export; 0 without one.
        length: u32,
    },
    /// 20: a set-point for another number of tips than the robot has.
    TipCount {
        /// As sent.
        got: u8,
        /// As the robot has.
        expected: u8,
    },
    /// 21: the chain is not of the shape of which the node knows the inverse kinematics
    /// ([`Finger`](crate::kinematics::Finger)).
    FingerShapeError {
        /// The chain.
        chain: u8,
    },
    /// 22: the chain's tip cannot be there.
    OutOfReach {
        /// The chain.
        chain: u8,
        /// The nearest place where it could be, were it not for the limits of its joints [m, base frame].
        nearest: [f32; 3],
    },
    /// 23: where the chain's tip is to be, it can hardly move in some direction: nearly straight, or near the axis of its
    /// first joint.
    Singular {
        /// The chain.
        chain: u8,
    },
    /// 24: the trajectory's acceleration is more than the joint's torque gives its inertia.
    TooMuchAcceleration {
        /// The joint.
        joint: u8,
        /// The acceleration [rad/s²].
        value: f32,
        /// Its limit [rad/s²].
        limit: f32,
    },
    /// 25: the point of a tip is NaN, infinite or a thousand kilometres away.
    TipNotFinite {
        /// The chain.
        chain: u8,
    },
    /// 26: no chain of the robot has a force sensor.
    NoForceSensor,
    /// 27: the robot is not a hand of three fingers with three joints and a force sensor each.
    NotAHand,
    /// 28: the force sensor of the chain was not tared since power-on, or since the model was committed.
    NotTared {
        /// The chain.
        chain: u8,
    },
    /// 29: the hand cannot do this.
    Unable(Unable),
    /// 30: a torque beyond the joint's limit [N·m].
    TooMuchTorque {
        /// The joint.
        joint: u8,
        /// The torque.
        value: f32,
        /// The limit.
        limit: f32,
    },
    /// 31: the robot is not a single chain of six or seven joints.
    NotAnArm,
    /// 32: an arm cannot behave like that.
    Settings(BadSettings),
    /// 33: the arm cannot do this.
    Arm(ArmError),
}

impl Refusal {
    /// The joint that it concerns, if it concerns one.
    pub const fn joint(&self) -> Option<u8> {
        match *self {
            Self::Model(ModelError { joint, .. }) | Self::Unsafe(Fault { joint, .. }) => joint,
            Self::NotHomed { joint }
            | Self::NotFinite { joint }
            | Self::OutsideLimits { joint, .. }
            | Self::TooFast { joint, .. }
            | Self::TooMuchAcceleration { joint, .. }
            | Self::TooMuchTorque { joint, .. }
            | Self::Jump { joint, .. } => Some(joint),
            _ => None,
        }
    }

    /// The chain that it concerns, if it concerns one.
    pub const fn chain(&self) -> Option<u8> {
        match *self {
            Self::FingerShapeError { chain }
            | Self::OutOfReach { chain, .. }
            | Self::Singular { chain }
            | Self::NotTared { chain }
            | Self::TipNotFinite { chain } => Some(chain),
            _ => None,
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
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
            Self::NoModel => write!(f, "the board has no robot model: push one first"),
            Self::Model(error) => write!(f, "the robot model was refused: {error}"),
            Self::ModelTransfer { received, announced } => {
                write!(
                    f,
                    "model transfer out of step ({received} of {announced} bytes arrived): begin it again"
                )
            }
            Self::ModelChecksum { received, announced } => write!(
                f,
                "the model arrived damaged (checksum {received:08x}, announced {announced:08x}): push it again"
            ),
            Self::ModelUnreadable { length, limit } => {
                write!(f, "{length} bytes are not a robot model of this version (at most {limit} bytes)")
            }
            Self::WrongMode(mode) => write!(f, "not possible while the board is {mode}"),
            Self::NotHomed { joint } => {
                write!(
                    f,
                    "joint {joint} has a relative encoder and was not homed since power-on: home it first"
                )
            }
            Self::FaultsUnread { total } => {
                write!(
                    f,
                    "{total} faults since power-on, not all of them read: read the faults, then clear them"
                )
            }
            Self::JointCount { got, expected } => write!(f, "{got} joints given, the robot has {expected}"),
            Self::NotFinite { joint } => write!(f, "joint {joint}: not a finite number"),
            Self::OutsideLimits { joint, value, lower, upper } => {
                write!(f, "joint {joint}: {value} rad is outside its limits {lower} to {upper} rad")
            }
            Self::TooFast { joint, value, limit } => {
                write!(f, "joint {joint}: {value} rad/s is beyond its limit of {limit} rad/s")
            }
            Self::Jump { joint, value, limit } => write!(
                f,
                "joint {joint}: the point lies {value} rad from the reference, at most {limit} rad is followed: \
                 start a stream where the joint is"
            ),
            Self::NoSensors => write!(f, "no sensor readings yet: check encoders and supply"),
            Self::Unsafe(fault) => write!(f, "arming now would end at once in {fault}"),
            Self::Commanded { by } => write!(
                f,
                "another client ({by:08x}) commands this board: wait until it is done, or take over by force while \
                 the board is not armed"
            ),
            Self::NotCommander => write!(f, "this client does not command the board: take command first"),
            Self::Stale { latest } => {
                write!(f, "the request came late or twice: request {latest} was answered already")
            }
            Self::NotExported { length } => {
                write!(f, "there is no such piece: the export has {length} bytes; export first")
            }
            Self::TipCount { got, expected } => write!(f, "{got} tips given, the robot has {expected}"),
            Self::FingerShapeError { chain } => write!(
                f,
                "chain {chain} is not a three-joint finger, so the board cannot compute its joint angles: send them \
                 (`tesaki eval ik` finds them)"
            ),
            Self::OutOfReach { chain, nearest: [x, y, z] } => write!(
                f,
                "the tip of chain {chain} does not reach so far (or so near); without its joints' limits it would reach \
                 ({x}, {y}, {z}) m"
            ),
            Self::Singular { chain } => write!(
                f,
                "the tip of chain {chain} is to move where it can hardly move in some direction: keep away from the \
                 straight finger and from the axis of its first joint"
            ),
            Self::TooMuchAcceleration { joint, value, limit } => write!(
                f,
                "joint {joint}: {value} rad/s² is more than its torque can do, {limit} rad/s²: a slower trajectory"
            ),
            Self::NoForceSensor => f.write_str(
                "the robot has no force sensor: there is nothing to tare, and an arm's force has to be found in its motors' torques"
            ),
            Self::TipNotFinite { chain } => write!(f, "the tip of chain {chain}: not a finite place"),
            Self::NotAHand => {
                write!(
                    f,
                    "the robot is not a hand of three fingers, each with three joints and a force sensor"
                )
            }
            Self::NotTared { chain } => write!(
                f,
                "the force sensor of chain {chain} was not tared since the model was pushed: tare it while nothing touches the tips"
            ),
            Self::Unable(unable) => unable.fmt(f),
            Self::TooMuchTorque { joint, value, limit } => {
                write!(f, "joint {joint}: {value} N·m is beyond its limit of {limit} N·m")
            }
            Self::NotAnArm => write!(f, "the robot is not an arm: a single chain of six or seven joints"),
            Self::Settings(bad) => bad.fmt(f),
            Self::Arm(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for Refusal {}

/// What the node is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mode {
    /// 0: outputs off.
    Disarmed,
    /// 1: at work.
    Armed(Task),
    /// 2: something was wrong; the outputs follow [`crate::model::Reaction`] until the fault is cleared.
    Fault,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disarmed => write!(f, "disarmed"),
            Self::Armed(Task::JointServo(ServoMode::Pid)) => write!(f, "armed (joint servo, PID)"),
            Self::Armed(Task::JointServo(ServoMode::Observer)) => write!(f, "armed (joint servo, observer)"),
            Self::Armed(Task::Grasp) => write!(f, "armed (grasp)"),
            Self::Armed(Task::Impedance) => write!(f, "armed (impedance)"),
            Self::Fault => write!(f, "in fault"),
        }
    }
}

/// The state of node and board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Status {
    /// The node's part.
    pub node: NodeStatus,
    /// The board's part.
    pub board: BoardStatus,
}

/// The node's part of [`Status`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct NodeStatus {
    /// Mode.
    pub mode: Mode,
    /// Name of the model in use; empty without one.
    pub model: String<MAX_NAME>,
    /// Its [`super::codec::checksum`]; 0 without one.
    pub model_checksum: u32,
    /// Bit `i` is set when joint `i` is homed or needs no homing.
    pub homed: u16,
    /// Faults since power-on.
    pub faults: u32,
    /// Whether they were all read.
    pub faults_read: bool,
    /// The client that commands.
    pub commander: Option<u32>,
    /// The last tick.
    pub tick: u32,
    /// Supply voltage [V].
    pub supply: f32,
}

/// The board's part of [`Status`]. The simulator and the replay tool report [`BoardStatus::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct BoardStatus {
    /// Who it is.
    pub identity: Identity,
    /// Where the clock comes from.
    pub clock: ClockSource,
    /// Why the board started last.
    pub reset: ResetCause,
    /// Message of the panic or CPU fault before the last reset; empty if there was none.
    pub last_words: String<96>,
    /// Most stack ever used since the last reset, and its size, in bytes.
    pub stack_used: u32,
    /// Size of the stack in bytes.
    pub stack_size: u32,
    /// The link to the supervisor.
    pub supervisor_link: LinkStatistics,
    /// The plant link.
    pub plant: LinkStatistics,
}

impl Default for BoardStatus {
    fn default() -> Self {
        Self {
            identity: Identity {
                firmware: crate::VERSION,
                capabilities: Identity::PLANT_LINK | Identity::TASKS,
                ..Identity::default()
            },
            clock: ClockSource::Crystal,
            reset: ResetCause::PowerOn,
            last_words: String::new(),
            stack_used: 0,
            stack_size: 0,
            supervisor_link: LinkStatistics::default(),
            plant: LinkStatistics::default(),
        }
    }
}

/// What a link of the board has seen since the last reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkStatistics {
    /// Received frames by kind.
    pub frames: FrameCounts,
    /// Received bytes lost because the queue was full.
    pub receive_overflow: u32,
    /// Received bytes lost in the UART: noise, framing, overrun.
    pub receive_errors: u32,
    /// Frames not sent because the queue was full.
    pub send_overflow: u32,
}

/// Where the board's clock comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ClockSource {
    /// 0: crystal and PLL, 168 MHz.
    Crystal,
    /// 1: internal oscillator and PLL, 168 MHz, 1 % exact.
    InternalPll,
    /// 2: internal oscillator alone, 16 MHz.
    Internal,
}

/// Why the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetCause {
    /// 0: power, or the reset button.
    PowerOn,
    /// 1: the watchdog.
    Watchdog,
    /// 2: a panic.
    Panic,
    /// 3: a CPU fault.
    HardFault,
    /// 4: asked for by software or the debugger.
    Software,
}

/// The state of the node after a tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Telemetry {
    /// The tick.
    pub tick: u32,
    /// Mode.
    pub mode: Mode,
    /// Faults since power-on.
    pub faults: u32,
    /// One entry for each joint.
    pub joints: Vec<JointTelemetry, MAX_JOINTS>,
}

/// The tips after a tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Tips {
    /// The tick.
    pub tick: u32,
    /// One entry for each chain.
    pub tips: Vec<TipTelemetry, MAX_CHAINS>,
}

/// A tip after a tick, in the base frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TipTelemetry {
    /// Where it is [m].
    pub position: [f32; 3],
    /// Force of the world on it, without the weight of what the sensor carries [N]; 0 without a sensor.
    pub force: [f32; 3],
    /// Torque likewise, about the tip [N·m].
    pub torque: [f32; 3],
    /// Whether its force sensor was tared.
    pub tared: bool,
}

/// A joint after a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct JointTelemetry {
    /// Measured angle [rad].
    pub position: f32,
    /// Measured velocity [rad/s].
    pub velocity: f32,
    /// Reference angle [rad].
    pub reference: f32,
    /// Torque [N·m].
    pub torque: f32,
}
