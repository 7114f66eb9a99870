use std::thread;
use std::time::{Duration, Instant};

use tesaki::fault::FaultLog;
use tesaki::kinematics::{ElbowSetpoint, PosePoint, TipPoint};
use tesaki::model::{MAX_CHAINS, MAX_JOINTS, RobotModel};
use tesaki::protocol::{
    Identity, Item, LEASE, MODEL_CHUNK, NodeStatus, Refusal, Reply, Request, SCHEMA_KEY, Status, Stream,
    TaskReport, codec,
};
use tesaki::task::grasping::{GraspCommand, GraspTelemetry};
use tesaki::task::impedance::{ImpedanceCommand, ImpedanceSettings, ImpedanceTelemetry};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::telexistence::{FingertipSample, TelexistenceCommand, TelexistenceTelemetry};
use tesaki::task::visual_approach::{VisualApproachCommand, VisualApproachTelemetry};
use tesaki::task::{TaskCommand, TaskConfig, TaskKind, TaskTelemetry};

use crate::words;

/// Why a request to a board failed.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// The board refused the request; nothing changed.
    #[error("the board refused to {action}: {refusal}")]
    Refused {
        /// The requested action.
        action: &'static str,
        /// The reason.
        refusal: Refusal,
    },
    /// The reply does not belong to the request.
    #[error("the board answered the request to {action} with {reply}; please report this")]
    WrongReply {
        /// The requested action.
        action: &'static str,
        /// The reply, in words.
        reply: &'static str,
    },
    /// Board and client use different versions of the protocol.
    #[error(
        "the board's firmware {}.{}.{} uses another version of the protocol (schema {board:016x}) than this program \
         {} (schema {here:016x}): flash the firmware that belongs to this program, or use the program that belongs to \
         the firmware",
        firmware[0], firmware[1], firmware[2], env!("CARGO_PKG_VERSION")
    )]
    SchemaMismatch {
        /// The board's schema key.
        board: u64,
        /// This program's schema key.
        here: u64,
        /// The board's firmware version.
        firmware: [u8; 3],
    },
    /// The board has forgotten this program.
    #[error(
        "the board was reset meanwhile: it has forgotten its model, homed joints and tared force sensors, and \
         this program. Push the model again (`tesaki model push`), home and tare"
    )]
    Reset,
    /// No answer in time.
    #[error("no answer from the board within {seconds} s: check cable, port and power")]
    Timeout {
        /// The time waited [s].
        seconds: f64,
    },
    /// The wait for an answer was interrupted, see
    /// [`LinkBoard::interrupt_by`](crate::LinkBoard::interrupt_by).
    #[error("a stop was sent before the board answered: this request may or may not have been carried out")]
    Interrupted,
    /// The board runs another task.
    #[error("the board's task is {reported}, not {expected}: {expected} has to be enabled first")]
    OtherTask {
        /// The expected task.
        expected: TaskKind,
        /// The reported task.
        reported: TaskKind,
    },
    /// The link itself failed.
    #[error("the link to the board failed: {0}")]
    Link(#[from] std::io::Error),
    /// The pieces of an export do not match.
    #[error("another client disturbed the export of the board: try again")]
    ExportDisturbed,
    /// More joints than a board can have.
    #[error("{0} joints given; a board has at most {MAX_JOINTS}")]
    TooManyJoints(usize),
    /// More tips than a board can have.
    #[error("{0} tips given; a board has at most {MAX_CHAINS}")]
    TooManyTips(usize),
    /// The model is too large, or the received data are not a model.
    #[error("the robot model cannot be encoded or decoded: {0}")]
    Encoding(#[from] postcard::Error),
}

impl BoardError {
    /// The board refused to do `action`. A board that requires a greeting although it speaks the same version
    /// of the protocol has forgotten this client: it was reset.
    pub const fn refused(action: &'static str, refusal: Refusal) -> Self {
        match refusal {
            Refusal::SchemaMismatch { board: SCHEMA_KEY, .. } => Self::Reset,
            refusal => Self::Refused { action, refusal },
        }
    }

    /// The exit code of a program that ends with it, as in docs/supervisor.md.
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::Reset
            | Self::WrongReply { .. }
            | Self::Interrupted
            | Self::ExportDisturbed
            | Self::Encoding(_) => 1,
            Self::TooManyJoints(_) | Self::TooManyTips(_) => 2,
            Self::Link(_) => 3,
            Self::SchemaMismatch { .. } => 4,
            Self::Timeout { .. } => 6,
            Self::Refused { .. } | Self::OtherTask { .. } => 7,
        }
    }

    /// Whether the same question may be answered soon, without anything being done about it: for programs
    /// that watch a board, and outlive its silence and its resets.
    pub const fn passes(&self) -> bool {
        matches!(self, Self::Timeout { .. } | Self::Interrupted | Self::ExportDisturbed | Self::Reset)
    }
}

