//! Common parts of the grasping scenarios: rig, trial, log, and the grip ratio.

mod calibration;
mod figures;
mod grasp_log;
mod grip_ratio;
mod rig;
pub mod scene;
mod trial;

pub use calibration::{SimulatedMachine, calibrate};
pub use figures::{component_targets, components, displacements, xyz};
pub use grasp_log::{GraspEstimates, GraspLog, GraspSample, table};
pub use grip_ratio::{GripRatio, grip_ratio, internal_forces};
pub use rig::{GraspRig, GraspedObject};
pub use trial::{GraspTrial, MOVE};

/// Height by which an object is lifted off its support [m].
pub const LIFT: f64 = 0.010;
