//! The list of tasks: the only place that names them all.

use core::fmt;

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::api::{Halt, Io, Tareable, Task, TaskFault};
use super::grasping::Grasping;
use super::impedance::ImpedanceControl;
use super::joint_servo::JointServoTask;
use super::telexistence::Telexistence;
use super::visual_approach::VisualApproach;
use crate::fault::Fault;
use crate::model::MAX_JOINTS;
use crate::robot::{Concerns, Measured, Postures, Robot};

/// Generates the enumerations over all tasks, and their dispatch.
///
/// A task's position is its number on the wire and its bit in [`Identity`](crate::protocol::Identity), so new
/// tasks come last. The idle state of the first task is all zero, which places a new node in `.bss`.
macro_rules! tasks {
    (@first $first:ident($task:ty) $($rest:tt)*) => { Self::$first(<$task as Task>::IDLE) };
    ($($(#[$doc:meta])* $name:ident($task:ty) = $number:literal: $words:literal),* $(,)?) => {
        /// Kind of a task.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub enum TaskKind { $($(#[$doc])* $name),* }

        /// Config that enables a task.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
        pub enum TaskConfig { $($(#[$doc])* $name(<$task as Task>::Config)),* }

        /// Command to the running task.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
        pub enum TaskCommand { $($(#[$doc])* $name(<$task as Task>::Command)),* }

        /// Telemetry of a task.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
        pub enum TaskTelemetry { $($(#[$doc])* $name(<$task as Task>::Telemetry)),* }

        /// Why a task refuses its config or a command.
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub enum TaskRefusal { $($(#[$doc])* $name(<$task as Task>::Refusal)),* }

        /// State of the running task, or of the last one.
        #[derive(Clone, Debug, Serialize, Deserialize, Schema)]
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
            /// The task that this config enables.
            pub const fn kind(&self) -> TaskKind {
                match self { $(Self::$name(_) => TaskKind::$name),* }
            }
        }

        impl TaskTelemetry {
            /// The task of this telemetry.
            pub const fn kind(&self) -> TaskKind {
                match self { $(Self::$name(_) => TaskKind::$name),* }
            }
        }

        impl fmt::Display for TaskRefusal {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self { $(Self::$name(refusal) => refusal.fmt(f)),* }
            }
        }

        impl core::error::Error for TaskRefusal {}

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

            /// Kind of the task.
            pub const fn kind(&self) -> TaskKind {
                match self { $(Self::$name(_) => TaskKind::$name),* }
            }

            /// See [`Task::check`].
            ///
            /// # Errors
            /// The precondition that does not hold.
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
                        *self = Self::$name(<$task as Task>::IDLE);
                        if let Self::$name(task) = self {
                            task.begin(io, config);
                        }
                    })*
                }
            }

            /// See [`Task::command`]. Returns `false` for a command to another task.
            ///
            /// # Errors
            /// The refusal.
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
            /// The fault that stops the task.
            #[inline]
            pub fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
                match self { $(Self::$name(task) => task.tick(io)),* }
            }

            /// See [`Task::halt`].
            pub fn halt(&mut self, io: Io<'_>, fault: &Fault) -> Halt {
                match self { $(Self::$name(task) => task.halt(io, fault)),* }
            }

            /// See [`Task::applied`].
            pub fn applied(&mut self, robot: &Robot, torques: &[f32; MAX_JOINTS], added: &[f32; MAX_JOINTS]) {
                match self { $(Self::$name(task) => task.applied(robot, torques, added)),* }
            }

            /// See [`Task::tareable`].
            pub fn tareable(&self) -> Tareable {
                match self { $(Self::$name(task) => task.tareable()),* }
            }

            /// See [`Task::tare_estimate`].
            pub fn tare_estimate(&mut self) {
                match self { $(Self::$name(task) => task.tare_estimate()),* }
            }

            /// See [`Task::acceleration`].
            pub fn acceleration(&self) -> Vector3<f32> {
                match self { $(Self::$name(task) => task.acceleration()),* }
            }

            /// See [`Task::telemetry`].
            pub fn telemetry(
                &self,
                robot: &Robot,
                measured: &Measured,
                postures: &Postures,
            ) -> TaskTelemetry {
                match self {
                    $(Self::$name(task) => TaskTelemetry::$name(task.telemetry(robot, measured, postures))),*
                }
            }
        }

        $(const _: () = assert!(TaskKind::$name as u8 == $number, "a task's number must be its position");)*
    };
}

tasks! {
    /// 0: joint servo ([`super::joint_servo`]).
    JointServo(JointServoTask) = 0: "joint servo",
    /// 1: grasping with three fingers ([`super::grasping`]).
    Grasping(Grasping) = 1: "grasping",
    /// 2: impedance control of an arm ([`super::impedance`]).
    Impedance(ImpedanceControl) = 2: "impedance control",
    /// 3: the operator's fingertips on a hand ([`super::telexistence`]).
    Telexistence(Telexistence) = 3: "telexistence",
    /// 4: visual guidance of a hand by its camera ([`super::visual_approach`]).
    VisualApproach(VisualApproach) = 4: "visual approach",
}
