//! `retargeting.toml` in a robot folder: how the hand follows an operator's fingertips.
//!
//! ```toml
//! operator_hand = "right"          # "right" or "left"
//! rotation = [0.0, 0.0, 0.0]       # rad, roll, pitch, yaw from the operator's hand to the robot's base
//! follows = ["thumb", "index", "middle", "ring", "little"]   # finger by finger, the thumb first
//! weights = [1.0, 1.0, 1.0, 1.0, 1.0]
//! scale = 1.0                      # length on the robot over length on the operator's hand
//! near = 0.005                     # m, precision pinch has full priority below this gap of the tips,
//! far = 0.025                      # m, none above this one
//! operator_contact = 0.0           # m, distance of the measured points when the operator's tips touch
//! robot_contact = 0.0              # m, distance of the robot's tips when they touch
//! tolerance = 0.0001               # m, a fingertip farther from its target is told
//! directions = false               # whether directions of fingertips are followed, too
//! speed = 6.0                      # rad/s, of every joint
//! acceleration = 100.0             # rad/s², of every joint
//! max_sample_age = 0.2             # s, a fingertip that is not seen for longer is unknown
//! servo = "observer"               # or "pid"
//! [speeds]                         # rad/s, of joints by name, in place of `speed`
//! [posture]                        # rad, of joints by name: the hand in the first frame of a file
//! ```
//!
//! Every key may be left out: these are the defaults. Without `posture`, robot and operator have their wrists
//! at the same place; a joint that it does not name is in the middle of its range.

use std::collections::BTreeMap;
use std::f32::consts::TAU;
use std::path::Path;

use nalgebra::UnitQuaternion;
use serde::Deserialize;
use tesaki::OutOfRange;
use tesaki::control::ServoMode;
use tesaki::kinematics::{Angles, Hand};
use tesaki::model::RobotModel;
use tesaki::robot::Robot;
use tesaki::task::telexistence::{InvalidTelexistenceSettings, TelexistenceSettings};
use tesaki::teleop::{HumanFinger, RetargetField, RetargetSettings};

use crate::file::{self, FileError, read_text};
use crate::finding::{Finding, Report};

/// Name of the file in a robot folder.
pub const FILE: &str = "retargeting.toml";
/// What a hand is.
const NEEDS: &str = "which has two to five chains, and at most one joint that moves several";
/// What to do without the file.
const NO_FILE: &str = "the file is not there: give the folder of a hand, where it names the operator's finger of \
                       each chain, as `follows = [\"thumb\", \"index\"]`";
/// What to do about a key that cannot be read.
const ADVICE: &str = "correct or remove it; without it the default holds";

/// A hand of the operator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The right one.
    #[default]
    Right,
    /// The left one.
    Left,
}

impl Side {
    /// The other one.
    pub const fn other(self) -> Self {
        match self {
            Self::Right => Self::Left,
            Self::Left => Self::Right,
        }
    }

    /// As in the file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Left => "left",
        }
    }
}

/// How a hand follows an operator.
#[derive(Clone, Debug)]
pub struct RetargetingSettings {
    /// Of the board's task.
    pub task: TelexistenceSettings,
    /// The operator's hand that the robot follows.
    pub operator_hand: Side,
    /// From the operator's hand frame to the robot's base frame.
    pub rotation: UnitQuaternion<f32>,
    /// Angles of the actuated joints to which the first frame of a file corresponds [rad]; without them, the
    /// wrists of robot and operator are at the same place.
    pub posture: Option<Angles>,
}

/// The content of a file.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    operator_hand: Option<Side>,
    rotation: Option<[f32; 3]>,
    follows: Option<Vec<HumanFinger>>,
    weights: Option<Vec<f32>>,
    scale: Option<f32>,
    near: Option<f32>,
    far: Option<f32>,
    operator_contact: Option<f32>,
    robot_contact: Option<f32>,
    tolerance: Option<f32>,
    directions: Option<bool>,
    speed: Option<f32>,
    acceleration: Option<f32>,
    max_sample_age: Option<f32>,
    servo: Option<FileServo>,
    #[serde(default)]
    speeds: BTreeMap<String, f32>,
    posture: Option<BTreeMap<String, f32>>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum FileServo {
    Pid,
    Observer,
}

