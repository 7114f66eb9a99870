//! Examples at the end of the help of each command.

pub const INFO: &str = "\
Examples:
  tesaki info                                   # the only board there is
  tesaki --port /dev/ttyUSB0 info
  tesaki --json info";

pub const DOCTOR: &str = "\
Examples:
  tesaki doctor
  tesaki doctor --robot robots/hand3            # also: is this the model on the board?";

pub const MONITOR: &str = "\
Examples:
  tesaki monitor                                # space stops the robot, q quits
  tesaki --json monitor                         # a line for each telemetry, 25 in a second";

pub const VIEW: &str = "\
Examples:
  tesaki view                                   # then open http://localhost:7480
  tesaki view --robot robots/hand3              # with what its URDF draws, and its grasps
  tesaki --port tcp://robot:7400 --key lab.key view    # of a board on another machine

A page only looks until it takes command. One page commands at a time; every page can stop it.
The robot is stopped when the page that commands it goes away.";

pub const ENABLE: &str = "\
Examples:
  tesaki enable                                 # until Ctrl-C
  tesaki enable --duration 5 --servo pid";

pub const MOVE: &str = "\
Examples:
  tesaki move finger1_swing=0.3                 # rad
  tesaki move --degrees finger1_swing=20 finger2_bend=30
  tesaki move --relative finger1_curl=-0.1
  tesaki move --no-hold elbow=0.5               # an arm falls after arrival: support it";

pub const REACH: &str = "\
Examples:
  tesaki reach finger1_tip=0.09,0.04,0.1        # m, in the base frame
  tesaki reach --relative --speed 0.02 finger1_tip=0.01,0,0.01";

pub const HOME: &str = "\
Examples:
  tesaki home finger1_swing=0 finger1_bend=0.33 finger1_curl=0.68   # each joint of a finger
  tesaki home --degrees finger1_swing=20 --others 0                 # if all others stand at 0 now";

pub const READ: &str = "\
Examples:
  tesaki read                                   # angles, tips and forces
  tesaki read model                             # all parameters
  tesaki read safety
  tesaki read 'joints.*.limits.velocity'";

pub const SET: &str = "\
Examples:
  tesaki set safety.reaction damp
  tesaki set 'joints.*.limits.velocity' 4.5     # of every joint
  tesaki set 'joints.*.limits.torque' 30%       # of the present value

The model is pushed again with the change. Homed joints stay homed, unless a parameter of their
encoders changes; force sensors must be tared anew. The limits of angles may only be narrowed.";

pub const PUSH: &str = "\
Examples:
  tesaki model push robots/hand3
  tesaki model push robots/hand3 --chain finger1_tip
  tesaki model push robots/hand3 --calibration calibration.toml";

pub const CHECK: &str = "\
Examples:
  tesaki model check robots/hand3
  tesaki model check robot.urdf                 # a URDF alone";

pub const KINEMATICS: &str = "\
Examples:
  tesaki eval fk --robot robots/hand3 --in angles.csv
  tesaki eval jacobian --robot robot.urdf --tip tool --in - --out jacobians.csv
  tesaki eval ik --robot robots/arm7 --in targets.csv --out angles.csv";

pub const FAULTS: &str = "\
Examples:
  tesaki faults
  tesaki faults --clear                         # leaves the fault mode; the board is disabled then";

pub const RECORD: &str = "\
Examples:
  tesaki record grip                            # grip.log and grip.mcap, until Ctrl-C
  tesaki record grip --force --duration 10 --robot robots/hand3";

pub const REPLAY: &str = "\
Examples:
  tesaki replay grip.log";

pub const SHARE: &str = "\
Examples:
  tesaki --port /dev/ttyUSB0 share              # at localhost:7400, for programs of this machine
  tesaki --port /dev/ttyUSB0 share unix:///tmp/hand
  tesaki --port unix:///tmp/hand monitor        # in another terminal
  tesaki --key lab.key share tcp://0.0.0.0:7400 # for other machines that have lab.key
  tesaki --key lab.key --port tcp://robot:7400 monitor   # on such a machine
  tesaki share foxglove://localhost:8765 --robot robots/hand3   # for Foxglove";

pub const ROS2: &str = "\
Examples:
  tesaki ros2 --robot robots/hand3              # in a checkout: cargo ros2 ...";

pub const KEY: &str = "\
Examples:
  tesaki key lab.key                            # copy it to the other machines, and keep it secret
  tesaki --key lab.key share tcp://0.0.0.0:7400";

pub const IMPEDANCE: &str = "\
Examples:
  tesaki impedance hold robots/arm7/impedances/soft.toml
  tesaki impedance hold robots/arm7/impedances/firm.toml --duration 10";

pub const COMPLETIONS: &str = "\
Examples:
  tesaki completions bash > ~/.local/share/bash-completion/completions/tesaki";

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use clap::{Command, CommandFactory, Parser};

    use crate::args::Cli;

    /// Commands that need no example: nothing can be added to them.
    const PLAIN: [&str; 7] = ["list", "disable", "stop", "tare", "show", "status", "help"];

    fn check(command: &Command, examples: &mut u32) {
        for inner in command.get_subcommands() {
            check(inner, examples);
        }
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let lines: Vec<&str> = help.lines().filter(|line| line.starts_with("  tesaki ")).collect();
        let name = command.get_name();
        let is_table = ["grip", "rnea", "mass", "bias"].contains(&name);
        assert!(
            command.has_subcommands() || is_table || PLAIN.contains(&name) || !lines.is_empty(),
            "{name} has no example"
        );
        for line in lines {
            let words = line.split(['#', '>']).next().unwrap().split_whitespace();
            if let Err(error) = Cli::try_parse_from(words) {
                panic!("{line}: {error}");
            }
            *examples += 1;
        }
        // Longer ones are wrapped anywhere.
        for line in help.lines() {
            assert!(line.chars().count() <= 100, "help of {name}: {line}");
        }
    }

    #[test]
    fn every_command_has_examples_that_it_understands() {
        let mut examples = 0;
        check(&Cli::command(), &mut examples);
        assert!(examples > 30, "only {examples} examples");
    }
}
