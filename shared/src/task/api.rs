use core::error::Error;
use core::fmt;

use nalgebra::Vector3;

use crate::control::JointPoint;
use crate::fault::{Fault, FaultCause, Finding};
use crate::model::MAX_JOINTS;
use crate::robot::{Concerns, Efforts, Measured, Postures, Robot, Targets};

/// Inputs and outputs of a task. A further input is a further field and changes no task.
pub struct Io<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// Its measured state.
    pub measured: &'a Measured,
    /// Postures of its chains at the measured angles.
    pub postures: &'a Postures,
    /// Torques of the drives beyond the model in the last tick.
    pub efforts: &'a dyn Efforts,
    /// Reference of each joint in the last tick. Entries beyond the robot's joints are meaningless.
    pub references: &'a [JointPoint; MAX_JOINTS],
    /// Targets of the joints.
    pub targets: &'a mut Targets,
}

/// A fault that stops a task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskFault {
    /// The cause.
    pub cause: FaultCause,
    /// Index of the joint, if it concerns one.
    pub joint: Option<u8>,
    /// The value that exceeds the limit, see [`FaultCause`].
    pub value: f32,
    /// The limit.
    pub limit: f32,
}

impl fmt::Display for TaskFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { cause, joint, value, limit } = *self;
        if let Some(joint) = joint {
            write!(f, "joint {joint}: ")?;
        }
        Finding { cause, value, limit }.fmt(f)
    }
}

impl Error for TaskFault {}

/// How a robot that can still be controlled comes to rest after a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Halt {
    /// The joint servos bring each joint to rest. Their feed-forward torques remain.
    Joints,
    /// The task brings the robot to rest: its ticks continue. Another fault of the task leads to damping.
    Task,
    /// The task cannot hold the robot: it is damped.
    Damp,
}

/// What may be tared. The tare of a loaded sensor would subtract that load from every later force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tareable {
    /// The force sensors.
    pub sensors: bool,
    /// The task's own estimate of the force.
    pub estimate: bool,
}

/// What an enabled node does in each tick.
///
/// The implementing type is the task's whole state: plain data that can be exported and restored.
pub trait Task {
    /// Sent with the request that enables the task.
    type Config;
    /// Requests to the running task.
    type Command;
    /// State that the supervisor sees, also after the task was disabled.
    type Telemetry;
    /// Why a config or a command is refused.
    type Refusal: Copy + Error + Concerns;

    /// The state before the task begins.
    const IDLE: Self;

    /// Checks all preconditions of [`begin`](Self::begin).
    ///
    /// # Errors
    /// The first one that does not hold.
    fn check(robot: &Robot, measured: &Measured, config: &Self::Config) -> Result<(), Self::Refusal>;

    /// Begins at rest at the robot's present position. Called on [`IDLE`](Self::IDLE), after a successful
    /// [`check`](Self::check). The joint servos hold the joints there: references and targets are set.
    fn begin(&mut self, io: Io<'_>, config: &Self::Config);

    /// Carries out a command between two ticks.
    ///
    /// # Errors
    /// Why it is refused; the state is unchanged then.
    fn command(&mut self, io: Io<'_>, command: &Self::Command) -> Result<(), Self::Refusal>;

    /// Runs one control period: sets the targets of this tick.
    ///
    /// # Errors
    /// The fault that stops the task.
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault>;

    /// Begins the controlled stop after a fault that leaves the measured joint state valid, on a robot whose
    /// reaction is to hold.
    fn halt(&mut self, _io: Io<'_>, _fault: &Fault) -> Halt {
        Halt::Joints
    }

    /// Feedback of the torques that [`Actuation::Acceleration`](crate::robot::Actuation) applied: mean motor
    /// torques until the next tick [N·m], and the accelerations that the limits added [rad/s²].
    fn applied(&mut self, _robot: &Robot, _torques: &[f32; MAX_JOINTS], _added: &[f32; MAX_JOINTS]) {}

    /// What may be tared now. A tare is refused if nothing may be.
    fn tareable(&self) -> Tareable {
        Tareable { sensors: true, estimate: false }
    }

    /// Tares the task's estimate of the force. Called only while it is [tareable](Self::tareable).
    fn tare_estimate(&mut self) {}

    /// Acceleration of the mass on the force sensor, in the base frame [m/s²].
    fn acceleration(&self) -> Vector3<f32> {
        Vector3::zeros()
    }

    /// The state that the supervisor sees.
    fn telemetry(&self, robot: &Robot, measured: &Measured, postures: &Postures) -> Self::Telemetry;
}
