//! The ways in which a command fails, with an exit code for scripts.

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use tesaki::model::RobotModel;
use tesaki::robot::Concerns;
use tesaki_description::FileError;
use tesaki_description::calibration::CalibrationError;
use tesaki_description::urdf::UrdfError;
use tesaki_supervisor::BoardError;
use tesaki_supervisor::identify::IdentifyError;
use tesaki_supervisor::port::{Address, PortError};
use tesaki_supervisor::publication::OtherRobot;
use tesaki_supervisor::{troubleshooting, words};

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The arguments are invalid for this robot.
    #[error("{0}")]
    Usage(String),
    /// No board was found, or its port cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The board refused, does not answer, or uses another version of the protocol.
    #[error("{0}{hint}", hint = hint(.0))]
    Board(#[from] BoardError),
    /// The board does not answer at a socket, whose program may know why.
    #[error(
        "{error}\n{socket} leads to the board through another program, such as `tesaki share`: its terminal says \
         whether the board is away, and why"
    )]
    Behind {
        /// What is told of the board.
        error: BoardError,
        /// The address of the socket.
        socket: Address,
    },
    /// The board refused; joint and chain are given by name.
    #[error("{0}")]
    Refused(String),
    /// The board has no model yet.
    #[error("the board has no robot model: push one with `tesaki model push ROBOT_FOLDER`")]
    NoModel,
    /// The board is in fault: description, and the reference to the document.
    #[error("the board is in fault: {0}\n`tesaki faults --clear` shows and clears the faults")]
    Fault(String),
    /// After the failure the board could not be disabled either, which is the second one.
    #[error("{0}\n{still_on}", still_on = words::still_on(.1))]
    StillOn(Box<Failure>, Box<Failure>),
    /// A failure told with commands for another port, and its exit code.
    #[error("{0}")]
    AtPort(String, u8),
    /// One board of two, by its port.
    #[error("{0}: {1}")]
    OtherBoard(String, Box<Failure>),
    /// A timeout.
    #[error("{0}")]
    Late(String),
    /// The folder of another robot.
    #[error(transparent)]
    OtherRobot(#[from] OtherRobot),
    /// An invalid file of a robot.
    #[error(transparent)]
    Description(#[from] FileError),
    /// A calibration that does not fit the robot.
    #[error("{path}: {source}; {advice}", path = path.display(), advice = calibration_advice(.source))]
    Calibration {
        /// The file.
        path: PathBuf,
        /// Why.
        source: CalibrationError,
    },
    /// The identification failed.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// The grasp failed.
    #[error("{0}\nSee {document}#a-grasp-that-fails", document = troubleshooting::DOCUMENT)]
    Grasp(String),
    /// An invalid URDF.
    #[error(transparent)]
    Urdf(#[from] UrdfError),
    /// A file cannot be read or written.
    #[error("{path}: {source}{hint}", path = path.display(), hint = file_hint(.source))]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Ctrl-C, or a request to terminate, before it was done: what became of the robot.
    #[error("interrupted: {0}")]
    Interrupted(String),
    /// Anything else.
    #[error("{0}")]
    Other(String),
    /// The reader of the output has paused for too long.
    #[error(
        "standard output was not read for too long, so the board was disabled: does the program that reads it hang?"
    )]
    Stalled,
    /// The reader of the output has closed it, which is no error.
    #[error("the output was closed")]
    Pipe,
    /// The same before a motion was done.
    #[error("the output was closed, so the board was disabled")]
    Unread,
}

/// How a command that helps begins.
const COMMAND: &str = "`tesaki ";

/// What to do about a refusal, in terms of this program.
fn hint(error: &BoardError) -> String {
    let BoardError::Refused { refusal, .. } = error else { return String::new() };
    format!("{}\nSee {}", words::hint(refusal), troubleshooting::refusal(refusal))
}

/// What to do about a file that cannot be read or written.
fn file_hint(error: &io::Error) -> &'static str {
    if error.kind() == io::ErrorKind::IsADirectory { "; name a file in it" } else { "" }
}

/// What to do about a calibration that does not fit the robot.
const fn calibration_advice(error: &CalibrationError) -> &'static str {
    match error {
        CalibrationError::Stranger { .. } => {
            "it is the calibration of another robot: give that of this one, or leave --calibration out"
        }
        CalibrationError::Model(_) => "correct it, or make the file anew with `tesaki identify`",
    }
}

impl Failure {
    /// The exit code, see the help.
    pub const fn number(&self) -> u8 {
        match self {
            Self::Description(_)
            | Self::Urdf(_)
            | Self::Calibration { .. }
            | Self::File { .. }
            | Self::Stalled
            | Self::Identify(
                IdentifyError::Model(_) | IdentifyError::Resisted { .. } | IdentifyError::Touched { .. },
            )
            | Self::Other(_) => 1,
            Self::Usage(_)
            | Self::OtherRobot(_)
            | Self::Identify(IdentifyError::NotAHand { .. } | IdentifyError::NoRoom { .. }) => 2,
            Self::Board(error) | Self::Behind { error, .. } => error.exit_code(),
            Self::Port(_) => 3,
            Self::Fault(_) => 5,
            Self::Late(_) | Self::Identify(IdentifyError::Stopped(_) | IdentifyError::Late { .. }) => 6,
            Self::Refused(_) | Self::NoModel => 7,
            Self::Grasp(_)
            | Self::Identify(IdentifyError::Grasp { .. } | IdentifyError::TooFewGrips { .. }) => 8,
            // What a shell says of a program that Ctrl-C has ended.
            Self::Interrupted(_) => 130,
            Self::AtPort(_, number) => *number,
            Self::OtherBoard(_, failure) | Self::StillOn(failure, _) => failure.number(),
            Self::Pipe => 0,
            // What a shell says of a program that a closed pipe has ended.
            Self::Unread => 141,
        }
    }

