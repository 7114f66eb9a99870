//! Arguments of `tesaki retarget`.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::{seconds, udp};

const HELP: &str = "\
The source is told by what it contains. As JSON, one object a line, each with \"time\" [s] and
  \"landmarks\": [[x,y,z], … 21] and \"handedness\": \"Left\" or \"Right\"; world landmarks of a webcam
                tracker [m] in the order of MediaPipe; null while it sees no hand
  \"tips\":      {\"thumb\": [x,y,z], … \"little\": …}; fingertips in the hand's frame [m]
  \"back\", \"thumb\", … \"little\": a glove as in `tesaki calibrate`; needs --operator
As CSV, not live: time and thumb_x … little_z [m], or back_qx … little3_qw. Leave empty or null what
was not measured. The hand's frame: origin at the wrist, z along the fingers, x out of the palm.

Examples:
  tesaki retarget --robot robots/hand5 --in tips.csv --out joints.csv
  tesaki retarget --robot robots/hand5 --in glove.jsonl --operator aiko.toml --out joints.csv
  glove | tesaki retarget --live --operator aiko.toml
  tesaki retarget --live --udp 7500 --robot robots/hand5";

#[derive(Args)]
#[command(after_help = HELP)]
pub struct Retarget {
    /// Robot folder; live it is needed for its retargeting.toml alone
    #[arg(long, env = "TESAKI_ROBOT", value_name = "DIR", required_unless_present = "live")]
    pub robot: Option<PathBuf>,
    /// Frames of the operator's hand, JSON lines or CSV; - reads standard input
    #[arg(long = "in", value_name = "FILE", required_unless_present = "live", conflicts_with = "live")]
    pub input: Option<PathBuf>,
    /// CSV file for the joint angles [rad]: time and each joint with a motor by name; - writes to standard
    /// output
    #[arg(long = "out", value_name = "CSV", default_value = "-", conflicts_with = "live")]
    pub output: PathBuf,
    /// Lead the hand on the board by JSON lines from standard input, until Ctrl-C or their end
    #[arg(long)]
    pub live: bool,
    /// Receive the lines as datagrams at this port of this machine instead
    #[arg(long, value_name = "PORT", requires = "live", value_parser = udp_address)]
    pub udp: Option<SocketAddr>,
    /// Calibration of the operator who wears the glove, as written by `tesaki calibrate`
    #[arg(long, value_name = "FILE")]
    pub operator: Option<PathBuf>,
    /// Bandwidth of the filter of orientations or positions [Hz], 0.5 to 20
    #[arg(long, value_name = "HZ", default_value = "5", value_parser = bandwidth, allow_negative_numbers = true)]
    pub bandwidth: f32,
    /// End if the source is silent for this time [s]
    #[arg(long, value_name = "S", default_value = "5", requires = "live", value_parser = seconds, allow_negative_numbers = true)]
    pub silence: Duration,
    /// At the end, hold until Ctrl-C before disabling the outputs; the default where gravity pulls a joint
    /// with more than its friction
    #[arg(long, requires = "live")]
    pub hold: bool,
    /// At the end, disable the outputs at once, even if the robot falls
    #[arg(long, requires = "live", conflicts_with = "hold")]
    pub no_hold: bool,
}

fn udp_address(text: &str) -> Result<SocketAddr, String> {
    let address = text.parse::<u16>().map_or_else(|_| text.to_owned(), |port| format!("127.0.0.1:{port}"));
    udp::local(text, &address, "PORT or 127.0.0.1:PORT, for example 7500")
}

fn bandwidth(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if (0.5..=20.0).contains(&value) => Ok(value),
        _ => Err(format!("{text:?}: expected 0.5 to 20 Hz")),
    }
}
