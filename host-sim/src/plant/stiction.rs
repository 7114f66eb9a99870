//! Static friction that does not creep.
//!
//! Rapier holds a sticking contact by its velocity, to single precision: 0.1 m from the origin that leaves a
//! creep of up to 0.05 mm/s. So what a contact has crept since it last slid is measured, and rapier is told
//! to take it back.

use rapier3d::geometry::ColliderHandle;
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Point3, Vector3};
use rapier3d::pipeline::{ContactModificationContext, PhysicsHooks};

use super::convert::{vector, wide};

/// Fraction of the creep that is corrected in a sub-step.
pub const CREEP_GAIN: f64 = 0.2;

/// How far the contacts of an object have crept.
pub struct Creep {
    /// Collider of each fingertip, and the velocity along the object that takes back its creep, in the frame
    /// of the base [m/s].
    pub tips: Vec<(ColliderHandle, Vector3<f64>)>,
    /// Collider of the support, and the motion by which the object has crept on it.
    pub support: Option<(ColliderHandle, Isometry3<f64>)>,
    /// Sub-step [s].
    pub step: f64,
}

impl Creep {
    /// Velocity along the object that takes back the creep of what has a collider, at a point.
    fn back(&self, other: ColliderHandle, point: Vector) -> Option<Vector3<f64>> {
        if let Some((_, velocity)) = self.tips.iter().find(|(tip, _)| *tip == other) {
            return Some(*velocity);
        }
        let (_, motion) = self.support.as_ref().filter(|(support, _)| *support == other)?;
        let point = Point3::from(wide(point));
        Some((motion.inverse() * point - point) * (CREEP_GAIN / self.step))
    }
}

impl PhysicsHooks for Creep {
    /// Rapier makes the first body's surface move by the tangent velocity, and with it what sticks.
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext<'_>) {
        let (one, two) = (context.collider1, context.collider2);
        let Some(manifold) = context.rigid_mut() else { return };
        for contact in manifold.solver_contacts.iter_mut() {
            let back = self.back(one, contact.anchor1);
            let back = back.or_else(|| self.back(two, contact.anchor2).map(|velocity| -velocity));
            contact.tangent_velocity = vector(&back.unwrap_or_default());
        }
    }
}
