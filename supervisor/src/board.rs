use tesaki::arm::{ArmSettings, ArmTelemetry, ElbowPoint, PosePoint};
use tesaki::kinematics::TipPoint;
use tesaki::manipulation::{GraspCommand, GraspTelemetry};
use tesaki::model::{MAX_CHAINS, MAX_JOINTS, RobotModel};
use tesaki::protocol::{
    FaultLog, Identity, Item, MODEL_CHUNK, Refusal, Reply, Request, SCHEMA_KEY, SetPoint, Status, Stream,
    Task, codec,
};

/// Why a request to a board came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// The board said no, and nothing changed.
    #[error("the board refused to {action}: {refusal}")]
    Refused {
        /// What it was asked to do.
        action: &'static str,
        /// Its reason.
        refusal: Refusal,
    },
    /// The board's answer is of another kind than the request.
    #[error("the board answered with something else when asked to {action}: {reply}")]
    WrongReply {
        /// What it was asked to do.
        action: &'static str,
        /// The answer.
        reply: String,
    },
    /// Board and client have different protocols.
    #[error(
        "the board's firmware {}.{}.{} speaks another version of the protocol (schema {board:016x}) than this program \
         {} (schema {here:016x}): flash the firmware that belongs to this program, or use the program that belongs to \
         the firmware",
        firmware[0], firmware[1], firmware[2], env!("CARGO_PKG_VERSION")
    )]
    SchemaMismatch {
        /// The board's schema key.
        board: u64,
        /// This program's.
        here: u64,
        /// The board's firmware version.
        firmware: [u8; 3],
    },
    /// No answer in time.
    #[error("no answer from the board within {seconds} s: check cable, port and power")]
    Timeout {
        /// How long was waited [s].
        seconds: f64,
    },
    /// The link itself failed.
    #[error("the link to the board failed: {0}")]
    Link(#[from] std::io::Error),
    /// What was read in pieces did not fit together.
    #[error("the board's export was disturbed by another client: try again")]
    ExportDisturbed,
    /// More joints than a board can have.
    #[error("{0} joints given, a board has at most {MAX_JOINTS}")]
    TooManyJoints(usize),
    /// More tips than a board can have.
    #[error("{0} tips given, a board has at most {MAX_CHAINS}")]
    TooManyTips(usize),
    /// The model is too large to send, or what came is none.
    #[error("the robot model cannot be encoded or decoded: {0}")]
    Encoding(#[from] postcard::Error),
}

/// A controller board, near or far: whatever answers [`Request`]s.
pub trait Board {
    /// Asks once and waits for the answer.
    ///
    /// # Errors
    /// When the link fails or nothing comes in time. A refusal is a [`Reply`].
    fn request(&mut self, request: Request) -> Result<Reply, BoardError>;

    /// Asks for something that is answered by [`Reply::Done`].
    ///
    /// # Errors
    /// Also when the board refuses.
    fn ask(&mut self, action: &'static str, request: Request) -> Result<(), BoardError> {
        match self.request(request)? {
            Reply::Done => Ok(()),
            Reply::Refused(refusal) => Err(BoardError::Refused { action, refusal }),
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
    /// When another client commands. `by_force` replaces it, unless the board is armed.
    fn take_command(&mut self, by_force: bool) -> Result<(), BoardError> {
        self.ask("be commanded", Request::TakeCommand { by_force })
    }

    /// Has the board send `stream` every so many ticks; 0 stops it.
    ///
    /// # Errors
    /// When the board refuses.
    fn set_rate(&mut self, stream: Stream, every: u16) -> Result<(), BoardError> {
        self.ask("send a stream", Request::SetRate { stream, every })
    }

    /// Reads a copy of what the board has, and the index of the last log entry before it was made.
    ///
    /// # Errors
    /// When the board refuses, or another client exports something at the same time, three times in a row.
    fn export(&mut self, item: Item) -> Result<(Vec<u8>, u32), BoardError> {
        const ACTION: &str = "export";
        for _ in 0..3 {
            let (length, checksum, index) = match self.request(Request::Export(item))? {
                Reply::Exported { length, checksum, index } => (length, checksum, index),
                Reply::Refused(refusal) => return Err(BoardError::Refused { action: ACTION, refusal }),
                reply => return Err(wrong(ACTION, &reply)),
            };
            let mut bytes = Vec::new();
            while bytes.len() < length as usize {
                let offset = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
                match self.request(Request::ReadExport { offset })? {
                    Reply::Chunk { data, .. } if !data.is_empty() => bytes.extend_from_slice(&data),
                    Reply::Chunk { .. } | Reply::Refused(Refusal::NotExported { .. }) => break,
                    Reply::Refused(refusal) => return Err(BoardError::Refused { action: ACTION, refusal }),
                    reply => return Err(wrong(ACTION, &reply)),
                }
            }
            if codec::checksum(&bytes) == checksum {
                return Ok((bytes, index));
            }
        }
        Err(BoardError::ExportDisturbed)
    }

    /// The robot model that the board uses.
    ///
    /// # Errors
    /// When it has none.
    fn model(&mut self) -> Result<RobotModel, BoardError> {
        let (bytes, _) = self.export(Item::Model)?;
        Ok(postcard::from_bytes(&bytes)?)
    }

    /// Sends a robot model, piece by piece, and has it taken into use.
    ///
    /// # Errors
    /// When the board refuses the transfer or the model; it then keeps the model that it had.
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

    /// Tells the board at which angles [rad] its joints stand.
    ///
    /// # Errors
    /// When the board refuses.
    fn home(&mut self, positions: &[f32]) -> Result<(), BoardError> {
        self.ask("home", Request::Home { positions: joints(positions)? })
    }

    /// Nothing touches the tips: what their force sensors read now is taken off from now on.
    ///
    /// # Errors
    /// When the board refuses.
    fn tare(&mut self) -> Result<(), BoardError> {
        self.ask("tare its force sensors", Request::Tare)
    }

    /// Arms the board.
    ///
    /// # Errors
    /// When the board refuses.
    fn arm(&mut self, task: Task) -> Result<(), BoardError> {
        self.ask("arm", Request::Arm { task })
    }

    /// Sends a goal for each joint [rad].
    ///
    /// # Errors
    /// When the board refuses.
    fn set_goal(&mut self, positions: &[f32]) -> Result<(), BoardError> {
        self.ask("move", Request::SetPoint(SetPoint::Goal { positions: joints(positions)? }))
    }

    /// Sends the next point of a trajectory for the tip of each finger: one a tick.
    ///
    /// # Errors
    /// When the board refuses.
    fn reach(&mut self, tips: &[TipPoint]) -> Result<(), BoardError> {
        let tips = heapless::Vec::from_slice(tips).map_err(|_| BoardError::TooManyTips(tips.len()))?;
        self.ask("move its tips", Request::SetPoint(SetPoint::Reach { tips }))
    }

    /// Tells a hand what to do next.
    ///
    /// # Errors
    /// When the board refuses.
    fn grasp(&mut self, command: GraspCommand) -> Result<(), BoardError> {
        self.ask("grasp", Request::Grasp(command))
    }

    /// The object in the hand.
    ///
    /// # Errors
    /// When the board refuses.
    fn read_grasp(&mut self) -> Result<GraspTelemetry, BoardError> {
        match self.request(Request::ReadGrasp)? {
            Reply::Grasp(grasp) => Ok(grasp),
            Reply::Refused(refusal) => Err(BoardError::Refused { action: "tell what it holds", refusal }),
            reply => Err(wrong("tell what it holds", &reply)),
        }
    }

    /// Tells an arm how to behave.
    ///
    /// # Errors
    /// When the board refuses.
    fn behave(&mut self, settings: ArmSettings) -> Result<(), BoardError> {
        self.ask("behave like that", Request::Impedance(settings))
    }

    /// Tells an arm where its tool should be, and its elbow.
    ///
    /// # Errors
    /// When the board refuses.
    fn aim(&mut self, point: PosePoint, elbow: ElbowPoint) -> Result<(), BoardError> {
        self.ask("move its tool", Request::SetPoint(SetPoint::Pose { point, elbow }))
    }

    /// The arm and its tool.
    ///
    /// # Errors
    /// When the board refuses.
    fn read_arm(&mut self) -> Result<ArmTelemetry, BoardError> {
        match self.request(Request::ReadArm)? {
            Reply::Arm(arm) => Ok(arm),
            Reply::Refused(refusal) => Err(BoardError::Refused { action: "tell of its tool", refusal }),
            reply => Err(wrong("tell of its tool", &reply)),
        }
    }

    /// Tells the board that the supervisor lives; nothing else changes.
    ///
    /// # Errors
    /// When the board refuses.
    fn keep(&mut self) -> Result<(), BoardError> {
        self.ask("go on", Request::SetPoint(SetPoint::Keep))
    }

    /// What the node and the board say of themselves.
    ///
    /// # Errors
    /// When the board refuses.
    fn status(&mut self) -> Result<Status, BoardError> {
        match self.request(Request::ReadStatus)? {
            Reply::Status(status) => Ok(status),
            Reply::Refused(refusal) => Err(BoardError::Refused { action: "tell its status", refusal }),
            reply => Err(wrong("tell its status", &reply)),
        }
    }

    /// The faults since power-on.
    ///
    /// # Errors
    /// When the board refuses.
    fn faults(&mut self) -> Result<FaultLog, BoardError> {
        match self.request(Request::ReadFaults)? {
            Reply::Faults(log) => Ok(log),
            Reply::Refused(refusal) => Err(BoardError::Refused { action: "tell its faults", refusal }),
            reply => Err(wrong("tell its faults", &reply)),
        }
    }
}

fn joints(values: &[f32]) -> Result<heapless::Vec<f32, MAX_JOINTS>, BoardError> {
    heapless::Vec::from_slice(values).map_err(|_| BoardError::TooManyJoints(values.len()))
}

fn wrong(action: &'static str, reply: &Reply) -> BoardError {
    BoardError::WrongReply { action, reply: format!("{reply:?}") }
}
