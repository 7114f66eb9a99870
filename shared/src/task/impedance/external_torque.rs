use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::Arm;
use super::redundancy::JointVector;
use super::tuning::REST_TICKS;
use crate::control::{FrictionFeedforward, FrictionState};
use crate::model::MAX_CHAIN_JOINTS;
use crate::{TICK, math};

/// Number of angle samples in the second difference.
const SAMPLES: u8 = 3;

/// External joint torques without a force sensor: the filtered residual of the inverse dynamics. That is the
/// torques that the measured motion requires by the model minus those of the motors, after a first-order
/// low-pass filter. In continuous time it equals the residual of the momentum observer (De Luca and Mattone
/// 2005), which integrates the generalised momentum and so needs no acceleration.
///
/// Here the acceleration is the second difference of the angles: over the last two periods the angles `q₀,
/// q₁, q₂` had the mean acceleration `(q₂ − 2q₁ + q₀)/T²`, exact for torques held over a period, and the
/// motors applied the mean of both periods' torques. The inverse dynamics at `q₁` give the torques that the
/// motion required.
///
/// Errors of the model, such as wrong masses or friction, appear as external torques. A tare at rest removes
/// the gravity error of that posture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct ExternalTorqueEstimate {
    /// Last and second-last joint angles [rad].
    angles: [[f32; MAX_CHAIN_JOINTS]; 2],
    /// Mean motor torques of this period and of the last one [N·m].
    torques: [[f32; MAX_CHAIN_JOINTS]; 2],
    /// Filtered residual [N·m].
    residual: [f32; MAX_CHAIN_JOINTS],
    /// Part of the residual that counts as model error [N·m].
    tare: [f32; MAX_CHAIN_JOINTS],
    /// Samples so far, at most [`SAMPLES`].
    samples: u8,
    /// Consecutive ticks at rest, and whether the estimate was tared after [`REST_TICKS`] of them.
    rest_ticks: u8,
    tared: bool,
}

impl ExternalTorqueEstimate {
    /// Before the first tick.
    pub const NONE: Self = Self {
        angles: [[0.0; MAX_CHAIN_JOINTS]; 2],
        torques: [[0.0; MAX_CHAIN_JOINTS]; 2],
        residual: [0.0; MAX_CHAIN_JOINTS],
        tare: [0.0; MAX_CHAIN_JOINTS],
        samples: 0,
        rest_ticks: 0,
        tared: false,
    };

    /// Stores the mean motor torques of the starting period [N·m].
    pub const fn push(&mut self, torques: &[f32; MAX_CHAIN_JOINTS]) {
        self.torques = [*torques, self.torques[0]];
    }

    /// Updates the residual with the joint `angles` [rad]. Friction is computed from `velocities` [rad/s];
    /// `bandwidth` is that of the filter [rad/s]. After [`REST_TICKS`] consecutive ticks `at_rest` the
    /// estimate tares itself, once.
    pub fn update(
        &mut self,
        arm: &Arm<'_>,
        angles: &[f32; MAX_CHAIN_JOINTS],
        velocities: &[f32; MAX_CHAIN_JOINTS],
        bandwidth: f32,
        at_rest: bool,
    ) {
        let [last, second_last] = self.angles;
        self.angles = [*angles, last];
        if self.samples < SAMPLES {
            self.samples += 1;
        }
        if self.samples < SAMPLES {
            return;
        }
        let [now, last, second_last] = [*angles, last, second_last].map(JointVector::from);
        let velocity = (now - second_last) * (0.5 / TICK);
        let acceleration = (now - last * 2.0 + second_last) * (1.0 / (TICK * TICK));
        let mut required = JointVector::zeros();
        arm.chain.inverse_dynamics(
            arm.gravity,
            last.as_slice(),
            velocity.as_slice(),
            acceleration.as_slice(),
            required.as_mut_slice(),
        );
        let gain = 1.0 - math::exp(-bandwidth * TICK);
        for ((required, joint), (acceleration, &velocity)) in
            required.iter_mut().zip(arm.joints).zip(acceleration.iter().zip(velocities))
        {
            let friction = FrictionFeedforward::new(&joint.friction).torque(&FrictionState::new(), velocity);
            *required = *required + joint.motor.rotor_inertia * acceleration + friction;
        }
        let [this, last] = &self.torques;
        let motors = this.iter().zip(last).take(arm.joints.len());
        for ((residual, required), (this, last)) in self.residual.iter_mut().zip(required.iter()).zip(motors)
        {
            *residual += gain * (required - 0.5 * (this + last) - *residual);
        }
        if !self.tared {
            self.rest_ticks = if at_rest { self.rest_ticks.saturating_add(1) } else { 0 };
            self.tared = self.rest_ticks >= REST_TICKS;
            self.tare();
        }
    }

    /// The angles of the missed ticks are unknown: with those before and after them, the second difference
    /// would be wrong.
    pub const fn miss(&mut self) {
        self.samples = 0;
    }

    /// Defines the present residual as model error. Has no effect before the first tare at rest.
    pub const fn tare(&mut self) {
        if self.tared {
            self.tare = self.residual;
        }
    }

    /// External joint torques [N·m]; 0 before the first tare.
    pub fn torques(&self) -> JointVector {
        if self.tared {
            JointVector::from(self.residual) - JointVector::from(self.tare)
        } else {
            JointVector::zeros()
        }
    }
}
