//! Unit tests of the control, without a node.

mod arm_angle;
mod external_torque;
mod fixture;
mod loss;
mod pressing;
mod resolver;
mod setpoints;
mod settings;
mod step4;
mod stopping;

pub use fixture::{SOFT, arm7};
