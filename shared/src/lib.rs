//! tesaki: the control core of robot hands and arms.
//!
//! One core, `no_std`, without allocation, I/O or clocks. A board, a simulator and a replay tool call the
//! same code and get bit-identical results. `docs/architecture.md` shows the loop around
//! [`Node::tick`](node::Node::tick).
//!
//! The modules are layers, each using only those before it:
//!
//! | module | holds |
//! |---|---|
//! | [`math`] | the elementary functions: `sin_cos`, `atan2`, `sqrt`; rotations; small solvers |
//! | [`signal`] | trajectory filter, pseudo-differentiator, rate limiter, minimum-jerk profile, motion within limits |
//! | [`model`] | a robot as data, and its validation |
//! | [`kinematics`] | forward, Jacobian, J̇q̇; inverse in closed form and iterated |
//! | [`dynamics`] | Newton–Euler, mass matrix |
//! | [`grasp`] | grasp map, internal forces, the least grip |
//! | [`control`] | PID, observer, friction feed-forward, joint servo, current loop of a motor, target impedance, discretised for a control period |
//! | [`teleop`] | following an operator's hand over a link; passivity of a link; fingertips of an operator's hand from a glove, and their calibration |
//! | [`vision`] | circle finding in a grey image |
//! | [`fault`] | causes of faults, and their log |
//! | [`robot`] | the model preprocessed for control; `Measured` and `Targets` |
//! | [`task`] | what an enabled node does: one module per task |
//! | [`behavior`] | behaviours that guide a task from outside the board: the visual approach |
//! | [`protocol`] | messages and their framing |
//! | [`node`] | modes, limits, faults, tick |
//!
//! *Configuration* (validated once, immutable) and *state* are separate types. SI units, single precision,
//! period [`TICK`].
//!
//! `examples/minimal_node.rs` is a node that moves one joint, in one file.
//!
#![doc = include_str!("papers.md")]
#![cfg_attr(not(test), no_std)]

pub mod behavior;
mod collect;
pub mod control;
pub mod dynamics;
pub mod fault;
pub mod grasp;
pub mod kinematics;
pub mod math;
pub mod model;
pub mod node;
pub mod protocol;
mod range;
pub mod robot;
pub mod signal;
pub mod task;
pub mod teleop;
#[cfg(any(test, feature = "test-support"))]
pub mod test_support;
pub mod vision;
mod zip;

pub use range::OutOfRange;

/// The control period `T` [s].
pub const TICK: f32 = 0.01;

/// Version of this crate: major, minor, patch.
pub const VERSION: [u8; 3] = [
    number(env!("CARGO_PKG_VERSION_MAJOR")),
    number(env!("CARGO_PKG_VERSION_MINOR")),
    number(env!("CARGO_PKG_VERSION_PATCH")),
];

const fn number(text: &str) -> u8 {
    match u8::from_str_radix(text, 10) {
        Ok(number) => number,
        Err(_) => panic!("a part of the crate's version is larger than 255"),
    }
}
