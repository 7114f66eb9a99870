//! The parts of the control by themselves, and a tick without a node around it.

mod arm_angle;
mod machine;
mod momentum;
mod resolver;
mod set_points;
mod settings;
mod stopping;

pub use machine::{SOFT, arm7};
