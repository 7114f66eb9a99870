//! The simulated three-finger hand and arm: compared with MuJoCo and hand calculations, and errors for
//! invalid input.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "tests"
)]
#![allow(clippy::manual_range_contains, reason = "reads as on paper")]

mod arm;
#[allow(clippy::approx_constant, reason = "numbers that a program wrote")]
mod arm_motion;
mod contact;
mod contact_motion;
mod environment;
mod errors;
mod fixtures;
mod force;
mod friction;
mod grip;
mod hand;
mod linkage;
mod motion;
mod objects;
mod pinch;
mod sensors;
mod six_joint_arm;
