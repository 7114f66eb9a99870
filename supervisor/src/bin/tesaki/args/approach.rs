//! Arguments of `tesaki approach`.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use tesaki_supervisor::port::Address;

const HELP: &str = "\
The circles come from `tesaki look`, or from a program of your own: a line of JSON for each picture,
  {\"picture\": 17, \"age\": 0.065, \"circle\": {\"center\": [120.5, 118.0], \"radius\": 24.1}}
with the time since its exposure [s], and the rose in it [px], or null. docs/visual-approach.md says
all of it.

Examples:
  tesaki approach --robot robots/knob-arm --from unix:///tmp/circles
  tesaki approach --robot robots/knob-arm --from tcp://localhost:7800 --hold
  tesaki approach --robot robots/knob-arm --resume     # after it was killed
  detector | tesaki approach --robot robots/knob-arm --from -";

#[derive(Args)]
#[command(after_help = HELP)]
pub struct Approach {
    /// Robot folder, with approach.toml and hand_eye.toml
    #[arg(long, env = "TESAKI_ROBOT")]
    pub robot: PathBuf,
    /// Where the circles come from: unix://PATH or tcp://localhost:PORT to listen at, or - for standard input
    #[arg(long, value_name = "SOURCE", default_value = "tcp://localhost:7800", allow_hyphen_values = true)]
    pub from: SightSource,
    /// Resume after this program was killed and the arm stopped: clears a command timeout, but no other
    /// fault, and enables the arm at once
    #[arg(long)]
    pub resume: bool,
    #[command(flatten)]
    pub stay: super::Stay,
}

/// Source of circles.
#[derive(Clone, Debug, PartialEq)]
pub enum SightSource {
    StandardInput,
    /// Where programs connect.
    Listen(Address),
}

impl FromStr for SightSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            _ if text == "-" => Ok(Self::StandardInput),
            Ok(address @ (Address::Unix(_) | Address::Tcp(_))) => Ok(Self::Listen(address)),
            _ => Err(format!("{text:?} is not a source: expected -, unix://PATH or tcp://localhost:PORT")),
        }
    }
}
