//! The command line.

mod approach;
mod calibrate;
mod eval;
mod examples;
mod find_circle;
mod follow;
mod grasp;
mod identify;
mod impedance;
mod init;
mod look;
mod retarget;
mod udp;
mod view;

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

use clap::builder::FalseyValueParser;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::parser::ValueSource;
use clap::{Arg, Args, CommandFactory, FromArgMatches as _, Parser, Subcommand, ValueEnum};
use tesaki::control::ServoMode;
use tesaki_supervisor::fault_injector::LinkFaults;
use tesaki_supervisor::port::Address;

pub use approach::{Approach, SightSource};
pub use calibrate::{Calibrate, CalibrateCamera, CalibrateCommand};
pub use eval::{Eval, Grip, Kinematics};
pub use find_circle::FindCircle;
pub use follow::{Follow, PoseSource, State, Switch};
pub use grasp::{Grasp, Run, Step};
pub use identify::Identify;
pub use impedance::{Hold, Impedance};
pub use init::Init;
pub use look::{Look, PictureSource};
pub use retarget::Retarget;
pub use view::{Listen, View};

use crate::failure::Failure;
use crate::output;

const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  failed: unreadable file, invalid robot folder, differing or damaged recording, problem found by
     `doctor`, board that was reset meanwhile
  2  invalid arguments, or a file that exists and is not to be replaced
  3  no device found, or it cannot be opened
  4  the board and this program use different versions of the protocol
  5  the board is in fault
  6  no answer, or not in time
  7  the board refused the request, or the motors cannot hold the robot there; nothing changed
  8  a grasp failed, also one of `identify`, or `approach` does not hold the knob
130  interrupted by Ctrl-C before it was done
141  nobody read the output any more before it was done

No board? `cargo sim serve` starts a simulated one, which `--port auto` finds.";

/// Control a tesaki board from a PC
#[derive(Parser)]
#[command(name = "tesaki", version, about = "Control a tesaki board from a PC", after_help = EXIT_CODES, propagate_version = true)]
pub struct Cli {
    #[command(flatten, next_help_heading = "Options of every command")]
    pub options: Options,
    #[command(subcommand)]
    pub command: Command,
}

/// Options of every command.
#[derive(Args)]
pub struct Options {
    /// Where the board is: auto, a serial port such as /dev/ttyUSB0, unix://PATH or tcp://HOST:PORT
    #[arg(long, short, global = true, env = "TESAKI_PORT", default_value = "auto")]
    pub port: Address,
    /// Key file for tcp://HOST:PORT, the same as at the other end; `tesaki key FILE` makes one
    #[arg(long, global = true, env = "TESAKI_KEY", value_name = "FILE")]
    pub key: Option<PathBuf>,
    /// Time to wait for an answer [s]
    #[arg(long, global = true, env = "TESAKI_TIMEOUT", default_value = "2", value_parser = seconds, allow_negative_numbers = true)]
    pub timeout: Duration,
    /// Print JSON: a single value, or one per line while a command runs
    #[arg(long, global = true, env = "TESAKI_JSON", value_parser = FalseyValueParser::new())]
    pub json: bool,
    /// Do not ask for confirmation (never asked for without a terminal)
    #[arg(long, global = true, env = "TESAKI_NON_INTERACTIVE", value_parser = FalseyValueParser::new())]
    pub non_interactive: bool,
    /// Take command even if another program holds it; refused while the board is enabled
    #[arg(long, global = true, env = "TESAKI_TAKE_OVER", value_parser = FalseyValueParser::new())]
    pub take_over: bool,
    /// Inject faults into the link, for example seed=1,flip=1e-4,drop=1e-4 or all=1e-3
    #[arg(long, global = true, env = "TESAKI_LINK_FAULTS", value_name = "FAULTS")]
    pub link_faults: Option<LinkFaults>,
}

impl Cli {
    /// The command line of this process; ends it where that is wrong.
    pub fn read() -> Self {
        let mut command = without_empty_variables(Self::command());
        let read = command.try_get_matches_from_mut(std::env::args_os()).and_then(|matches| {
            let cli = Self::from_arg_matches(&matches)?;
            // In the environment it may be meant for other commands.
            let is_given = matches
                .subcommand_matches("share")
                .is_some_and(|share| share.value_source("robot") == Some(ValueSource::CommandLine));
            if let Command::Share { listen: Listen::Programs(address), .. } = &cli.command
                && is_given
            {
                let message = format!(
                    "--robot is for foxglove:// only: programs at {address} have their own, as in `tesaki view \
                     --robot DIR`. Leave it out, or share at foxglove://HOST:PORT"
                );
                return Err(Self::command().error(ErrorKind::ArgumentConflict, message));
            }
            Ok(cli)
        });
        read.unwrap_or_else(|error| {
            let error = naming_variable(&command, error);
            if error.use_stderr() && wants_json() {
                let text = error.to_string();
                let message = text.trim().trim_start_matches("error: ");
                output::json_failure(message, error.exit_code());
                let _ = output::flush(false);
                std::process::exit(error.exit_code());
            }
            error.exit()
        })
    }
}

