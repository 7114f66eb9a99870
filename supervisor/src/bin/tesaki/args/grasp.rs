//! Arguments of `tesaki grasp`.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use tesaki::math;

const STEPS: &str = "\
Steps are carried out in order. Positions and rotations are relative to the pose at the grasp:
  lift=M         height [m], against gravity
  shift=X,Y,Z    translation [m] in the base frame, in addition to the height
  turn=X,Y,Z     rotation vector [rad] in the base frame
  hold=S         hold still for this time [s]
  hold           hold until Ctrl-C

Without steps the object is held until Ctrl-C. At the end, and at Ctrl-C, the object is lowered
until something supports it, and the outputs are disabled. A second Ctrl-C disables them at once:
the object falls.

  tesaki grasp run robots/hand3/grasps/box.toml lift=0.01 turn=0,0.1,0 turn=0,0,0 hold=5";

#[derive(Subcommand)]
pub enum Grasp {
    /// Grasp an object, carry out the steps, put it down, and disable the outputs
    #[command(visible_alias = "take", after_help = STEPS)]
    Run(Run),
    /// Show what the hand does and holds
    Status,
}

#[derive(Args)]
pub struct Run {
    /// Grasp file, for example robots/hand3/grasps/box.toml
    pub file: PathBuf,
    /// Steps: lift=M, shift=X,Y,Z, turn=X,Y,Z, hold=S, hold
    #[arg(value_name = "STEP", value_parser = step)]
    pub steps: Vec<Step>,
    /// Maximum speed of the object [m/s]
    #[arg(long, default_value_t = 0.02, value_parser = super::positive, allow_negative_numbers = true)]
    pub speed: f32,
    /// Maximum angular velocity of the object [rad/s]
    #[arg(long, default_value_t = 0.2, value_parser = super::positive, allow_negative_numbers = true)]
    pub turn_speed: f32,
}

/// A step of a grasp, relative to the pose at the grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Height [m].
    Lift(f32),
    /// Translation [m].
    Shift([f32; 3]),
    /// Rotation vector [rad].
    Turn([f32; 3]),
    /// Hold for this time, or until Ctrl-C.
    Hold(Option<Duration>),
}

/// As it is typed.
impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lift(height) => write!(f, "lift={height}"),
            Self::Shift([x, y, z]) => write!(f, "shift={x},{y},{z}"),
            Self::Turn([x, y, z]) => write!(f, "turn={x},{y},{z}"),
            Self::Hold(Some(time)) => write!(f, "hold={}", time.as_secs_f32()),
            Self::Hold(None) => f.write_str("hold"),
        }
    }
}

/// No hand moves an object farther than this [m], or turns it by more than half a turn [rad].
const FARTHEST: f32 = 1.0;
const LARGEST_TURN: f32 = 3.2;

fn step(text: &str) -> Result<Step, String> {
    let (name, value) = text.split_once('=').unwrap_or((text, ""));
    let number = |value: &str| match value.trim().parse::<f32>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("{name}: {value:?} is not a number")),
    };
    let three = || match value.split(',').collect::<Vec<_>>()[..] {
        [x, y, z] => Ok([number(x)?, number(y)?, number(z)?]),
        _ => Err(format!("{name}={value}: expected three numbers, X,Y,Z")),
    };
    // A typing error of a unit is told before the hand grasps.
    let within = |values: [f32; 3], limit: f32, unit: &str| {
        let size = math::sqrt(values.iter().map(|value| value * value).sum());
        if size <= limit {
            Ok(values)
        } else {
            Err(format!("{name}={value}: {size:.2} {unit} in all, at most {limit}: is it in {unit}?"))
        }
    };
    match name {
        "lift" => Ok(Step::Lift(within([number(value)?, 0.0, 0.0], FARTHEST, "metres")?[0])),
        "shift" => Ok(Step::Shift(within(three()?, FARTHEST, "metres")?)),
        "turn" => Ok(Step::Turn(within(three()?, LARGEST_TURN, "radians")?)),
        "hold" if value.is_empty() => Ok(Step::Hold(None)),
        "hold" => Ok(Step::Hold(Some(super::seconds(value)?))),
        _ => Err("unknown step: expected lift=M, shift=X,Y,Z, turn=X,Y,Z, hold=S or hold".to_owned()),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_step_in_another_unit_is_told() {
        for (text, words) in [
            ("lift=10", "lift=10: 10.00 metres in all, at most 1: is it in metres?"),
            ("shift=0.8,-0.8,0", "1.13 metres in all, at most 1"),
            ("turn=0,0,90", "90.00 radians in all, at most 3.2: is it in radians?"),
            ("turn=0,0", "expected three numbers"),
            ("lift=up", "\"up\" is not a number"),
        ] {
            let error = step(text).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
        assert_eq!(step("turn=0,3.1416,0").unwrap().to_string(), "turn=0,3.1416,0");
        assert_eq!(step("lift=0.01").unwrap().to_string(), "lift=0.01");
    }
}
