//! What several programs say of a board in the same words.

use std::fmt::Display;
use std::time::Duration;

use tesaki::fault::{Fault, FaultCause};
use tesaki::kinematics::FingerError;
use tesaki::model::{JointModel, Safety};
use tesaki::protocol::{Mode, Refusal};
use tesaki::task::grasping::{GraspCommand, GraspRefusal};
use tesaki::task::impedance::{ImpedanceCommand, ImpedanceRefusal};
use tesaki::task::{TaskCommand, TaskRefusal};
pub use tesaki_description::robot::named;

use crate::timing::KEEP_ALIVE;

/// The answer to a program that would take over an enabled board.
pub const NOT_TAKEN_OVER: &str = "another client commands the board, which is enabled: it can only be taken over \
                                  after `tesaki stop` or `tesaki disable`";

/// What is said of a board that is told to stop for longer than
/// [`STOP_PATIENCE`](crate::timing::STOP_PATIENCE).
pub const NOT_STOPPED: &str = "THE BOARD DOES NOT SHOW THAT IT HAS STOPPED: press the emergency stop, or cut the power. \
                               It is told to stop until it does";

/// What is said of a held object that is moved where it stands.
pub const ON_SUPPORT: &str =
    "the object was not lifted, and is pressed against what it stands on, at worst until fault 20";

/// What is said when faults were to be cleared and there are more than those that were shown.
pub const ANOTHER_FAULT: &str = "another fault has come since: nothing was cleared. See what it is first";

/// Says that a request takes so long that an enabled board would stop before it gets the next; `None` if it
/// does not. What to do is in [`SLOW_LINK`].
pub fn slow_link(round_trip: Duration, safety: &Safety) -> Option<String> {
    let limit = Duration::from_secs_f32(safety.command_timeout);
    (round_trip + KEEP_ALIVE > limit).then(|| {
        format!(
            "a request takes {} ms over this link, and an enabled board stops {} ms after the last command",
            round_trip.as_millis(),
            limit.as_millis()
        )
    })
}

/// What to do about a [slow link](slow_link).
pub const SLOW_LINK: &str = "use a faster link, or raise safety.command_timeout";

/// Says why a board sends no telemetry, and what to do, by whether its port is open.
pub const fn silence(is_open: bool) -> &'static str {
    if is_open {
        "no telemetry from the board: is its control loop running? Try `tesaki doctor`"
    } else {
        "no telemetry from the board: its port has disappeared; when it is back, this goes on"
    }
}

/// Says that the board could not be disabled, and why.
pub fn still_on(why: impl Display) -> String {
    format!(
        "The board could not be disabled: {why}\n\
         Its outputs may still be on: press the emergency stop, or cut the power"
    )
}

/// Returns a mode in words; for mode fault also what the outputs do, if that is known.
pub fn mode(mode: Mode, outputs: Option<bool>) -> String {
    let outputs = match (mode, outputs) {
        (Mode::Fault, Some(true)) => ", and its outputs are on: it brakes or holds the robot",
        (Mode::Fault, Some(false)) => ", and its outputs are off",
        _ => "",
    };
    format!("{mode}{outputs}")
}

/// Returns what a command to a task does, as in "the board refused to …".
pub const fn action(command: &TaskCommand) -> &'static str {
    use tesaki::task::joint_servo::JointCommand;
    match command {
        TaskCommand::JointServo(JointCommand::StreamTips { .. }) => "move its tips",
        TaskCommand::JointServo(_) => "move",
        TaskCommand::Grasping(GraspCommand::Grasp(_)) => "grasp",
        TaskCommand::Grasping(GraspCommand::Move { .. }) => "move the object",
        TaskCommand::Grasping(GraspCommand::PutDown) => "put the object down",
        TaskCommand::Grasping(GraspCommand::Open) => "open the hand",
        TaskCommand::Impedance(ImpedanceCommand::Configure(_)) => "change its impedance",
        TaskCommand::Impedance(_) => "move its tool",
        TaskCommand::Telexistence(_) => "follow the fingertips",
        TaskCommand::VisualApproach(_) => "move its hand",
    }
}

/// Returns why a fingertip cannot be at a position, whose words precede; `joints` are those of the finger.
pub fn unreachable(error: &FingerError, joints: &[JointModel]) -> String {
    match error {
        FingerError::NotFinite => "is not finite".to_owned(),
        FingerError::OutOfReach { nearest } => format!(
            "is out of reach; the nearest position, ignoring joint limits, is {:.4}, {:.4}, {:.4} m",
            nearest.x, nearest.y, nearest.z
        ),
        FingerError::OutsideLimits { joint, value, lower, upper } => format!(
            "cannot be reached: {} would need {value:.3} rad, outside its limits {lower} to {upper} rad",
            joints.get(usize::from(*joint)).map_or("a joint", |joint| joint.name.as_str())
        ),
    }
}

/// Returns what to do about a refusal, in terms of the program `tesaki`; empty where nothing is known.
pub const fn hint(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::Commanded { .. } => " (with --take-over)",
        Refusal::NoSensors => {
            "; a board with the model of another robot has none either: `tesaki doctor --robot DIR` compares"
        }
        Refusal::NotHomed { .. } => " (`tesaki home JOINT=ANGLE …` with the present angle of every joint)",
        Refusal::Task(
            TaskRefusal::Grasping(GraspRefusal::NotTared { .. })
            | TaskRefusal::Impedance(ImpedanceRefusal::NotTared { .. }),
        ) => " (`tesaki tare`)",
        Refusal::Unsafe(Fault { cause: FaultCause::VelocityLimit, .. }) => {
            ". To be enabled, a joint moves at most at a fifth of its limit: wait until it rests, then try again"
        }
        Refusal::FaultsUnread { .. } => " (`tesaki faults --clear` does both)",
        Refusal::WrongMode(Mode::Fault) => " (`tesaki faults --clear` ends the fault)",
        _ => "",
    }
}