    /// [`Failure::number`] as an [`ExitCode`].
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(self.number())
    }

    /// The same failure with names of joints and chains instead of their numbers.
    pub fn named(self, model: &RobotModel) -> Self {
        match &self {
            Self::Board(BoardError::Refused { refusal, .. })
                if refusal.joint().is_some() || refusal.chain().is_some() =>
            {
                Self::Refused(words::named(refusal, &self.to_string(), Some(model)))
            }
            _ => self,
        }
    }

    /// The same failure of a board at a port: one that is silent behind a socket may be away from the program
    /// there.
    pub fn through(self, port: &Address) -> Self {
        match (self, port) {
            (Self::Board(error @ BoardError::Timeout { .. }), Address::Unix(_) | Address::Tcp(_)) => {
                Self::Behind { error, socket: port.clone() }
            }
            (failure, _) => failure,
        }
    }

    /// The same failure of a board that is not the one of `--port`: the commands that help name its port.
    pub fn at_port(self, port: &str) -> Self {
        // The command of `Behind` is for the computer of that port.
        let text = self.to_string();
        if matches!(self, Self::Behind { .. }) || !text.contains(COMMAND) {
            return self;
        }
        Self::AtPort(text.replace(COMMAND, &format!("{COMMAND}--port {port} ")), self.number())
    }

    /// A failure to write `path`.
    pub fn written(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |error| {
            let source = io::Error::new(error.kind(), format!("cannot be written: {error}"));
            Self::File { path, source }
        }
    }

    /// A failure to read or write `path`.
    pub fn file(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }
}

#[cfg(test)]
mod tests {
    use tesaki::fault::{Fault, FaultCause};
    use tesaki::protocol::Refusal;

    use super::*;

    /// The rows of the table in docs/supervisor.md, and a failure of each; 0 is that of a closed output.
    #[test]
    fn the_exit_codes_are_those_of_the_document() {
        let document = include_str!("../../../../docs/supervisor.md");
        let table = document.lines().skip_while(|line| !line.starts_with("| code |")).skip(2);
        let codes: Vec<u8> =
            table.map_while(|line| line.strip_prefix("| ")?.split(' ').next()?.parse().ok()).collect();
        let refused = BoardError::Refused { action: "move", refusal: Refusal::NoModel };
        let timeout = || Failure::Late("no telemetry".to_owned());
        let failures = [
            Failure::Pipe,
            Failure::Other("the recordings differ".to_owned()),
            Failure::Usage("no such joint".to_owned()),
            Failure::Board(BoardError::Link(io::Error::other("gone"))),
            Failure::Board(BoardError::SchemaMismatch { board: 1, here: 2, firmware: [0, 1, 0] }),
            Failure::Fault("stopped".to_owned()),
            timeout(),
            Failure::Board(refused),
            Failure::Grasp("dropped".to_owned()),
            Failure::Interrupted("disabled".to_owned()),
            Failure::Unread,
        ];
        let numbers: Vec<u8> = failures.iter().map(Failure::number).collect();
        assert_eq!(codes, numbers);
        // The failure of one board of many.
        assert_eq!(Failure::OtherBoard("b".to_owned(), Box::new(timeout())).number(), 6);
        // The first failure is what a script must know, and both what a person must.
        let both = Failure::StillOn(Box::new(Failure::Fault("a".to_owned())), Box::new(timeout()));
        assert_eq!(both.number(), 5);
        let text = both.to_string();
        assert!(
            text.contains("in fault: a") && text.contains("could not be disabled: no telemetry"),
            "{text}"
        );
        // Other failures of a board.
        let number = |error| Failure::Board(error).number();
        assert_eq!(number(BoardError::Reset), 1);
        assert_eq!(number(BoardError::TooManyJoints(40)), 2);
        assert_eq!(number(BoardError::Timeout { seconds: 2.0 }), 6);
        assert_eq!(number(BoardError::ExportDisturbed), 1);
    }

    #[test]
    fn commands_that_help_are_for_the_port_of_the_board() {
        for (failure, command, number) in [
            (Failure::NoModel, "`tesaki --port unix://m model push ROBOT_FOLDER`", 7),
            (Failure::Fault("stopped".to_owned()), "`tesaki --port unix://m faults --clear`", 5),
        ] {
            let failure = failure.at_port("unix://m");
            assert!(failure.to_string().contains(command), "{failure}");
            assert_eq!(failure.number(), number);
        }
        assert!(matches!(Failure::Pipe.at_port("unix://m"), Failure::Pipe));
    }

    #[test]
    fn a_robot_that_still_moves_is_to_be_waited_for() {
        let fault =
            Fault { cause: FaultCause::VelocityLimit, joint: Some(1), value: 3.0, limit: 1.0, tick: 7 };
        let refused = BoardError::Refused { action: "enable its outputs", refusal: Refusal::Unsafe(fault) };
        let text = Failure::from(refused).to_string();
        assert!(text.contains("at most at a fifth of its limit: wait until it rests"), "{text}");
    }
}