impl RetargetingSettings {
    /// The settings in the folder of the robot of `model`; the defaults where there is no file.
    ///
    /// # Errors
    /// The file cannot be read, or what is wrong in it, by line; or the robot is no hand.
    pub fn load(robot: &Path, model: &RobotModel) -> Result<Self, FileError> {
        let path = robot.join(FILE);
        let (settings, mut findings) = match read_text(&path) {
            Ok(text) => Self::check(&path, &text, model),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Self::check(&path, "", model),
            Err(error) => return Err(FileError::unread(&path, "")(error)),
        };
        if !path.exists() {
            findings.iter_mut().for_each(|finding| NO_FILE.clone_into(&mut finding.advice));
        }
        settings.ok_or(FileError::Wrong(findings))
    }

    /// Everything that is wrong with `text`, the content of `path`, for the robot of `model`; the settings
    /// when nothing is.
    pub fn check(path: &Path, text: &str, model: &RobotModel) -> (Option<Self>, Vec<Finding>) {
        let mut report = Report::of_toml(path, text);
        let Some(file) = file::parse::<File>(text, ADVICE, &mut report) else {
            return (None, report.findings);
        };
        let mut robot = Box::new(Robot::NONE);
        let hand = robot.configure(model).ok().and_then(|()| robot.hand());
        let Some(hand) = hand else {
            let message = format!("{} is not a hand, {NEEDS}", model.name);
            report.dynamics(None, message, "remove the file, or use a hand");
            return (None, report.findings);
        };
        let settings = file.settings(hand, model, &mut report);
        report.sort();
        (Some(settings).filter(|_| report.findings.is_empty()), report.findings)
    }
}

impl File {
    /// The settings, which are wrong if the report says so.
    fn settings(&self, hand: &Hand, model: &RobotModel, report: &mut Report) -> RetargetingSettings {
        let mut task = TelexistenceSettings::DEFAULT;
        self.set_fingers(&mut task.retargeting, hand.len(), report);
        self.set_values(&mut task);
        self.check_speeds(report);
        if let Some(joint) = hand.shared().filter(|joint| hand.actuated(0).contains(joint)) {
            let message = format!(
                "joint {} moves the thumb and other fingers: the thumb goes first, and then the fingers would move it",
                model.joint_name(usize::from(joint))
            );
            report.dynamics(None, message, "retargeting needs a thumb with joints of its own");
        }
        let mut posture = hand.center();
        set_joints("speeds", &self.speeds, &mut task.retargeting.speeds, model, report);
        if let Some(angles) = &self.posture {
            set_joints("posture", angles, posture.as_mut_slice(), model, report);
        }
        check_posture(&posture, hand, model, report);
        let rotation = self.rotation(report);
        if let Err(invalid) = task.validate(hand) {
            self.out_of_range(&task, &invalid, report);
        }
        RetargetingSettings {
            task,
            operator_hand: self.operator_hand.unwrap_or_default(),
            rotation,
            posture: self.posture.is_some().then_some(posture),
        }
    }

    /// What has one entry for each finger.
    fn set_fingers(&self, settings: &mut RetargetSettings, fingers: usize, report: &mut Report) {
        if let Some(follows) = self.list("follows", self.follows.as_ref(), fingers, report) {
            let thumbs = follows.iter().filter(|finger| **finger == HumanFinger::Thumb).count();
            if follows.first() != Some(&HumanFinger::Thumb) || thumbs != 1 {
                let message =
                    "follows must name the thumb first, and only there: the first chain is the hand's thumb";
                let advice =
                    "correct it; another order of the chains is that of the joints at the base in robot.urdf";
                report.dynamics(report.line_of("follows"), message, advice);
            }
            for (place, finger) in settings.follows.iter_mut().zip(follows) {
                *place = *finger as u8;
            }
        }
        if let Some(weights) = self.list("weights", self.weights.as_ref(), fingers, report) {
            settings.weights.iter_mut().zip(weights).for_each(|(place, weight)| *place = *weight);
        }
    }

