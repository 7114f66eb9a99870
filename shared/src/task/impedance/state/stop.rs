//! A controlled stop: set-points where the arm is, and release of what the tool presses on.

use nalgebra::Vector6;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::super::contact::own_mass;
use super::super::redundancy::JointVector;
use super::super::response::respond;
use super::super::setpoint::{at_rest, check_point, pose_error};
use super::super::settings::Redundancy;
use super::super::tuning::{RELEASE_ANGULAR_SPEED, RELEASE_SPEED};
use super::super::{Arm, ArmAngle, ArmMeasurement};
use super::ImpedanceState;
use crate::TICK;
use crate::control::ObserverState;
use crate::kinematics::{PosePoint, Posture};
use crate::math;

/// Release, in a stop, of what the tool presses on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub(super) enum Release {
    /// The tool pressed on nothing, or no stop has begun.
    NotNeeded,
    /// The set-point of the tool moves to the tool. That counts as contact, however small the force: else
    /// the arm would come to rest pressing a little, and friction raise it again.
    Moving,
    /// The set-point has reached the tool. The residual force counts no more as contact: at a stiff wall a
    /// force that lags would make the arm oscillate.
    Done,
}

/// What a stop takes over of the reference arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Takeover {
    /// All of it.
    All,
    /// Its disturbances: the arm moved on without control for some ticks. What balanced the errors of the
    /// model does so on.
    Disturbances,
    /// Nothing: what drove the arm away from it is not known.
    Nothing,
}

impl ImpedanceState {
    /// Begins a controlled stop. The set-points are where tool and elbow are; in contact that of the tool
    /// moves there slowly, which releases what the tool presses on. A reference arm that has lost the real
    /// one begins where that is.
    pub fn halt(&mut self, arm: &Arm<'_>, measurement: &ArmMeasurement, takeover: Takeover) {
        if takeover != Takeover::All {
            (self.angles, self.velocities) = (measurement.angles, measurement.velocities);
            self.tool_acceleration = [0.0; 3];
            for observer in &mut self.observers {
                observer.reset_motion();
                if takeover == Takeover::Nothing {
                    *observer = ObserverState::new();
                }
            }
        }
        self.halted = true;
        self.take_own_mass(arm);
        let posture = arm.chain.posture(&self.angles);
        self.setpoint = PosePoint { velocity: [0.0; 6], acceleration: [0.0; 6], ..self.setpoint };
        if self.contact && check_point(posture.tip(), &self.setpoint, &self.settings).is_ok() {
            self.release = Release::Moving;
            self.relax_spring(&posture, &self.external_wrench(measurement));
        } else {
            self.release = Release::NotNeeded;
            self.setpoint = at_rest(posture.tip());
        }
        self.hold_elbow(arm, &posture);
        self.arm_angle_undefined =
            self.settings.redundancy == Redundancy::ArmAngle && ArmAngle::of(&posture, arm.gravity).is_none();
    }

    /// Makes the tool as heavy as the arm itself, where it is lighter: it would yield to a push faster than
    /// the push alone moves the arm, and the drives would bring in the difference of the energies.
    #[cold]
    #[inline(never)]
    fn take_own_mass(&mut self, arm: &Arm<'_>) {
        let axes = self.impedance.axes;
        self.impedance.raise_mass(|| own_mass(arm.chain, arm.joints, &self.angles, axes));
        self.settings.impedance = self.impedance;
    }

    /// Moves the set-point of a tool that moves on into what it touches so near that its spring presses no
    /// harder than the contact does.
    #[cold]
    #[inline(never)]
    fn relax_spring(&mut self, posture: &Posture, wrench: &Vector6<f32>) {
        let velocity = posture.jacobian() * JointVector::from(self.velocities);
        if velocity.fixed_rows::<3>(0).dot(&wrench.fixed_rows::<3>(0)) >= 0.0 {
            return;
        }
        let zero = Vector6::zeros();
        let error = pose_error(posture.tip(), &self.setpoint);
        let [spring, contact] = [(&error, &zero), (&zero, wrench)].map(|(error, force)| {
            let response = respond(&self.impedance, self.settings.law, posture.tip(), error, &zero, force);
            math::sqrt(response.fixed_rows::<3>(0).norm_squared())
        });
        if spring > contact {
            let moved = error * ((1.0 - contact / spring) / TICK);
            let moved = PosePoint { velocity: moved.into(), ..self.setpoint }.coasted();
            self.setpoint = PosePoint { velocity: [0.0; 6], ..moved };
        }
    }

    /// Moves the set-point of the tool a period's way along the pose `error`, until it is at the tool.
    #[inline(never)]
    pub(super) fn release(&mut self, error: &Vector6<f32>) {
        let [distance, angle] = [0, 3].map(|axis| math::sqrt(error.fixed_rows::<3>(axis).norm_squared()));
        let rate = |length: f32, max: f32| if length > max { max / length } else { 1.0 };
        let linear = rate(distance, RELEASE_SPEED * TICK) / TICK;
        let angular = rate(angle, RELEASE_ANGULAR_SPEED * TICK) / TICK;
        let &[x, y, z, rx, ry, rz] = error.as_ref();
        let velocity = [x * linear, y * linear, z * linear, rx * angular, ry * angular, rz * angular];
        let moved = PosePoint { velocity, ..self.setpoint }.coasted();
        self.setpoint = PosePoint { velocity: [0.0; 6], ..moved };
        if distance <= RELEASE_SPEED * TICK && angle <= RELEASE_ANGULAR_SPEED * TICK {
            (self.release, self.contact) = (Release::Done, false);
        }
    }
}
