use core::fmt;

use nalgebra::Vector3;

use crate::control::JointPoint;
use crate::fault::FaultCause;
use crate::model::MAX_JOINTS;
use crate::robot::{Concerns, Measured, Postures, Robot, Targets};

/// What a task reads and writes. A later input is a further field and changes no task.
#[derive(Debug)]
pub struct Io<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// What its sensors say.
    pub measured: &'a Measured,
    /// Postures of its chains at the measured angles.
    pub postures: &'a Postures,
    /// The reference of each joint in the last tick; entries beyond its joints mean nothing.
    pub references: &'a [JointPoint; MAX_JOINTS],
    /// What the joints are to do.
    pub targets: &'a mut Targets,
}

/// Why a task cannot go on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskFault {
    /// The cause.
    pub cause: FaultCause,
    /// Index of the joint, if it concerns one.
    pub joint: Option<u8>,
    /// The offending value, see [`FaultCause`].
    pub value: f32,
    /// The limit that it broke.
    pub limit: f32,
}

/// What an enabled node does in each tick.
///
/// The implementing type is the task's whole state: plain data that can be exported and restored.
pub trait Task {
    /// Travels with the request that enables the task.
    type Config;
    /// What a supervisor may ask while the task runs.
    type Command;
    /// What a supervisor sees of the task. There from the moment it was enabled, and readable after it was disabled.
    type Telemetry;
    /// Why a config or a command was refused.
    type Refusal: Copy + fmt::Display + Concerns;

    /// A task that does nothing yet.
    const IDLE: Self;

    /// Checks everything for which [`begin`](Self::begin) could be refused.
    ///
    /// # Errors
    /// The first thing that forbids it.
    fn check(robot: &Robot, measured: &Measured, config: &Self::Config) -> Result<(), Self::Refusal>;

    /// Begins at rest, where the robot is. Called on [`IDLE`](Self::IDLE), after a successful [`check`](Self::check).
    fn begin(&mut self, io: Io<'_>, config: &Self::Config);

    /// Carries out a command between two ticks.
    ///
    /// # Errors
    /// Why it is refused; nothing has changed then.
    fn command(&mut self, io: Io<'_>, command: &Self::Command) -> Result<(), Self::Refusal>;

    /// One control period: sets the targets of this tick.
    ///
    /// # Errors
    /// The fault that ends the task.
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault>;

    /// What became of the targets under [`Actuation::Acceleration`](crate::robot::Actuation): the mean torques of the motors
    /// until the next tick [N·m], and the accelerations that the limits added [rad/s²].
    fn applied(&mut self, _robot: &Robot, _torques: &[f32; MAX_JOINTS], _added: &[f32; MAX_JOINTS]) {}

    /// Takes the forces that the task estimates itself for zero. `false` if it estimates none.
    fn tare(&mut self) -> bool {
        false
    }

    /// Acceleration of what a force sensor carries, in the base frame [m/s²].
    fn acceleration(&self) -> Vector3<f32> {
        Vector3::zeros()
    }

    /// What a supervisor sees.
    fn telemetry(&self, robot: &Robot, measured: &Measured, postures: &Postures) -> Self::Telemetry;
}
