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

mod handle;
mod joint;
mod robot;
mod tick;
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

pub use robot::Robot;

use heapless::Vec;

use crate::control::ServoMode;
use crate::model::{MAX_JOINTS, Reaction};
use crate::protocol::{Fault, FaultLog, Mode, Telemetry};
use joint::JointState;
use transfer::Transfer;

/// The controller of one board: configuration (the [`Robot`]), state, and the rules between them.
#[derive(Clone, Debug)]
pub struct Node {
    robot: Robot,
    model_checksum: u32,
    transfer: Transfer,
    /// Whether a hello with our schema key came.
    agreed: bool,
    mode: Mode,
    /// What the outputs do in [`Mode::Fault`].
    reaction: Reaction,
    servo_mode: ServoMode,
    /// Sequence number of the last sensor frame.
    tick: Option<u32>,
    /// What the last sensor frame showed that would be a fault when armed.
    alarm: Option<Fault>,
    /// Ticks since the last accepted command.
    silence: u32,
    /// Whether references come point by point instead of through the trajectory filter.
    streaming: bool,
    joints: [JointState; MAX_JOINTS],
    faults: FaultLog,
    telemetry_every: u16,
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
            agreed: false,
            mode: Mode::Disarmed,
            reaction: Reaction::Off,
            servo_mode: ServoMode::Pid,
            tick: None,
            alarm: None,
            silence: 0,
            streaming: false,
            joints: [JointState::new(); MAX_JOINTS],
            faults: FaultLog::new(),
            telemetry_every: 0,
        }
    }

    /// The mode.
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// The robot, once a model was accepted.
    pub fn robot(&self) -> Option<&Robot> {
        self.robot.loaded()
    }

    /// The faults so far.
    pub const fn faults(&self) -> &FaultLog {
        &self.faults
    }

    /// Takes over the faults from before a reset and adds what the board found at boot. Before the first tick.
    pub fn restore_faults(&mut self, log: FaultLog) {
        self.faults = log;
    }

    /// Adds a fault that the board found and that does not concern the mode, for instance the cause of a reset.
    pub fn record_fault(&mut self, fault: Fault) {
        self.faults.record(fault);
    }

    /// Whether the last tick is one after which telemetry goes out.
    pub const fn telemetry_due(&self) -> bool {
        match self.tick {
            Some(tick) => matches!(tick.checked_rem(self.telemetry_every as u32), Some(0)),
            None => false,
        }
    }

    /// The state after the last tick.
    pub fn telemetry(&self) -> Telemetry {
        let list = |value| self.for_each_joint(value);
        Telemetry {
            tick: self.tick.unwrap_or(0),
            mode: self.mode,
            faults: self.faults.total,
            positions: list(|joint| joint.position),
            velocities: list(|joint| joint.velocity),
            references: list(|joint| joint.reference.position),
            torques: list(|joint| joint.torque),
        }
    }

    /// One value for each joint of the robot.
    fn for_each_joint(&self, value: fn(&JointState) -> f32) -> Vec<f32, MAX_JOINTS> {
        let count = self.robot.joints.len();
        let mut list = Vec::new();
        for state in self.joints.iter().take(count) {
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
        match self.mode {
            Mode::Disarmed => return,
            // A fault is answered once; only one that takes more away counts after it.
            Mode::Fault if reaction != Reaction::Off || self.reaction == Reaction::Off => return,
            Mode::Fault => {}
            Mode::Armed(_) => {
                if reaction == Reaction::Hold {
                    let at_once = fault.cause.means_motion_is_wrong();
                    for state in &mut self.joints {
                        state.hold(at_once);
                    }
                }
            }
        }
        self.faults.record(fault);
        self.mode = Mode::Fault;
        self.reaction = reaction;
        self.streaming = false;
    }
}
