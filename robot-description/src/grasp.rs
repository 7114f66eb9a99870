//! Grasp files: the object, its contacts and the forces.
//!
//! ```toml
//! clearance = 0.010                 # m, in front of the surfaces
//! touch_force = 0.1                 # N
//! force_limit = 9.0                 # N, of a fingertip
//! # friction = 0.5                  # if omitted, the hand probes the friction
//! internal = { least_grip = { margin = 0.2, capacity_at_rest = 0.22, capacity_in_motion = 0.6 } }
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

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use tesaki::control::ServoMode;
use tesaki::task::grasping::{
    FINGERS, GraspPlan, InternalForce, InvalidPlan, JointTargets, LoadSource, ObjectControl, ObjectFrame,
    PlannedContact, WrenchGains,
};

use crate::file::{self, FileError, read_text};
use crate::line::line_of;

/// Why a grasp cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum GraspFileError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// It describes an object.
    #[error(
        "{}: this is an object file, not a grasp file; a grasp file has contacts, as robots/hand3/grasps/box.toml",
        path.display()
    )]
    Object {
        /// The file.
        path: PathBuf,
    },
    /// The number of contacts differs from the number of fingers.
    #[error("{}: {got} contacts; a hand has {FINGERS} fingers, and each needs one [[contact]]", path.display())]
    Contacts {
        /// The file.
        path: PathBuf,
        /// The number of contacts.
        got: usize,
    },
    /// A value is invalid, or the contacts cannot grip.
    #[error("{}: {problem}", path.display())]
    Plan {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: InvalidPlan,
    },
}

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
        Self::LeastGrip { margin: 0.2, capacity_at_rest: 0.22, capacity_in_motion: 0.6 }
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
/// What is wrong with the file, and where.
pub fn load(path: &Path) -> Result<GraspPlan, GraspFileError> {
    load_placed(path).map(|grasp| grasp.plan)
}

/// What belongs to objects, and to no grasp.
const OF_OBJECTS: [&str; 3] = ["shape", "size", "mass"];

/// The error of a grasp file, or that the file is one of an object.
fn if_object(path: &Path, error: FileError) -> GraspFileError {
    let is_object = matches!(error, FileError::Toml { .. })
        && read_text(path).is_ok_and(|text| OF_OBJECTS.iter().all(|key| line_of(&text, key).is_some()));
    if is_object { GraspFileError::Object { path: path.to_path_buf() } } else { error.into() }
}

/// The plan in a grasp file, checked, and the pose of its object.
///
/// # Errors
/// What is wrong with the file, and where.
pub fn load_placed(path: &Path) -> Result<PlacedGrasp, GraspFileError> {
    let place = || path.to_path_buf();
    let file: File = file::read(path).map_err(|error| if_object(path, error))?;
    let got = file.contact.len();
    let contacts: [Contact; FINGERS] =
        file.contact.as_slice().try_into().map_err(|_| GraspFileError::Contacts { path: place(), got })?;
    let [roll, pitch, yaw] = file.object.rpy;
    let frame = Isometry3::from_parts(
        Translation3::from(Vector3::from(file.object.position)),
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
        clearance: file.clearance as f32,
        touch_force: file.touch_force,
        friction: file.friction,
        internal: file.internal.into(),
        force_limit: file.force_limit,
        feedback: file.feedback,
        control: file.control.into(),
        object_frame: file.object_frame.into(),
        load: file.load.into(),
        joint_targets: file.joint_targets.into(),
    };
    plan.validate().map_err(|problem| GraspFileError::Plan { path: place(), problem })?;
    Ok(PlacedGrasp { plan, position: file.object.position, orientation: frame.rotation.coords.into() })
}
