//! Contact forces: estimates of load and friction, the internal forces of the grip, and force feedback.

mod dither;
mod estimates;
mod feedback;
mod grip;

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests;

use nalgebra::{Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{InternalForce, PerFinger};
use crate::grasp::{Contact, GraspMap, GripState, ThreeFingers, WrenchInverse};
use crate::math::abs;
use crate::zip::zip;

/// State of the force control.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub(super) struct Forces {
    /// Filtered wrench of the fingers on the object, about the object's origin [N, N·m].
    pub load: [f32; 6],
    /// The same with a slower filter: the load before a change [N, N·m].
    pub earlier_load: [f32; 6],
    /// The same with the slowest filter: the object's weight [N, N·m].
    pub weight: [f32; 6],
    /// Anticipated further increase of a load that grows [N, N·m].
    anticipated_load: [f32; 6],
    /// Increase of the internal forces after a slip, as a fraction of them.
    slip_grip: f32,
    /// Internal forces of the last solution [N].
    base: PerFinger<[f32; 3]>,
    /// Norm of the load of that solution, with moments counted as forces [N, N·m].
    base_load: f32,
    /// Norm of the least grip's internal forces in the last tick [N].
    grip_magnitude: f32,
    /// Estimated coefficient of friction.
    pub friction: f32,
    /// Target forces of the fingers on the object [N].
    pub target: PerFinger<[f32; 3]>,
    /// Integral part of the force feedback [N].
    correction: PerFinger<[f32; 3]>,
    /// Filtered tangential over normal force of each contact.
    pub force_ratios: PerFinger<f32>,
    /// Filtered tangential force of each contact beyond that at which slip is incipient [N].
    excess: PerFinger<f32>,
    /// Distances of the fingertips from their anchors in the last tick [m].
    anchor_errors: PerFinger<f32>,
    /// Warm start of the least grip.
    search: GripState,
    /// No forces within the limits balance the load: the grip is at its limits.
    pub overloaded: bool,
    /// Ticks with a slip.
    pub slips: u16,
}

/// Inputs of the contact forces of a tick.
pub(super) struct ForceInputs<'a> {
    pub map: &'a GraspMap,
    /// Measured forces of the fingertips on the object [N].
    pub measured: &'a PerFinger<Vector3<f32>>,
    /// Distances of the fingertips from their anchors [m].
    pub anchor_errors: PerFinger<f32>,
    pub internal: InternalForce,
    /// Whether the force sensors correct the internal forces.
    pub feedback: bool,
    /// Whether the fingers hold the object. Before and after, they press on an object on its support.
    pub is_held: bool,
    /// The load where it is not measured [N, N·m].
    pub known_load: Option<Vector6<f32>>,
    /// Whether no support carries the object. Internal forces between fingers and a support look like a load;
    /// a grip that followed them would grow without bound.
    pub is_lifted: bool,
    /// Fraction of the load that is fed forward.
    pub load_feedforward: f32,
    /// Whether to grip as for a motion.
    pub in_motion: bool,
    /// Map from contact forces to joint torques.
    pub three: &'a ThreeFingers,
    /// Joint torques that forces on the object may take [N·m].
    pub torque_limits: PerFinger<[f32; 3]>,
}

/// Contact forces of a tick [N].
pub(super) struct GripForces {
    /// Internal forces: those of the grip with superposed ones and feedback.
    pub internal: PerFinger<Vector3<f32>>,
    /// Forces that balance the load.
    pub load: PerFinger<Vector3<f32>>,
}

impl Forces {
    /// No object.
    pub const NONE: Self = Self {
        load: [0.0; 6],
        earlier_load: [0.0; 6],
        weight: [0.0; 6],
        anticipated_load: [0.0; 6],
        slip_grip: 0.0,
        base: [[0.0; 3]; 3],
        base_load: 0.0,
        grip_magnitude: 0.0,
        friction: 0.0,
        target: [[0.0; 3]; 3],
        correction: [[0.0; 3]; 3],
        force_ratios: [0.0; 3],
        excess: [0.0; 3],
        anchor_errors: [0.0; 3],
        search: GripState::START,
        overloaded: false,
        slips: 0,
    };

    /// The state before the grasp of an object with this coefficient of friction.
    pub const fn new(friction: f32) -> Self {
        Self { friction, ..Self::NONE }
    }

