use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::force_sensor::ForceSensorState;
use super::joint::JointState;
use super::lease::Lease;
use super::optional::Optional;
use crate::control::JointPoint;
use crate::fault::{Fault, FaultLog};
use crate::model::{MAX_CHAINS, MAX_JOINTS, Reaction};
use crate::protocol::{Mode, Stream};
use crate::robot::{Measured, Targets};
use crate::task::TaskState;

/// Number of clients with a matching schema key that the node remembers, besides the commander.
const CLIENTS: usize = 4;

/// Increment it when the *meaning* of the state changes: the hash of [`STATE_KEY`] covers only names and
/// structure.
macro_rules! revision {
    () => {
        "tesaki/state/1"
    };
}

/// Identifies layout and meaning of an exported [`State`]. Only a core with the same key can replay a log
/// that begins with a state.
pub const STATE_KEY: u64 = {
    let hash = u64::from_le_bytes(postcard_schema::key::Key::for_path::<State>(revision!()).to_bytes());
    // The hash does not cover the capacities of lists.
    hash ^ (MAX_JOINTS as u64) << 8 ^ (MAX_CHAINS as u64) << 16 ^ (CLIENTS as u64) << 24
};

/// The state of a [`Node`](super::Node). Together with the model it determines all further outputs.
// `repr(C)` and this order: the fields of every tick are within the immediate offset of a load. A new state
// is all zero, which places a node in a static in `.bss`.
#[repr(C)]
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct State {
    /// The clients whose hello had our schema key, the latest first.
    accepted: [Option<u32>; CLIENTS],
    pub(super) lease: Lease,
    pub(super) mode: Mode,
    /// What the outputs do in [`Mode::Fault`].
    pub(super) reaction: Reaction,
    /// Whether the task itself brings the robot to rest under [`Reaction::Hold`].
    pub(super) halting: bool,
    /// Whether the joints were damped in the last tick.
    pub(super) damped: bool,
    /// The tick in which the reaction began.
    pub(super) reacting_since: u32,
    /// Sequence number of the last sensor frame; 0 before the first.
    pub(super) tick: u32,
    /// Whether the joints were read since the commit of the model.
    pub(super) sensed: bool,
    /// Supply voltage of the last sensor frame [mV].
    pub(super) supply: u16,
    /// State of the last sensor frame that is a fault when enabled.
    pub(super) alarm: Optional<Fault>,
    /// Ticks since the last accepted command of a running task.
    pub(super) silence: u32,
    pub(super) measured: Measured,
    pub(super) targets: Targets,
    /// The reference of each joint in the last tick.
    pub(super) references: [JointPoint; MAX_JOINTS],
    pub(super) joints: [JointState; MAX_JOINTS],
    pub(super) force_sensors: [ForceSensorState; MAX_CHAINS],
    pub(super) faults: FaultLog,
    /// Total number of faults at the last read.
    pub(super) faults_read: u32,
    /// Period of each [`Stream`] [ticks]; 0: off.
    pub(super) rates: [u16; Stream::ALL.len()],
    /// Number of requests and frames so far: the index of the log.
    pub(super) records: u32,
    /// Whether a task was enabled since the commit of the model, so that its telemetry exists.
    pub(super) has_task: bool,
    pub(super) task: TaskState,
}

impl State {
    /// Disabled, without model.
    pub const fn new() -> Self {
        Self {
            accepted: [None; CLIENTS],
            lease: Lease::new(),
            mode: Mode::Disabled,
            reaction: Reaction::Off,
            halting: false,
            damped: false,
            reacting_since: 0,
            tick: 0,
            sensed: false,
            supply: 0,
            alarm: Optional::None,
            silence: 0,
            measured: Measured::NONE,
            targets: Targets::NONE,
            references: [JointPoint { position: 0.0, velocity: 0.0, acceleration: 0.0 }; MAX_JOINTS],
            joints: [JointState::new(); MAX_JOINTS],
            force_sensors: [ForceSensorState::new(); MAX_CHAINS],
            faults: FaultLog::new(),
            faults_read: 0,
            rates: [0; Stream::ALL.len()],
            records: 0,
            has_task: false,
            task: TaskState::NONE,
        }
    }

    /// Whether the client has our schema key. The commander's hello is never dropped.
    pub fn is_accepted(&self, client: u32) -> bool {
        self.accepted.contains(&Some(client)) || self.lease.commander() == Some(client)
    }

    /// Stores whether the client's hello had our schema key.
    pub fn set_accepted(&mut self, client: u32, accepted: bool) {
        for entry in &mut self.accepted {
            if *entry == Some(client) {
                *entry = None;
            }
        }
        if accepted {
            self.accepted.rotate_right(1);
            self.accepted[0] = Some(client);
        }
    }
}

impl Default for State {
    fn default() -> Self {
        Self::new()
    }
}
