//! Everything that a controller board decides: modes, limits, faults, tick.
//!
//! ```text
//!              Arm                    fault, Stop
//!  Disarmed ─────────► Armed(task) ─────────────────► Fault
//!     ▲ ▲  Disarm           │                          │
//!     │ └───────────────────┘              ClearFaults │
//!     └────────────────────────────────────────────────┘
//! ```
//!
//! In `Fault` the outputs follow the configured [`Reaction`]; `Disarm` puts them off there, too, but the fault stays
//! until it was read and cleared.
//!
//! A [`Node`] never reads a clock, waits or touches a pin. [`Node::tick`] is a function of its state, one
//! [`SensorFrame`](crate::protocol::SensorFrame) and the requests [handled](Node::handle) since the last tick.

mod export;
mod handle;
mod joint;
mod lease;
mod replay;
mod robot;
mod state;
mod tick;
mod tip;
mod transfer;

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::float_cmp,
    clippy::indexing_slicing,
    reason = "tests"
)]
mod tests;

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::float_cmp,
    clippy::indexing_slicing,
    reason = "tests"
)]
mod arm_tests;

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod arm_loop_tests;

pub use replay::{Difference, Replay, ReplayError};
pub use robot::Robot;
pub use state::State;

use heapless::Vec;

use crate::arm::ArmTelemetry;
use crate::control::Actuation;
use crate::manipulation::GraspTelemetry;
use crate::model::{MAX_CHAIN_JOINTS, MAX_JOINTS, Reaction};
use crate::protocol::{Fault, FaultLog, JointTelemetry, Mode, Stream, Telemetry, TipTelemetry, Tips};
use export::Export;
use joint::JointState;
use transfer::Transfer;

/// Longest postcard encoding of a [`State`].
const MAX_STATE: usize = 5120;

/// The controller of one board: configuration (the [`Robot`]), state, and the rules between them.
#[derive(Clone, Debug)]
pub struct Node {
    robot: Robot,
    model_checksum: u32,
    transfer: Transfer,
    export: Export,
    state: State,
}

impl Default for Node {
    fn default() -> Self {
        Self::new()
    }
}

impl Node {
    /// A disarmed node without a robot.
    pub const fn new() -> Self {
        Self {
            robot: Robot::NONE,
            model_checksum: 0,
            transfer: Transfer::new(),
            export: Export::new(),
            state: State::new(),
        }
    }

    /// The mode.
    pub const fn mode(&self) -> Mode {
        self.state.mode
    }

    /// The robot, once a model was accepted.
    pub fn robot(&self) -> Option<&Robot> {
        self.robot.loaded()
    }

    /// The faults so far.
    pub const fn faults(&self) -> &FaultLog {
        &self.state.faults
    }

    /// Takes over the faults from before a reset and adds what the board found at boot. Before the first tick.
    pub fn restore_faults(&mut self, log: FaultLog) {
        self.state.faults = log;
    }

    /// Adds a fault that the board found and that does not concern the mode, for instance the cause of a reset.
    pub fn record_fault(&mut self, fault: Fault) {
        self.state.faults.record(fault);
    }

    /// Sequence number of the last tick; 0 before the first.
    pub fn last_tick(&self) -> u32 {
        self.state.tick
    }

    /// Whether `stream` is due after the last tick.
    pub fn is_due(&self, stream: Stream) -> bool {
        let every = self.state.rates.get(stream as usize).copied().unwrap_or(0);
        self.state.tick.checked_rem(every.into()) == Some(0)
    }

    /// Whether anybody wants the log.
    pub fn is_logged(&self) -> bool {
        self.state.rates[Stream::Log as usize] != 0
    }

    /// How many requests and frames there were: the index of the last entry of the log. A tick makes two entries.
    pub const fn records(&self) -> u32 {
        self.state.records
    }

    /// As after power-on.
    #[inline(never)]
    fn reset(&mut self) {
        *self = Self::new();
    }

    /// Goes on from `state`, the postcard encoding of a [`State`]; `false`, and no change, when it is none.
    #[inline(never)]
    fn restore(&mut self, state: &[u8]) -> bool {
        match postcard::take_from_bytes(state) {
            Ok((state, [])) => {
                self.state = state;
                true
            }
            _ => false,
        }
    }

    /// The state after the last tick.
    pub fn telemetry(&self) -> Telemetry {
        let mut joints = Vec::new();
        for state in self.state.joints.iter().take(self.robot.joints.len()) {
            // Cannot fail, as below.
            let _ = joints.push(JointTelemetry {
                position: state.position,
                velocity: state.velocity,
                reference: state.reference.position,
                torque: state.torque,
            });
        }
        Telemetry { tick: self.state.tick, mode: self.state.mode, faults: self.state.faults.total, joints }
    }

    /// The tips after the last tick.
    pub fn tips(&self) -> Tips {
        let mut tips = Vec::new();
        let mut first = 0;
        for ((chain, _), state) in self.robot.chains.iter().zip(&self.state.tips) {
            let mut angles = [0.0; MAX_CHAIN_JOINTS];
            let states = self.state.joints.iter().skip(first).take(chain.len());
            angles.iter_mut().zip(states).for_each(|(angle, joint)| *angle = joint.position);
            first += chain.len();
            let position = chain.posture(&angles).tip().translation.vector.into();
            let (force, torque, tared) = (state.force, state.torque, state.tared);
            // Cannot fail: there are no more chains than places.
            let _ = tips.push(TipTelemetry { position, force, torque, tared });
        }
        Tips { tick: self.state.tick, tips }
    }

    /// The grasp after the last tick.
    pub fn grasp(&self) -> GraspTelemetry {
        self.state.hand.telemetry(self.state.tick)
    }

    /// The arm and its tool after the last tick, if the robot is one.
    pub fn tool(&self) -> Option<ArmTelemetry> {
        Some(self.state.arm.telemetry(&self.robot.arm()?, &self.state.arm_sense(), self.state.tick))
    }

    /// One value for each joint of the robot.
    fn for_each_joint(&self, value: fn(&JointState) -> f32) -> Vec<f32, MAX_JOINTS> {
        let count = self.robot.joints.len();
        let mut list = Vec::new();
        for state in self.state.joints.iter().take(count) {
            // Cannot fail: there are no more states than places. (`collect` would bring in a panic.)
            let _ = list.push(value(state));
        }
        list
    }

    /// Records a fault and reacts to it.
    fn fail(&mut self, fault: Fault) {
        let reaction = match self.robot.loaded() {
            Some(robot) if fault.cause.leaves_sensors_trustworthy() => robot.model().safety.reaction,
            _ => Reaction::Off,
        };
        match self.state.mode {
            Mode::Disarmed => return,
            // A fault is answered once; only one that takes more away counts after it.
            Mode::Fault if reaction != Reaction::Off || self.state.reaction == Reaction::Off => return,
            Mode::Fault => {}
            Mode::Armed(_) => {
                if reaction == Reaction::Hold {
                    // Where no servo was at work, there is no reference to come to rest along.
                    let no_servo = !matches!(self.state.drive, Actuation::Servo);
                    let at_once = no_servo || fault.cause.means_motion_is_wrong();
                    self.state.drive = Actuation::Servo;
                    for state in &mut self.state.joints {
                        state.hold(at_once);
                    }
                }
            }
        }
        self.state.faults.record(fault);
        self.state.mode = Mode::Fault;
        self.state.reaction = reaction;
        self.state.streaming = false;
    }
}
