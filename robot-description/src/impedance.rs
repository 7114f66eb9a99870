//! Impedance files: the settings of an arm's Cartesian impedance control.
//!
//! ```toml
//! law = "model-following"               # or "direct"
//! redundancy = "arm-angle"              # or "none", or { driven = "shoulder_yaw" }
//! elbow_bandwidth = 12.0                # rad/s
//! force = "sensor"                      # or { observer = 30.0 }: from motor torques, bandwidth in rad/s
//! contact_force = 1.5                   # N
//! max_deviation = { translation = 0.3, rotation = 1.5 }         # m, rad
//!
//! # Along and about x, y, z of the base frame: one number, or one for each axis.
//! mass = { translation = 1.5, rotation = 0.008 }                # kg, kg·m²
//! damping = { translation = [30.0, 30.0, 60.0], rotation = 0.5 } # N·s/m, N·m·s/rad
//! stiffness = { translation = 300.0, rotation = 16.0 }          # N/m, N·m/rad
//! ```

use std::path::{Path, PathBuf};

use serde::Deserialize;
use tesaki::control::Impedance;
use tesaki::model::RobotModel;
use tesaki::task::impedance::{ForceSource, ImpedanceSettings, InvalidSettings, Law, Redundancy};

use crate::file::{self, FileError};

/// Why an impedance cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ImpedanceFileError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The robot has no such joint.
    #[error("{}: redundancy: {robot} has no joint {joint:?}; its joints are {names}", path.display())]
    Joint {
        /// The file.
        path: PathBuf,
        /// The robot.
        robot: String,
        /// The name in the file.
        joint: String,
        /// The robot's joints.
        names: String,
    },
    /// A value is invalid, or does not suit the robot.
    #[error("{}: {problem}", path.display())]
    Settings {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: InvalidSettings,
    },
}

/// The content of a file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    mass: Axes,
    damping: Axes,
    stiffness: Axes,
    #[serde(default)]
    law: FileLaw,
    redundancy: FileRedundancy,
    elbow_bandwidth: f32,
    #[serde(default)]
    force: FileForce,
    contact_force: f32,
    max_deviation: MaxDeviation,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Axes {
    translation: Three,
    rotation: Three,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(untagged, expecting = "expected a number, or three: for x, y and z")]
enum Three {
    All(f32),
    Each([f32; 3]),
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum FileLaw {
    Direct,
    #[default]
    ModelFollowing,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum FileForce {
    #[default]
    Sensor,
    Observer(f32),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum FileRedundancy {
    None,
    ArmAngle,
    Driven(String),
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MaxDeviation {
    translation: f32,
    rotation: f32,
}

impl Axes {
    fn six(self) -> [f32; 6] {
        let [[x, y, z], [a, b, c]] = [self.translation, self.rotation].map(|three| match three {
            Three::All(value) => [value; 3],
            Three::Each(values) => values,
        });
        [x, y, z, a, b, c]
    }
}

/// The settings in an impedance file, checked for the robot of `model`.
///
/// # Errors
/// What is wrong with the file, and where.
pub fn load(path: &Path, model: &RobotModel) -> Result<ImpedanceSettings, ImpedanceFileError> {
    let file_path = || path.to_path_buf();
    let file: File = file::read(path)?;
    let redundancy = match file.redundancy {
        FileRedundancy::None => Redundancy::None,
        FileRedundancy::ArmAngle => Redundancy::ArmAngle,
        FileRedundancy::Driven(name) => {
            let found = (0..).zip(&model.joints).find(|(_, joint)| joint.name == name.as_str());
            let (joint, _) = found.ok_or_else(|| {
                let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
                ImpedanceFileError::Joint {
                    path: file_path(),
                    robot: model.name.to_string(),
                    joint: name,
                    names: names.join(", "),
                }
            })?;
            Redundancy::DrivenJoint { joint }
        }
    };
    let settings = ImpedanceSettings {
        impedance: Impedance {
            mass: file.mass.six(),
            damping: file.damping.six(),
            stiffness: file.stiffness.six(),
        },
        law: match file.law {
            FileLaw::Direct => Law::Direct,
            FileLaw::ModelFollowing => Law::ModelFollowing,
        },
        redundancy,
        elbow_bandwidth: file.elbow_bandwidth,
        force: match file.force {
            FileForce::Sensor => ForceSource::Sensor,
            FileForce::Observer(bandwidth) => ForceSource::Observer { bandwidth },
        },
        contact_force: file.contact_force,
        max_deviation: [file.max_deviation.translation, file.max_deviation.rotation],
    };
    settings
        .validate(model.joints.len())
        .map_err(|problem| ImpedanceFileError::Settings { path: file_path(), problem })?;
    Ok(settings)
}
