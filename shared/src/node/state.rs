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

/// How many clients, the commander aside, the node remembers to have agreed on the schema.
const CLIENTS: usize = 4;

/// Raise it when the *meaning* of the state changes: the hash behind [`STATE_KEY`] sees names and structure only.
macro_rules! revision {
    () => {
        "tesaki/state/1"
    };
}

/// Identifies layout and meaning of an exported [`State`]. A log that begins with a state can be replayed by a core with the
/// same key.
pub const STATE_KEY: u64 = {
    let hash = u64::from_le_bytes(postcard_schema::key::Key::for_path::<State>(revision!()).to_bytes());
    // The hash does not see the capacities of lists.
    hash ^ (MAX_JOINTS as u64) << 8 ^ (MAX_CHAINS as u64) << 16 ^ (CLIENTS as u64) << 24
};

/// Everything that a [`Node`](super::Node) knows beside the robot's model. Together with the model, whose configuration
/// is fixed, it decides what the node does from here on.
// In this order in memory: what every tick needs is within reach of a load's immediate offset. A new state is all zero, so
// that a node in a static lies in `.bss`.
#[repr(C)]
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct State {
    /// The clients that said hello with our schema key, the latest first.
    agreed: [Option<u32>; CLIENTS],
    pub(super) lease: Lease,
    pub(super) mode: Mode,
    /// What the outputs do in [`Mode::Fault`].
    pub(super) reaction: Reaction,
    /// Sequence number of the last sensor frame; 0 before the first.
    pub(super) tick: u32,
    /// Whether the joints were read since the model was taken into use.
    pub(super) sensed: bool,
    /// Supply voltage of the last sensor frame [mV].
    pub(super) supply: u16,
    /// What the last sensor frame showed that would be a fault when enabled.
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
    /// The total of the faults when they were read last.
    pub(super) faults_read: u32,
    /// Ticks from one message to the next, by [`Stream`].
    pub(super) rates: [u16; Stream::ALL.len()],
    /// Requests and frames so far: numbers the entries of the log.
    pub(super) records: u32,
    /// Whether a task was enabled since the model was taken into use, so that there is telemetry of it.
    pub(super) has_task: bool,
    pub(super) task: TaskState,
}

impl State {
    /// Disabled, and nothing known.
    pub const fn new() -> Self {
        Self {
            agreed: [None; CLIENTS],
            lease: Lease::new(),
            mode: Mode::Disabled,
            reaction: Reaction::Off,
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

    /// Whether the client speaks our protocol. That of the commander is never forgotten, however many others say hello.
    pub fn agrees(&self, client: u32) -> bool {
        self.agreed.contains(&Some(client)) || self.lease.commander() == Some(client)
    }

    /// The client speaks our protocol, or does not.
    pub fn agree(&mut self, client: u32, agrees: bool) {
        for place in &mut self.agreed {
            if *place == Some(client) {
                *place = None;
            }
        }
        if agrees {
            self.agreed.rotate_right(1);
            self.agreed[0] = Some(client);
        }
    }
}

impl Default for State {
    fn default() -> Self {
        Self::new()
    }
}