    /// What has one value.
    fn set_values(&self, task: &mut TelexistenceSettings) {
        let retargeting = &mut task.retargeting;
        for (place, value) in [
            (&mut retargeting.scale, self.scale),
            (&mut retargeting.near, self.near),
            (&mut retargeting.far, self.far),
            (&mut retargeting.operator_contact, self.operator_contact),
            (&mut retargeting.robot_contact, self.robot_contact),
            (&mut retargeting.tolerance, self.tolerance),
            (&mut task.acceleration, self.acceleration),
            (&mut task.max_sample_age, self.max_sample_age),
        ] {
            *place = value.unwrap_or(*place);
        }
        retargeting.directions = self.directions.unwrap_or(retargeting.directions);
        retargeting.speeds = [self.speed.unwrap_or(RetargetSettings::DEFAULT.speeds[0]); _];
        task.servo_mode = match self.servo {
            None | Some(FileServo::Observer) => ServoMode::Observer,
            Some(FileServo::Pid) => ServoMode::Pid,
        };
    }

    fn check_speeds(&self, report: &mut Report) {
        let speeds = self.speeds.iter().map(|(joint, value)| (format!("speeds.{joint}"), *value));
        for (key, value) in self.speed.map(|value| ("speed".to_owned(), value)).into_iter().chain(speeds) {
            if !(1e-3..=1e3).contains(&value) {
                let message = format!("{key} is {value}; it must be 0.001 to 1000 rad/s");
                report.dynamics(line(report, &key), message, "correct the value");
            }
        }
    }

    /// From the operator's hand frame to the robot's base frame.
    fn rotation(&self, report: &mut Report) -> UnitQuaternion<f32> {
        let rotation = self.rotation.unwrap_or_default();
        if let Some(angle) = rotation.into_iter().find(|angle| !(-TAU..=TAU).contains(angle)) {
            let message = format!("rotation holds {angle}; it must be -6.2832 to 6.2832 rad");
            report.dynamics(report.line_of("rotation"), message, "correct the value");
        }
        let [roll, pitch, yaw] = rotation;
        UnitQuaternion::from_euler_angles(roll, pitch, yaw)
    }

    /// A list with one entry for each finger; another length is reported.
    fn list<'a, T>(
        &self,
        key: &str,
        given: Option<&'a Vec<T>>,
        fingers: usize,
        report: &mut Report,
    ) -> Option<&'a Vec<T>> {
        let list = given?;
        if list.len() != fingers {
            let message = format!("{key} has {} entries, the hand {fingers} fingers", list.len());
            report.dynamics(report.line_of(key), message, "write one entry for each finger, the thumb first");
            return None;
        }
        Some(list)
    }

    /// Reports a setting that is out of its range, by its key.
    fn out_of_range(
        &self,
        task: &TelexistenceSettings,
        invalid: &InvalidTelexistenceSettings,
        report: &mut Report,
    ) {
        let (key, verb, value, range) = match invalid {
            InvalidTelexistenceSettings::Acceleration { value } => {
                ("acceleration", "is", *value, "1 to 10000 rad/s²".to_owned())
            }
            InvalidTelexistenceSettings::MaxSampleAge { value } => {
                ("max_sample_age", "is", *value, "0.02 to 2 s".to_owned())
            }
            InvalidTelexistenceSettings::Retargeting(OutOfRange { field, value, min, max }) => {
                let range = format!("{min} to {max}");
                match field {
                    // Told above, by finger and joint.
                    RetargetField::Follows | RetargetField::Speeds => return,
                    RetargetField::Fingers => ("the number of chains", "is", *value, range),
                    RetargetField::Weights => ("weights", "holds", *value, range),
                    RetargetField::Scale => ("scale", "is", *value, range),
                    RetargetField::Near => ("near", "is", *value, range + " m"),
                    RetargetField::Far => ("far", "is", *value, range + " m" + &self.why_far(task)),
                    RetargetField::OperatorContact => ("operator_contact", "is", *value, range + " m"),
                    RetargetField::RobotContact => ("robot_contact", "is", *value, range + " m"),
                    RetargetField::Tolerance => ("tolerance", "is", *value, range + " m"),
                }
            }
        };
        // A default can be wrong beside what the file has.
        let at = report
            .line_of(key)
            .or_else(|| report.line_of("near"))
            .or_else(|| report.line_of("robot_contact"));
        report.dynamics(at, format!("{key} {verb} {value}; it must be {range}"), "correct the value");
    }

    /// What the smallest `far` comes from.
    fn why_far(&self, task: &TelexistenceSettings) -> String {
        let RetargetSettings { near, operator_contact, robot_contact, scale, .. } = task.retargeting;
        let default = if self.far.is_none() { ", the default" } else { "" };
        format!(
            "{default}: near {near} and 0.001, and twice what robot_contact {robot_contact} differs from \
             operator_contact {operator_contact}, over scale {scale}"
        )
    }
}

