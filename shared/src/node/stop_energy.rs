//! Supervision of a stop by its energy: the drives must not add energy to a robot that is to come to rest.
//!
//! A servo, a damper or a task that brings a robot to rest is passive as long as encoders and drives are
//! correct: the torque beyond gravity compensation takes energy out of the motion. Work that exceeds the
//! initial kinetic energy shows that an encoder or a drive is wrong, that the control oscillates, or that the
//! load balanced by the torques is gone.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::Node;
use super::joint::Joints;
use crate::TICK;
use crate::fault::{Fault, FaultCause, Finding};
use crate::math::abs;
use crate::model::Reaction;
use crate::robot::{JointConfig, Motion};

/// The kinetic energy of the robot's mass at this speed [m/s] is tolerated: the model has errors, and drives
/// and sensors have delays.
const TOLERATED_SPEED: f32 = 0.12;
/// For a robot whose links have no mass: the kinetic energy of its joints at this share of their velocity
/// limits is tolerated.
const TOLERATED_SHARE: f32 = 0.1;
/// Relative error of the model's weight.
const WEIGHT_ERROR: f32 = 0.1;
/// Time for which the initial torques continue unchanged [s].
const REACTION_TIME: f32 = 2.0 * TICK;
/// Upper bound of the time that is allowed for the initial torques to decay [s].
const MAX_FADING: f32 = 0.1;
/// Decay per period of both sums (time constant 2.5 s). Without it, encoder noise would accumulate while a
/// robot is held for hours.
const MEMORY: f32 = 0.996;

/// Work of the drives beyond gravity compensation since a stop began, and its limit [J].
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct StopEnergy {
    pub work: f32,
    allowed: f32,
}

impl StopEnergy {
    pub const NONE: Self = Self { work: 0.0, allowed: 0.0 };
}

impl Node {
    /// Energy that is tolerated at any time [J].
    pub(super) fn tolerated_energy(&self) -> f32 {
        let mass = self.robot.mass();
        if mass > 0.0 {
            return 0.5 * mass * TOLERATED_SPEED * TOLERATED_SPEED;
        }
        let of_joint = |joint: &JointConfig| {
            let speed = TOLERATED_SHARE * joint.limits.velocity;
            0.5 * joint.inertia * speed * speed
        };
        self.robot.joints().iter().map(of_joint).sum()
    }

    /// Begins the energy balance of a stop. The limit is the tolerance, plus the kinetic energy, plus the
    /// work of the initial torques until they have decayed.
    #[cold]
    #[inline(never)]
    pub(super) fn begin_stop_energy(&mut self) {
        let mut allowed = self.tolerated_energy();
        let robot = &self.robot;
        let mut all = Joints::of(robot, &mut self.state);
        let weight = all.weight();
        let mut motion = Motion::default();
        for (motion, joint) in motion.iter_mut().zip(all.each()) {
            *motion = [*joint.position, 0.0, *joint.velocity];
        }
        let with_momentum = robot.coupled_dynamics(&motion);
        let mut kinetic = 0.0;
        for ((joint, weight), torque) in all.each().zip(weight).zip(with_momentum) {
            joint.state.rise = 0.0;
            let velocity = *joint.velocity;
            let momentum = torque - weight + joint.config.servo.rotor_torque(velocity);
            let excess = joint.state.torque - weight;
            // In motion, part of the torque may accelerate the joint.
            let acceleration = joint.config.acceleration(joint.state.change, velocity);
            joint.state.begin_hold(excess);
            joint.state.pressed = abs(excess).max(abs(excess - joint.config.inertia * acceleration));
            let fading =
                (0.5 * abs(excess) / joint.config.limits.torque_rate).min(MAX_FADING) + REACTION_TIME;
            let gained = excess / joint.config.inertia * fading;
            let faded = excess * (velocity + 0.5 * gained) * fading;
            kinetic += 0.5 * momentum * velocity;
            allowed += faded.max(0.0);
        }
        self.state.stop_energy = StopEnergy { work: 0.0, allowed: allowed + kinetic.max(0.0) };
    }

    /// Adds the work of the drives in the last period of a stop, and checks the encoders of damped joints and
    /// those that may have jumped. Returns a fault of an encoder, or of the work if it exceeds its limit.
    #[cold]
    #[inline(never)]
    pub(super) fn check_stop(&mut self) -> Option<Fault> {
        let tolerated = self.tolerated_energy();
        let damps = self.state.reaction == Reaction::Damp;
        let tick = self.state.tick;
        let mut all = Joints::of(&self.robot, &mut self.state);
        let weight = all.weight();
        let [mut work, mut allowed] = [0.0; 2];
        let (mut hardest, mut largest) = (0, 0.0);
        for (index, (mut joint, weight)) in (0..).zip(all.each().zip(weight)) {
            let excess = joint.state.torque - weight;
            if damps && let Some(found) = joint.check_damped_encoder(excess) {
                return Some(found.at(Some(index), tick));
            }
            if let Some(found) = joint.check_leap(tick) {
                return Some(found.at(Some(index), tick));
            }
            let moved = joint.state.change;
            joint.state.rise += if weight > 0.0 { moved } else { -moved };
            let uncompensated = if damps { 1.0 - joint.state.borne_weight() } else { 0.0 };
            let own = excess * moved;
            work += own;
            // The robot sinks under the weight that damping does not compensate.
            allowed += WEIGHT_ERROR * abs(weight * moved)
                + uncompensated * (-weight * moved).max(0.0)
                + abs(joint.config.servo.friction(&joint.state.servo, *joint.velocity) * moved);
            if own > largest {
                (hardest, largest) = (index, own);
            }
        }
        let energy = &mut self.state.stop_energy;
        energy.work = MEMORY * energy.work + work;
        if damps {
            // Energy that damping has dissipated is lost: it does not offset work that the torques do later.
            energy.work = energy.work.max(0.0);
        }
        energy.allowed = tolerated + MEMORY * (energy.allowed - tolerated) + allowed;
        let (value, limit) = (energy.work, energy.allowed);
        let found = Finding { cause: FaultCause::EnergyGained, value, limit };
        (value > limit).then_some(found.at(Some(hardest), tick))
    }
}
