//! Contacts of solids: where they touch, and the impulses between them.
//!
//! The contacts are rapier's springs. [`Constraints`] finds the impulses, as rapier's sweeps would converge
//! slowly: with 16 of them, joints that should stick creep, and joint friction of 0.08 N·m does not reduce a
//! finger's normal force of 2 N on an object at rest. (With 16, 64, 256 and 1000 sweeps, the force is 2.02,
//! 1.91, 0.77 and 0.77 N.)

use rapier3d::dynamics::SpringCoefficients;
use rapier3d::na::{Isometry3, Point3, UnitQuaternion, Vector3};
use rapier3d::parry::query::ContactManifoldsWorkspace;

use super::constraints::{Constraints, ObjectRow, Row};
use super::convert::{narrow, pose, wide};
use super::links::Links;
use super::narrow_phase::{self, Manifold};
use super::rigid_body::FreeBody;
use super::shapes::Solid;

/// A contact slides when its friction is at least this fraction of Coulomb's limit.
const SLIDING: f64 = 0.999;
/// Solids are found to touch from this distance on [m]. What happens then is up to the constraints.
const PREDICTION: f32 = 2e-4;
/// Natural frequency [Hz] and damping ratio of the contact spring with the effective mass.
const SOFTNESS: SpringCoefficients<f32> =
    SpringCoefficients { natural_frequency: 1000.0, damping_ratio: 1.0 };
/// Largest velocity at which the spring of a contact separates the solids [m/s].
const MAX_CORRECTION: f64 = 3.0;

/// A solid, and its pose in the frame of the base.
pub type Placed<'a> = (&'a Solid, Isometry3<f64>);

/// The contacts of two solids, each point with the impulse of the last sub-step.
#[derive(Default)]
pub struct Pair {
    manifolds: Vec<Manifold>,
    workspace: Option<ContactManifoldsWorkspace>,
}

/// A point where two solids touch, or soon may, in a sub-step. The first is the object or a fixed body; the
/// second is a link, or the support of the object. Vectors are in the frame of the base.
pub struct Touch {
    /// Index of the pair of solids.
    pub pair: usize,
    /// Joint of the second solid's link; `None` for the support.
    pub link: Option<usize>,
    /// Coefficient of friction.
    pub friction: f64,
    /// The outward normal of the first solid, and two directions along its surface.
    pub axes: [Vector3<f64>; 3],
    pub point: Vector3<f64>,
    /// Negative if the solids overlap [m].
    pub distance: f64,
    /// Impulse on the first solid [N·s]: of the last sub-step, until that of this one is known.
    pub impulse: Vector3<f64>,
    /// Velocity of the second solid along the first one's surface [m/s].
    pub slip_velocity: Vector3<f64>,
}

impl Pair {
    /// Finds the points where two solids touch, and returns them as touches of the pair with an index.
    pub fn find(
        &mut self,
        (first, at): Placed<'_>,
        (second, second_at): Placed<'_>,
        (pair, link, friction): (usize, Option<usize>, f64),
    ) -> impl Iterator<Item = Touch> {
        let between = at.inverse() * second_at;
        if first.is_near(second, &between, PREDICTION) {
            let (manifolds, workspace) = (&mut self.manifolds, &mut self.workspace);
            let shapes = [&*first.shape, &*second.shape];
            narrow_phase::find(&pose(&between), shapes, PREDICTION, manifolds, workspace);
        } else {
            self.manifolds.clear();
        }
        self.manifolds.iter().flat_map(move |manifold| {
            let axes = axes(at.rotation * wide(manifold.local_n1));
            manifold.points.iter().filter(|point| point.dist < PREDICTION).map(move |point| {
                let one = at * Point3::from(wide(point.local_p1));
                let two = second_at * Point3::from(wide(point.local_p2));
                Touch {
                    pair,
                    link,
                    friction,
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

/// Changes the velocities of links and object so that they meet the constraints of joints and touches, as far
/// as impulses are found. Sets impulses and slip velocities of the touches. Without an object, the first
/// solids are fixed.
pub fn constrain(
    constraints: &mut Constraints,
    links: &mut Links,
    mut object: Option<&mut FreeBody>,
    touches: &mut [Touch],
    step: f64,
) {
    let dt = narrow(step);
    let (erp, cfm) = (f64::from(SOFTNESS.erp_inv_dt(dt)), f64::from(SOFTNESS.cfm_coeff(dt)));
    let body = object.as_deref().map(|body| (body.center(), body.mass.mass, body.inverse_inertia()));
    constraints.begin(links.constraints(dt));
    for touch in &*touches {
        let rows = touch.axes.map(|direction| {
            let mut row = match touch.link {
                Some(link) => links.row(link, &touch.point, &direction),
                None => Row::default(),
            };
            row.object = body.map(|(center, mass, inverse_inertia)| {
                let turn = (touch.point - center).cross(&direction);
                ObjectRow {
                    linear: -direction,
                    angular: -turn,
                    linear_response: -direction / mass,
                    angular_response: -(inverse_inertia * turn),
                }
            });
            row.impulse = -touch.impulse.dot(&direction);
            row
        });
        let bias = if touch.distance > 0.0 {
            touch.distance / step
        } else {
            (erp * touch.distance).max(-MAX_CORRECTION)
        };
        constraints.add_contact(rows, touch.friction, (bias, cfm));
    }
    let of_object = object.as_deref().map_or([Vector3::zeros(); 2], |body| [body.linear, body.angular]);
    constraints.solve(|row| row.of(links.velocities(row.chain), &of_object));
    if let Some(body) = &mut object {
        for row in constraints.rows() {
            if let Some(object) = &row.object {
                body.linear += object.linear_response * row.impulse;
                body.angular += object.angular_response * row.impulse;
            }
        }
    }
    links.take_impulses(constraints.rows());
    for (touch, [normal, one, two]) in touches.iter_mut().zip(constraints.contacts()) {
        let sum = |values: [f64; 3]| -> Vector3<f64> {
            touch.axes.iter().zip(values).map(|(axis, value)| axis * value).sum()
        };
        let impulse = -sum([normal.impulse, one.impulse, two.impulse]);
        (touch.slip_velocity, touch.impulse) = (sum([0.0, one.velocity, two.velocity]), impulse);
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
