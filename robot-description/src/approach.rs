//! `approach.toml` in a robot folder: how its hand approaches a door knob by the camera in the hand.
//!
//! ```toml
//! [hand]
//! speed = 0.15          # m/s, largest
//! acceleration = 0.5    # m/s², largest
//! contact_force = 15.0  # N: a larger force against the motion ends it
//! reach = 0.5           # m from where the task begins
//!
//! [gripper]
//! joint = "gripper"
//! open = -0.98          # rad
//! closed = 0.35         # rad, with nothing in it
//! speed = 2.0           # rad/s
//! torque = 0.8          # N·m
//!
//! [knob]
//! rose = [0.035, 0.045]     # m, radius of the rose
//! radius = 0.025            # m, of the knob
//! length = 0.056            # m, from the rim of the rose to that of the knob's end
//! distance = [0.13, 0.28]   # m, of the rose from the hand at the start
//! aside = 0.06              # m, at the start
//!
//! [approach]
//! grip_distance = 0.012 # m from the rose, where the gripper closes
//! guard_distance = 0.075 # m from the rose, where the hand waits until it is centred
//! tolerance = 0.004     # m aside
//! speed = 0.12          # m/s, to the guard distance
//! near_speed = 0.04     # m/s, from there on
//! opening = [-0.1, 0.16] # rad, of the gripper while it holds the knob
//! pull = 0.02           # m, by which what is held is tried
//! retries = 3
//! patience = 8.0        # s, for each part
//! ```
//!
//! What the camera sees is in [`hand_eye.toml`](crate::hand_eye).

use std::f32::consts::TAU;
use std::ops::RangeInclusive;
use std::path::Path;

use serde::Deserialize;
use tesaki::behavior::{ApproachSettings, KnobExpectation};
use tesaki::control::ServoMode;
use tesaki::model::{JointModel, RobotModel};
use tesaki::robot::{LimitRefusal, Robot};
use tesaki::task::visual_approach::{
    GripperSettings, VisualApproachField, VisualApproachRefusal, VisualApproachSettings,
};

use crate::file::{self, FileError, read_text};
use crate::finding::{Finding, Report};
use crate::hand_eye::{self, HandEyeFile};
use crate::robot::named;

/// Name of the file in a robot folder.
pub const FILE: &str = "approach.toml";
/// What to do about a key that cannot be read.
const ADVICE: &str = "correct it; robots/knob-arm/approach.toml is an example";
/// What to do when it cannot be read.
const UNREAD: &str = "a robot that approaches door knobs has an approach.toml in its folder \
                      (robots/knob-arm/approach.toml is an example)";

/// Settings of the board's task, and of the behaviour that leads it.
#[derive(Clone, Debug, PartialEq)]
pub struct ApproachFile {
    /// Of the task.
    pub task: VisualApproachSettings,
    /// Of the behaviour.
    pub behavior: ApproachSettings,
    /// Width and height of the camera's pictures [px], if `hand_eye.toml` tells them.
    pub size: Option<[usize; 2]>,
}

