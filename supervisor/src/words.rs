//! What several programs say of a board in the same words.

use std::fmt::Display;

use tesaki::fault::{Fault, FaultCause};
use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Refusal};
use tesaki::robot::Concerns;
use tesaki::task::grasping::{GraspCommand, GraspRefusal};
use tesaki::task::impedance::{ImpedanceCommand, ImpedanceRefusal};
use tesaki::task::{TaskCommand, TaskRefusal};

/// The answer to a program that would take over an enabled board.
pub const NOT_TAKEN_OVER: &str = "another client commands the board, which is enabled: it can only be taken over \
                                  after `tesaki stop` or `tesaki disable`";

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

/// Puts the name of the joint or tip that a refusal concerns in the place of its number in `text`.
pub fn named(refusal: &impl Concerns, text: &str, model: Option<&RobotModel>) -> String {
    let Some(model) = model else { return text.to_owned() };
    if let Some(joint) = refusal.joint() {
        return text.replacen(&format!("joint {joint}"), model.joint_name(usize::from(joint)), 1);
    }
    let tip = refusal.chain().and_then(|chain| Some((chain, model.chains.get(usize::from(chain))?)));
    tip.map_or_else(|| text.to_owned(), |(chain, tip)| text.replacen(&format!("chain {chain}"), &tip.name, 1))
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
            ". The joint still moves: wait until it rests, then try again"
        }
        Refusal::FaultsUnread { .. } => " (`tesaki faults --clear` does both)",
        Refusal::WrongMode(Mode::Fault) => " (`tesaki faults --clear` ends the fault)",
        _ => "",
    }
}