/// Data exported by a board.
#[derive(Clone, Debug)]
pub struct Exported {
    /// The data.
    pub bytes: Vec<u8>,
    /// Index of the last log entry before the export.
    pub index: u32,
    /// Identifies its layout, see [`Reply::Exported`].
    pub key: u64,
}

/// What [`Board::enable`] does, for its errors.
pub(crate) const ENABLE: &str = "enable its outputs";
/// What [`Board::tare`] does, for its errors.
pub(crate) const TARE: &str = "tare its force sensors";

/// The time after which the lease of a commander that has gone has expired.
pub const LEASE_EXPIRES: Duration = Duration::from_millis(10 * LEASE as u64 + 200);

/// A controller board, local or remote: anything that answers [`Request`]s.
pub trait Board {
    /// Sends a request once and waits for the reply.
    ///
    /// # Errors
    /// When the link fails or no reply comes in time. A refusal is a [`Reply`].
    fn request(&mut self, request: Request) -> Result<Reply, BoardError>;

    /// Sends a request that is answered by [`Reply::Done`].
    ///
    /// # Errors
    /// Also when the board refuses.
    fn ask(&mut self, action: &'static str, request: Request) -> Result<(), BoardError> {
        match self.request(request)? {
            Reply::Done => Ok(()),
            Reply::Refused(refusal) => Err(BoardError::refused(action, refusal)),
            reply => Err(wrong(action, &reply)),
        }
    }

    /// Greets the board and checks that it speaks this protocol.
    ///
    /// # Errors
    /// [`BoardError::SchemaMismatch`] when it does not.
    fn hello(&mut self) -> Result<Identity, BoardError> {
        match self.request(Request::Hello { schema: SCHEMA_KEY })? {
            Reply::Hello { schema: SCHEMA_KEY, identity } => Ok(identity),
            Reply::Hello { schema, identity } => {
                let firmware = identity.firmware;
                Err(BoardError::SchemaMismatch { board: schema, here: SCHEMA_KEY, firmware })
            }
            reply => Err(wrong("say hello", &reply)),
        }
    }

    /// Takes command of the board. The client must have said [hello](Self::hello).
    ///
    /// # Errors
    /// When another client commands. `by_force` replaces it, unless the board is enabled.
    fn take_command(&mut self, by_force: bool) -> Result<(), BoardError> {
        self.ask("give command to this program", Request::TakeCommand { by_force })
    }

    /// As [`take_command`](Self::take_command), but lets the lease of a commander that has gone expire first;
    /// one that is active keeps command.
    ///
    /// # Errors
    /// When another client commands the board.
    fn await_command(&mut self, by_force: bool) -> Result<(), BoardError> {
        let deadline = Instant::now() + LEASE_EXPIRES;
        loop {
            match self.take_command(by_force) {
                Err(BoardError::Refused { refusal: Refusal::Commanded { .. }, .. })
                    if Instant::now() < deadline =>
                {
                    thread::sleep(Duration::from_millis(50));
                }
                other => return other,
            }
        }
    }

    /// Sets the period of `stream` in ticks; 0 stops it.
    ///
    /// # Errors
    /// When the board refuses.
    fn set_rate(&mut self, stream: Stream, every: u16) -> Result<(), BoardError> {
        self.ask("send a stream", Request::SetRate { stream, every })
    }

