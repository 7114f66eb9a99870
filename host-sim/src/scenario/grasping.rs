//! Common parts of the grasping scenarios: rig, trial, log, and the ratio of a grip to the least grip.

mod calibration;
mod figures;
mod grasp_log;
mod grip_ratio;
mod rig;
pub mod scene;
mod trial;

pub use calibration::calibrate;
pub use figures::{component_targets, components, moved, xyz};
pub use grasp_log::{GraspLog, GraspSample, table};
pub use grip_ratio::{GripRatio, grip_ratio, internal_forces};
pub use rig::{GraspRig, GraspedObject, PAPER_STRENGTH};
pub use trial::{GraspTrial, MOVE};

use super::{Scenario, ScenarioError, Setting};

/// Control period [s].
pub const T: f64 = 0.01;
/// How far an object is lifted off what it stands on [m].
pub const UP: f64 = 0.010;

/// Refuses a time that is shorter than the scenario's own.
pub fn require_duration(scenario: &Scenario, setting: &Setting<'_, '_>) -> Result<(), ScenarioError> {
    let Setting { duration, .. } = *setting;
    if duration.is_nan() || duration < scenario.duration {
        return Err(ScenarioError::TooShort { duration, name: scenario.name, minimum: scenario.duration });
    }
    Ok(())
}
