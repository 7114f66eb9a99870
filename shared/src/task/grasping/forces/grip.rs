use nalgebra::{Vector3, Vector6};

use super::{ForceInputs, Forces};
use crate::TICK;
use crate::grasp::{GraspMap, GripError, LeastGrip, WrenchInverse};
use crate::math;
use crate::task::grasping::tuning::{
    GRIP_BUDGET, GRIP_RELEASE_TIME, GRIP_TOLERANCE, MAX_PRELOAD, NORMAL_TOLERANCE, PRELOAD_GAIN,
};
use crate::task::grasping::{InternalForce, PerFinger};

impl Forces {
    /// Internal forces as planned, for the present load and its anticipated increase [N].
    pub(super) fn internal_forces(
        &mut self,
        inputs: &ForceInputs<'_>,
        inverse: &WrenchInverse<'_>,
        load_torques: &PerFinger<Vector3<f32>>,
    ) -> PerFinger<Vector3<f32>> {
        self.overloaded = false;
        match inputs.internal {
            InternalForce::LeastGrip { margin, capacity_at_rest, capacity_in_motion } => {
                let capacity = if inputs.in_motion { capacity_in_motion } else { capacity_at_rest };
                let min_force = capacity / self.friction + self.preload();
                let load = if inputs.is_lifted { self.load } else { self.earlier_load };
                let load = Vector6::from(load) + Vector6::from(self.anticipated_load);
                self.update_least_grip(inputs.map, inverse, margin, min_force, &load);
                return self.scaled_least_grip(inputs, load_torques, &load);
            }
            // If the contacts have moved so far that no solution exists, the last one is kept: the grip does
            // not open.
            InternalForce::Normal { strength } => {
                if let Ok(grip) = inputs.map.normal_grip(NORMAL_TOLERANCE) {
                    let forces = grip.forces(strength);
                    self.base.iter_mut().zip(&forces).for_each(|(base, force)| *base = (*force).into());
                }
            }
            InternalForce::Pairwise { strengths } => {
                if let Ok(pairs) = inputs.map.pairwise() {
                    let forces = pairs * Vector3::from(strengths);
                    let forces = forces.as_slice().chunks_exact(3);
                    self.base.iter_mut().zip(forces).for_each(|(base, force)| base.copy_from_slice(force));
                }
            }
        }
        // As a whole: cut at one contact, the forces would push the object.
        self.scaled(inputs, load_torques, 1.0).1
    }

    /// The largest factor, at most `max_scale`, within the limits of contacts and joints, and the internal
    /// forces scaled by it.
    #[inline(never)]
    fn scaled(
        &self,
        inputs: &ForceInputs<'_>,
        load_torques: &PerFinger<Vector3<f32>>,
        max_scale: f32,
    ) -> (f32, PerFinger<Vector3<f32>>) {
        let mut forces = self.base.map(Vector3::from);
        let scale = inputs.grip_scale(&forces, load_torques, max_scale);
        forces.iter_mut().for_each(|force| *force *= scale);
        (scale, forces)
    }

    /// Additional minimum normal force while a load grows [N].
    fn preload(&self) -> f32 {
        let [x, y, z, ..] = self.anticipated_load;
        let preload = PRELOAD_GAIN * math::sqrt(x * x + y * y + z * z);
        if preload < MAX_PRELOAD { preload } else { MAX_PRELOAD }
    }

    /// Continues the search for the least grip, and stores its internal forces.
    fn update_least_grip(
        &mut self,
        map: &GraspMap,
        inverse: &WrenchInverse<'_>,
        margin: f32,
        min_force: f32,
        load: &Vector6<f32>,
    ) {
        let grip = LeastGrip::try_new(margin, min_force).and_then(|grip| grip.with_tolerance(GRIP_TOLERANCE));
        match grip.map(|grip| grip.advance(map, load, &mut self.search, GRIP_BUDGET)) {
            Ok(Ok(grip)) => {
                let mut forces = [Vector3::zeros(); 3];
                forces.iter_mut().zip(&grip.forces).for_each(|(force, found)| *force = *found);
                // Internal forces prepare for the anticipated part of the load; they do not balance it.
                inverse.project_to_null_space(&mut forces);
                self.base = forces.map(Into::into);
                self.base_load = math::norm(load);
            }
            Ok(Err(GripError::CannotHold(_) | GripError::Limit { .. })) => self.overloaded = true,
            // During a search, and at the boundary of the feasible set, the last forces are kept.
            _ => {}
        }
    }

    /// The least grip of the last solution, scaled for slips and for a load that has grown since.
    fn scaled_least_grip(
        &mut self,
        inputs: &ForceInputs<'_>,
        load_torques: &PerFinger<Vector3<f32>>,
        load: &Vector6<f32>,
    ) -> PerFinger<Vector3<f32>> {
        // An infeasible load gets the largest grip within the limits.
        let mut scale = if self.overloaded { f32::MAX } else { 1.0 + self.slip_grip };
        let magnitude = math::sqrt(self.base.map(Vector3::from).iter().map(Vector3::norm_squared).sum());
        let load = math::norm(load);
        if load > self.base_load && magnitude > f32::MIN_POSITIVE {
            // The solution was for a smaller load.
            let unit = if magnitude > self.base_load { magnitude } else { self.base_load };
            scale *= 1.0 + (load - self.base_load) / unit;
        }
        // The grip decays slowly, because forces are not exact while a load decreases.
        let min_magnitude = self.grip_magnitude * (1.0 - TICK / GRIP_RELEASE_TIME);
        if magnitude * scale < min_magnitude && magnitude > f32::MIN_POSITIVE {
            scale = min_magnitude / magnitude;
        }
        let (scale, forces) = self.scaled(inputs, load_torques, scale);
        self.grip_magnitude = magnitude * scale;
        forces
    }
}
