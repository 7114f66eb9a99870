//! The node: state machine, limits, faults and control tick of a controller board.
//!
//! ```text
//!      ┌─────────────────── Stop ──────────────────────────┐
//!      │        Enable                   fault, Stop       ▼
//!   Disabled ─────────► Enabled(task) ─────────────────► Fault
//!      ▲ ▲  Disable          │                             │
//!      │ └───────────────────┘                 ClearFaults │
//!      └───────────────────────────────────────────────────┘
//! ```
//!
//! In `Fault` the outputs follow the configured [`Reaction`]; `Disable` switches them off, but the fault
//! remains until it is read and cleared.
//!
//! A [`Node`] has no clock, no I/O and no waiting. [`Node::tick`] is a function of its state, one
//! [`SensorFrame`](crate::protocol::SensorFrame) and the requests [handled](Node::handle) since the last
//! tick.

mod clients;
mod export;
mod force_sensor;
mod handle;
mod joint;
mod lease;
mod optional;
mod replay;
mod safety;
mod state;
mod stop_energy;
mod tick;
mod transfer;

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::float_cmp,
    clippy::indexing_slicing,
    reason = "tests"
)]
mod tests;

pub use export::{MAX_MODEL, MAX_STATE};
pub use replay::{Difference, Replay, ReplayError};
pub use state::{STATE_KEY, State};

use heapless::Vec;

use crate::fault::{Fault, FaultLog};
use crate::model::Reaction;
use crate::protocol::{
    BoardStatus, FromBoard, JointTelemetry, Mode, Stream, TaskReport, Telemetry, TipTelemetry, Tips,
};
use crate::robot::{Postures, Robot};
use crate::task::{Io, TaskState};
use export::Export;
use transfer::Transfer;

/// The controller of one board: configuration (the [`Robot`]) and state.
#[derive(Clone, Debug)]
pub struct Node {
    robot: Robot,
    model_checksum: u32,
    transfer: Transfer,
    export: Export,
    /// A cache that depends on the state only.
    postures: Postures,
    state: State,
}

impl Default for Node {
    fn default() -> Self {
        Self::new()
    }
}

impl Node {
    /// A disabled node without a robot.
    pub const fn new() -> Self {
        Self {
            robot: Robot::NONE,
            model_checksum: 0,
            transfer: Transfer::new(),
            export: Export::new(),
            postures: Postures::NONE,
            state: State::new(),
        }
    }

    /// The mode.
    pub const fn mode(&self) -> Mode {
        self.state.mode
    }

    /// Reaction of the outputs in [`Mode::Fault`], and whether the task itself brings the robot to rest.
    pub fn reaction(&self) -> (Reaction, bool) {
        (self.state.reaction, self.state.halting && self.is_holding())
    }

    /// The robot; `None` before the first model.
    pub fn robot(&self) -> Option<&Robot> {
        self.robot.loaded()
    }

    /// The faults so far.
    pub const fn faults(&self) -> &FaultLog {
        &self.state.faults
    }

    /// Checksum of the names of the joints that the faults refer to by index. A board retains it over a
    /// reset, with the faults.
    pub const fn fault_joints(&self) -> u32 {
        self.state.fault_joints
    }

    /// Restores the faults from before a reset, and the [checksum](Self::fault_joints) of their joints. Call
    /// it before the first tick.
    pub fn restore_faults(&mut self, log: FaultLog, joints: u32) {
        (self.state.faults, self.state.fault_joints) = (log, joints);
    }

    /// Records a fault of the board without a change of the mode, for instance the cause of a reset.
    pub fn record_fault(&mut self, fault: Fault) {
        self.state.faults.record(fault);
    }

    /// Sequence number of the last tick; 0 before the first.
    pub fn last_tick(&self) -> u32 {
        self.state.tick
    }

    /// The message of `stream` after the last tick; `None` when it is not due. Log entries are sent one by
    /// one, not here.
    pub fn due(&self, stream: Stream, board: &BoardStatus) -> Option<FromBoard> {
        if !self.is_due(stream) {
            return None;
        }
        match stream {
            Stream::Telemetry => Some(FromBoard::Telemetry(self.telemetry())),
            Stream::Status => Some(FromBoard::Status(self.status(board))),
            Stream::Log => None,
            Stream::Tips => Some(FromBoard::Tips(self.tips())),
            Stream::Task => self.task_report().map(FromBoard::Task),
        }
    }

    /// Whether `stream` is due after the last tick.
    pub fn is_due(&self, stream: Stream) -> bool {
        let every = self.state.rates.get(stream as usize).copied().unwrap_or(0);
        self.state.tick.checked_rem(every.into()) == Some(0)
    }

    /// Whether the log is sent.
    pub fn is_logged(&self) -> bool {
        self.state.rates[Stream::Log as usize] != 0
    }

    /// Number of requests and frames so far: the index of the last log entry. A tick has two entries.
    pub const fn records(&self) -> u32 {
        self.state.records
    }

    /// Resets the node to its state after power-on.
    #[inline(never)]
    fn reset(&mut self) {
        *self = Self::new();
    }

    /// Restores `state`, the postcard encoding of a [`State`]. Returns `false`, without change, if it is
    /// invalid.
    #[inline(never)]
    fn restore(&mut self, state: &[u8]) -> bool {
        match postcard::take_from_bytes(state) {
            Ok((state, [])) => {
                self.state = state;
                self.postures.clear();
                true
            }
            _ => false,
        }
    }

    /// Telemetry of the joints after the last tick.
    pub fn telemetry(&self) -> Telemetry {
        let mut joints = Vec::new();
        let State { measured, references, .. } = &self.state;
        let measured = measured.positions.iter().zip(&measured.velocities);
        let states = self.state.joints.iter().zip(references).zip(measured);
        for ((state, reference), (&position, &velocity)) in states.take(self.robot.joints().len()) {
            let reference = reference.position;
            // Cannot fail: the capacity is that of the robot.
            let _ = joints.push(JointTelemetry { position, velocity, reference, torque: state.torque });
        }
        Telemetry { tick: self.state.tick, mode: self.state.mode, faults: self.state.faults.total, joints }
    }

    /// Telemetry of the tips after the last tick.
    pub fn tips(&self) -> Tips {
        let mut tips = Vec::new();
        let measured = &self.state.measured;
        for (chain, &[fx, fy, fz, tx, ty, tz]) in (0..self.robot.chains().len()).zip(&measured.wrenches) {
            let Some(posture) = self.postures.of(&self.robot, measured, chain) else { break };
            let position = posture.tip().translation.vector.into();
            let (force, torque, tared) = ([fx, fy, fz], [tx, ty, tz], measured.is_tared(chain));
            // Cannot fail: the capacity is that of the robot.
            let _ = tips.push(TipTelemetry { position, force, torque, tared });
        }
        Tips { tick: self.state.tick, tips }
    }

    /// Telemetry of the running task, or of the last one; `None` before the first.
    pub fn task_report(&self) -> Option<TaskReport> {
        let state = &self.state;
        let telemetry =
            state.has_task.then(|| state.task.telemetry(&self.robot, &state.measured, &self.postures))?;
        Some(TaskReport { tick: state.tick, telemetry })
    }

    /// The task with its inputs and outputs.
    fn task_and_io(&mut self) -> (&mut TaskState, Io<'_>) {
        let Self { robot, postures, state, .. } = self;
        let State { measured, references, targets, task, joints, .. } = state;
        (task, Io { robot, measured, postures, efforts: joints, references, targets })
    }
}
