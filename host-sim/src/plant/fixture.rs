//! Fixed bodies, and the links that touch them.

use rapier3d::dynamics::{FrictionModel, IntegrationParameters, RigidBodyHandle};
use rapier3d::geometry::{ColliderBuilder, ColliderHandle, Group, InteractionGroups, InteractionTestMode};
use rapier3d::na::{Isometry3, Point3, Vector3};
use rapier3d::pipeline::PhysicsWorld;
use tesaki_description::urdf::{RigidBody, isometry};
use urdf_rs::{Geometry, Robot};

use super::contact::across;
use super::convert::{narrow, pose_of, wide};
use super::error::{PlantError, check};
use super::grasp::SOFTNESS;
use super::shapes::{bevelled_cylinder, cuboid, cylinder, placed, with_friction};
use super::stiction::{Creep, Crept};
use super::tree::Body;

/// A contact slides when it has moved by more than this along a surface; below it is creep [m].
const SLACK: f64 = 5e-6;

/// Rapier's sweeps over the constraints in a sub-step. After 16, joints that should stick creep.
const SWEEPS: usize = 256;

/// Sets rapier's parameters for contacts at the scale of grams and centimetres.
pub fn set_parameters(parameters: &mut IntegrationParameters) {
    parameters.length_unit = 0.01;
    parameters.normalized_max_corrective_velocity = 300.0;
    parameters.contact_recycling = false;
    parameters.contact_softness = SOFTNESS;
    parameters.static_contact_softness = SOFTNESS;
    // Affects faces only; a point contact always has Coulomb friction. With the other model, the friction at
    // the corners of a sliding face has different directions, and the sum is too small.
    parameters.friction_model = FrictionModel::Simplified;
    parameters.friction_in_bias_pass = true;
    parameters.num_internal_pgs_iterations = SWEEPS;
}

/// A fixed body that the collision elements of the robot's links touch.
#[derive(Clone, Debug, PartialEq)]
pub struct Fixture {
    /// Its name.
    pub name: String,
    /// Its shape.
    pub shape: FixtureShape,
    /// Pose of its centre, in the frame of the base.
    pub pose: Isometry3<f64>,
    /// Coefficient of friction with all links.
    pub friction: f64,
}

/// Shape of a fixed body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FixtureShape {
    /// A cuboid.
    Box {
        /// Extents along its x, y and z [m].
        size: [f64; 3],
    },
    /// A cylinder along its z.
    Cylinder {
        /// Radius [m].
        radius: f64,
        /// Length [m].
        length: f64,
    },
    /// A cylinder along its z with bevelled edges.
    BevelledCylinder {
        /// [m].
        radius: f64,
        /// [m].
        length: f64,
        /// Size of the 45° bevel, measured along either face from the edge [m].
        chamfer: f64,
    },
}

/// Contact of a link with a fixed body in the last control period.
#[derive(Clone, Debug, PartialEq)]
pub struct FixtureContact {
    /// Index of the body in [`super::PlantOptions::fixtures`].
    pub fixture: usize,
    /// Name of the link in the URDF.
    pub link: String,
    /// Mean force on the fixed body, in the frame of the base [N].
    pub force: Vector3<f64>,
    /// Largest penetration [m].
    pub depth: f64,
}

