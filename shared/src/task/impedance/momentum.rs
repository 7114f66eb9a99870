use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::Arm;
use super::redundancy::Joints;
use crate::control::{FrictionFeedforward, FrictionState};
use crate::model::MAX_CHAIN_JOINTS;
use crate::{TICK, math};

/// Ticks of rest after which what is left over counts as the model's error: 0.4 s.
const REST_TICKS: u8 = 40;
/// Readings of the angles that an acceleration takes.
const READINGS: u8 = 3;

/// Joint torques that the world exerts, without a force sensor: the change of the arm's momentum that neither its motors
/// nor gravity, Coriolis forces and friction explain, through a filter of first order (De Luca and Mattone 2005).
///
/// In discrete time: over the last two periods the angles `q₀, q₁, q₂` had the mean acceleration `(q₂ − 2q₁ + q₀)/T²`, which
/// is exact under torques held for a period, and the motors gave the mean of both periods' torques. The inverse dynamics at
/// `q₁` say what the motion needed.
///
/// What the model does not know looks like a push: wrong masses, wrong friction. The first is left out by a tare at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct MomentumObserver {
    /// The last angles and those before [rad].
    angles: [[f32; MAX_CHAIN_JOINTS]; 2],
    /// Mean torques of the motors in the period that begins, and of that before [N·m].
    torques: [[f32; MAX_CHAIN_JOINTS]; 2],
    /// What the motors and the model do not explain [N·m].
    residual: [f32; MAX_CHAIN_JOINTS],
    /// What of it counts as the model's error [N·m].
    tare: [f32; MAX_CHAIN_JOINTS],
    /// Readings so far; counts no farther than [`READINGS`].
    readings: u8,
    /// Ticks of rest so far, and whether what was left over then was taken for the tare.
    rested: u8,
    tared: bool,
}

impl MomentumObserver {
    /// Before the first tick.
    pub const NONE: Self = Self {
        angles: [[0.0; MAX_CHAIN_JOINTS]; 2],
        torques: [[0.0; MAX_CHAIN_JOINTS]; 2],
        residual: [0.0; MAX_CHAIN_JOINTS],
        tare: [0.0; MAX_CHAIN_JOINTS],
        readings: 0,
        rested: 0,
        tared: false,
    };

    /// The motors' mean torques in the period that begins [N·m].
    pub const fn push(&mut self, torques: &[f32; MAX_CHAIN_JOINTS]) {
        self.torques = [*torques, self.torques[0]];
    }

    /// Takes the joints' `angles` [rad]; friction acts against `velocities` [rad/s]. `bandwidth` of the filter [rad/s];
    /// `resting`: whether the arm is to stand still, so that it may tare.
    pub fn update(
        &mut self,
        arm: &Arm<'_>,
        angles: &[f32; MAX_CHAIN_JOINTS],
        velocities: &[f32; MAX_CHAIN_JOINTS],
        bandwidth: f32,
        resting: bool,
    ) {
        let [last, before] = self.angles;
        self.angles = [*angles, last];
        if self.readings < READINGS {
            self.readings += 1;
        }
        if self.readings < READINGS {
            return;
        }
        let [now, last, before] = [*angles, last, before].map(Joints::from);
        let velocity = (now - before) * (0.5 / TICK);
        let acceleration = (now - last * 2.0 + before) * (1.0 / (TICK * TICK));
        let mut needed = Joints::zeros();
        arm.chain.inverse_dynamics(
            arm.gravity,
            last.as_slice(),
            velocity.as_slice(),
            acceleration.as_slice(),
            needed.as_mut_slice(),
        );
        let gain = 1.0 - math::exp(-bandwidth * TICK);
        let of_joints = arm.joints.iter().zip(acceleration.iter().zip(velocities));
        let motors = self.torques[0].iter().zip(&self.torques[1]);
        let all = self.residual.iter_mut().zip(needed.iter()).zip(motors).zip(of_joints);
        for (((residual, links), (now, before)), (joint, (acceleration, &velocity))) in all {
            let friction = FrictionFeedforward::new(&joint.friction).torque(&FrictionState::new(), velocity);
            let needed = links + joint.motor.rotor_inertia * acceleration + friction;
            *residual += gain * (needed - 0.5 * (now + before) - *residual);
        }
        if !self.tared {
            self.rested = if resting { self.rested + 1 } else { 0 };
            self.tared = self.rested >= REST_TICKS;
            self.tare();
        }
    }

    /// What is left over now is the model's error. Before the arm has rested long enough it will be anyway.
    pub const fn tare(&mut self) {
        if self.tared {
            self.tare = self.residual;
        }
    }

    /// The torques of the world on the joints [N·m]; none before the tare.
    pub fn torques(&self) -> Joints {
        if self.tared { Joints::from(self.residual) - Joints::from(self.tare) } else { Joints::zeros() }
    }
}
