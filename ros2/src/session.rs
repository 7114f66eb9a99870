//! The connection to the board.

use std::io;
use std::path::PathBuf;
use std::time::Duration;

use tesaki::fault::Fault;
use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Refusal, Request};
use tesaki_description::robot::RobotFolder;
use tesaki_description::{FileError, read_text};
use tesaki_recording::McapError;
use tesaki_supervisor::faults;
use tesaki_supervisor::port::{Key, PortError, Reopening};
use tesaki_supervisor::publication::OtherRobot;
use tesaki_supervisor::{Board as _, BoardError, LinkBoard, output_queue, troubleshooting, words};

use crate::args::Options;
use crate::dds::DdsError;

/// Why the program ends.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    #[error("{0}")]
    Usage(String),
    #[error(transparent)]
    Port(#[from] PortError),
    #[error(transparent)]
    Board(#[from] BoardError),
    #[error(transparent)]
    OtherRobot(#[from] OtherRobot),
    #[error(transparent)]
    Robot(#[from] FileError),
    #[error("{path}: {1}", path = .0.display())]
    File(PathBuf, io::Error),
    #[error(transparent)]
    Dds(#[from] DdsError),
    #[error(transparent)]
    Encoding(#[from] McapError),
    #[error("{0}")]
    Other(String),
}

impl Failure {
    /// Returns the exit code, the same as that of `tesaki`.
    pub const fn number(&self) -> u8 {
        match self {
            Self::Usage(_) | Self::OtherRobot(_) => 2,
            Self::Board(error) => error.exit_code(),
            Self::Port(_) => 3,
            Self::Robot(_) | Self::File(..) | Self::Dds(_) | Self::Encoding(_) | Self::Other(_) => 1,
        }
    }
}

/// A board that has answered the greeting.
pub struct Session {
    pub board: LinkBoard<Reopening>,
    /// The address of its port.
    pub port: String,
    timeout: Duration,
    take_over: bool,
    commands: bool,
}

impl Session {
    /// Opens the port and greets the board.
    pub fn open(options: &Options) -> Result<Self, Failure> {
        let key = Key::for_addresses(options.key.as_deref(), &[&options.port])
            .map_err(|error| Failure::File(options.key.clone().unwrap_or_default(), error))?;
        let link = Reopening::open(options.port.clone(), key)?;
        let port = link.port().map_or_else(String::new, |port| port.address().to_string());
        let mut board = LinkBoard::new(link, options.timeout);
        board.hello()?;
        Ok(Self { board, port, timeout: options.timeout, take_over: options.take_over, commands: false })
    }

    /// Takes command, unless it already has it.
    pub fn take_command(&mut self) -> Result<(), BoardError> {
        if !self.commands {
            self.board.take_command(self.take_over)?;
            self.commands = true;
        }
        Ok(())
    }

    /// Releases command. A board that does not answer forgets its commander by itself.
    pub fn release_command(&mut self) {
        if std::mem::take(&mut self.commands) {
            let _ = self.board.ask("release command", Request::ReleaseCommand);
        }
    }

    /// Notes that this program no longer has command.
    pub const fn lose_command(&mut self) {
        self.commands = false;
    }

    /// Sets the time that the board has for an answer to `patience`, at most to what the user allows.
    pub fn set_patience(&mut self, patience: Option<Duration>) {
        self.board.set_timeout(patience.map_or(self.timeout, |patience| patience.min(self.timeout)));
    }
}

/// Reads the robot folder of the options, with its URDF.
pub fn robot_folder(options: &Options) -> Result<Option<(RobotFolder, String)>, Failure> {
    let Some(path) = &options.robot else { return Ok(None) };
    let folder = RobotFolder::load(path)?;
    let urdf = path.join("robot.urdf");
    let text = read_text(&urdf).map_err(|error| Failure::File(urdf, error))?;
    Ok(Some((folder, text)))
}

/// Describes an error of the board, with the joint's name, what to do about it, and where it is explained.
pub fn words(error: &BoardError, model: Option<&RobotModel>, options: &Options) -> String {
    let text = error.to_string();
    let BoardError::Refused { refusal, .. } = error else { return text };
    let service = |name: &str| options.full_name(&format!("tesaki/{name}"));
    let hint = match refusal {
        Refusal::Commanded { .. } if options.take_over => format!(" (call {} first)", service("disable")),
        Refusal::Commanded { .. } => " (a --take-over when this program is started takes command)".to_owned(),
        Refusal::FaultsUnread { .. } => format!(" ({} does both)", service("clear_faults")),
        Refusal::WrongMode(Mode::Fault) => format!(" ({} ends the fault)", service("clear_faults")),
        refusal => words::hint(refusal).to_owned(),
    };
    format!("{}{hint}. See {}", words::named(refusal, &text, model), troubleshooting::refusal(refusal))
}

/// Describes faults, the last one first, with the joints' names and where they are explained.
pub fn describe(faults: &[Fault], model: Option<&RobotModel>) -> String {
    if faults.is_empty() {
        return String::new();
    }
    format!("{}. See {}", faults::in_words(faults, model), faults::entries(faults))
}

/// Says that the faults are not known.
pub fn untold(error: &BoardError) -> String {
    format!("the board does not tell its fault: {error}")
}

/// Prints a line, without waiting for its reader. A failure to print it is ignored.
pub fn say(text: &str) {
    let _ = output_queue::send(output_queue::Stream::Error, format!("{text}\n"));
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    #[test]
    fn what_to_do_about_a_refusal_names_the_services_of_the_node() {
        let options = Options::parse_from(["tesaki-ros2", "--namespace", "left"]);
        let told = |refusal| words(&BoardError::Refused { action: "move", refusal }, None, &options);
        let fault = told(Refusal::WrongMode(Mode::Fault));
        assert!(fault.contains(" (/left/tesaki/clear_faults ends the fault). See "), "{fault}");
        let unread = told(Refusal::FaultsUnread { total: 2 });
        assert!(unread.contains(" (/left/tesaki/clear_faults does both). See "), "{unread}");
    }

    #[test]
    fn the_exit_codes_are_those_of_tesaki() {
        let number = |error| Failure::Board(error).number();
        let refused = BoardError::Refused { action: "move", refusal: Refusal::NoModel };
        assert_eq!(number(BoardError::Reset), 1);
        assert_eq!(number(BoardError::TooManyJoints(40)), 2);
        assert_eq!(number(BoardError::Link(io::Error::other("gone"))), 3);
        assert_eq!(number(BoardError::SchemaMismatch { board: 1, here: 2, firmware: [0, 1, 0] }), 4);
        assert_eq!(number(BoardError::Timeout { seconds: 2.0 }), 6);
        assert_eq!(number(refused), 7);
        assert_eq!(number(BoardError::ExportDisturbed), 1);
        assert_eq!(Failure::Usage(String::new()).number(), 2);
        assert_eq!(Failure::Dds(DdsError::Ended).number(), 1);
    }
}