impl Fixture {
    /// Checks the values. `index` is the position in the options.
    pub(super) fn validate(&self, index: usize) -> Result<(), PlantError> {
        const LENGTH: &str = "above 0 and at most 10 m";
        let item = |value: &str| format!("fixtures[{index}] ({:?}), {value},", self.name);
        let length = |value: f64| value > 0.0 && value <= 10.0;
        match self.shape {
            FixtureShape::Box { size } => check(&item("size"), &size, length, LENGTH)?,
            FixtureShape::Cylinder { radius, length: along } => {
                check(&item("radius"), &[radius], length, LENGTH)?;
                check(&item("length"), &[along], length, LENGTH)?;
            }
            FixtureShape::BevelledCylinder { radius, length: along, chamfer } => {
                check(&item("radius"), &[radius], length, LENGTH)?;
                check(&item("length"), &[along], length, LENGTH)?;
                let fits = |chamfer: f64| chamfer > 0.0 && chamfer < radius && chamfer < along / 2.0;
                check(&item("chamfer"), &[chamfer], fits, "above 0, below the radius and half the length")?;
            }
        }
        let near = |value: f64| value.abs() <= 10.0;
        check(&item("position"), self.pose.translation.vector.as_slice(), near, "within 10 m")?;
        let unit = |norm: f64| (norm - 1.0).abs() < 1e-3;
        let norm = self.pose.rotation.quaternion().norm();
        check(&item("length of the orientation"), &[norm], unit, "1, as of a unit quaternion")?;
        let friction = |value: f64| (0.0..=10.0).contains(&value);
        check(&item("friction"), &[self.friction], friction, "from 0 to 10")
    }

    fn solid(&self) -> ColliderBuilder {
        let solid = match self.shape {
            FixtureShape::Box { size } => cuboid(size),
            FixtureShape::Cylinder { radius, length } => cylinder(radius, length),
            // A valid one has a volume, so the fallback is not needed.
            FixtureShape::BevelledCylinder { radius, length, chamfer } => {
                bevelled_cylinder(radius, length, chamfer).unwrap_or_else(|| cylinder(radius, length))
            }
        };
        placed(solid, &self.pose)
    }
}

/// A collision element of a link.
pub struct Element {
    link: String,
    /// The moving body that it is part of.
    pub body: usize,
    solid: ColliderBuilder,
}

/// Collects the boxes, cylinders and spheres among the collision elements of the moving links.
pub fn elements(robot: &Robot, bodies: &[Body]) -> Vec<Element> {
    let mut elements = Vec::new();
    for (index, body) in bodies.iter().enumerate() {
        let Some(joint) = robot.joints.iter().find(|joint| joint.name == body.joint) else { continue };
        for (link, frame) in RigidBody::new(robot, &joint.child.link).links {
            for collision in &link.collision {
                let solid = match &collision.geometry {
                    Geometry::Box { size } => cuboid(size.0),
                    Geometry::Cylinder { radius, length } => cylinder(*radius, *length),
                    Geometry::Sphere { radius } => ColliderBuilder::ball(narrow(*radius)),
                    Geometry::Capsule { .. } | Geometry::Mesh { .. } => continue,
                };
                let solid = placed(solid, &(frame * isometry(&collision.origin)));
                elements.push(Element { link: link.name.clone(), body: index, solid });
            }
        }
    }
    elements
}

/// The fixed bodies in the physics engine.
pub struct Fixtures {
    touches: Vec<Touch>,
}

/// A pair of a fixed body and a collision element of a link.
struct Touch {
    fixture: usize,
    link: String,
    /// The moving body of the element.
    body: RigidBodyHandle,
    fixed: ColliderHandle,
    moving: ColliderHandle,
    /// Pose of the moving body when the contact began, or when it last slid; `None` without contact.
    stuck_at: Option<Isometry3<f64>>,
    /// Sum of the forces on the fixed body since the last [`Fixtures::begin_means`] [N], and number of
    /// sub-steps.
    sum: (Vector3<f64>, f64),
    /// Whether they touched since then.
    touched: bool,
    /// Largest penetration since then [m].
    depth: f64,
}

impl Fixtures {
    /// Inserts the fixed bodies and the links' collision elements, each with its moving body, into the
    /// physics engine.
    pub fn new(
        physics: &mut PhysicsWorld,
        fixtures: &[Fixture],
        elements: Vec<(RigidBodyHandle, Element)>,
    ) -> Self {
        let fixed: Vec<_> = fixtures
            .iter()
            .map(|fixture| {
                let solid = fixture.solid().collision_groups(groups(true));
                physics.insert_collider(with_friction(solid, fixture.friction), None)
            })
            .collect();
        let mut touches = Vec::new();
        for (body, element) in elements {
            let solid = element.solid.density(0.0).collision_groups(groups(false));
            let moving = physics.insert_collider(with_friction(solid, 0.0), Some(body));
            touches.extend(fixed.iter().enumerate().map(|(fixture, &fixed)| Touch {
                fixture,
                link: element.link.clone(),
                body,
                fixed,
                moving,
                stuck_at: None,
                sum: (Vector3::zeros(), 0.0),
                touched: false,
                depth: 0.0,
            }));
        }
        Self { touches }
    }

