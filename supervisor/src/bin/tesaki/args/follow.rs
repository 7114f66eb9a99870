//! Arguments of `tesaki follow`.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use clap::{Args, ValueEnum};
use tesaki::teleop::Workspace;
use tesaki_supervisor::port::Address;

use super::{seconds, udp};

const HELP: &str = "\
A line of the source is a JSON object:
  {\"time\": s, \"position\": [x,y,z], \"quaternion\": [x,y,z,w], \"elbow\": rad, \"clutch\": true}
position [m] and quaternion in axes parallel to those of the arm's base, from any origin; elbow and
clutch may be left out. {\"clutch\": false} alone opens the clutch. With another source than standard
input, the lines `closed` and `open` on standard input close and open the clutch.
Columns of a file: time,x,y,z,qx,qy,qz,qw and, if measured, elbow (rad) and clutch (1 or 0).

Examples:
  tracker | tesaki follow --impedance robots/arm7/impedances/firm.toml
  tesaki follow --impedance robots/arm7/impedances/firm.toml --from udp://127.0.0.1:7600 --scale 0.5
  tesaki follow --impedance firm.toml --from board:unix:///run/master --clutch open
  tesaki follow --impedance soft.toml --from board:tcp://localhost:7401 --reflect handle.toml
  tesaki follow --impedance firm.toml --from file:hand.csv --workspace 0.2,0.5,-0.2,0.2,-0.5,-0.1";

#[derive(Args)]
#[command(after_help = HELP)]
pub struct Follow {
    /// Impedance file of the arm, for example robots/arm7/impedances/firm.toml
    #[arg(long, value_name = "FILE")]
    pub impedance: PathBuf,
    /// Source of the poses: - for standard input, udp://127.0.0.1:PORT, board:ADDRESS of another board, or
    /// file:FILE.csv
    #[arg(long, value_name = "SOURCE", default_value = "-", allow_hyphen_values = true)]
    pub from: PoseSource,
    /// The clutch at the beginning; closed: as soon as the source gives poses
    #[arg(long, value_enum, value_name = "STATE", default_value_t = State::Closed)]
    pub clutch: State,
    /// Displacement of the tool per displacement of the hand
    #[arg(long, value_name = "S", default_value_t = 1.0, allow_negative_numbers = true)]
    pub scale: f32,
    /// Box in the arm's base frame that the set-point does not leave [m]
    #[arg(long, value_name = "X0,X1,Y0,Y1,Z0,Z1", value_parser = workspace, allow_hyphen_values = true)]
    pub workspace: Option<Workspace>,
    /// Whether the tool turns with the hand
    #[arg(long, value_enum, value_name = "ON", default_value_t = Switch::On)]
    pub rotation: Switch,
    /// Let the master feel the force on the tool: enable it with this impedance file, for example
    /// robots/arm7/impedances/handle.toml; with --from board:ADDRESS
    #[arg(long, value_name = "FILE")]
    pub reflect: Option<PathBuf>,
    /// Time there and back on the links of master and slave together for --reflect [s], in place of the one
    /// measured at the start: with links whose delay varies, the longest. If the links delay more than the
    /// damping of the handle allows, the command is refused
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true, requires = "reflect")]
    pub round_trip: Option<Duration>,
    /// End after this time [s]; without it, at Ctrl-C or with the source
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<Duration>,
    /// End if the source is silent for this time after its first sample [s]
    #[arg(long, value_name = "S", default_value = "5", value_parser = seconds, allow_negative_numbers = true)]
    pub silence: Duration,
    #[command(flatten)]
    pub stay: super::Stay,
}

/// State of the clutch.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum State {
    Closed,
    Open,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    On,
    Off,
}

/// Source of the poses.
#[derive(Clone, PartialEq)]
pub enum PoseSource {
    /// Lines of standard input.
    StandardInput,
    /// Lines of datagrams at a port of this machine.
    Udp(SocketAddr),
    /// The tip of another board's robot.
    Board(Address),
    /// A table.
    File(PathBuf),
}

impl FromStr for PoseSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "-" {
            return Ok(Self::StandardInput);
        }
        match text.split_once(':') {
            Some(("udp", address)) => {
                let expected = "udp://127.0.0.1:PORT, for example udp://127.0.0.1:7600";
                udp::local(text, address.trim_start_matches("//"), expected).map(Self::Udp)
            }
            Some(("board", address)) => address.parse().map(Self::Board).map_err(|error| format!("{error}")),
            Some(("file", path)) if !path.is_empty() => Ok(Self::File(path.into())),
            _ => Err(format!(
                "{text:?} is not a source: expected -, udp://127.0.0.1:PORT, board:ADDRESS or file:FILE.csv"
            )),
        }
    }
}

fn workspace(text: &str) -> Result<Workspace, String> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x0, x1, y0, y1, z0, z1]) => Ok(Workspace { lower: [x0, y0, z0], upper: [x1, y1, z1] }),
        _ => Err(format!(
            "{text:?} is not a box: expected X0,X1,Y0,Y1,Z0,Z1 in m, for example 0.2,0.5,-0.2,0.2,0,0.4"
        )),
    }
}
