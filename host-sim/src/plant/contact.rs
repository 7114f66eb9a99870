//! Contacts of the grasped object, read from the physics engine.

use rapier3d::geometry::{ColliderHandle, ContactPair};
use rapier3d::na::{UnitQuaternion, Vector3};

use super::convert::wide;
use super::stiction::CREEP_GAIN;

/// A contact slides when its friction is at least this fraction of Coulomb's limit.
const SLIDING: f64 = 0.999;
/// Fraction of the direction error of sliding friction that is corrected in a sub-step.
const DIRECTION_GAIN: f64 = 0.5;

/// A fingertip and its contact with the object, as of the last sub-step.
#[derive(Clone, Debug)]
pub struct TipContact {
    pub collider: ColliderHandle,
    /// Force on the object, in the base frame [N].
    pub force: Vector3<f64>,
    /// Sum of the forces, and number of sub-steps.
    sum: (Vector3<f64>, f64),
    /// Point of contact, in the base frame [m]; the centre of the tip without contact.
    pub point: Vector3<f64>,
    /// Outward normal of the object, in the base frame; 0 without contact.
    pub normal: Vector3<f64>,
    /// Penetration of the tip into the object [m].
    pub depth: f64,
    /// Velocity of the tip along the object's surface, in the object frame [m/s].
    pub slip_velocity: Vector3<f64>,
    /// Integral of the slip velocity during contact [m].
    pub slip: Vector3<f64>,
    /// Path of the tip along the surface while the contact slid [m].
    pub slip_path: f64,
    /// `slip` when the contact last slid: the change since then is creep.
    stuck_at: Vector3<f64>,
    /// See [`Self::correct_direction`]; 0 while the contact sticks.
    direction_correction: Vector3<f64>,
}

impl TipContact {
    pub fn new(collider: ColliderHandle) -> Self {
        let zero = Vector3::zeros();
        Self {
            collider,
            force: zero,
            sum: (zero, 0.0),
            point: zero,
            normal: zero,
            depth: 0.0,
            slip_velocity: zero,
            slip: zero,
            slip_path: 0.0,
            stuck_at: zero,
            direction_correction: zero,
        }
    }

    /// Updates the contact after a sub-step of `step` seconds. `motion` is the velocity of the tip relative
    /// to the object, `rotation` that of the object.
    pub fn update(
        &mut self,
        contact: &Contact,
        point: Vector3<f64>,
        motion: &Vector3<f64>,
        rotation: &UnitQuaternion<f64>,
        (friction, step): (f64, f64),
    ) {
        let touches = contact.force != Vector3::zeros();
        self.force = contact.force;
        self.sum = (self.sum.0 + contact.force, self.sum.1 + 1.0);
        self.point = point;
        self.normal = contact.normal;
        self.depth = contact.depth;
        self.slip_velocity =
            if touches { rotation.inverse() * across(motion, &contact.normal) } else { Vector3::zeros() };
        self.slip += self.slip_velocity * step;
        if contact.slides(friction) {
            self.slip_path += self.slip_velocity.norm() * step;
            self.stuck_at = self.slip;
            self.correct_direction(&(rotation.inverse() * across(&contact.force, &contact.normal)));
        } else {
            self.direction_correction = Vector3::zeros();
        }
    }

    /// Begins a new averaging interval of the force.
    pub fn begin_mean(&mut self) {
        self.sum = (Vector3::zeros(), 0.0);
    }

    /// Mean force on the object since then, in the base frame [N].
    pub fn mean_force(&self) -> Vector3<f64> {
        self.sum.0 / self.sum.1.max(1.0)
    }

    /// Corrects the direction of sliding friction, which must oppose the slip velocity. Rapier's friction
    /// does not if the effective mass of the contact differs between tangential directions. The correction is
    /// a velocity across the slip direction, which is added to the velocity that rapier sees; this updates
    /// it.
    fn correct_direction(&mut self, friction: &Vector3<f64>) {
        let (Some(slip), Some(pull)) = (self.slip_velocity.try_normalize(1e-6), friction.try_normalize(1e-9))
        else {
            self.direction_correction = Vector3::zeros();
            return;
        };
        self.direction_correction =
            across(&(self.direction_correction + DIRECTION_GAIN * (slip - pull)), &slip).cap_magnitude(1.0);
    }

    /// Velocity along the surface that corrects creep and the direction of friction, in the object frame
    /// [m/s].
    pub fn correction(&self, step: f64) -> Vector3<f64> {
        (self.slip - self.stuck_at) * (CREEP_GAIN / step)
            + self.direction_correction * self.slip_velocity.norm()
    }
}

/// The contact of two colliders during a sub-step.
#[derive(Default)]
pub struct Contact {
    pub force: Vector3<f64>,
    pub normal: Vector3<f64>,
    pub depth: f64,
}

impl Contact {
    /// Returns whether it slides or separates.
    pub fn slides(&self, friction: f64) -> bool {
        let limit = friction * self.force.dot(&self.normal).abs();
        across(&self.force, &self.normal).norm() >= SLIDING * limit
    }
}

/// Returns the contact of a pair, with the forces on `object` in the last sub-step, which had one solver
/// iteration.
pub fn contact(pair: &ContactPair, object: ColliderHandle, step: f64) -> Contact {
    let side = if pair.collider1 == object { 1.0 } else { -1.0 };
    let mut contact = Contact::default();
    for manifold in pair.manifolds() {
        let normal = wide(manifold.data.normal);
        let touching = || manifold.points.iter().filter(|point| point.data.impulse > 0.0);
        let Some(first) = touching().next() else { continue };
        // Rapier stores the friction of a whole face at each of its points.
        let friction = wide(first.data.warmstart_tangent_world);
        let push = touching().map(|point| f64::from(point.data.impulse)).sum::<f64>();
        contact.force += (friction - normal * push) * (side / step);
        contact.normal = normal * side;
        contact.depth = touching().fold(contact.depth, |depth, point| depth.max(-f64::from(point.dist)));
    }
    contact
}

/// Returns the component of a vector perpendicular to a direction.
pub fn across(vector: &Vector3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    vector - direction * direction.dot(vector)
}
