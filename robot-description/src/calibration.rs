//! Calibration files: the identified values of one machine.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::Deserialize;
use tesaki::model::RobotModel;
use toml_edit::{DocumentMut, Item, Table, Value};

use crate::file::{self, FileError};
use crate::finding::{Finding, Report};
use crate::robot::{implausible_values, invalid_value};

/// What to do about a key that cannot be read.
const ADVICE: &str = "correct it, or make the file anew with `tesaki identify`";

/// Values of one machine, which override those of `robot.urdf` and `controller.toml`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// By joint name.
    #[serde(default)]
    pub joints: BTreeMap<String, JointCalibration>,
}

/// The values of a joint; those that are `None` are not overridden.
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
    /// The calibration is of another robot.
    #[error("[joints.{joint}]: {robot} has no such joint; its joints are {joints}")]
    Stranger {
        /// The name.
        joint: String,
        /// The robot.
        robot: String,
        /// Their names.
        joints: String,
    },
    /// A value is invalid.
    #[error("the calibration: {0}")]
    Model(String),
}

impl Calibration {
    /// Reads a file.
    ///
    /// # Errors
    /// What is wrong, and where.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        file::load(path, "", |path, text| {
            let (read, findings) = read(path, text);
            (read.map(|(values, _)| values), findings)
        })
    }

    /// Whether it is of this robot.
    ///
    /// # Errors
    /// A joint that the robot does not have.
    pub fn check_joints(&self, model: &RobotModel) -> Result<(), CalibrationError> {
        let has = |name: &str| model.joints.iter().any(|joint| joint.name == name);
        self.joints.keys().find(|name| !has(name)).map_or(Ok(()), |name| {
            let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
            Err(CalibrationError::Stranger {
                joint: name.clone(),
                robot: model.name.to_string(),
                joints: names.join(", "),
            })
        })
    }

    /// Applies the values to a model.
    ///
    /// # Errors
    /// A joint that the robot does not have, or a value that is invalid or not plausible; the model is
    /// unchanged then.
    pub fn apply(&self, model: &mut RobotModel) -> Result<(), CalibrationError> {
        self.check_joints(model)?;
        let mut changed = model.clone();
        for joint in &mut changed.joints {
            let Some(values) = self.joints.get(joint.name.as_str()) else { continue };
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
            CalibrationError::Model(format!("joint {name}: {}", invalid_value(&error)))
        })?;
        let before = implausible_values(model);
        if let Some(value) = implausible_values(&changed).into_iter().find(|value| !before.contains(value)) {
            let name = value.joint.map_or("", |joint| model.joint_name(joint));
            return Err(CalibrationError::Model(format!("joint {name}: {}", value.message)));
        }
        *model = changed;
        Ok(())
    }

    /// The joints of a model that keep the values of their robot folder, because there are none of them.
    pub fn missing<'a>(&self, model: &'a RobotModel) -> Vec<&'a str> {
        let names = model.joints.iter().map(|joint| joint.name.as_str());
        names.filter(|name| !self.joints.contains_key(*name)).collect()
    }
}

/// A calibration file that keeps comments and layout when values change.
#[derive(Clone, Debug, Default)]
pub struct CalibrationFile(DocumentMut);

impl CalibrationFile {
    /// The file at `path`; an empty one if there is none yet.
    ///
    /// # Errors
    /// The file exists, but is not a calibration.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        if !path.exists() {
            return Ok(Self::default());
        }
        file::load(path, "", |path, text| {
            let (read, findings) = read(path, text);
            (read.map(|(_, document)| Self(document)), findings)
        })
    }

    /// Sets a value of a joint to a number of so many decimals, with a comment behind it. Without one the
    /// joint has the value of its robot folder.
    pub fn set(&mut self, joint: &str, key: &str, number: Option<(f32, usize)>, comment: &str) {
        let table = self.joint(joint);
        let Some((number, decimals)) = number else {
            table.remove(key);
            return;
        };
        // As written, 0.55000 says how exact it is.
        let mut value =
            format!("{number:.decimals$}").parse().unwrap_or_else(|_| Value::from(f64::from(number)));
        value.decor_mut().set_prefix(" ");
        value.decor_mut().set_suffix(format!("  # {comment}"));
        match table.get_mut(key) {
            Some(item) => *item = Item::Value(value),
            None => {
                table.insert(key, Item::Value(value));
            }
        }
    }

    /// Puts a comment behind the head of a joint's table, in place of what was there.
    pub fn remark(&mut self, joint: &str, comment: &str) {
        let suffix = if comment.is_empty() { String::new() } else { format!("  # {comment}") };
        self.joint(joint).decor_mut().set_suffix(suffix);
    }

    fn joint(&mut self, name: &str) -> &mut Table {
        let mut all = Table::new();
        all.set_implicit(true);
        let joints = table(self.0.entry("joints").or_insert(Item::Table(all)));
        table(joints.entry(name).or_insert(Item::Table(Table::new())))
    }
}

/// Reads the text of a file as values, and as a document that can be changed. The latter has only integers of
/// 64 bits, as TOML says.
fn read(path: &Path, text: &str) -> (Option<(Calibration, DocumentMut)>, Vec<Finding>) {
    let mut report = Report::of_toml(path, text);
    let read = file::parse::<Calibration>(text, ADVICE, &mut report).and_then(|values| {
        let document = text.parse::<DocumentMut>().map_err(|error| {
            let before = error.span().and_then(|span| text.get(..span.start));
            let line = before.map(|before| before.matches('\n').count() + 1);
            report.dynamics(line, error.message(), ADVICE);
        });
        Some((values, document.ok()?))
    });
    (read, report.findings)
}

/// The item as a table that has lines of its own.
fn table(item: &mut Item) -> &mut Table {
    if !item.is_table() {
        *item = Item::Table(std::mem::take(item).into_table().unwrap_or_default());
    }
    match item {
        Item::Table(table) => table,
        _ => unreachable!("it has just become a table"),
    }
}

impl fmt::Display for CalibrationFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}
