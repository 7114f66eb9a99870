//! Contacts of the grasped object.

use rapier3d::geometry::SharedShape;
use rapier3d::na::{Isometry3, Point3, UnitQuaternion, Vector3};
use rapier3d::parry::query::{
    ContactManifold, ContactManifoldsWorkspace, DefaultQueryDispatcher, PersistentQueryDispatcher,
};

use super::convert::{pose, wide};

/// A contact slides when its friction is at least this fraction of Coulomb's limit.
const SLIDING: f64 = 0.999;
/// Solids are found to touch from this distance on [m]. What happens then is up to the constraints.
const PREDICTION: f32 = 2e-4;

/// A solid, and its pose in the frame of the base.
pub type Placed<'a> = (&'a SharedShape, Isometry3<f64>);

/// The contacts of two solids, each point with the impulse of the last sub-step.
#[derive(Default)]
pub struct Pair {
    manifolds: Vec<ContactManifold<(), Vector3<f64>>>,
    workspace: Option<ContactManifoldsWorkspace>,
}

/// A point where the object touches another solid, or soon may, in a sub-step. Vectors are in the frame of
/// the base.
pub struct Touch {
    /// The tip; `None` for the support.
    pub tip: Option<usize>,
    /// The outward normal of the object, and two directions along its surface.
    pub axes: [Vector3<f64>; 3],
    pub point: Vector3<f64>,
    /// Negative if the solids overlap [m].
    pub distance: f64,
    /// Impulse on the object [N·s]: of the last sub-step, until that of this one is known.
    pub impulse: Vector3<f64>,
    /// Velocity of the other solid along the object's surface [m/s].
    pub slip_velocity: Vector3<f64>,
}

impl Pair {
    /// Finds the points where the object touches the other solid, which is a `tip` or the support.
    pub fn find(
        &mut self,
        (object, at): Placed<'_>,
        (other, other_at): Placed<'_>,
        tip: Option<usize>,
    ) -> impl Iterator<Item = Touch> {
        let between = pose(&(at.inverse() * other_at));
        let prediction = PREDICTION;
        let (manifolds, workspace) = (&mut self.manifolds, &mut self.workspace);
        // All solids are convex, so parry knows their contacts.
        let _ = DefaultQueryDispatcher
            .contact_manifolds(&between, &**object, &**other, prediction, manifolds, workspace);
        self.manifolds.iter().flat_map(move |manifold| {
            let axes = axes(at.rotation * wide(manifold.local_n1));
            manifold.points.iter().filter(|point| point.dist < PREDICTION).map(move |point| {
                let one = at * Point3::from(wide(point.local_p1));
                let two = other_at * Point3::from(wide(point.local_p2));
                Touch {
                    tip,
                    axes,
                    point: (one.coords + two.coords) / 2.0,
                    distance: point.dist.into(),
                    impulse: point.data,
                    slip_velocity: Vector3::zeros(),
                }
            })
        })
    }

    /// Keeps the impulses of its touches, in the order in which they were found.
    pub fn keep<'a>(&mut self, mut touches: impl Iterator<Item = &'a Touch>) {
        let points = self.manifolds.iter_mut().flat_map(|manifold| manifold.points.iter_mut());
        for point in points {
            let touch = if point.dist < PREDICTION { touches.next() } else { None };
            point.data = touch.map_or(Vector3::zeros(), |touch| touch.impulse);
        }
    }
}

/// A fingertip and its contact with the object, as of the last sub-step.
#[derive(Clone, Debug, Default)]
pub struct TipContact {
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
}

impl TipContact {
    /// Updates the contact after a sub-step of `step` seconds, in which it was `touch`. `tip` holds centre
    /// and radius of the tip, `rotation` is that of the object.
    pub fn update(
        &mut self,
        touch: Option<&Touch>,
        (center, radius): (Vector3<f64>, f64),
        rotation: &UnitQuaternion<f64>,
        (friction, step): (f64, f64),
    ) {
        self.sum.1 += 1.0;
        let Some(touch) = touch.filter(|touch| touch.impulse != Vector3::zeros()) else {
            *self = Self { sum: self.sum, slip: self.slip, slip_path: self.slip_path, ..Self::default() };
            self.point = center;
            return;
        };
        let normal = touch.axes[0];
        self.force = touch.impulse / step;
        self.sum.0 += self.force;
        self.point = center - normal * radius;
        self.normal = normal;
        self.depth = (-touch.distance).max(0.0);
        self.slip_velocity = rotation.inverse() * touch.slip_velocity;
        self.slip += self.slip_velocity * step;
        let limit = friction * self.force.dot(&normal).abs();
        if across(&self.force, &normal).norm() >= SLIDING * limit {
            self.slip_path += self.slip_velocity.norm() * step;
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
}

/// Returns the component of a vector perpendicular to a direction.
pub fn across(vector: &Vector3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    vector - direction * direction.dot(vector)
}

/// Returns the unit vector along a normal, and two directions across it.
fn axes(normal: Vector3<f64>) -> [Vector3<f64>; 3] {
    let normal = normal.normalize();
    let one = across(&Vector3::ith(normal.iamin(), 1.0), &normal).normalize();
    [normal, one, normal.cross(&one)]
}
