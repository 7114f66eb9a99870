use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

#[cfg(doc)]
use super::FromBoard;
use super::status::Mode;
use crate::model::{MAX_CHAINS, MAX_JOINTS};
use crate::task::TaskTelemetry;

/// Periodic messages of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stream {
    /// 0: [`FromBoard::Telemetry`].
    Telemetry,
    /// 1: [`FromBoard::Status`].
    Status,
    /// 2: [`FromBoard::Log`]: all inputs and outputs of the node. Complete for any period except 0.
    Log,
    /// 3: [`FromBoard::Tips`].
    Tips,
    /// 4: [`FromBoard::Task`], after the first task was enabled.
    Task,
}

impl Stream {
    /// All streams.
    pub const ALL: [Self; 5] = [Self::Telemetry, Self::Status, Self::Log, Self::Tips, Self::Task];
}

/// The state of the node after a tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Telemetry {
    /// The tick.
    pub tick: u32,
    /// Mode.
    pub mode: Mode,
    /// Faults since power-on.
    pub faults: u32,
    /// One entry for each joint.
    pub joints: Vec<JointTelemetry, MAX_JOINTS>,
}

/// The tips after a tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Tips {
    /// The tick.
    pub tick: u32,
    /// One entry for each chain.
    pub tips: Vec<TipTelemetry, MAX_CHAINS>,
}

/// A tip after a tick, in the base frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TipTelemetry {
    /// Position [m].
    pub position: [f32; 3],
    /// External force, without the weight on the sensor [N]; 0 without a sensor.
    pub force: [f32; 3],
    /// External torque, about the tip [N·m].
    pub torque: [f32; 3],
    /// Whether its force sensor was tared.
    pub tared: bool,
}

/// A joint after a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct JointTelemetry {
    /// Measured angle [rad].
    pub position: f32,
    /// Measured velocity [rad/s].
    pub velocity: f32,
    /// Reference angle [rad].
    pub reference: f32,
    /// Torque [N·m].
    pub torque: f32,
}

/// Telemetry of the running task after a tick, or of the last task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct TaskReport {
    /// The tick.
    pub tick: u32,
    /// Telemetry of the task.
    pub telemetry: TaskTelemetry,
}
