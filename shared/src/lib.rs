//! tesaki: the control core of robot hands and arms.
//!
//! One core, written once, `no_std`, without allocation, free of I/O and of clocks. A board, a simulator and
//! a replay tool call the same code and get the same bits:
//!
//! ```text
//!          bytes                    Request                   SensorFrame
//!  serial ───────► codec ─────────► Node::handle ──┐      board or plant ──┐
//!         ◄─────── (COBS, CRC) ◄─── Reply,       ◄─┴── Node::tick ◄────────┘
//!                                   Telemetry            │ ActuatorFrame
//!                                                        └────────────► board or plant
//! ```
//!
//! The modules are layers, each using only those before it:
//!
//! | module | holds |
//! |---|---|
//! | [`math`] | elementary functions, SO(3), small solvers |
//! | [`signal`] | trajectory filter, pseudo-differentiator, rate limiter |
//! | [`model`] | the robot as data |
//! | [`kinematics`] | forward, Jacobian, J̇q̇; inverse in closed form and iterative |
//! | [`dynamics`] | Newton–Euler, mass matrix |
//! | [`grasp`] | contacts and forces: grasp map, internal forces, the least grip |
//! | [`control`] | PID, observer, friction feed-forward, joint servo |
//! | [`teleop`] | unilateral master-slave control over a delayed link, passivity of bilateral links |
//! | [`vision`] | circle finding in a grey image |
//! | [`fault`] | causes of faults, and their log |
//! | [`robot`] | preprocessed model, measured state, targets of the joints |
//! | [`task`] | what an enabled node does: joint servo, grasping, impedance control |
//! | [`behavior`] | what leads the visual approach, beside the board |
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
pub mod robot;
pub mod signal;
pub mod task;
pub mod teleop;
#[cfg(any(test, feature = "test-support"))]
pub mod test_support;
pub mod vision;
mod zip;

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