/// Whether the output is to be JSON, by arguments that could not be read.
fn wants_json() -> bool {
    // What clap takes for false.
    let no = ["", "0", "n", "no", "f", "false", "off"];
    let is_set = |text: OsString| !no.iter().any(|no| text.eq_ignore_ascii_case(no));
    let mut words = std::env::args_os().take_while(|word| word != "--");
    words.any(|word| word == "--json") || std::env::var_os("TESAKI_JSON").is_some_and(is_set)
}

/// An environment variable that is empty is as good as none.
fn without_empty_variables(command: clap::Command) -> clap::Command {
    let unless_empty = |argument: Arg| {
        let value = argument.get_env().and_then(std::env::var_os);
        if value.is_some_and(|value| value.is_empty()) { argument.env(None::<&str>) } else { argument }
    };
    command.mut_args(unless_empty).mut_subcommands(without_empty_variables)
}

/// Adds to an error of a value that it comes from the environment.
fn naming_variable(command: &clap::Command, mut error: clap::Error) -> clap::Error {
    let of = |kind| error.get(kind).map(ToString::to_string);
    let (argument, value) = (of(ContextKind::InvalidArg), of(ContextKind::InvalidValue));
    let is_given = |long: &str| {
        let option = format!("--{long}");
        std::env::args().any(|word| word.split('=').next() == Some(option.as_str()))
    };
    let found = command.get_arguments().find(|known| {
        let in_environment = known.get_env().and_then(std::env::var_os);
        argument.as_deref() == Some(known.to_string().as_str())
            && in_environment.map(|text| text.to_string_lossy().into_owned()) == value
            && !known.get_long().is_some_and(is_given)
    });
    if let Some(variable) = found.and_then(Arg::get_env) {
        let tip = format!("this value is that of the environment variable {}", variable.display());
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}

#[derive(Subcommand)]
pub enum Command {
    /// List the ports where a board may be connected
    List,
    /// Show identity and status of the board
    #[command(after_help = examples::INFO)]
    Info,
    /// Diagnose everything from the port to the joints, with advice for each problem
    #[command(after_help = examples::DOCTOR)]
    Doctor {
        /// Robot folder to compare with the model on the board
        #[arg(long, env = "TESAKI_ROBOT")]
        robot: Option<PathBuf>,
    },
    /// Show the joints live
    #[command(after_help = examples::MONITOR)]
    Monitor,
    /// Show the robot on a page in a browser, and command it from there
    #[command(after_help = examples::VIEW)]
    View(View),
    /// Enable the outputs and hold the joints where they are, until Ctrl-C
    #[command(after_help = examples::ENABLE)]
    Enable(Enable),
    /// Disable the outputs, even if another program commands
    Disable,
    /// Stop at once with the configured reaction, even if another program commands
    Stop,
    /// Move joints to angles, then disable the outputs, or hold where the robot would fall
    #[command(after_help = examples::MOVE)]
    Move(Move),
    /// Move fingertips to positions along straight lines, then disable the outputs
    #[command(after_help = examples::REACH)]
    Reach(Reach),
    /// Grasp an object with three fingers, lift, turn and shift it, and put it down
    #[command(subcommand)]
    Grasp(Grasp),
    /// Identify torque constants and friction of a hand's joints from free and loaded motion
    Identify(Identify),
    /// Calibrate the links of an operator's fingers from a glove's orientations and markers on the tips, or
    /// the camera in a robot's hand; needs no board
    Calibrate(Calibrate),
    /// Retarget an operator's fingertips to a hand, from a file or live: glove, webcam landmarks or positions
    Retarget(Retarget),
    /// Find a circle in pictures, such as the rose of a door knob; needs no board
    FindCircle(FindCircle),
    /// Find the rose of a door knob in the pictures of a camera, for `tesaki approach`; needs no board
    Look(Look),
    /// Approach a door knob and grip it, led by the circles that `tesaki look` or another program finds
    Approach(Approach),
    /// Cartesian impedance control of an arm: the tool behaves as a mass with a spring and a damper
    #[command(subcommand)]
    Impedance(Impedance),
    /// Lead an arm under impedance control by poses of a hand: JSON lines, another board, or a recorded file
    Follow(Follow),
    /// Set the current joint angles (homing of relative encoders)
    #[command(after_help = examples::HOME)]
    Home(Home),
    /// Zero the force sensors of the tips; nothing may touch them
    Tare,
    /// Read the joint states, or a parameter of the model such as safety.command_timeout or
    /// joints.NAME.limits
    #[command(after_help = examples::READ)]
    Read {
        /// Name of the parameter; `model` for all parameters
        path: Option<String>,
    },
    /// Change a parameter of the model on the board, until the next reset or push
    #[command(after_help = examples::SET)]
    Set {
        /// Name of the parameter; `joints.*.…` means every joint
        path: String,
        /// The value: a number, a share of the present one such as 30%, true, false, a word, or JSON
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
    /// Push, show or check a robot model
    Model {
        #[command(subcommand)]
        command: ModelCommand,
    },
    /// Compute kinematics and dynamics of a robot, or the least grip of contacts, for every row of a table;
    /// needs no board
    #[command(subcommand, subcommand_value_name = "fk|jacobian|ik|rnea|mass|bias|grip")]
    Eval(Eval),
    /// Show the faults since power-on
    #[command(after_help = examples::FAULTS)]
    Faults {
        /// Clear them once read: a board in fault becomes disabled, and a robot that was held loses its
        /// power
        #[arg(long)]
        clear: bool,
    },
    /// Record all inputs and outputs of the control core, until Ctrl-C
    #[command(after_help = examples::RECORD)]
    Record(Record),
    /// Run the control core over a recording and report the first bit that differs
    #[command(after_help = examples::REPLAY)]
    Replay {
        /// The recording
        log: PathBuf,
    },
    /// Share a board between several programs: one commands, the others watch
    #[command(after_help = examples::SHARE)]
    Share {
        /// Address for the other programs: unix://PATH or tcp://HOST:PORT. One that other machines reach
        /// needs a --key, which encrypts the connections: all who have it may command the board.
        /// foxglove://HOST:PORT shows the board to Foxglove, which cannot command
        #[arg(default_value = "tcp://localhost:7400")]
        listen: Listen,
        /// Robot folder of the board's model, with foxglove://: its URDF, and the names of its links
        #[arg(long, env = "TESAKI_ROBOT", value_name = "DIR")]
        robot: Option<PathBuf>,
    },
    /// Show the board to ROS 2, and let its programs command it: starts the program tesaki-ros2, whose
    /// options follow (`tesaki ros2 --help`)
    #[command(disable_help_flag = true, disable_version_flag = true, after_help = examples::ROS2)]
    Ros2 {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<OsString>,
    },
    /// Make a key file for --key, and so for boards that are shared with other machines; needs no board
    #[command(after_help = examples::KEY)]
    Key {
        /// The new file
        file: PathBuf,
    },
    /// Print shell completions
    #[command(after_help = examples::COMPLETIONS)]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

#[derive(Subcommand)]
pub enum ModelCommand {
    /// Write a robot folder for a URDF: settings of controller and simulator; needs no board
    #[command(after_help = init::help())]
    Init(Init),
    /// Send a robot's model to the board
    #[command(after_help = examples::PUSH)]
    Push {
        /// Robot folder
        robot: PathBuf,
        /// Push only the chain with this tip, for a board that drives one finger, for example finger1_tip
        #[arg(long, value_name = "TIP")]
        chain: Option<String>,
        /// Calibration of this machine, as written by `tesaki identify`
        #[arg(long, value_name = "FILE")]
        calibration: Option<PathBuf>,
    },
    /// Print the model on the board
    Show,
    /// Report all problems of a robot folder by file and line; needs no board
    #[command(after_help = examples::CHECK)]
    Check {
        /// Robot folder or URDF file
        robot: PathBuf,
    },
}

#[derive(Args)]
pub struct Enable {
    /// Joint servo law
    #[arg(long, value_enum, default_value_t = Servo::Observer)]
    pub servo: Servo,
    /// Disable the outputs after this time [s]; without it, hold until Ctrl-C
    #[arg(long, value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<Duration>,
}

#[derive(Args)]
pub struct Move {
    /// Target angles, JOINT=ANGLE in rad; the other joints hold their angles
    #[arg(required = true, value_name = "JOINT=ANGLE", value_parser = joint_angle)]
    pub joints: Vec<(String, f32)>,
    /// The angles are in degrees
    #[arg(long)]
    pub degrees: bool,
    /// The angles are relative to the current ones
    #[arg(long)]
    pub relative: bool,
    /// Joint servo law
    #[arg(long, value_enum, default_value_t = Servo::Observer)]
    pub servo: Servo,
    /// Position tolerance [rad]
    #[arg(long, default_value_t = 0.005, value_parser = positive, allow_negative_numbers = true)]
    pub tolerance: f32,
    /// Fail if the targets are not reached within this time [s]; default: 20 s, or more where the joints'
    /// trajectory filters take longer
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    pub within: Option<Duration>,
    #[command(flatten)]
    pub stay: Stay,
}

#[derive(Args)]
pub struct Reach {
    /// Target positions, TIP=X,Y,Z in m in the robot's base frame; the other tips hold their positions
    #[arg(required = true, value_name = "TIP=X,Y,Z", value_parser = tip_position)]
    pub tips: Vec<(String, [f32; 3])>,
    /// The positions are relative to the current ones
    #[arg(long)]
    pub relative: bool,
    /// Maximum speed along the path [m/s]
    #[arg(long, default_value_t = 0.05, value_parser = positive, allow_negative_numbers = true)]
    pub speed: f32,
    /// Joint servo law
    #[arg(long, value_enum, default_value_t = Servo::Observer)]
    pub servo: Servo,
    /// Position tolerance [m]
    #[arg(long, default_value_t = 0.002, value_parser = positive, allow_negative_numbers = true)]
    pub tolerance: f32,
    #[command(flatten)]
    pub stay: Stay,
}

/// What a robot does that has done its task.
#[derive(Args)]
pub struct Stay {
    /// At the end, hold until Ctrl-C before disabling the outputs; the default where gravity pulls a joint
    /// with more than its friction
    #[arg(long)]
    pub hold: bool,
    /// At the end, disable the outputs at once, even if the robot falls
    #[arg(long, conflicts_with = "hold")]
    pub no_hold: bool,
}

#[derive(Args)]
pub struct Home {
    /// Current joint angles, JOINT=ANGLE in rad
    #[arg(value_name = "JOINT=ANGLE", value_parser = joint_angle)]
    pub joints: Vec<(String, f32)>,
    /// Angle of all joints that are not named, in rad, or in degrees with --degrees
    #[arg(long, allow_hyphen_values = true)]
    pub others: Option<f32>,
    /// The angles are in degrees
    #[arg(long)]
    pub degrees: bool,
}

#[derive(Args)]
pub struct Record {
    /// Base name: writes NAME.log for replay and NAME.mcap for viewers
    #[arg(default_value = "recording")]
    pub name: PathBuf,
    /// Replace files of this name
    #[arg(long)]
    pub force: bool,
    /// Stop after this time [s]; without it, at Ctrl-C
    #[arg(long, value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<Duration>,
    /// Robot folder; viewers need its URDF to draw the robot
    #[arg(long, env = "TESAKI_ROBOT")]
    pub robot: Option<PathBuf>,
}

/// [`ServoMode`] on the command line.
#[derive(Clone, Copy, ValueEnum)]
pub enum Servo {
    /// PID controller with pseudo-differentiator
    Pid,
    /// State feedback with an observer of velocity and disturbance
    Observer,
    /// PID alone, without anything of the model
    BarePid,
}

impl From<Servo> for ServoMode {
    fn from(servo: Servo) -> Self {
        match servo {
            Servo::Pid => Self::Pid,
            Servo::Observer => Self::Observer,
            Servo::BarePid => Self::BarePid,
        }
    }
}

/// The longest time that can be given: some days [s].
const MAX_SECONDS: f64 = 1e6;

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("{text:?} is not a number of seconds"))?;
    if !(seconds > 0.0 && seconds <= MAX_SECONDS) {
        return Err(format!("{text} s: expected a time above 0 s, at most {MAX_SECONDS} s"));
    }
    Ok(Duration::from_secs_f64(seconds).max(Duration::from_nanos(1)))
}

fn positive(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(number) if number > 0.0 && number.is_finite() => Ok(number),
        _ => Err(format!("{text}: expected a number above 0")),
    }
}

