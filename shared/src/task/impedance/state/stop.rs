//! A controlled stop: set-points at the present pose, and release of contact forces.

use nalgebra::Vector6;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::super::contact::own_mass;
use super::super::redundancy::JointVector;
use super::super::response::respond;
use super::super::setpoint::{at_rest, check_point, pose_error};
use super::super::tuning::{RELEASE_ANGULAR_SPEED, RELEASE_SPEED};
use super::super::{Arm, ArmMeasurement};
use super::ImpedanceState;
use crate::TICK;
use crate::control::ObserverState;
use crate::kinematics::{PosePoint, Posture};
use crate::math;

/// Release of the contact force of the tool in a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub(super) enum Release {
    /// The tool was not in contact, or no stop has begun.
    NotNeeded,
    /// The set-point of the tool moves to the tool. That counts as contact, however small the force:
    /// otherwise the arm would come to rest with a small contact force, which friction would raise again.
    Moving,
    /// The set-point has reached the tool. The residual force no longer counts as contact: at a stiff wall
    /// the lag of the measured force would make the arm oscillate.
    Done,
}

/// The part of the reference arm's state that a stop keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Takeover {
    /// All of it.
    All,
    /// Its disturbance estimates, which compensate model errors. The arm moved without control for some
    /// ticks.
    Disturbances,
    /// Nothing: it is unknown what drove the arm away from it.
    Nothing,
}

impl ImpedanceState {
    /// Begins a controlled stop. The set-points become the poses of tool and elbow; in contact the set-point
    /// of the tool moves there slowly, which releases the contact force. Unless `takeover` keeps it, the
    /// reference arm restarts at the measured state.
    pub fn halt(&mut self, arm: &Arm<'_>, measurement: &ArmMeasurement, takeover: Takeover) {
        if takeover != Takeover::All {
            (self.angles, self.velocities) = (measurement.angles, measurement.velocities);
            self.tool_acceleration = [0.0; 3];
            self.momentum_observer.miss();
            self.observers.iter_mut().for_each(ObserverState::reset_motion);
            if takeover == Takeover::Nothing {
                self.forget_disturbances();
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
    }

    /// Raises the mass of the impedance to the arm's own mass where it is lighter. Otherwise the tool would
    /// accelerate more under a push than the push alone accelerates the arm, and the drives would add the
    /// difference in energy.
    #[cold]
    #[inline(never)]
    fn take_own_mass(&mut self, arm: &Arm<'_>) {
        let axes = self.impedance.axes;
        self.impedance.raise_mass(&own_mass(arm.chain, arm.joints, &self.angles, axes));
        self.settings.impedance = self.impedance;
    }

    /// If the tool still moves into the contact, moves the set-point so near to the tool that the spring
    /// presses no harder than the contact force.
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
            math::norm(&response.fixed_rows::<3>(0))
        });
        if spring > contact {
            self.setpoint = self.setpoint.moved_by(&(error * (1.0 - contact / spring)));
        }
    }

    /// Moves the set-point along the pose `error` by the way of one period, until it is at the tool.
    #[inline(never)]
    pub(super) fn release(&mut self, error: &Vector6<f32>) {
        let [distance, angle] = math::halves(error).map(|half| math::norm(&half));
        let rate = |length: f32, max: f32| if length > max { max / length } else { 1.0 };
        let linear = rate(distance, RELEASE_SPEED * TICK);
        let angular = rate(angle, RELEASE_ANGULAR_SPEED * TICK);
        let [translation, rotation] = math::halves(error);
        self.setpoint = self.setpoint.moved_by(&math::stack([translation * linear, rotation * angular]));
        if distance <= RELEASE_SPEED * TICK && angle <= RELEASE_ANGULAR_SPEED * TICK {
            (self.release, self.contact) = (Release::Done, false);
        }
    }
}
