//! What an enabled node does: one module per task.
//!
//! A task turns what is [`Measured`](crate::robot::Measured) into [`Targets`](crate::robot::Targets) for the joints, once a
//! tick. It knows nothing of messages, modes and limits: those are the [node](crate::node)'s, which knows that there are
//! tasks, but not which.
//!
//! | task | module | what it does |
//! |---|---|---|
//! | joint servo | [`joint_servo`] | every joint follows its own set-point, or every fingertip its own |
//! | grasping | [`grasping`] | three fingers find, grasp, hold, move and put down an object |
//! | impedance | [`impedance`] | an arm's tool yields like a mass on a spring and a damper |
//!
//! A new task is a module that implements [`Task`], and a line in the list (`list.rs`).

mod api;
pub mod grasping;
pub mod impedance;
pub mod joint_servo;
mod list;

pub use api::{Io, Task, TaskFault};
pub use list::{TaskCommand, TaskConfig, TaskKind, TaskRefusal, TaskState, TaskTelemetry};
