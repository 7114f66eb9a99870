//! The list of tasks: the one place that names them all.

use core::fmt;

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::api::{Io, Task, TaskFault};
use super::grasping::Grasping;
use super::impedance::ImpedanceControl;
use super::joint_servo::JointServoTask;
use crate::model::MAX_JOINTS;
use crate::robot::{Concerns, Measured, Postures, Robot};

/// Makes the enumerations over all tasks, and their dispatch.
///
/// A task's position is its number on the wire, and its bit in [`Identity`](crate::protocol::Identity): new tasks come at the
/// end. The first one's idle state is all zero, so that a node without a task lies in `.bss`.
macro_rules! tasks {
    (@first $first:ident($task:ty) $($rest:tt)*) => { Self::$first(<$task as Task>::IDLE) };
    ($($(#[$doc:meta])* $name:ident($task:ty) = $number:literal: $words:literal),* $(,)?) => {
        /// Which task.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub enum TaskKind { $($(#[$doc])* $name),* }

        /// Enables a task.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
        pub enum TaskConfig { $($(#[$doc])* $name(<$task as Task>::Config)),* }

        /// Asks something of a running task.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
        pub enum TaskCommand { $($(#[$doc])* $name(<$task as Task>::Command)),* }

        /// What a supervisor sees of a task.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
        pub enum TaskTelemetry { $($(#[$doc])* $name(<$task as Task>::Telemetry)),* }

        /// Why a task refused its config or a command.
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub enum TaskRefusal { $($(#[$doc])* $name(<$task as Task>::Refusal)),* }

        /// The state of the task that runs, or ran last.
        #[derive(Clone, Debug, Serialize, Deserialize, Schema)]
        #[expect(clippy::large_enum_variant, reason = "it is kept in place, once, and never moved")]
        #[repr(u8)]
        pub enum TaskState { $($(#[$doc])* $name($task)),* }

        impl TaskKind {
            /// All tasks.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];
        }

        impl fmt::Display for TaskKind {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self { $(Self::$name => $words),* })
            }
        }

        impl TaskConfig {
            /// The task that it enables.
            pub const fn kind(&self) -> TaskKind {
                match self { $(Self::$name(_) => TaskKind::$name),* }
            }
        }

        impl fmt::Display for TaskRefusal {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self { $(Self::$name(refusal) => refusal.fmt(f)),* }
            }
        }

        impl Concerns for TaskRefusal {
            fn joint(&self) -> Option<u8> {
                match self { $(Self::$name(refusal) => refusal.joint()),* }
            }

            fn chain(&self) -> Option<u8> {
                match self { $(Self::$name(refusal) => refusal.chain()),* }
            }
        }

        impl TaskState {
            /// The first task, idle.
            pub const NONE: Self = tasks!(@first $($name($task))*);

            /// The task.
            pub const fn kind(&self) -> TaskKind {
                match self { $(Self::$name(_) => TaskKind::$name),* }
            }

            /// See [`Task::check`].
            ///
            /// # Errors
            /// What forbids the task.
            pub fn check(robot: &Robot, measured: &Measured, config: &TaskConfig) -> Result<(), TaskRefusal> {
                match config {
                    $(TaskConfig::$name(config) => {
                        <$task as Task>::check(robot, measured, config).map_err(TaskRefusal::$name)
                    })*
                }
            }

            /// See [`Task::begin`].
            #[inline(never)]
            pub fn begin(&mut self, io: Io<'_>, config: &TaskConfig) {
                match config {
                    $(TaskConfig::$name(config) => {
                        // Copied from a static: by value it would take its size of the stack, several times.
                        static IDLE: TaskState = TaskState::$name(<$task as Task>::IDLE);
                        self.clone_from(&IDLE);
                        if let Self::$name(task) = self {
                            task.begin(io, config);
                        }
                    })*
                }
            }

            /// See [`Task::command`].
            ///
            /// # Errors
            /// `Ok(false)`: the command is another task's.
            pub fn command(&mut self, io: Io<'_>, command: &TaskCommand) -> Result<bool, TaskRefusal> {
                match (self, command) {
                    $((Self::$name(task), TaskCommand::$name(command)) => {
                        task.command(io, command).map_err(TaskRefusal::$name)?;
                        Ok(true)
                    })*
                    _ => Ok(false),
                }
            }

            /// See [`Task::tick`].
            ///
            /// # Errors
            /// The fault that ends the task.
            #[inline]
            pub fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
                match self { $(Self::$name(task) => task.tick(io)),* }
            }

            /// See [`Task::applied`].
            pub fn applied(&mut self, robot: &Robot, torques: &[f32; MAX_JOINTS], added: &[f32; MAX_JOINTS]) {
                match self { $(Self::$name(task) => task.applied(robot, torques, added)),* }
            }

            /// See [`Task::tare`].
            pub fn tare(&mut self) -> bool {
                match self { $(Self::$name(task) => task.tare()),* }
            }

            /// See [`Task::acceleration`].
            pub fn acceleration(&self) -> Vector3<f32> {
                match self { $(Self::$name(task) => task.acceleration()),* }
            }

            /// See [`Task::telemetry`].
            pub fn telemetry(&self, robot: &Robot, measured: &Measured, postures: &Postures) -> TaskTelemetry {
                match self {
                    $(Self::$name(task) => TaskTelemetry::$name(task.telemetry(robot, measured, postures))),*
                }
            }
        }

        $(const _: () = assert!(TaskKind::$name as u8 == $number, "a task's number is its position");)*
    };
}

tasks! {
    /// 0: every joint follows its own set-point ([`super::joint_servo`]).
    JointServo(JointServoTask) = 0: "joint servo",
    /// 1: three fingers grasp and move an object ([`super::grasping`]).
    Grasping(Grasping) = 1: "grasping",
    /// 2: an arm yields at its tool ([`super::impedance`]).
    Impedance(ImpedanceControl) = 2: "impedance control",
}