fn joint_angle(text: &str) -> Result<(String, f32), String> {
    // A name may have another one.
    let (name, angle) = text
        .rsplit_once('=')
        .ok_or_else(|| format!("{text:?}: expected JOINT=ANGLE, for example finger1_swing=0.3"))?;
    match angle.trim().parse::<f32>() {
        Ok(angle) if angle.is_finite() => Ok((name.trim().to_owned(), angle)),
        _ => Err(format!("{angle:?} is not an angle in rad; in degrees: --degrees and a number")),
    }
}

fn tip_position(text: &str) -> Result<(String, [f32; 3]), String> {
    let (name, position) = text
        .rsplit_once('=')
        .ok_or_else(|| format!("{text:?}: expected TIP=X,Y,Z, for example finger1_tip=0.09,0.04,0.1"))?;
    let numbers: Vec<f32> = position.split(',').filter_map(|number| number.trim().parse().ok()).collect();
    match <[f32; 3]>::try_from(numbers) {
        Ok(position) if position.iter().all(|value| value.is_finite()) && text.matches(',').count() == 2 => {
            Ok((name.trim().to_owned(), position))
        }
        _ => Err(format!("{position:?} is not a position: expected X,Y,Z in m")),
    }
}

/// Prints the completions of `shell`.
pub fn completions(shell: clap_complete::Shell) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "tesaki", &mut text);
    output::line(String::from_utf8_lossy(&text).trim_end())
}
