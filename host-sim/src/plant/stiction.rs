//! Static friction without creep.
//!
//! Rapier holds a sticking contact by its velocity, in single precision: 0.1 m from the origin that leaves a
//! creep of up to 0.05 mm/s. Therefore the creep of each contact since it last slid is measured, and rapier
//! is made to reverse it.

use rapier3d::geometry::ColliderHandle;
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Point3, Vector3};
use rapier3d::pipeline::{ContactModificationContext, PhysicsHooks};

use super::convert::{vector, wide};

/// Fraction of the creep that is corrected in a sub-step.
const CREEP_GAIN: f64 = 0.2;

/// Creep of all contacts.
pub struct Creep {
    pub contacts: Vec<Crept>,
    /// Sub-step [s].
    pub step: f64,
}

/// A creep on a fixed body.
pub struct Crept {
    /// Collider of the fixed body.
    pub fixed: ColliderHandle,
    /// Collider of the creeping body.
    pub moving: ColliderHandle,
    /// The motion of its creep.
    pub motion: Isometry3<f64>,
}

impl Creep {
    /// Returns the velocity of a surface at a point that reverses the creep of the other surface on it.
    fn back(&self, surface: ColliderHandle, other: ColliderHandle, point: Vector) -> Option<Vector3<f64>> {
        let same = |crept: &&Crept| crept.fixed == surface && crept.moving == other;
        let motion = self.contacts.iter().find(same)?.motion;
        let point = Point3::from(wide(point));
        Some((motion.inverse() * point - point) * (CREEP_GAIN / self.step))
    }
}

impl PhysicsHooks for Creep {
    /// Sets the tangent velocities, with which rapier moves the first body's surface and whatever sticks to
    /// it.
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext<'_>) {
        let (one, two) = (context.collider1, context.collider2);
        let Some(manifold) = context.rigid_mut() else { return };
        for contact in manifold.solver_contacts.iter_mut() {
            let back = self.back(one, two, contact.anchor1);
            let back = back.or_else(|| self.back(two, one, contact.anchor2).map(|velocity| -velocity));
            contact.tangent_velocity = vector(&back.unwrap_or_default());
        }
    }
}