/// The content of a file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    hand: Hand,
    gripper: Gripper,
    knob: Knob,
    approach: Behavior,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Hand {
    #[serde(default)]
    chain: u8,
    speed: f32,
    acceleration: f32,
    contact_force: f32,
    reach: f32,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Gripper {
    joint: String,
    open: f32,
    closed: f32,
    speed: f32,
    torque: f32,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Knob {
    rose: [f32; 2],
    radius: f32,
    length: f32,
    distance: [f32; 2],
    aside: f32,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Behavior {
    grip_distance: f32,
    guard_distance: f32,
    tolerance: f32,
    speed: f32,
    near_speed: f32,
    opening: [f32; 2],
    pull: f32,
    retries: u8,
    patience: f32,
}

/// The settings in the folder of a robot, and the table of its camera.
///
/// # Errors
/// A file cannot be read, or what is wrong in it, by line and key.
pub fn load(robot: &Path, model: &RobotModel) -> Result<ApproachFile, FileError> {
    let path = robot.join(FILE);
    let text = read_text(&path).map_err(FileError::unread(&path, UNREAD))?;
    let (settings, findings) = check(&path, &text, model, &hand_eye::load(robot)?);
    settings.ok_or(FileError::Wrong(findings))
}

/// What is wrong with `text`, the content of `path`, for the robot of `model` with the camera of `hand_eye`;
/// the settings when nothing is.
pub fn check(
    path: &Path,
    text: &str,
    model: &RobotModel,
    hand_eye: &HandEyeFile,
) -> (Option<ApproachFile>, Vec<Finding>) {
    let mut report = Report::of_toml(path, text);
    let Some(file) = file::parse::<File>(text, ADVICE, &mut report) else {
        return (None, report.findings);
    };
    match file.settings(model, hand_eye) {
        Ok(settings) => (Some(settings), report.findings),
        Err((section, key, message)) => {
            report.dynamics(report.line_of(&format!("{section}.{key}")), message, ADVICE);
            (None, report.findings)
        }
    }
}

/// Section, key and what is wrong there.
type Wrong = (&'static str, &'static str, String);

impl File {
    fn settings(&self, model: &RobotModel, hand_eye: &HandEyeFile) -> Result<ApproachFile, Wrong> {
        let Self { hand, gripper, knob, approach } = self;
        let found = (0..).zip(&model.joints).find(|(_, joint)| joint.name == gripper.joint.as_str());
        let Some((joint, JointModel { limits, .. })) = found else {
            let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
            let message = format!(
                "{} has no joint {:?}; its joints are {}",
                model.name,
                gripper.joint,
                names.join(", ")
            );
            return Err(("gripper", "joint", message));
        };
        let Gripper { open, closed, speed, torque, .. } = *gripper;
        let task = VisualApproachSettings {
            chain: hand.chain,
            gripper: GripperSettings { joint, open, closed, speed, torque },
            servo_mode: ServoMode::Pid,
            speed: hand.speed,
            acceleration: hand.acceleration,
            contact_force: hand.contact_force,
            reach: hand.reach,
        };
        let mut robot = Box::new(Robot::NONE);
        robot.configure(model).map_err(|error| ("hand", "chain", error.to_string()))?;
        task.validate(&robot).map_err(|refusal| {
            let (section, key) = place(&refusal, &task);
            (section, key, named(&refusal, &refusal.to_string(), Some(model)) + &refused_degrees(&refusal))
        })?;
        let Knob { rose, radius, length, distance, aside } = *knob;
        let behavior = ApproachSettings {
            table: hand_eye.table.clone(),
            expectation: KnobExpectation { rose, radius, length, distance, aside },
            grip_distance: approach.grip_distance,
            guard_distance: approach.guard_distance,
            tolerance: approach.tolerance,
            speed: approach.speed,
            near_speed: approach.near_speed,
            opening: approach.opening,
            pull: approach.pull,
            retries: approach.retries,
            patience: approach.patience,
        };
        behavior.validate(&task).map_err(|invalid| {
            let of_knob = ["rose", "radius", "length", "distance", "aside"].contains(&invalid.field);
            (if of_knob { "knob" } else { "approach" }, invalid.field, invalid.to_string())
        })?;
        let limits = limits.lower..=limits.upper;
        let [low, high] = behavior.opening;
        if !limits.contains(&low) && !limits.contains(&high) {
            let message = format!(
                "opening is {low} to {high} rad, and both lie outside the limits of {}, {} to {} rad: a held knob could \
                 not be told from an empty grip",
                gripper.joint,
                limits.start(),
                limits.end()
            );
            return Err(("approach", "opening", message + &in_degrees(low, &limits)));
        }
        Ok(ApproachFile { task, behavior, size: hand_eye.size })
    }
}

/// That an angle that is refused is one in degrees.
fn refused_degrees(refusal: &VisualApproachRefusal) -> String {
    match *refusal {
        VisualApproachRefusal::Limit(LimitRefusal::OutsideLimits { value, lower, upper, .. }) => {
            in_degrees(value, &(lower..=upper))
        }
        _ => String::new(),
    }
}

/// That an angle outside the limits would be within them in degrees, or is larger than a turn.
fn in_degrees(value: f32, limits: &RangeInclusive<f32>) -> String {
    let radians = value.to_radians();
    if limits.contains(&radians) || value.abs() > TAU {
        format!(" (angles are in rad: {value}° are {radians:.4})")
    } else {
        String::new()
    }
}

/// Section and key of what a board refuses.
fn place(refusal: &VisualApproachRefusal, task: &VisualApproachSettings) -> (&'static str, &'static str) {
    match refusal {
        VisualApproachRefusal::NoGripper { .. } | VisualApproachRefusal::GripperAxis { .. } => {
            ("gripper", "joint")
        }
        VisualApproachRefusal::Limit(LimitRefusal::OutsideLimits { value, .. })
            if value.to_bits() == task.gripper.closed.to_bits() =>
        {
            ("gripper", "closed")
        }
        VisualApproachRefusal::Limit(_) => ("gripper", "open"),
        VisualApproachRefusal::Value { field, .. } => match field {
            VisualApproachField::Speed => ("hand", "speed"),
            VisualApproachField::Acceleration => ("hand", "acceleration"),
            VisualApproachField::ContactForce => ("hand", "contact_force"),
            VisualApproachField::Reach => ("hand", "reach"),
            VisualApproachField::GripperRange => ("gripper", "closed"),
            VisualApproachField::GripperSpeed => ("gripper", "speed"),
            VisualApproachField::GripperTorque => ("gripper", "torque"),
        },
        VisualApproachRefusal::NoChain { .. }
        | VisualApproachRefusal::Target { .. }
        | VisualApproachRefusal::Speed { .. }
        | VisualApproachRefusal::Blocked { .. }
        | VisualApproachRefusal::Singular { .. } => ("hand", "chain"),
    }
}
