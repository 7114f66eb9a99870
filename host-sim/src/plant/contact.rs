//! Contacts of an object, as the physics tells them.

use rapier3d::geometry::{ColliderHandle, ContactPair};
use rapier3d::na::{UnitQuaternion, Vector3};

use super::convert::wide;
use super::stiction::SHARE;

/// A contact slides when its friction is at least this share of what it can be.
const SLIDING: f64 = 0.999;
/// Share of an error of the direction of sliding friction that is corrected in a sub-step.
const LEANING: f64 = 0.5;

/// A fingertip and its contact with the object, as of the last sub-step.
#[derive(Clone, Debug)]
pub struct Touch {
    pub collider: ColliderHandle,
    /// On the object, in the frame of the base [N].
    pub force: Vector3<f64>,
    /// Sum of the forces of so many sub-steps.
    sum: (Vector3<f64>, f64),
    /// Where it acts, in the frame of the base [m]; the middle of the tip without contact.
    pub point: Vector3<f64>,
    /// Out of the object, in the frame of the base; 0 without contact.
    pub normal: Vector3<f64>,
    /// How deep the tip is in the object [m].
    pub depth: f64,
    /// Of the tip along the object's surface, in the frame of the object [m/s].
    pub slip_velocity: Vector3<f64>,
    /// Its integral while the tip touched [m].
    pub slip: Vector3<f64>,
    /// Integral of its size while the contact slid [m].
    pub slip_path: f64,
    /// `slip` when the contact last slid: all since then is creep.
    stuck_at: Vector3<f64>,
    /// See [`Self::lean`]; 0 while the contact sticks.
    leaning: Vector3<f64>,
}

impl Touch {
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
            leaning: zero,
        }
    }

    /// Takes in the contact of a sub-step [s]: where it is, and how the tip moves along the object, turned by
    /// `turn`.
    pub fn update(
        &mut self,
        contact: &Contact,
        point: Vector3<f64>,
        motion: &Vector3<f64>,
        turn: &UnitQuaternion<f64>,
        (friction, step): (f64, f64),
    ) {
        let touches = contact.force != Vector3::zeros();
        self.force = contact.force;
        self.sum = (self.sum.0 + contact.force, self.sum.1 + 1.0);
        self.point = point;
        self.normal = contact.normal;
        self.depth = contact.depth;
        self.slip_velocity =
            if touches { turn.inverse() * across(motion, &contact.normal) } else { Vector3::zeros() };
        self.slip += self.slip_velocity * step;
        if contact.slides(friction) {
            self.slip_path += self.slip_velocity.norm() * step;
            self.stuck_at = self.slip;
            self.lean(&(turn.inverse() * across(&contact.force, &contact.normal)));
        } else {
            self.leaning = Vector3::zeros();
        }
    }

    /// Begins a new mean of the force.
    pub fn begin_mean(&mut self) {
        self.sum = (Vector3::zeros(), 0.0);
    }

    /// Mean of the force on the object since then, in the frame of the base [N].
    pub fn mean_force(&self) -> Vector3<f64> {
        self.sum.0 / self.sum.1.max(1.0)
    }

    /// Friction on the object is to point where the tip slides. Rapier's does not where the masses that the
    /// contact moves differ between directions, unless it is told of a suitable motion across.
    fn lean(&mut self, friction: &Vector3<f64>) {
        let (Some(way), Some(pull)) = (self.slip_velocity.try_normalize(1e-6), friction.try_normalize(1e-9))
        else {
            self.leaning = Vector3::zeros();
            return;
        };
        self.leaning = across(&(self.leaning + LEANING * (way - pull)), &way).cap_magnitude(1.0);
    }

    /// What rapier is to add to the tip's velocity along the object, in the frame of the object [m/s].
    pub fn correction(&self, step: f64) -> Vector3<f64> {
        (self.slip - self.stuck_at) * (SHARE / step) + self.leaning * self.slip_velocity.norm()
    }
}

/// What one collider does to another.
#[derive(Default)]
pub struct Contact {
    pub force: Vector3<f64>,
    pub normal: Vector3<f64>,
    pub depth: f64,
}

impl Contact {
    /// Whether it slides, or parts.
    pub fn slides(&self, friction: f64) -> bool {
        let limit = friction * self.force.dot(&self.normal).abs();
        across(&self.force, &self.normal).norm() >= SLIDING * limit
    }
}

/// The forces of a pair on `object` in the last sub-step, which had one solver iteration.
pub fn contact(pair: &ContactPair, object: ColliderHandle, step: f64) -> Contact {
    let side = if pair.collider1 == object { 1.0 } else { -1.0 };
    let mut contact = Contact::default();
    for manifold in pair.manifolds() {
        let normal = wide(manifold.data.normal);
        let touching = || manifold.points.iter().filter(|point| point.data.impulse > 0.0);
        let Some(first) = touching().next() else { continue };
        // A face rubs as a whole, and each of its points is told the whole friction.
        let friction = wide(first.data.warmstart_tangent_world);
        let push = touching().map(|point| f64::from(point.data.impulse)).sum::<f64>();
        contact.force += (friction - normal * push) * (side / step);
        contact.normal = normal * side;
        contact.depth = touching().fold(contact.depth, |depth, point| depth.max(-f64::from(point.dist)));
    }
    contact
}

/// The part of a vector that is across a direction.
fn across(vector: &Vector3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    vector - direction * direction.dot(vector)
}
