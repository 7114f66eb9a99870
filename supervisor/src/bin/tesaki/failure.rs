//! Why a command came to nothing, and the exit code that says so to scripts.

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Refusal};
use tesaki_description::calibration::CalibrationError;
use tesaki_description::grasp::GraspFileError;
use tesaki_description::impedance::ImpedanceFileError;
use tesaki_description::robot::RobotError;
use tesaki_description::urdf::UrdfError;
use tesaki::robot::Concerns;
use tesaki::task::TaskRefusal;
use tesaki::task::grasping::GraspRefusal;
use tesaki::task::impedance::ImpedanceRefusal;
use tesaki_supervisor::BoardError;
use tesaki_supervisor::identify::IdentifyError;
use tesaki_supervisor::port::PortError;

/// Why a command came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The command line makes no sense for this robot.
    #[error("{0}")]
    Usage(String),
    /// There is no board, or its port cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The board refused, does not answer, or is another one.
    #[error("{0}{hint}", hint = hint(.0))]
    Board(#[from] BoardError),
    /// The board refused because of a joint that we know by name.
    #[error("{0}")]
    Refused(String),
    /// The board has no model yet.
    #[error("the board has no robot model: send one with `tesaki model push robots/NAME`")]
    NoModel,
    /// The board is in fault.
    #[error(
        "the board is in fault: {0}\nRead the faults and clear them with `tesaki faults --clear`, then try again"
    )]
    Fault(String),
    /// Something took too long.
    #[error("{0}")]
    Late(String),
    /// A robot folder.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// A file that says how to grasp.
    #[error(transparent)]
    GraspFile(#[from] GraspFileError),
    /// A file that says how an arm is to yield.
    #[error(transparent)]
    ImpedanceFile(#[from] ImpedanceFileError),
    /// A file with values of a machine.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The hand could not be identified.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// The hand did not take hold of the object, or could not go on with it.
    #[error("{0}")]
    Grasp(String),
    /// A URDF.
    #[error(transparent)]
    Urdf(#[from] UrdfError),
    /// A file.
    #[error("{path}: {source}", path = path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Anything else.
    #[error("{0}")]
    Other(String),
    /// The reader of our output has gone, which is its right.
    #[error("nobody reads the output")]
    Pipe,
}

/// What to do about a refusal, in terms of this program.
fn hint(error: &BoardError) -> &'static str {
    match error {
        BoardError::Refused { refusal: Refusal::Commanded { .. }, .. } => " (with --take-over)",
        BoardError::Refused { refusal: Refusal::NotHomed { .. }, .. } => {
            " (`tesaki home JOINT=ANGLE … --others 0`)"
        }
        BoardError::Refused {
            refusal:
                Refusal::Task(
                    TaskRefusal::Grasping(GraspRefusal::NotTared { .. })
                    | TaskRefusal::Impedance(ImpedanceRefusal::NotTared { .. }),
                ),
            ..
        } => " (`tesaki tare`)",
        BoardError::Refused {
            refusal: Refusal::FaultsUnread { .. } | Refusal::WrongMode(Mode::Fault),
            ..
        } => " (`tesaki faults --clear` does both)",
        _ => "",
    }
}

impl Failure {
    /// The number for scripts: see the help.
    pub const fn number(&self) -> u8 {
        match self {
            Self::Robot(_)
            | Self::Urdf(_)
            | Self::GraspFile(_)
            | Self::ImpedanceFile(_)
            | Self::Calibration(_)
            | Self::File { .. }
            | Self::Other(_) => 1,
            Self::Usage(_)
            | Self::Board(BoardError::TooManyJoints(_))
            | Self::Identify(IdentifyError::NotAHand { .. } | IdentifyError::NoRoom { .. }) => 2,
            Self::Port(_) | Self::Board(BoardError::Link(_)) => 3,
            Self::Board(BoardError::SchemaMismatch { .. }) => 4,
            Self::Fault(_) => 5,
            Self::Identify(IdentifyError::Stopped(_)) => 6,
            Self::Late(_) | Self::Board(BoardError::Timeout { .. }) => 6,
            Self::Board(_) | Self::Refused(_) | Self::NoModel => 7,
            Self::Grasp(_)
            | Self::Identify(IdentifyError::Grasp { .. } | IdentifyError::TooFewGrips { .. }) => 8,
            Self::Pipe => 0,
        }
    }

    /// [`Failure::number`] for the system.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(self.number())
    }

    /// The same, with the joint's name instead of its number.
    pub fn named(self, model: &RobotModel) -> Self {
        match &self {
            Self::Board(BoardError::Refused { refusal, .. }) => {
                let chain =
                    refusal.chain().and_then(|chain| Some((chain, model.chains.get(usize::from(chain))?)));
                let named = |number: String, name: &str| self.to_string().replacen(&number, name, 1);
                match (refusal.joint(), chain) {
                    (Some(joint), _) => {
                        Self::Refused(named(format!("joint {joint}"), model.joint_name(usize::from(joint))))
                    }
                    (_, Some((chain, tip))) => Self::Refused(named(format!("chain {chain}"), &tip.name)),
                    _ => self,
                }
            }
            _ => self,
        }
    }

    /// For files.
    pub fn file(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }
}