    /// Begins a new averaging interval of the forces.
    pub fn begin_means(&mut self) {
        for touch in &mut self.touches {
            (touch.sum, touch.touched, touch.depth) = ((Vector3::zeros(), 0.0), false, 0.0);
        }
    }

    /// Reads the contacts of the last sub-step of `step` seconds.
    pub fn read(&mut self, physics: &PhysicsWorld, step: f64) {
        self.touches.iter_mut().for_each(|touch| touch.read(physics, step));
    }

    /// Returns the creep of the contacts since they last slid, for correction in rapier.
    pub fn creep(&self, physics: &PhysicsWorld, step: f64) -> Creep {
        let crept = |touch: &Touch| {
            let motion = pose_of(physics.bodies.get(touch.body)?) * touch.stuck_at?.inverse();
            Some(Crept { fixed: touch.fixed, moving: touch.moving, motion })
        };
        Creep { contacts: self.touches.iter().filter_map(crept).collect(), step }
    }

    /// Returns the pairs of fixed body and link that touched in the averaging interval.
    pub fn contacts(&self) -> Vec<FixtureContact> {
        let mut contacts: Vec<FixtureContact> = Vec::new();
        for touch in self.touches.iter().filter(|touch| touch.touched) {
            let Touch { fixture, ref link, depth, .. } = *touch;
            let force = touch.sum.0 / touch.sum.1.max(1.0);
            let same = |other: &&mut FixtureContact| other.fixture == fixture && other.link == *link;
            if let Some(contact) = contacts.iter_mut().find(same) {
                contact.force += force;
                contact.depth = contact.depth.max(depth);
            } else {
                contacts.push(FixtureContact { fixture, link: link.clone(), force, depth });
            }
        }
        contacts
    }
}

impl Touch {
    fn read(&mut self, physics: &PhysicsWorld, step: f64) {
        self.sum.1 += 1.0;
        let pair = physics.contact_pair(self.fixed, self.moving);
        let (Some(pair), Some(body)) = (pair, physics.bodies.get(self.body)) else {
            self.stuck_at = None;
            return;
        };
        let pose = pose_of(body);
        let first = pair.collider1 == self.fixed;
        let side = if first { 1.0 } else { -1.0 };
        let back = self.stuck_at.unwrap_or(pose) * pose.inverse();
        let (mut touches, mut crept) = (false, 0.0_f64);
        for manifold in pair.manifolds() {
            let normal = wide(manifold.data.normal);
            for point in manifold.points.iter().filter(|point| point.data.impulse > 0.0) {
                let impulse =
                    wide(point.data.warmstart_tangent_world) - normal * f64::from(point.data.impulse);
                self.sum.0 += impulse * (side / step);
                self.depth = self.depth.max(-f64::from(point.dist));
                let own = if first { point.local_p2 } else { point.local_p1 };
                let place = physics.colliders.get(self.moving).map(|moving| moving.position() * own);
                let place = Point3::from(wide(place.unwrap_or_default()));
                crept = crept.max(across(&(back * place - place), &normal).norm());
                touches = true;
            }
        }
        self.touched |= touches;
        self.stuck_at = touches.then(|| self.stuck_at.filter(|_| crept <= SLACK).unwrap_or(pose));
    }
}

/// Fixed bodies and links collide only with each other.
const fn groups(fixed: bool) -> InteractionGroups {
    let (own, other) =
        if fixed { (Group::GROUP_3, Group::GROUP_4) } else { (Group::GROUP_4, Group::GROUP_3) };
    InteractionGroups::new(own, other, InteractionTestMode::And)
}
