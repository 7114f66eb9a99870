//! What can be said on the command line.

mod eval;
mod grasp;
mod identify;
mod impedance;

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum};
use tesaki::control::ServoMode;
use tesaki_supervisor::fault_injector::LinkFaults;
use tesaki_supervisor::port::Address;

pub use eval::{Eval, Grip, Kinematics};
pub use grasp::{Grasp, Run, Step};
pub use identify::Identify;
pub use impedance::{Hold, Impedance};

const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  failed: a file, a robot folder, a recording that differs, a finding of the doctor
  2  the command line makes no sense
  3  no device, or it cannot be opened
  4  board and program speak different versions of the protocol
  5  the board is in fault
  6  no answer, or not in time
  7  the board refused, and nothing changed
  8  the hand did not take hold of the object, or could not go on with it

Without a board: `cargo sim serve` offers a simulated one, which `--port auto` finds.";

/// Commands a tesaki board from a PC
#[derive(Parser)]
#[command(version, about = "Commands a tesaki board from a PC", after_help = EXIT_CODES, propagate_version = true)]
pub struct Cli {
    #[command(flatten)]
    pub options: Options,
    #[command(subcommand)]
    pub command: Command,
}

/// What every command understands.
#[derive(Args)]
pub struct Options {
    /// Where the board is: auto, a serial port such as /dev/ttyUSB0, unix://PATH or tcp://HOST:PORT
    #[arg(long, short, global = true, env = "TESAKI_PORT", default_value = "auto")]
    pub port: Address,
    /// How long to wait for an answer [s]
    #[arg(long, global = true, env = "TESAKI_TIMEOUT", default_value = "2", value_parser = seconds)]
    pub timeout: Duration,
    /// Print JSON: one object, or one a line while something is going on
    #[arg(long, global = true, env = "TESAKI_JSON")]
    pub json: bool,
    /// Ask nothing, and do what the command line says; without a terminal nothing is asked anyway
    #[arg(long, global = true, env = "TESAKI_NON_INTERACTIVE")]
    pub non_interactive: bool,
    /// Take command although another program has it; refused while the board is armed
    #[arg(long, global = true, env = "TESAKI_TAKE_OVER")]
    pub take_over: bool,
    /// Damage the line on purpose, such as seed=1,flip=1e-4,drop=1e-4 or all=1e-3
    #[arg(long, global = true, env = "TESAKI_LINK_FAULTS", value_name = "FAULTS")]
    pub link_faults: Option<LinkFaults>,
}

