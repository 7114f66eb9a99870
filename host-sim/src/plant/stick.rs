//! Static friction that does not creep.
//!
//! Rapier holds a sticking contact by its velocity, to single precision: 0.1 m from the origin that leaves a creep of up
//! to 0.05 mm/s. So what a contact has crept since it last slid is measured, and rapier is told to take it back.

use rapier3d::geometry::ColliderHandle;
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Point3, Vector3};
use rapier3d::pipeline::{ContactModificationContext, PhysicsHooks};

use super::world::{vector, wide};

/// Share of the creep that is taken back in a sub-step.
const SHARE: f64 = 0.2;

/// How far the contacts of an object have crept.
pub struct Creep {
    /// Collider of each fingertip, and its creep on the object in the frame of the base [m].
    pub tips: Vec<(ColliderHandle, Vector3<f64>)>,
    /// Collider of the support, and the motion by which the object has crept on it.
    pub support: Option<(ColliderHandle, Isometry3<f64>)>,
    /// Sub-step [s].
    pub step: f64,
}

impl Creep {
    /// Creep on the object at a point, of the tip or support that has a collider.
    fn at(&self, other: ColliderHandle, point: Vector) -> Option<Vector3<f64>> {
        if let Some((_, creep)) = self.tips.iter().find(|(tip, _)| *tip == other) {
            return Some(*creep);
        }
        let (_, motion) = self.support.as_ref().filter(|(support, _)| *support == other)?;
        let point = Point3::from(wide(point));
        Some(motion.inverse() * point - point)
    }
}

impl PhysicsHooks for Creep {
    /// Rapier makes the first body's surface move by the tangent velocity, and with it what sticks.
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext<'_>) {
        let (one, two) = (context.collider1, context.collider2);
        let Some(manifold) = context.rigid_mut() else { return };
        for contact in manifold.solver_contacts.iter_mut() {
            let creep = self.at(one, contact.anchor1);
            let creep = creep.or_else(|| self.at(two, contact.anchor2).map(|creep| -creep));
            contact.tangent_velocity = vector(&(creep.unwrap_or_default() * (SHARE / self.step)));
        }
    }
}
