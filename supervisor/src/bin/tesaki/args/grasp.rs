//! `tesaki grasp …`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

const STEPS: &str = "\
Steps, one after the other; places and turns are counted from where the object was grasped:
  lift=M         so high [m], against gravity
  shift=X,Y,Z    so far to the side [m], in the base frame, besides the height
  turn=X,Y,Z     turned so far about each axis of the base frame [rad] (rotation vector)
  hold=S         hold still for so long [s]
  hold           hold until Ctrl-C

Without steps the object is held until Ctrl-C. At the end, and at Ctrl-C, it is lowered until
something carries it, and the board is disarmed; Ctrl-C once more disarms at once: it falls.

  tesaki grasp run robots/hand3/grasps/box.toml lift=0.01 turn=0,0.1,0 turn=0,0,0 hold=5";

#[derive(Subcommand)]
pub enum Grasp {
    /// Grasp an object, take the steps, put it down, and disarm
    #[command(visible_alias = "take", after_help = STEPS)]
    Run(Run),
    /// Say what the hand does and what it holds, whoever commands
    Status,
}

#[derive(Args)]
pub struct Run {
    /// Where and how to grasp, such as robots/hand3/grasps/box.toml
    pub file: PathBuf,
    /// What to do with the object: lift=M, shift=X,Y,Z, turn=X,Y,Z, hold=S, hold
    #[arg(value_name = "STEP", value_parser = step)]
    pub steps: Vec<Step>,
    /// Largest speed of the object [m/s]
    #[arg(long, default_value_t = 0.02)]
    pub speed: f32,
    /// Largest rate at which it turns [rad/s]
    #[arg(long, default_value_t = 0.2)]
    pub turn_speed: f32,
}

/// What to do with an object in the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// So high above where it was grasped [m].
    Lift(f32),
    /// So far to the side [m].
    Shift([f32; 3]),
    /// Turned by so much [rad].
    Turn([f32; 3]),
    /// For so long, or until Ctrl-C.
    Hold(Option<Duration>),
}

fn step(text: &str) -> Result<Step, String> {
    let (name, value) = text.split_once('=').unwrap_or((text, ""));
    let number = |value: &str| match value.trim().parse::<f32>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("{name}: {value:?} is no number")),
    };
    let three = || match value.split(',').collect::<Vec<_>>()[..] {
        [x, y, z] => Ok([number(x)?, number(y)?, number(z)?]),
        _ => Err(format!("{name}={value}: three numbers with commas between are needed")),
    };
    match name {
        "lift" => Ok(Step::Lift(number(value)?)),
        "shift" => Ok(Step::Shift(three()?)),
        "turn" => Ok(Step::Turn(three()?)),
        "hold" if value.is_empty() => Ok(Step::Hold(None)),
        "hold" => Ok(Step::Hold(Some(super::seconds(value)?))),
        _ => Err("there are lift=M, shift=X,Y,Z, turn=X,Y,Z, hold=S and hold".to_owned()),
    }
}
