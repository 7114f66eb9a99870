use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::joint::JointState;
use super::lease::Lease;
use super::tip::TipState;
use crate::arm::{ArmSense, ArmState};
use crate::control::{Actuation, ServoMode};
use crate::manipulation::HandState;
use crate::model::{MAX_CHAINS, MAX_JOINTS, Reaction};
use crate::protocol::{Fault, FaultLog, Mode, Stream};

/// How many clients, the commander aside, the node remembers to have agreed on the schema.
const CLIENTS: usize = 4;

/// Everything that a [`Node`](super::Node) knows beside the robot's model. Together with the model, whose configuration
/// is fixed, it decides what the node does from here on.
// In this order in memory: what every tick needs is within reach of a load's immediate offset.
#[repr(C)]
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct State {
    /// The clients that said hello with our schema key, the latest first.
    agreed: [Option<u32>; CLIENTS],
    pub(super) lease: Lease,
    pub(super) mode: Mode,
    /// What the outputs do in [`Mode::Fault`].
    pub(super) reaction: Reaction,
    pub(super) servo_mode: ServoMode,
    /// Sequence number of the last sensor frame; 0 before the first.
    pub(super) tick: u32,
    /// Whether the joints were read since the model was taken into use.
    pub(super) sensed: bool,
    /// Supply voltage of the last sensor frame [mV].
    pub(super) supply: u16,
    /// What the last sensor frame showed that would be a fault when armed.
    pub(super) alarm: Option<Fault>,
    /// Ticks since the last accepted set-point.
    pub(super) silence: u32,
    /// Whether references come point by point instead of through the trajectory filter.
    pub(super) streaming: bool,
    /// Whether the servos or the task alone make the torques.
    pub(super) drive: Actuation,
    pub(super) joints: [JointState; MAX_JOINTS],
    pub(super) tips: [TipState; MAX_CHAINS],
    pub(super) hand: HandState,
    pub(super) faults: FaultLog,
    /// The total of the faults when they were read last.
    pub(super) faults_read: u32,
    /// Ticks from one message to the next, by [`Stream`].
    pub(super) rates: [u16; Stream::ALL.len()],
    /// Requests and frames so far: numbers the entries of the log.
    pub(super) records: u32,
    pub(super) arm: ArmState,
}

impl State {
    /// Disarmed, and nothing known.
    pub const fn new() -> Self {
        Self {
            agreed: [None; CLIENTS],
            lease: Lease::new(),
            mode: Mode::Disarmed,
            reaction: Reaction::Off,
            servo_mode: ServoMode::Pid,
            tick: 0,
            sensed: false,
            supply: 0,
            alarm: None,
            silence: 0,
            streaming: false,
            drive: Actuation::Servo,
            joints: [JointState::new(); MAX_JOINTS],
            tips: [TipState::new(); MAX_CHAINS],
            hand: HandState::NONE,
            faults: FaultLog::new(),
            faults_read: 0,
            rates: [0; Stream::ALL.len()],
            records: 0,
            arm: ArmState::NONE,
        }
    }

    /// What an arm of the first joints, with the first tip, senses. Entries beyond its joints mean nothing.
    pub fn arm_sense(&self) -> ArmSense {
        let mut sense = ArmSense::default();
        let values = sense.angles.iter_mut().zip(&mut sense.velocities).zip(&self.joints);
        values.for_each(|((angle, velocity), joint)| (*angle, *velocity) = (joint.position, joint.velocity));
        if let Some(tip) = self.tips.first() {
            let wrench = tip.force.iter().chain(&tip.torque);
            sense.wrench.iter_mut().zip(wrench).for_each(|(value, sensed)| *value = *sensed);
        }
        sense
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
