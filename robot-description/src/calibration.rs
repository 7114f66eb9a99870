//! A machine's own values as a file, `calibration.toml`: what was identified of its joints.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use tesaki::model::RobotModel;

use crate::file::{self, FileError};

/// What one machine has other than its kind: over the values of `robot.urdf` and `controller.toml`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// By the joints' names.
    #[serde(default)]
    pub joints: BTreeMap<String, JointCalibration>,
}

/// A joint's own values; those that are `None` stay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointCalibration {
    /// Joint torque for one ampere [N·m/A].
    pub torque_constant: Option<f32>,
    /// Coulomb friction [N·m].
    pub coulomb: Option<f32>,
    /// Viscous friction [N·m·s/rad].
    pub viscous: Option<f32>,
}

/// Why a calibration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// It is of another robot.
    #[error("[joints.{joint}] belongs to no joint of {robot}; its joints are {joints}")]
    Stranger {
        /// The name.
        joint: String,
        /// The robot.
        robot: String,
        /// Their names.
        joints: String,
    },
    /// A number makes no sense.
    #[error("the calibration: {0}")]
    Model(String),
}

impl Calibration {
    /// Reads a file.
    ///
    /// # Errors
    /// What is wrong, and where.
    pub fn load(path: &Path) -> Result<Self, CalibrationError> {
        Ok(file::read(path)?)
    }

    /// Puts the values into a model.
    ///
    /// # Errors
    /// A joint that the robot does not have, or a number that makes no sense; the model is as it was.
    pub fn apply(&self, model: &mut RobotModel) -> Result<(), CalibrationError> {
        let mut changed = model.clone();
        for (name, values) in &self.joints {
            let Some(joint) = changed.joints.iter_mut().find(|joint| joint.name == name.as_str()) else {
                let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
                return Err(CalibrationError::Stranger {
                    joint: name.clone(),
                    robot: model.name.to_string(),
                    joints: names.join(", "),
                });
            };
            for (place, value) in [
                (&mut joint.motor.torque_constant, values.torque_constant),
                (&mut joint.friction.coulomb, values.coulomb),
                (&mut joint.friction.viscous, values.viscous),
            ] {
                *place = value.unwrap_or(*place);
            }
        }
        changed.validate().map_err(|error| {
            let name = error.joint.map_or("", |joint| model.joint_name(usize::from(joint)));
            let message = format!("joint {name}: {} = {} {}", error.field.path(), error.value, error.problem);
            CalibrationError::Model(message)
        })?;
        *model = changed;
        Ok(())
    }
}
