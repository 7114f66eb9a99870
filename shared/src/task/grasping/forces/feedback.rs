use nalgebra::Vector3;

use super::{ForceInputs, Forces, limit_scale};
use crate::TICK;
use crate::grasp::WrenchInverse;
use crate::math::{self, abs};
use crate::task::grasping::tuning::{
    CONVERGED_FORCE, CONVERGED_FRACTION, DEAD_BAND_FORCE, DEAD_BAND_FRACTION, FORCE_INTEGRAL_GAIN,
    MAX_FORCE_CORRECTION,
};
use crate::task::grasping::{InternalForce, PerFinger};
use crate::zip::zip;

impl Forces {
    /// Integral control of the `internal` forces by the force sensors; returns their commands [N]. Together
    /// with the `load` forces they keep the limits of contacts and joints.
    pub(super) fn apply_feedback(
        &mut self,
        inputs: &ForceInputs<'_>,
        inverse: &WrenchInverse<'_>,
        internal: PerFinger<Vector3<f32>>,
        load: &PerFinger<Vector3<f32>>,
        load_torques: &PerFinger<Vector3<f32>>,
    ) -> PerFinger<Vector3<f32>> {
        let in_dead_band =
            matches!(inputs.internal, InternalForce::LeastGrip { .. }) && self.is_in_dead_band(inputs);
        if inputs.feedback && !in_dead_band {
            let mut next = self.correction.map(Vector3::from);
            for (next, target, measured) in zip((&mut next, &self.target, inputs.measured)) {
                *next += (Vector3::from(*target) - measured) * (FORCE_INTEGRAL_GAIN * TICK);
            }
            // Contacts that have moved change what is internal, of the earlier errors, too.
            inverse.project_to_null_space(&mut next);
            let limited = |part: f32| math::clamp(part, -MAX_FORCE_CORRECTION, MAX_FORCE_CORRECTION);
            self.correction = next.map(|part| part.map(limited).into());
        }
        let mut command = internal;
        command.iter_mut().zip(&self.correction).for_each(|(force, part)| *force += Vector3::from(*part));
        let mut scale = 1.0;
        for (contact, command, load) in zip((inputs.map.contacts(), &command, load)) {
            let headroom = contact.limit() - contact.normal().dot(load);
            scale = limit_scale(scale, contact.normal().dot(command), headroom);
        }
        let scale = inputs.torque_scale(&command, load_torques, scale);
        if scale < 1.0 {
            // Saturated contacts or joints: scale the forces down, and set the integrator back (anti-windup
            // by back-calculation).
            for (force, internal, correction) in zip((&mut command, &internal, &mut self.correction)) {
                *force *= scale;
                if inputs.feedback {
                    *correction = (*force - internal).into();
                }
            }
        }
        command
    }

    /// Multiplies the integral part by `fraction`.
    pub fn reduce_correction(&mut self, fraction: f32) {
        self.correction.iter_mut().flatten().for_each(|part| *part *= fraction);
    }

    /// Whether every normal force is in the dead band above its target.
    fn is_in_dead_band(&self, inputs: &ForceInputs<'_>) -> bool {
        let mut contacts = zip((inputs.map.contacts(), inputs.measured, &self.target));
        contacts.all(|(contact, measured, target)| {
            let target = contact.normal().dot(&Vector3::from(*target));
            let measured = contact.normal().dot(measured);
            measured >= target && measured < target * (1.0 + DEAD_BAND_FRACTION) + DEAD_BAND_FORCE
        })
    }

    /// Whether the internal forces are near their targets, along the normals. Forces of a support do not
    /// count.
    pub fn have_converged(&self, inputs: &ForceInputs<'_>, inverse: &WrenchInverse<'_>) -> bool {
        let error = self.internal_force_error(inputs, inverse);
        let mut contacts = zip((inputs.map.contacts(), &error, &self.target));
        contacts.all(|(contact, error, target)| {
            let target = contact.normal().dot(&Vector3::from(*target));
            abs(contact.normal().dot(error)) < CONVERGED_FRACTION * target + CONVERGED_FORCE
        })
    }

    /// Internal part of target minus measured forces [N].
    fn internal_force_error(
        &self,
        inputs: &ForceInputs<'_>,
        inverse: &WrenchInverse<'_>,
    ) -> PerFinger<Vector3<f32>> {
        let mut error: PerFinger<Vector3<f32>> = self.target.map(Into::into);
        error.iter_mut().zip(inputs.measured).for_each(|(error, measured)| *error -= measured);
        inverse.project_to_null_space(&mut error);
        error
    }
}
