//! Grasp files: the object, its contacts and the forces.
//!
//! ```toml
//! clearance = 0.010                 # m, in front of the surfaces
//! touch_force = 0.1                 # N
//! force_limit = 9.0                 # N, of a fingertip
//! # friction = 0.5                  # if omitted, the hand probes the friction
//! internal = { least_grip = { margin = 0.24, capacity_at_rest = 0.22, capacity_in_motion = 0.6 } }
//! # control = "observer"            # or "pid", "bare_pid", or { wrench = { … } }: how the object's pose is controlled
//! # object_frame = "rolling"        # or "triangle": corrected for tips that roll, or as Hand3 section 5.1 prints it
//! # load = "measured"               # or { constant = 0.023 }: what the fingers carry [kg]
//! # joint_targets = "closed_form"   # or "accumulated" (Hand3 eq. 25)
//!
//! [object]                          # the frame of the contacts, in the base frame
//! position = [0.090, 0.0, 0.085]    # m
//! rpy = [0.0, 0.769, 0.0]           # rad, as in URDF
//!
//! [[contact]]                       # one for each finger
//! position = [-0.049, 0.04, 0.0]    # m
//! normal = [1.0, 0.0, 0.0]          # into the object
//! # …
//! ```

use std::path::Path;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use tesaki::control::ServoMode;
use tesaki::task::grasping::{
    FINGERS, GraspPlan, InternalForce, InvalidPlan, JointTargets, LoadSource, ObjectControl, ObjectFrame,
    PlanField, PlannedContact, WrenchGains,
};

use crate::file::{self, FileError};
use crate::finding::{Finding, Report};
use crate::urdf::LARGEST_ANGLE;

/// Name of the folder of such files in a robot folder.
pub const FOLDER: &str = "grasps";
/// What to do about a key that cannot be used.
const ADVICE: &str = "correct it; robots/hand3/grasps/box.toml is an example";

