//! A machine's own values as a file, `calibration.toml`: what was identified of its joints.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use serde::Deserialize;
use tesaki::model::RobotModel;

use super::regression::Fit;
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

    /// The values that were identified, of the joints of `model`, whose torque constants the drives had.
    #[expect(clippy::cast_possible_truncation, reason = "the model is in single precision")]
    pub fn identified(model: &RobotModel, fits: &[Fit]) -> Self {
        let joint = |(joint, fit): (&tesaki::model::JointModel, &Fit)| {
            let gain = fit.gain.ok().map(|gain| gain.value);
            let friction = fit.friction.ok();
            let values = JointCalibration {
                torque_constant: gain.map(|gain| (gain * f64::from(joint.motor.torque_constant)) as f32),
                coulomb: friction.map(|[coulomb, _]| coulomb.value as f32),
                viscous: friction.map(|[_, viscous]| viscous.value as f32),
            };
            (joint.name.to_string(), values)
        };
        Self { joints: model.joints.iter().zip(fits).map(joint).collect() }
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

    /// The file's text, with the deviations and what is not identified as comments.
    pub fn text(&self, head: &str, model: &RobotModel, fits: &[Fit]) -> String {
        let mut text = String::new();
        for line in head.lines() {
            let _ = writeln!(text, "# {line}");
        }
        for (joint, fit) in model.joints.iter().zip(fits) {
            let Some(values) = self.joints.get(joint.name.as_str()) else { continue };
            let _ = writeln!(text, "\n[joints.{}]", joint.name);
            let constant = f64::from(joint.motor.torque_constant);
            match (values.torque_constant, &fit.gain) {
                (Some(value), Ok(gain)) => {
                    let deviation = gain.deviation * constant;
                    let _ = writeln!(text, "torque_constant = {value:.5}  # N·m/A, ± {deviation:.5}");
                }
                (_, Err(doubt)) => {
                    let _ = writeln!(text, "# torque_constant is not identified, because {doubt}");
                }
                _ => {}
            }
            match (values.coulomb, values.viscous, &fit.friction) {
                (Some(coulomb), Some(viscous), Ok([c, v])) => {
                    let _ = writeln!(text, "coulomb = {coulomb:.6}  # N·m, ± {:.6}", c.deviation);
                    let _ = writeln!(text, "viscous = {viscous:.6}  # N·m·s/rad, ± {:.6}", v.deviation);
                }
                (_, _, Err(doubt)) => {
                    let _ = writeln!(text, "# friction is not identified, because {doubt}");
                }
                _ => {}
            }
        }
        text
    }
}
