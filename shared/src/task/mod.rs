//! What an enabled node does: one module per task.
//!
//! A task computes [`Targets`](crate::robot::Targets) for the joints from the
//! [`Measured`](crate::robot::Measured) state, once per tick. Messages, modes and limits belong to the
//! [node](crate::node), which does not know the individual tasks.
//!
//! | task | module | what it does |
//! |---|---|---|
//! | joint servo | [`joint_servo`] | each joint, or each fingertip, follows a set-point |
//! | grasping | [`grasping`] | three fingers approach, grasp, hold, move and release an object |
//! | impedance | [`impedance`] | Cartesian impedance control of an arm |
//! | telexistence | [`telexistence`] | a hand reproduces the fingertips of an operator |
//! | visual approach | [`visual_approach`] | a hand moves to targets from a camera on it, and grips |
//!
//! A new task is a module that implements [`Task`], and a line in the list (`list.rs`).

mod api;
pub mod grasping;
pub mod impedance;
pub mod joint_servo;
mod list;
pub mod telexistence;
pub mod visual_approach;

pub use api::{Halt, Io, Tareable, Task, TaskFault};
pub use list::{TaskCommand, TaskConfig, TaskKind, TaskRefusal, TaskState, TaskTelemetry};