/// The content of a file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    clearance: f64,
    touch_force: f32,
    force_limit: f32,
    friction: Option<f32>,
    #[serde(default)]
    internal: Internal,
    #[serde(default = "yes")]
    feedback: bool,
    #[serde(default)]
    control: Control,
    #[serde(default)]
    object_frame: FrameName,
    #[serde(default)]
    load: LoadName,
    #[serde(default)]
    joint_targets: TargetsName,
    object: Object,
    contact: Vec<Contact>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum Internal {
    LeastGrip { margin: f32, capacity_at_rest: f32, capacity_in_motion: f32 },
    Normal { strength: f32 },
    Pairwise { strengths: [f32; 3] },
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum Control {
    Pid,
    #[default]
    Observer,
    BarePid,
    Wrench {
        position: [f32; 2],
        orientation: [f32; 2],
        damping: f32,
        compensated: bool,
    },
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FrameName {
    #[default]
    Rolling,
    Triangle,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LoadName {
    #[default]
    Measured,
    Constant(f32),
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum TargetsName {
    #[default]
    ClosedForm,
    Accumulated,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Object {
    position: [f64; 3],
    #[serde(default)]
    rpy: [f64; 3],
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Contact {
    position: [f64; 3],
    normal: [f64; 3],
}

const fn yes() -> bool {
    true
}

impl Default for Internal {
    fn default() -> Self {
        Self::LeastGrip { margin: 0.24, capacity_at_rest: 0.22, capacity_in_motion: 0.6 }
    }
}

impl From<Internal> for InternalForce {
    fn from(internal: Internal) -> Self {
        match internal {
            Internal::LeastGrip { margin, capacity_at_rest, capacity_in_motion } => {
                Self::LeastGrip { margin, capacity_at_rest, capacity_in_motion }
            }
            Internal::Normal { strength } => Self::Normal { strength },
            Internal::Pairwise { strengths } => Self::Pairwise { strengths },
        }
    }
}

impl From<Control> for ObjectControl {
    fn from(control: Control) -> Self {
        match control {
            Control::Pid => Self::Differential(ServoMode::Pid),
            Control::Observer => Self::Differential(ServoMode::Observer),
            Control::BarePid => Self::Differential(ServoMode::BarePid),
            Control::Wrench { position, orientation, damping, compensated } => {
                Self::Wrench(WrenchGains { position, orientation, damping, compensated })
            }
        }
    }
}

impl From<FrameName> for ObjectFrame {
    fn from(frame: FrameName) -> Self {
        match frame {
            FrameName::Rolling => Self::Rolling,
            FrameName::Triangle => Self::Triangle,
        }
    }
}

impl From<LoadName> for LoadSource {
    fn from(load: LoadName) -> Self {
        match load {
            LoadName::Measured => Self::Measured,
            LoadName::Constant(mass) => Self::Constant { mass },
        }
    }
}

impl From<TargetsName> for JointTargets {
    fn from(targets: TargetsName) -> Self {
        match targets {
            TargetsName::ClosedForm => Self::ClosedForm,
            TargetsName::Accumulated => Self::Accumulated,
        }
    }
}

/// A grasp with the pose of its object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedGrasp {
    /// The plan, checked.
    pub plan: GraspPlan,
    /// Position of the object's frame in the base frame [m].
    pub position: [f64; 3],
    /// Orientation of the object's frame: a unit quaternion `[x, y, z, w]`.
    pub orientation: [f64; 4],
}

/// The plan in a grasp file, checked.
///
/// # Errors
/// The file cannot be read, or what is wrong in it, by line.
pub fn load(path: &Path) -> Result<GraspPlan, FileError> {
    load_placed(path).map(|grasp| grasp.plan)
}

/// Keys that object files have, and no grasp file.
const OF_OBJECTS: [&str; 3] = ["shape", "size", "mass"];
const OBJECT_ADVICE: &str = "a grasp file has contacts, as robots/hand3/grasps/box.toml";

/// The plan in a grasp file, checked, and the pose of its object.
///
/// # Errors
/// The file cannot be read, or what is wrong in it, by line.
pub fn load_placed(path: &Path) -> Result<PlacedGrasp, FileError> {
    file::load(path, "", check)
}

/// What is wrong with `text`, the content of `path`; the grasp when nothing is.
pub fn check(path: &Path, text: &str) -> (Option<PlacedGrasp>, Vec<Finding>) {
    let mut report = Report::of_toml(path, text);
    if OF_OBJECTS.iter().all(|key| report.line_of(key).is_some()) {
        report.dynamics(None, "this is an object file, not a grasp file", OBJECT_ADVICE);
        return (None, report.findings);
    }
    let grasp = file::parse::<File>(text, ADVICE, &mut report).and_then(|file| {
        let placed = file.placed().map_err(|(key, message)| {
            report.dynamics(report.line_of(&key), message, ADVICE);
        });
        placed.ok()
    });
    (grasp, report.findings)
}

impl File {
    /// The grasp, checked; or the key that is wrong, and what is wrong there.
    fn placed(&self) -> Result<PlacedGrasp, (String, String)> {
        let contacts: [Contact; FINGERS] = self.contact.as_slice().try_into().map_err(|_| {
            let got = self.contact.len();
            let message = format!(
                "{got} contacts; a hand for grasping has {FINGERS} fingers, each needs one [[contact]]"
            );
            ("contact".to_owned(), message)
        })?;
        let rpy = self.object.rpy;
        if let Some(angle) = rpy.iter().find(|angle| angle.abs() > LARGEST_ANGLE) {
            return Err(("object.rpy".to_owned(), format!("an angle of {angle} rad, beyond ±4π: degrees?")));
        }
        let [roll, pitch, yaw] = rpy;
        let frame = Isometry3::from_parts(
            Translation3::from(Vector3::from(self.object.position)),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        );
        #[expect(clippy::cast_possible_truncation, reason = "the core works in single precision")]
        let single = |vector: Vector3<f64>| -> [f32; 3] { vector.map(|value| value as f32).into() };
        #[expect(clippy::cast_possible_truncation, reason = "the core works in single precision")]
        let plan = GraspPlan {
            contacts: contacts.map(|contact| PlannedContact {
                position: single((frame * Point3::from(contact.position)).coords),
                normal: single(frame * Vector3::from(contact.normal)),
            }),
            clearance: self.clearance as f32,
            touch_force: self.touch_force,
            friction: self.friction,
            internal: self.internal.into(),
            force_limit: self.force_limit,
            feedback: self.feedback,
            control: self.control.into(),
            object_frame: self.object_frame.into(),
            load: self.load.into(),
            joint_targets: self.joint_targets.into(),
        };
        plan.validate().map_err(|problem| (key(&problem), problem.to_string()))?;
        Ok(PlacedGrasp { plan, position: self.object.position, orientation: frame.rotation.coords.into() })
    }
}

/// The key of what is wrong.
fn key(problem: &InvalidPlan) -> String {
    let key = match problem {
        InvalidPlan::Value { field, .. } => match field {
            PlanField::Clearance => "clearance",
            PlanField::TouchForce => "touch_force",
            PlanField::Friction => "friction",
            PlanField::ForceLimit => "force_limit",
            PlanField::Margin | PlanField::Capacity | PlanField::Strength => "internal",
            PlanField::Gain => "control",
            PlanField::Mass => "load",
        },
        InvalidPlan::Contact { finger } => return format!("contact.{finger}"),
        InvalidPlan::NoTriangle | InvalidPlan::CannotGrip | InvalidPlan::Unbalanced { .. } => "contact",
    };
    key.to_owned()
}
