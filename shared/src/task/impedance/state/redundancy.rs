//! Resolution of the redundancy: null-space motion of the joints, and control of the elbow.

use nalgebra::Vector6;

use super::super::redundancy::{JointVector, Resolver};
use super::super::setpoint::wrap_angle;
use super::super::settings::{ImpedanceSettings, Redundancy};
use super::super::tuning::{ARM_ANGLE_DAMPING, INITIAL_ITERATIONS, MAX_ELBOW_ERROR};
use super::super::{Arm, ArmAngle};
use super::ImpedanceState;
use crate::kinematics::{ElbowSetpoint, Jacobian, Posture};
use crate::math;
use crate::model::MAX_CHAIN_JOINTS;

impl ImpedanceState {
    /// Resolves the redundancy (Arm7 step 4): computes joint accelerations for the acceleration `tool`,
    /// without its bias `J̇ q̇`, and for the elbow's control law.
    pub(super) fn resolve(
        &mut self,
        arm: &Arm<'_>,
        settings: &ImpedanceSettings,
        posture: &Posture,
        resolver: &Resolver,
        jacobian: &Jacobian,
        tool: &Vector6<f32>,
    ) -> JointVector {
        let velocities = JointVector::from(self.velocities);
        let mut arm_angle = None;
        if settings.redundancy == Redundancy::ArmAngle {
            arm_angle = ArmAngle::of(posture, arm.gravity);
            if let (Some(ArmAngle { angle, .. }), true) = (&arm_angle, self.arm_angle_undefined) {
                // Defined again: the elbow holds this angle until the next set-point.
                self.elbow_setpoint = ElbowSetpoint { angle: *angle, ..ElbowSetpoint::default() };
            }
            self.arm_angle_undefined = arm_angle.is_none();
        }
        if let Some(joint) = driven_joint(settings.redundancy) {
            let state = self.angles.get(joint).zip(self.velocities.get(joint));
            let (&angle, &velocity) = state.unwrap_or((&0.0, &0.0));
            let driven = self.elbow_acceleration(settings, angle, velocity);
            let mut columns = jacobian.column_iter();
            let Some(column) = columns.nth(joint) else { return resolver.solve(tool) };
            let mut other_joints = *tool;
            if settings.law.direct().is_none_or(|law| law.driven_term) {
                for (value, column) in other_joints.iter_mut().zip(column.iter()) {
                    *value -= column * driven;
                }
            }
            let mut accelerations = resolver.solve(&other_joints);
            accelerations.iter_mut().skip(joint).take(1).for_each(|value| *value = driven);
            return accelerations;
        }
        let mut accelerations = resolver.solve(tool);
        if let Some(ArmAngle { angle, jacobian: gradient }) = arm_angle {
            // `ġ·q̇` is left out: the feedback of the elbow corrects it.
            let residual = self.elbow_acceleration(settings, angle, gradient.dot(&velocities))
                - gradient.dot(&accelerations);
            let projected = resolver.project_to_null_space(&gradient);
            let size = gradient.dot(&projected);
            accelerations += projected * (residual * size / (size * size + ARM_ANGLE_DAMPING));
        } else if arm.chain.len() == MAX_CHAIN_JOINTS
            && settings.law.direct().is_none_or(|law| law.null_space_damping)
        {
            // The elbow has no set-point: damp the null-space motion.
            let damping = 2.0 * settings.elbow_bandwidth;
            accelerations -= resolver.project_to_null_space(&velocities) * damping;
        }
        accelerations
    }

    /// Critically damped control of the elbow: its acceleration [rad/s²] at `angle` [rad] and `velocity`
    /// [rad/s].
    #[inline]
    fn elbow_acceleration(&self, settings: &ImpedanceSettings, angle: f32, velocity: f32) -> f32 {
        let (setpoint, bandwidth) = (&self.elbow_setpoint, settings.elbow_bandwidth);
        setpoint.acceleration
            + 2.0 * bandwidth * (setpoint.velocity - velocity)
            + bandwidth
                * bandwidth
                * math::clamp(wrap_angle(setpoint.angle - angle), -MAX_ELBOW_ERROR, MAX_ELBOW_ERROR)
    }

    /// Elbow angle at joint `angles` [rad]; `posture` belongs to these. `None` without elbow control, and
    /// where the arm angle is undefined.
    #[inline(never)]
    pub(in super::super) fn elbow_angle(
        &self,
        arm: &Arm<'_>,
        posture: &Posture,
        angles: &[f32; MAX_CHAIN_JOINTS],
    ) -> Option<f32> {
        match self.settings.redundancy {
            Redundancy::DrivenJoint { joint } => angles.get(usize::from(joint)).copied(),
            Redundancy::ArmAngle => ArmAngle::of(posture, arm.gravity).map(|arm| arm.angle),
            Redundancy::None => None,
        }
    }

    /// Sets the elbow's set-point to its angle in `posture`, at rest.
    pub(in super::super) fn hold_elbow(&mut self, arm: &Arm<'_>, posture: &Posture) {
        let angle = self.elbow_angle(arm, posture, &self.angles);
        self.arm_angle_undefined = self.settings.redundancy == Redundancy::ArmAngle && angle.is_none();
        self.elbow_setpoint = ElbowSetpoint { angle: angle.unwrap_or(0.0), ..ElbowSetpoint::default() };
    }

    /// Finds the smallest singular value by inverse iteration; each tick then adds one step.
    pub(super) fn initialize_singular_value(&mut self, posture: &Posture) {
        let jacobian = posture.jacobian();
        let driven = driven_joint(self.settings.redundancy);
        let mut left_singular_vector = Vector6::repeat(math::sqrt(1.0 / 6.0));
        for _ in 0..INITIAL_ITERATIONS {
            let _ = Resolver::new(&jacobian, driven, &mut left_singular_vector, &mut self.sigma_min);
        }
        self.left_singular_vector = left_singular_vector.into();
    }
}

/// The joint that follows the elbow's set-point directly, if any.
pub(super) fn driven_joint(redundancy: Redundancy) -> Option<usize> {
    match redundancy {
        Redundancy::DrivenJoint { joint } => Some(joint.into()),
        _ => None,
    }
}