/// Puts the values of joints by name, from the table `key`, in their places.
fn set_joints(
    key: &str,
    values: &BTreeMap<String, f32>,
    places: &mut [f32],
    model: &RobotModel,
    report: &mut Report,
) {
    for (name, &value) in values {
        let joint = model.joints.iter().position(|joint| joint.name == name.as_str());
        match joint.and_then(|joint| places.get_mut(joint)) {
            Some(place) => *place = value,
            None => {
                let message = format!("{key}: {} has no joint {name}", model.name);
                report.dynamics(line(report, &format!("{key}.{name}")), message, "correct or remove it");
            }
        }
    }
}

/// Reports angles beyond the limits of their joints.
fn check_posture(posture: &Angles, hand: &Hand, model: &RobotModel, report: &mut Report) {
    for ((angle, (lower, upper)), joint) in posture.iter().zip(hand.limits()).zip(&model.joints) {
        if !(lower..=upper).contains(&angle) {
            let key = format!("posture.{}", joint.name);
            let message = format!(
                "{key} is {angle}; it must be {lower:.3} to {upper:.3} rad: the joint's limits, less the margin of a \
                 hand"
            );
            report.limits(line(report, &key), message, "correct the value");
        }
    }
}

/// The line of a key, or of its table where that is written in one line.
fn line(report: &Report, key: &str) -> Option<usize> {
    report.line_of(key).or_else(|| report.line_of(key.split('.').next()?))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::robot::RobotFolder;

    fn folder(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(name)
    }

    fn check(text: &str) -> (Option<RetargetingSettings>, Vec<Finding>) {
        let model = RobotFolder::load(&folder("hand5")).unwrap().model;
        RetargetingSettings::check(Path::new(FILE), text, &model)
    }

    /// A joint that follows the spread of the fingers, put before those of the thumb.
    #[test]
    fn a_thumb_that_moves_with_other_fingers_is_refused_by_the_joint() {
        let mut model = RobotFolder::load(&folder("hand5")).unwrap().model;
        (model.mimics[0].chain, model.mimics[0].place) = (0, 0);
        let (_, findings) = RetargetingSettings::check(Path::new(FILE), "", &model);
        let told: String = findings.iter().map(ToString::to_string).collect();
        assert!(told.contains("joint spread moves the thumb and other fingers"), "{told}");
    }

    #[test]
    fn the_file_of_the_five_finger_hand_and_none_are_good() {
        let model = RobotFolder::load(&folder("hand5")).unwrap().model;
        let settings = RetargetingSettings::load(&folder("hand5"), &model).unwrap();
        assert_eq!((settings.task.retargeting.tolerance, settings.posture), (1e-3, None));
        let (none, findings) = check("");
        assert!(findings.is_empty());
        assert_eq!(none.unwrap().task, TelexistenceSettings::DEFAULT);
        let (all, _) = check(
            "operator_hand = \"left\"\nrotation = [0, 0, 1.5707964]\nfollows = [\"thumb\", \"index\", \"index\", \
             \"ring\", \"little\"]\nspeed = 2.0\nservo = \"pid\"\n[speeds]\nspread = 1.0\n\
             [posture]\nspread = 0.2\n",
        );
        let all = all.unwrap();
        assert_eq!((all.operator_hand, all.task.servo_mode), (Side::Left, ServoMode::Pid));
        assert_eq!(all.task.retargeting.follows, [0, 1, 1, 3, 4]);
        assert_eq!((all.task.retargeting.speeds[4], all.task.retargeting.speeds[5]), (2.0, 1.0));
        let posture = all.posture.unwrap();
        assert_eq!((posture[5], posture[6]), (0.2, 0.7));
        assert!((all.rotation * nalgebra::Vector3::x() - nalgebra::Vector3::y()).norm() < 1e-6);
    }

    #[test]
    fn what_is_wrong_is_said_by_line() {
        for (text, expected) in [
            ("scale = 1.0\nspeedy = 3\n", "retargeting.toml:2: unknown field `speedy`"),
            ("\nscale = 20.0\n", "retargeting.toml:2: scale is 20; it must be 0.1 to 10"),
            ("near = 0.02\nfar = 0.02\n", "retargeting.toml:2: far is 0.02; it must be 0.021"),
            ("follows = [\"thumb\"]\n", "retargeting.toml:1: follows has 1 entries, the hand 5 fingers"),
            ("follows = [\"pinky\"]\n", "retargeting.toml:1: unknown variant `pinky`"),
            (
                "weights = [1, 1, 1, 1, 1]\nfollows = [\"index\", \"index\", \"index\", \"ring\", \"little\"]\n",
                "retargeting.toml:2: follows must name the thumb first, and only there",
            ),
            ("[speeds]\nelbow = 1.0\n", "retargeting.toml:2: speeds: hand5 has no joint elbow"),
            (
                "[speeds]\nspread = -1.0\n",
                "retargeting.toml:2: speeds.spread is -1; it must be 0.001 to 1000",
            ),
            (
                "speed = 0.0\n[speeds]\nspread = 1.0\n",
                "retargeting.toml:1: speed is 0; it must be 0.001 to 1000 rad/s",
            ),
            ("# one\nspeeds = { spread = 0.0 }\n", "retargeting.toml:2: speeds.spread is 0"),
            (
                "near = 0.03\n",
                "retargeting.toml:1: far is 0.025; it must be 0.031 to 0.5 m, the default: near 0.03",
            ),
            ("\nrobot_contact = 0.03\n", "retargeting.toml:2: far is 0.025; it must be 0.066"),
            (
                "weights = [1, 1, -1, 1, 1]\n",
                "retargeting.toml:1: weights holds -1; it must be 0.001 to 1000",
            ),
            (
                "follows = [\"thumb\", \"index\", \"thumb\", \"ring\", \"little\"]\n",
                "retargeting.toml:1: follows must name the thumb first, and only there",
            ),
            (
                "[posture]\nspread = 1.0\n",
                "retargeting.toml:2: posture.spread is 1; it must be -0.145 to 0.345 rad: the joint's limits, less the",
            ),
            ("rotation = [0, nan, 0]\n", "retargeting.toml:1: rotation holds NaN"),
            ("max_sample_age = 9.0\n", "retargeting.toml:1: max_sample_age is 9; it must be 0.02 to 2 s"),
            ("acceleration = 0.0\n", "retargeting.toml:1: acceleration is 0; it must be 1 to 10000 rad/s²"),
        ] {
            let (settings, findings) = check(text);
            let said = crate::urdf::list(&findings);
            assert!(settings.is_none() && said.starts_with(expected), "{text:?}: {said}");
        }
    }

    #[test]
    fn an_arm_is_no_hand() {
        let model = RobotFolder::load(&folder("arm7")).unwrap().model;
        let said = RetargetingSettings::load(&folder("arm7"), &model).unwrap_err().to_string();
        assert!(said.contains("arm7 is not a hand, which has two to five chains"), "{said}");
        assert!(
            said.contains("retargeting.toml: ")
                && said.contains("the file is not there")
                && said.contains("follows = ["),
            "{said}"
        );
        let (_, findings) = RetargetingSettings::check(Path::new(FILE), "scale = 1.0\n", &model);
        let said = crate::urdf::list(&findings);
        assert!(said.contains("arm7 is not a hand") && said.contains("remove the file"), "{said}");
    }
}
