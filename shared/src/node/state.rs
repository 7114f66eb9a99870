use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::clients::{CLIENTS, Clients, ahead};
use super::force_sensor::ForceSensorState;
use super::joint::JointState;
use super::lease::Lease;
use super::optional::Optional;
use super::stop_energy::StopEnergy;
use crate::control::JointPoint;
use crate::fault::{Fault, FaultCause, FaultLog};
use crate::model::{MAX_CHAINS, MAX_JOINTS, Reaction};
use crate::protocol::{Mode, Refusal, Stream};
use crate::robot::{Measured, Targets};
use crate::task::TaskState;

/// Increment it when the *meaning* of the state changes: the hash of [`STATE_KEY`] covers only names and
/// structure.
macro_rules! revision {
    () => {
        "tesaki/state/3"
    };
}

/// Identifies layout and meaning of an exported [`State`]. Only a core with the same key can replay a log
/// that begins with a state.
pub const STATE_KEY: u64 = {
    let hash = u64::from_le_bytes(postcard_schema::key::Key::for_path::<State>(revision!()).to_bytes());
    // The hash does not cover the capacities of lists.
    hash ^ (MAX_JOINTS as u64) << 8 ^ (MAX_CHAINS as u64) << 16 ^ (CLIENTS as u64) << 24
};

/// Whether the joint angles are known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) enum Sensing {
    /// Nothing since the commit of the model.
    None,
    /// They were read in the last tick.
    Read,
    /// They were last read in tick `since`.
    Silent { since: u32 },
}

impl Sensing {
    /// Registers a tick without a readable frame; `tick` is the previous one.
    pub(super) const fn lose(&mut self, tick: u32) {
        if let Self::Read = self {
            *self = Self::Silent { since: tick };
        }
    }
}

/// The state of a [`Node`](super::Node). Together with the model it determines all further outputs.
// `repr(C)` and this order: the fields of every tick are within the immediate offset of a load. A new state
// is all zero, which places a node in a static in `.bss`.
#[repr(C)]
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct State {
    /// The clients whose hello had our schema key. Their outdated requests can no longer take command.
    pub(super) accepted: Clients,
    pub(super) lease: Lease,
    pub(super) mode: Mode,
    /// Reaction of the outputs in [`Mode::Fault`].
    pub(super) reaction: Reaction,
    /// Whether the task itself brings the robot to rest under [`Reaction::Hold`].
    pub(super) halting: bool,
    /// Whether the joints were damped in the last tick.
    pub(super) damped: bool,
    /// The tick in which the reaction began.
    pub(super) reacting_since: u32,
    /// The fault that it reacts to: the log may also have some of before a reset.
    pub(super) reacts_to: FaultCause,
    /// Sequence number of the last sensor frame; 0 before the first.
    pub(super) tick: u32,
    pub(super) sensing: Sensing,
    /// Supply voltage of the last sensor frame [mV].
    pub(super) supply: u16,
    /// Fault that the last sensor frame would cause if the node were enabled.
    pub(super) alarm: Optional<Fault>,
    /// Ticks since the last accepted command of a running task, or `Keep`.
    pub(super) silence: u32,
    pub(super) measured: Measured,
    pub(super) targets: Targets,
    /// The reference of each joint in the last tick.
    pub(super) references: [JointPoint; MAX_JOINTS],
    pub(super) joints: [JointState; MAX_JOINTS],
    pub(super) force_sensors: [ForceSensorState; MAX_CHAINS],
    /// Ticks until they may be tared.
    pub(super) tare_delay: u8,
    pub(super) faults: FaultLog,
    /// Checksum of the names of the joints that the faults refer to by index; 0 before the first model.
    pub(super) fault_joints: u32,
    /// Total number of faults at the last read.
    pub(super) faults_read: u32,
    /// Period of each [`Stream`] [ticks]; 0: off.
    pub(super) rates: [u16; Stream::ALL.len()],
    /// Number of requests and frames so far: the index of the log.
    pub(super) records: u32,
    /// Whether a task was enabled since the commit of the model; only then is there task telemetry.
    pub(super) has_task: bool,
    pub(super) stop_energy: StopEnergy,
    /// How often the stop restarted after missed ticks.
    pub(super) restarts: u8,
    pub(super) task: TaskState,
}

impl State {
    /// Disabled, without model.
    pub const fn new() -> Self {
        Self {
            accepted: Clients::NONE,
            lease: Lease::new(),
            mode: Mode::Disabled,
            reaction: Reaction::Off,
            halting: false,
            damped: false,
            reacting_since: 0,
            reacts_to: FaultCause::CommandTimeout,
            tick: 0,
            sensing: Sensing::None,
            supply: 0,
            alarm: Optional::None,
            silence: 0,
            measured: Measured::NONE,
            targets: Targets::NONE,
            references: [JointPoint { position: 0.0, velocity: 0.0, acceleration: 0.0 }; MAX_JOINTS],
            joints: [JointState::new(); MAX_JOINTS],
            force_sensors: [ForceSensorState::new(); MAX_CHAINS],
            tare_delay: 0,
            faults: FaultLog::new(),
            fault_joints: 0,
            faults_read: 0,
            rates: [0; Stream::ALL.len()],
            records: 0,
            has_task: false,
            stop_energy: StopEnergy::NONE,
            restarts: 0,
            task: TaskState::NONE,
        }
    }

    /// Whether the client has our schema key. The commander stays accepted until it sends a hello with
    /// another key.
    pub fn is_accepted(&self, client: u32) -> bool {
        let commands = self.lease.commander() == Some(client) && !self.lease.mismatched;
        commands || self.accepted.latest(client).is_some()
    }

    /// Stores whether the client's hello had our schema key.
    pub fn set_accepted(&mut self, client: u32, sequence: u16, accepted: bool) {
        self.lease.greet(client, accepted);
        let known = self.accepted.latest(client);
        if accepted {
            self.accepted.replace(client, Some((client, known.unwrap_or(sequence))));
        } else if known.is_some() {
            self.accepted.replace(client, None);
        }
    }

    /// Registers a request of any kind.
    pub fn register(&mut self, client: u32, sequence: u16) {
        self.lease.register(client, sequence, self.tick);
        self.accepted.register(client, sequence);
    }

    /// Requests that the client sent up to `sequence` can no longer take command: a late or repeated one must
    /// not be executed.
    pub fn outdate(&mut self, client: u32, sequence: u16) {
        self.accepted.outdate(client, sequence);
    }

    /// Registers a request that any client may send at any time. Commands that the client sent before it but
    /// that arrive later are not executed.
    pub fn overrule(&mut self, client: u32, sequence: u16) {
        self.lease.overrule(client, sequence);
        self.outdate(client, sequence);
    }

    /// Gives the lease to `client`, unless it is another's or the request is late.
    pub fn take(&mut self, client: u32, sequence: u16, by_force: bool) -> Result<(), Refusal> {
        if let Some(latest) = self.accepted.latest(client)
            && self.lease.commander() != Some(client)
            && ahead(sequence, latest) <= 0
        {
            return Err(Refusal::Stale { latest });
        }
        let enabled = matches!(self.mode, Mode::Enabled(_));
        let taken = self.lease.take(client, sequence, by_force, enabled, self.tick);
        if taken.is_err() {
            // The same request may succeed when it is repeated.
            self.outdate(client, sequence.wrapping_sub(1));
        }
        taken
    }
}

impl Default for State {
    fn default() -> Self {
        Self::new()
    }
}