    /// Exports data of the board and reads them.
    ///
    /// # Errors
    /// When the board refuses, or another client disturbs the export three times in a row.
    fn export(&mut self, item: Item) -> Result<Exported, BoardError> {
        const ACTION: &str = "export";
        for _ in 0..3 {
            let (length, checksum, index, key) = match self.request(Request::Export(item))? {
                Reply::Exported { length, checksum, index, key } => (length, checksum, index, key),
                Reply::Refused(refusal) => return Err(BoardError::refused(ACTION, refusal)),
                reply => return Err(wrong(ACTION, &reply)),
            };
            let mut bytes = Vec::new();
            while bytes.len() < length as usize {
                let offset = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
                match self.request(Request::ReadExport { offset })? {
                    Reply::Chunk { data, .. } if !data.is_empty() => bytes.extend_from_slice(&data),
                    Reply::Chunk { .. } | Reply::Refused(Refusal::NotExported { .. }) => break,
                    Reply::Refused(refusal) => return Err(BoardError::refused(ACTION, refusal)),
                    reply => return Err(wrong(ACTION, &reply)),
                }
            }
            if codec::checksum(&bytes) == checksum {
                return Ok(Exported { bytes, index, key });
            }
        }
        Err(BoardError::ExportDisturbed)
    }

    /// The robot model on the board.
    ///
    /// # Errors
    /// When the board has no model.
    fn model(&mut self) -> Result<RobotModel, BoardError> {
        Ok(postcard::from_bytes(&self.export(Item::Model)?.bytes)?)
    }