    /// Solves for the contact forces: those that balance the load, and the internal ones, of which
    /// `grip_fraction` (0 to 1) is applied. `superposed`: further internal forces, of probe or dither [N].
    pub fn solve_grip(
        &mut self,
        inputs: &ForceInputs<'_>,
        inverse: &WrenchInverse<'_>,
        grip_fraction: f32,
        superposed: &PerFinger<Vector3<f32>>,
    ) -> GripForces {
        let contacts = inputs.map.contacts();
        let load = least_forces(inverse, &inputs.known_load.unwrap_or_else(|| self.load.into()));
        let load_torques = inputs.three.torques(&load);
        let mut internal = self.internal_forces(inputs, inverse, &load_torques);
        internal.iter_mut().for_each(|force| *force *= grip_fraction);
        let scale = superposition_scale(contacts, &internal, &load, superposed);
        for (internal, load, superposed, contact, target) in
            zip((&mut internal, &load, superposed, contacts, &mut self.target))
        {
            // The normal force never exceeds the contact's limit, so that nothing is crushed.
            let force = contact.limited(&(*internal + superposed * scale + load));
            *target = force.into();
            *internal = force - load;
        }
        let internal = self.apply_feedback(inputs, inverse, internal, &load, &load_torques);
        GripForces { internal, load }
    }
}

impl ForceInputs<'_> {
    /// Largest factor, at most `max_scale`, by which the internal `forces` [N] can be scaled within the
    /// limits of contacts and joints. `load_torques`: joint torques of the forces that balance the load
    /// [N·m].
    fn grip_scale(
        &self,
        forces: &PerFinger<Vector3<f32>>,
        load_torques: &PerFinger<Vector3<f32>>,
        max_scale: f32,
    ) -> f32 {
        let mut scale = max_scale;
        for (contact, force) in self.map.contacts().iter().zip(forces) {
            scale = limit_scale(scale, contact.normal().dot(force), contact.limit());
        }
        self.torque_scale(forces, load_torques, scale)
    }

    /// Largest factor, at most `scale`, by which the `forces` [N] can be scaled within the joints' torque
    /// limits, in addition to `load_torques` [N·m].
    fn torque_scale(
        &self,
        forces: &PerFinger<Vector3<f32>>,
        load_torques: &PerFinger<Vector3<f32>>,
        mut scale: f32,
    ) -> f32 {
        let torques = self.three.torques(forces);
        for (load_torques, torques, limits) in zip((load_torques, &torques, &self.torque_limits)) {
            for (&load_torque, &torque, &limit) in zip((load_torques, torques, limits)) {
                // Headroom in the direction of the added torque.
                let headroom = limit - if torque > 0.0 { load_torque } else { -load_torque };
                scale = limit_scale(scale, abs(torque), headroom);
            }
        }
        scale
    }

    /// The finger with the smallest normal force, and that force [N].
    pub fn min_normal_force(&self) -> (u8, f32) {
        let forces = zip((0.., self.map.contacts(), self.measured))
            .map(|(finger, contact, force)| (finger, contact.normal().dot(force)));
        forces.fold((0, f32::INFINITY), |min, force| if force.1 < min.1 { force } else { min })
    }
}

/// Largest factor, at most 1, of `superposed` forces with which no contact exceeds its limit. It is the same
/// for all fingers, so that the direction of their wrench stays, and internal forces stay internal.
pub(super) fn superposition_scale(
    contacts: &[Contact],
    internal: &PerFinger<Vector3<f32>>,
    load: &PerFinger<Vector3<f32>>,
    superposed: &PerFinger<Vector3<f32>>,
) -> f32 {
    let mut scale = 1.0;
    for (contact, internal, load, superposed) in zip((contacts, internal, load, superposed)) {
        let headroom = contact.limit() - contact.normal().dot(&(internal + load));
        scale = limit_scale(scale, contact.normal().dot(superposed), headroom);
    }
    scale
}

/// `scale`, reduced so that `scale · rate` does not exceed the `headroom`.
fn limit_scale(scale: f32, rate: f32, headroom: f32) -> f32 {
    let headroom = if headroom > 0.0 { headroom } else { 0.0 };
    if scale * rate > headroom { headroom / rate } else { scale }
}

/// The least contact forces for a `wrench` [N, N·m]; none for one that the contacts do not resist [N].
pub(super) fn least_forces(inverse: &WrenchInverse<'_>, wrench: &Vector6<f32>) -> PerFinger<Vector3<f32>> {
    let mut least = [Vector3::zeros(); 3];
    if let Ok(forces) = inverse.forces(wrench) {
        least.iter_mut().zip(&forces).for_each(|(least, force)| *least = *force);
    }
    least
}

/// The grasp map of contacts at `levers` from `origin` with these `normals`; `None` if they are invalid.
pub(super) fn grasp_map(
    origin: Vector3<f32>,
    levers: &PerFinger<Vector3<f32>>,
    normals: &PerFinger<Vector3<f32>>,
    friction: f32,
    limits: &PerFinger<f32>,
) -> Option<GraspMap> {
    let mut contacts = heapless::Vec::<Contact, 3>::new();
    for (lever, normal, limit) in zip((levers, normals, limits)) {
        let contact = Contact::try_new(origin + lever, *normal, friction, *limit).ok()?;
        contacts.push(contact).ok()?;
    }
    GraspMap::try_new(&contacts, origin).ok()
}