#[derive(Subcommand)]
pub enum Command {
    /// List the ports at which a board may be
    List,
    /// Say who the board is and how it is
    Info,
    /// Find what is wrong between this PC and the board's joints, and say what to do
    Doctor {
        /// The robot's folder, to compare with the model on the board
        #[arg(long, env = "TESAKI_ROBOT")]
        robot: Option<PathBuf>,
    },
    /// Watch the joints live
    Monitor,
    /// Arm the board and hold the joints where they are, until Ctrl-C
    Arm(Arm),
    /// Switch the outputs off, whoever commands
    Disarm,
    /// Stop at once with the configured reaction, whoever commands
    Stop,
    /// Move joints to angles, then disarm
    Move(Move),
    /// Lead fingertips to places in straight lines, then disarm
    Reach(Reach),
    /// Grasp an object with three fingers, lift, turn and shift it, and put it down
    #[command(subcommand)]
    Grasp(Grasp),
    /// Find out torque constants and friction of a hand's joints, from motions free and under load
    Identify(Identify),
    /// Let an arm yield at its tool like a mass on a spring and a damper
    #[command(subcommand)]
    Impedance(Impedance),
    /// Tell the board at which angles its joints stand
    Home(Home),
    /// Take what the force sensors of the tips read now for nothing: when nothing touches them
    Tare,
    /// Read the joints' state, or a parameter of the model such as safety.command_timeout or
    /// joints.NAME.limits
    Read {
        /// The parameter; `model` for all of them
        path: Option<String>,
    },
    /// Change a parameter of the model on the board, until the next reset or push
    Set {
        /// The parameter; `joints.*.…` means every joint
        path: String,
        /// The value: a number, true, false, a word, or JSON
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
    /// The robot model: push, show, check
    Model {
        #[command(subcommand)]
        command: ModelCommand,
    },
    /// Compute kinematics of a robot's tips, or the least grip of contacts, for every row of a table, without
    /// a board
    #[command(subcommand, subcommand_value_name = "fk|jacobian|ik|grip")]
    Eval(Eval),
    /// Read the faults since power-on
    Faults {
        /// Clear them once read, which leads a board in fault back to disarmed
        #[arg(long)]
        clear: bool,
    },
    /// Record everything that goes into the control core and comes out of it, until Ctrl-C
    Record(Record),
    /// Run the control core over a recording, and report the first bit that differs
    Replay {
        /// The recording
        log: PathBuf,
    },
    /// Share a board among several programs: one commands, the others watch
    Share {
        /// Where the others find it: unix://PATH or tcp://HOST:PORT
        listen: Address,
    },
    /// Print the completions of a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

#[derive(Subcommand)]
pub enum ModelCommand {
    /// Send a robot's model to the board
    Push {
        /// The robot's folder
        robot: PathBuf,
        /// Only the chain with this tip, for a board that has one finger of a hand, such as finger1_tip
        #[arg(long, value_name = "TIP")]
        chain: Option<String>,
        /// Values of this very machine, as `tesaki identify` writes them
        #[arg(long, value_name = "FILE")]
        calibration: Option<PathBuf>,
    },
    /// Print the model that the board uses
    Show,
    /// Find what is wrong in a robot folder, by file and line, without a board
    Check {
        /// The robot's folder, or a URDF alone
        robot: PathBuf,
    },
}

#[derive(Args)]
pub struct Arm {
    /// How the joints are controlled
    #[arg(long, value_enum, default_value_t = Servo::Observer)]
    pub servo: Servo,
    /// Disarm after so long [s]; without it, hold until Ctrl-C
    #[arg(long, value_parser = seconds)]
    pub duration: Option<Duration>,
}

#[derive(Args)]
pub struct Move {
    /// Where to: JOINT=ANGLE in rad; the other joints stay
    #[arg(required = true, value_name = "JOINT=ANGLE", value_parser = joint_angle)]
    pub joints: Vec<(String, f32)>,
    /// The angles are in degrees
    #[arg(long)]
    pub degrees: bool,
    /// The angles are counted from where the joints are
    #[arg(long)]
    pub relative: bool,
    /// How the joints are controlled
    #[arg(long, value_enum, default_value_t = Servo::Observer)]
    pub servo: Servo,
    /// How near is there [rad]
    #[arg(long, default_value_t = 0.005)]
    pub tolerance: f32,
    /// Longest time to get there [s]
    #[arg(long, default_value = "20", value_parser = seconds)]
    pub within: Duration,
    /// Once there, hold until Ctrl-C instead of disarming
    #[arg(long)]
    pub hold: bool,
}

#[derive(Args)]
pub struct Reach {
    /// Where to: TIP=X,Y,Z in m, in the robot's base frame; the other tips stay
    #[arg(required = true, value_name = "TIP=X,Y,Z", value_parser = tip_place)]
    pub tips: Vec<(String, [f32; 3])>,
    /// The places are counted from where the tips are
    #[arg(long)]
    pub relative: bool,
    /// Largest speed on the way [m/s]
    #[arg(long, default_value_t = 0.05)]
    pub speed: f32,
    /// How the joints are controlled
    #[arg(long, value_enum, default_value_t = Servo::Observer)]
    pub servo: Servo,
    /// How near is there [m]
    #[arg(long, default_value_t = 0.002)]
    pub tolerance: f32,
    /// Once there, hold until Ctrl-C instead of disarming
    #[arg(long)]
    pub hold: bool,
}

#[derive(Args)]
pub struct Home {
    /// Where the joints stand: JOINT=ANGLE in rad
    #[arg(value_name = "JOINT=ANGLE", value_parser = joint_angle)]
    pub joints: Vec<(String, f32)>,
    /// The angle of the joints that are not named [rad]
    #[arg(long, allow_hyphen_values = true)]
    pub others: Option<f32>,
    /// The angles are in degrees
    #[arg(long)]
    pub degrees: bool,
}

#[derive(Args)]
pub struct Record {
    /// Where to: NAME.log for replays and NAME.mcap for viewers are made
    #[arg(default_value = "recording")]
    pub name: PathBuf,
    /// Stop after so long [s]; without it, at Ctrl-C
    #[arg(long, value_parser = seconds)]
    pub duration: Option<Duration>,
    /// The robot's folder, whose URDF viewers need to draw it
    #[arg(long, env = "TESAKI_ROBOT")]
    pub robot: Option<PathBuf>,
}

/// [`ServoMode`] on the command line.
#[derive(Clone, Copy, ValueEnum)]
pub enum Servo {
    /// PID with pseudo-differentiator
    Pid,
    /// Observer of velocity and disturbance
    Observer,
}

impl From<Servo> for ServoMode {
    fn from(servo: Servo) -> Self {
        match servo {
            Servo::Pid => Self::Pid,
            Servo::Observer => Self::Observer,
        }
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("{text:?} is no number of seconds"))?;
    match Duration::try_from_secs_f64(seconds) {
        Ok(duration) if !duration.is_zero() => Ok(duration),
        _ => Err(format!("{text} s is no time to wait")),
    }
}

fn joint_angle(text: &str) -> Result<(String, f32), String> {
    let (name, angle) =
        text.split_once('=').ok_or_else(|| format!("{text:?} is not JOINT=ANGLE, such as f1_base=0.3"))?;
    match angle.trim().parse::<f32>() {
        Ok(angle) if angle.is_finite() => Ok((name.trim().to_owned(), angle)),
        _ => Err(format!("{angle:?} is no angle")),
    }
}

fn tip_place(text: &str) -> Result<(String, [f32; 3]), String> {
    let (name, place) = text
        .split_once('=')
        .ok_or_else(|| format!("{text:?} is not TIP=X,Y,Z, such as finger1_tip=0.09,0.04,0.1"))?;
    let numbers: Vec<f32> = place.split(',').filter_map(|number| number.trim().parse().ok()).collect();
    match <[f32; 3]>::try_from(numbers) {
        Ok(place) if place.iter().all(|value| value.is_finite()) && text.matches(',').count() == 2 => {
            Ok((name.trim().to_owned(), place))
        }
        _ => Err(format!("{place:?} is no place: three numbers with commas between, in m")),
    }
}

/// Prints the completions of `shell`.
pub fn completions(shell: clap_complete::Shell) {
    clap_complete::generate(shell, &mut Cli::command(), "tesaki", &mut std::io::stdout());
}