    /// The model on the board; `None` where there is none, or where it cannot be read just now: the next
    /// status tells whether there is one.
    ///
    /// # Errors
    /// One that does not [pass](BoardError::passes).
    fn model_if_there(&mut self) -> Result<Option<RobotModel>, BoardError> {
        match self.model() {
            Ok(model) => Ok(Some(model)),
            Err(BoardError::Refused { refusal: Refusal::NoModel, .. }) => Ok(None),
            Err(error) if error.passes() => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Reads the model again if it is another one than `known`, with its checksum, by the status. Returns
    /// whether it was.
    ///
    /// # Errors
    /// As [`model_if_there`](Self::model_if_there).
    fn update_model(
        &mut self,
        known: &mut Option<(RobotModel, u32)>,
        status: &Status,
    ) -> Result<bool, BoardError> {
        let checksum = (!status.node.model.is_empty()).then_some(status.node.model_checksum);
        let is_new = known.as_ref().map(|(_, checksum)| *checksum) != checksum;
        if is_new {
            *known = match checksum {
                // Where it cannot be read, the next status comes soon.
                Some(checksum) => self.model_if_there()?.map(|model| (model, checksum)),
                None => None,
            };
        }
        Ok(is_new)
    }

    /// Sends a robot model in chunks and commits it.
    ///
    /// # Errors
    /// When the board refuses the transfer or the model; it then keeps its previous model.
    fn push_model(&mut self, model: &RobotModel) -> Result<(), BoardError> {
        let bytes = postcard::to_stdvec(model)?;
        let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        self.ask("receive a model", Request::ModelBegin { length, checksum: codec::checksum(&bytes) })?;
        for (data, offset) in bytes.chunks(MODEL_CHUNK).zip((0..).step_by(MODEL_CHUNK)) {
            // Cannot fail: a chunk has exactly that capacity.
            let data = heapless::Vec::from_slice(data).unwrap_or_default();
            self.ask("receive a piece of the model", Request::ModelChunk { offset, data })?;
        }
        self.ask("use the model", Request::ModelCommit)
    }

    /// As [`push_model`](Self::push_model), but waits until the sensors have been read with the model, so
    /// that the next request finds readings; for 0.3 s at most. Returns the status at that time.
    ///
    /// # Errors
    /// As [`push_model`](Self::push_model).
    fn push_model_and_sense(&mut self, model: &RobotModel) -> Result<NodeStatus, BoardError> {
        self.push_model(model)?;
        let before = self.status()?.node.tick;
        let deadline = Instant::now() + Duration::from_millis(300);
        loop {
            let node = self.status()?.node;
            if node.tick != before || Instant::now() > deadline {
                return Ok(node);
            }
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Sets the current joint angles [rad] (homing).
    ///
    /// # Errors
    /// When the board refuses.
    fn home(&mut self, positions: &[f32]) -> Result<(), BoardError> {
        self.ask("home", Request::Home { positions: joints(positions)? })
    }

    /// Zeroes the force sensors; nothing may touch the tips.
    ///
    /// # Errors
    /// When the board refuses.
    fn tare(&mut self) -> Result<(), BoardError> {
        self.ask(TARE, Request::Tare)
    }

    /// Starts a task and switches the outputs on.
    ///
    /// # Errors
    /// When the board refuses.
    fn enable(&mut self, task: TaskConfig) -> Result<(), BoardError> {
        self.ask(ENABLE, Request::Enable(task))
    }

    /// Ends the task and switches the outputs off.
    ///
    /// # Errors
    /// When the link fails.
    fn disable(&mut self) -> Result<(), BoardError> {
        self.ask("disable its outputs", Request::Disable)
    }

    /// Sends a command to the task.
    ///
    /// # Errors
    /// When the board refuses.
    fn command(&mut self, command: TaskCommand) -> Result<(), BoardError> {
        self.ask(words::action(&command), Request::Task(command))
    }

    /// Sends a goal for each joint [rad].
    ///
    /// # Errors
    /// When the board refuses.
    fn set_goal(&mut self, positions: &[f32]) -> Result<(), BoardError> {
        self.command(TaskCommand::JointServo(JointCommand::Goal { positions: joints(positions)? }))
    }

    /// Sends the next point of the trajectory of each fingertip, one per tick.
    ///
    /// # Errors
    /// When the board refuses.
    fn reach(&mut self, tips: &[TipPoint]) -> Result<(), BoardError> {
        let tips = heapless::Vec::from_slice(tips).map_err(|_| BoardError::TooManyTips(tips.len()))?;
        self.command(TaskCommand::JointServo(JointCommand::StreamTips { tips }))
    }

    /// Sends a grasp command.
    ///
    /// # Errors
    /// When the board refuses.
    fn grasp(&mut self, command: GraspCommand) -> Result<(), BoardError> {
        self.command(TaskCommand::Grasping(command))
    }

    /// Telemetry of the running task, or of the last one.
    ///
    /// # Errors
    /// When no task was enabled yet.
    fn read_task(&mut self) -> Result<TaskReport, BoardError> {
        const ACTION: &str = "report on its task";
        match self.request(Request::ReadTask)? {
            Reply::Task(report) => Ok(report),
            Reply::Refused(refusal) => Err(BoardError::refused(ACTION, refusal)),
            reply => Err(wrong(ACTION, &reply)),
        }
    }

    /// Telemetry of grasping.
    ///
    /// # Errors
    /// When the board's task is not grasping.
    fn read_grasp(&mut self) -> Result<GraspTelemetry, BoardError> {
        match self.read_task()?.telemetry {
            TaskTelemetry::Grasping(grasp) => Ok(grasp),
            other => Err(BoardError::OtherTask { expected: TaskKind::Grasping, reported: other.kind() }),
        }
    }

    /// Telemetry of impedance control.
    ///
    /// # Errors
    /// When the board's task is not impedance control.
    fn read_impedance(&mut self) -> Result<ImpedanceTelemetry, BoardError> {
        match self.read_task()?.telemetry {
            TaskTelemetry::Impedance(arm) => Ok(arm),
            other => Err(BoardError::OtherTask { expected: TaskKind::Impedance, reported: other.kind() }),
        }
    }

    /// Changes the settings of impedance control.
    ///
    /// # Errors
    /// When the board refuses.
    fn configure_impedance(&mut self, settings: ImpedanceSettings) -> Result<(), BoardError> {
        self.command(TaskCommand::Impedance(ImpedanceCommand::Configure(settings)))
    }

    /// Sets the target of tool and elbow under impedance control.
    ///
    /// # Errors
    /// When the board refuses.
    fn set_target(&mut self, point: PosePoint, elbow: ElbowSetpoint) -> Result<(), BoardError> {
        self.command(TaskCommand::Impedance(ImpedanceCommand::SetTarget { point, elbow }))
    }

    /// Moves a hand to the operator's fingertips.
    ///
    /// # Errors
    /// When the board refuses.
    fn follow_fingertips(&mut self, sample: FingertipSample) -> Result<(), BoardError> {
        self.command(TaskCommand::Telexistence(TelexistenceCommand::Follow(sample)))
    }

    /// Telemetry of telexistence.
    ///
    /// # Errors
    /// When the board's task is not telexistence.
    fn read_telexistence(&mut self) -> Result<TelexistenceTelemetry, BoardError> {
        match self.read_task()?.telemetry {
            TaskTelemetry::Telexistence(hand) => Ok(hand),
            other => Err(BoardError::OtherTask { expected: TaskKind::Telexistence, reported: other.kind() }),
        }
    }

    /// A command to the visual approach.
    ///
    /// # Errors
    /// When the board refuses.
    fn approach(&mut self, command: VisualApproachCommand) -> Result<(), BoardError> {
        self.command(TaskCommand::VisualApproach(command))
    }

    /// Telemetry of the visual approach.
    ///
    /// # Errors
    /// When the board's task is not the visual approach.
    fn read_visual_approach(&mut self) -> Result<VisualApproachTelemetry, BoardError> {
        match self.read_task()?.telemetry {
            TaskTelemetry::VisualApproach(hand) => Ok(hand),
            other => {
                Err(BoardError::OtherTask { expected: TaskKind::VisualApproach, reported: other.kind() })
            }
        }
    }

    /// Keeps the task running: resets the command timeout only.
    ///
    /// # Errors
    /// When the board refuses.
    fn keep(&mut self) -> Result<(), BoardError> {
        self.ask("keep the task running", Request::Keep)
    }

    /// Status of node and board.
    ///
    /// # Errors
    /// When the board refuses.
    fn status(&mut self) -> Result<Status, BoardError> {
        match self.request(Request::ReadStatus)? {
            Reply::Status(status) => Ok(status),
            Reply::Refused(refusal) => Err(BoardError::refused("report its status", refusal)),
            reply => Err(wrong("report its status", &reply)),
        }
    }

    /// The faults since power-on.
    ///
    /// # Errors
    /// When the board refuses.
    fn faults(&mut self) -> Result<FaultLog, BoardError> {
        match self.request(Request::ReadFaults)? {
            Reply::Faults(log) => Ok(log),
            Reply::Refused(refusal) => Err(BoardError::refused("report its faults", refusal)),
            reply => Err(wrong("report its faults", &reply)),
        }
    }
}

fn joints(values: &[f32]) -> Result<heapless::Vec<f32, MAX_JOINTS>, BoardError> {
    heapless::Vec::from_slice(values).map_err(|_| BoardError::TooManyJoints(values.len()))
}

const fn wrong(action: &'static str, reply: &Reply) -> BoardError {
    let reply = match reply {
        Reply::Hello { .. } => "a greeting",
        Reply::Done => "a confirmation without data",
        Reply::Refused(_) => "a refusal",
        Reply::Status(_) => "its status",
        Reply::Faults(_) => "its faults",
        Reply::Exported { .. } => "the size of an export",
        Reply::Chunk { .. } => "a piece of an export",
        Reply::Task(_) => "a report on its task",
    };
    BoardError::WrongReply { action, reply }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_watches_outlives_a_reset_and_not_another_version() {
        let greet = |board| Refusal::SchemaMismatch { board, firmware: [0, 1, 0] };
        let refused = |refusal| BoardError::refused("export", refusal);
        assert!(refused(greet(SCHEMA_KEY)).passes() && BoardError::Timeout { seconds: 1.0 }.passes());
        assert!(!refused(greet(!SCHEMA_KEY)).passes() && !refused(Refusal::NoModel).passes());
    }
}
