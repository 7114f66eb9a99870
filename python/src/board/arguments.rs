//! Arguments of a board's methods.

use std::path::PathBuf;
use std::time::Duration;

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tesaki::control::ServoMode;
use tesaki::model::RobotModel;
use tesaki::task::TaskConfig;
use tesaki_description::impedance;
use tesaki_description::retargeting::RetargetingSettings;
use tesaki_description::robot::RobotFolder;

use super::Board;
use crate::error::{RefusedError, file};
use crate::robot::Robot;

/// The longest time that can be asked for, as that of the program `tesaki` [s].
const MAX_SECONDS: f64 = 1e6;

impl Board {
    pub(super) fn known_model(&self) -> PyResult<&RobotModel> {
        self.model.as_ref().ok_or_else(|| RefusedError::new_err("the board has no robot model: push one"))
    }

    pub(super) fn config(&self, task: &str, servo: &str, path: Option<PathBuf>) -> PyResult<TaskConfig> {
        let needed =
            |what: &str| PyValueError::new_err(format!("file is missing: the task {task} needs {what}"));
        Ok(match task {
            "joints" => TaskConfig::JointServo(match servo {
                "observer" => ServoMode::Observer,
                "pid" => ServoMode::Pid,
                "bare-pid" => ServoMode::BarePid,
                other => {
                    return Err(PyValueError::new_err(format!(
                        "servo is {other:?}: expected observer, pid or bare-pid"
                    )));
                }
            }),
            "impedance" => {
                let wanted =
                    "an impedance file, as in enable('impedance', file='robots/arm7/impedances/soft.toml')";
                let path = path.ok_or_else(|| needed(wanted))?;
                TaskConfig::Impedance(impedance::load(&path, self.known_model()?).map_err(file)?)
            }
            "grasping" => TaskConfig::Grasping(()),
            "telexistence" => {
                let path = path.ok_or_else(|| needed("the robot's folder"))?;
                let model = self.known_model()?;
                TaskConfig::Telexistence(RetargetingSettings::load(&path, model).map_err(file)?.task)
            }
            other => {
                return Err(PyValueError::new_err(format!(
                    "task is {other:?}: expected joints, impedance, grasping or telexistence"
                )));
            }
        })
    }

    /// Writes the values of named joints into their places.
    pub(super) fn named(&self, values: &Bound<'_, PyDict>, places: &mut [f32]) -> PyResult<()> {
        let names = self.joints();
        for (name, value) in values.iter() {
            let name: String = name.extract()?;
            let value: f32 = value
                .extract()
                .map_err(|_| PyTypeError::new_err(format!("{name}: {value} is no angle in rad")))?;
            if !value.is_finite() {
                return Err(PyValueError::new_err(format!("{name}: {value} is no angle in rad")));
            }
            let place = names.iter().position(|known| *known == name).and_then(|joint| places.get_mut(joint));
            *place.ok_or_else(|| {
                let robot = self.model.as_ref().map_or("the board", |model| model.name.as_str());
                PyValueError::new_err(format!(
                    "{robot} has no joint {name:?}; its joints are {}",
                    names.join(", ")
                ))
            })? = value;
        }
        Ok(())
    }
}

/// The model of a robot, or of that in a folder.
pub(super) fn model(robot: &Bound<'_, PyAny>) -> PyResult<RobotModel> {
    if let Ok(robot) = robot.cast::<Robot>() {
        return Ok(robot.get().folder.model.clone());
    }
    let folder: PathBuf = robot.extract().map_err(|_| {
        let kind = robot.get_type().name().map_or_else(|_| "?".to_owned(), |name| name.to_string());
        PyTypeError::new_err(format!(
            "robot is of type {kind}: expected a tesaki.Robot, or the path of a robot folder"
        ))
    })?;
    Ok(RobotFolder::load(&folder).map_err(file)?.model)
}

/// A time argument [s].
pub(super) fn seconds(name: &str, value: f64) -> PyResult<Duration> {
    if (0.0..=MAX_SECONDS).contains(&value) {
        return Ok(Duration::from_secs_f64(value));
    }
    Err(PyValueError::new_err(format!("{name} is {value}: expected seconds, 0 to {MAX_SECONDS}")))
}
