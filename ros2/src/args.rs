//! The command line.

use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Parser;
use clap::builder::FalseyValueParser;
use tesaki_supervisor::port::Address;

use crate::controller::Defaults;

const EXAMPLES: &str = "\
Examples:
  tesaki-ros2 --robot robots/hand3
  tesaki-ros2 --robot robots/arm7 --namespace left --port /dev/ttyUSB0
  ROS_DOMAIN_ID=7 tesaki-ros2

Exit codes: those of `tesaki`. docs/ros2.md says what a ROS 2 program finds.";

/// A tesaki board as a ROS 2 node: joint states, frames, wrenches, a trajectory controller. Needs no ROS
#[derive(Parser)]
#[command(name = "tesaki-ros2", version, after_help = EXAMPLES)]
pub struct Options {
    /// Where the board is: auto, a serial port such as /dev/ttyUSB0, unix://PATH or tcp://HOST:PORT
    #[arg(long, short, env = "TESAKI_PORT", default_value = "auto")]
    pub port: Address,
    /// Key file for tcp://HOST:PORT, the same as at the other end; `tesaki key FILE` makes one
    #[arg(long, env = "TESAKI_KEY", value_name = "FILE")]
    pub key: Option<PathBuf>,
    /// Time to wait for an answer of the board [s]
    #[arg(long, env = "TESAKI_TIMEOUT", default_value = "2", value_parser = seconds)]
    #[arg(allow_negative_numbers = true)]
    pub timeout: Duration,
    /// Take command even if another program holds it; refused while the board is enabled
    #[arg(long, env = "TESAKI_TAKE_OVER", value_parser = FalseyValueParser::new())]
    pub take_over: bool,
    /// Robot folder of the board's model: its URDF for /robot_description, and the names of its links
    #[arg(long, env = "TESAKI_ROBOT", value_name = "DIR")]
    pub robot: Option<PathBuf>,
    /// DDS domain
    #[arg(long, env = "ROS_DOMAIN_ID", default_value = "0")]
    #[arg(value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: u16,
    /// Namespace of all names but /tf, /tf_static, /diagnostics and /rosout
    #[arg(long, default_value = "", value_parser = namespace, hide_default_value = true)]
    pub namespace: String,
    /// Name of the controller, whose action is NAME/follow_joint_trajectory
    #[arg(long, value_name = "NAME", default_value = "joint_trajectory_controller", value_parser = name)]
    pub controller: String,
    /// Distance from its goal at which a joint has arrived, where a goal does not say [rad]
    #[arg(long, value_name = "ANGLE", default_value = "0.01", value_parser = positive)]
    #[arg(allow_negative_numbers = true)]
    pub goal_tolerance: f64,
    /// Time after the last point in which all joints must have arrived, where a goal does not say [s]
    #[arg(long, value_name = "TIME", default_value = "2", value_parser = positive)]
    #[arg(allow_negative_numbers = true)]
    pub goal_time: f64,
    /// Do not publish /tf and /tf_static, because a robot_state_publisher does
    #[arg(long)]
    pub no_tf: bool,
    /// Open DDS to the networks of this machine, and announce it at this address of one of its interfaces:
    /// everybody there may command the board. Without it, only programs of this machine do
    #[arg(long, value_name = "ADDRESS")]
    pub network: Option<Ipv4Addr>,
}

impl Options {
    /// Returns what applies where a goal states nothing.
    pub const fn defaults(&self) -> Defaults {
        Defaults { tolerance: self.goal_tolerance, time: self.goal_time }
    }

    /// Returns a name of this node in its namespace, such as `/tesaki/enable`.
    pub fn full_name(&self, name: &str) -> String {
        format!("{}/{}", self.namespace, name.trim_start_matches('/'))
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    positive(text).map(Duration::from_secs_f64)
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number <= 1e6 => Ok(number),
        _ => Err(format!("{text}: expected a number above 0, at most 1000000")),
    }
}

/// Parses a name of ROS 2, without slashes.
fn name(text: &str) -> Result<String, String> {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if !text.is_empty() && text.chars().all(is_word) && !text.starts_with(|c: char| c.is_ascii_digit()) {
        Ok(text.to_owned())
    } else {
        Err(format!("{text:?}: a name in ROS 2 has letters, digits and _, and does not begin with a digit"))
    }
}

/// Parses a namespace, such as `/a/b`; empty for the root.
fn namespace(text: &str) -> Result<String, String> {
    let names = text.trim_matches('/');
    if names.is_empty() {
        return Ok(String::new());
    }
    let names = names.split('/').map(name).collect::<Result<Vec<_>, _>>()?;
    Ok(format!("/{}", names.join("/")))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn names_are_put_into_the_namespace() {
        let options = |namespace: &str| Options::parse_from(["tesaki-ros2", "--namespace", namespace]);
        assert_eq!(options("").full_name("/joint_states"), "/joint_states");
        assert_eq!(options("left").full_name("tesaki/enable"), "/left/tesaki/enable");
        assert_eq!(options("/a/b/").full_name("/joint_states"), "/a/b/joint_states");
        for wrong in ["a//b", "7up", "a-b"] {
            assert!(Options::try_parse_from(["tesaki-ros2", "--namespace", wrong]).is_err(), "{wrong}");
        }
    }
}
