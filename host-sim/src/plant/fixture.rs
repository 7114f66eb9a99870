//! Fixed bodies, and the links that touch them.

use rapier3d::geometry::ColliderBuilder;
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Vector3};
use tesaki_description::urdf::{RigidBody, isometry};
use urdf_rs::{Geometry, Robot};

use super::constraints::Constraints;
use super::contact::{self, Pair, Touch};
use super::convert::{isometry_of, narrow};
use super::error::{PlantError, check};
use super::links::Links;
use super::shapes::{Solid, bevelled_cylinder, cuboid, cylinder, placed};
use super::tree::Body;

/// What [`is_length`] accepts.
const LENGTH: &str = "above 0 and at most 10 m";

/// Returns whether a body can have this length [m].
fn is_length(length: f64) -> bool {
    length > 0.0 && length <= 10.0
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
        let item = |value: &str| format!("fixtures[{index}] ({:?}), {value},", self.name);
        let length = is_length;
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
    body: usize,
    solid: Solid,
}

/// Collects the boxes, cylinders and spheres among the collision elements of the moving links.
pub fn elements(robot: &Robot, bodies: &[Body]) -> Result<Vec<Element>, PlantError> {
    let mut elements = Vec::new();
    for (index, body) in bodies.iter().enumerate() {
        let Some(joint) = robot.joints.iter().find(|joint| joint.name == body.joint) else { continue };
        for (link, frame) in RigidBody::new(robot, &joint.child.link).links {
            for collision in &link.collision {
                let has_size = |extents: &[f64]| {
                    check(&format!("link {:?}, <collision>, size,", link.name), extents, is_length, LENGTH)
                };
                let solid = match collision.geometry {
                    Geometry::Box { size } => has_size(&*size).map(|()| cuboid(*size))?,
                    Geometry::Cylinder { radius, length } => {
                        has_size(&[radius, length]).map(|()| cylinder(radius, length))?
                    }
                    Geometry::Sphere { radius } => {
                        has_size(&[radius]).map(|()| ColliderBuilder::ball(narrow(radius)))?
                    }
                    Geometry::Capsule { .. } | Geometry::Mesh { .. } => continue,
                };
                let solid = placed(solid, &(frame * isometry(&collision.origin))).into();
                elements.push(Element { link: link.name.clone(), body: index, solid });
            }
        }
    }
    Ok(elements)
}

/// The fixed bodies, and the sub-steps of a robot that may touch them.
pub struct Fixtures {
    /// Each with its coefficient of friction.
    solids: Vec<(Solid, f64)>,
    elements: Vec<Element>,
    /// The contacts of each fixed body with each element.
    contacts: Vec<ElementContact>,
    constraints: Constraints,
    /// Number of sub-steps in the averaging interval.
    steps: f64,
}

/// The contact of a fixed body with an element, in the averaging interval.
struct ElementContact {
    fixture: usize,
    element: usize,
    pair: Pair,
    /// Sum of the forces on the fixed body [N].
    sum: Vector3<f64>,
    has_touched: bool,
    /// Largest penetration [m].
    depth: f64,
}

impl Fixtures {
    pub fn new(fixtures: &[Fixture], elements: Vec<Element>) -> Self {
        let solids: Vec<_> =
            fixtures.iter().map(|fixture| (fixture.solid().into(), fixture.friction)).collect();
        let pairs =
            (0..solids.len()).flat_map(|fixture| (0..elements.len()).map(move |element| (fixture, element)));
        let contact = |(fixture, element)| ElementContact {
            fixture,
            element,
            pair: Pair::default(),
            sum: Vector3::zeros(),
            has_touched: false,
            depth: 0.0,
        };
        Self {
            contacts: pairs.map(contact).collect(),
            solids,
            elements,
            constraints: Constraints::default(),
            steps: 0.0,
        }
    }

    /// Advances the links by a sub-step of `step` seconds.
    pub fn step(&mut self, links: &mut Links, gravity: Vector, step: f64) {
        let mut touches = self.find_touches(links);
        if touches.is_empty() {
            links.step(gravity, narrow(step));
        } else {
            links.accelerate(gravity, narrow(step));
            contact::constrain(&mut self.constraints, links, None, &mut touches, step);
            links.advance(narrow(step));
        }
        self.read(&touches, step);
    }

    fn find_touches(&mut self, links: &Links) -> Vec<Touch> {
        let mut touches = Vec::new();
        for (index, contact) in self.contacts.iter_mut().enumerate() {
            let (fixed, friction) = &self.solids[contact.fixture];
            let Element { solid, body, .. } = &self.elements[contact.element];
            let place = isometry_of(links.pose(*body)) * solid.place;
            let (first, second) = ((fixed, fixed.place), (solid, place));
            touches.extend(contact.pair.find(first, second, (index, Some(*body), *friction)));
        }
        touches
    }

    /// Reads the contacts after the sub-step.
    fn read(&mut self, touches: &[Touch], step: f64) {
        self.steps += 1.0;
        for (index, contact) in self.contacts.iter_mut().enumerate() {
            let of_pair = || touches.iter().filter(|touch| touch.pair == index);
            contact.pair.keep(of_pair());
            for touch in of_pair().filter(|touch| touch.impulse != Vector3::zeros()) {
                contact.sum += touch.impulse / step;
                contact.depth = contact.depth.max(-touch.distance);
                contact.has_touched = true;
            }
        }
    }

    /// Begins a new averaging interval of the forces.
    pub fn begin_means(&mut self) {
        self.steps = 0.0;
        for contact in &mut self.contacts {
            (contact.sum, contact.has_touched, contact.depth) = (Vector3::zeros(), false, 0.0);
        }
    }

    /// Returns the pairs of fixed body and link that touched in the averaging interval.
    pub fn contacts(&self) -> Vec<FixtureContact> {
        let mut contacts: Vec<FixtureContact> = Vec::new();
        for contact in self.contacts.iter().filter(|contact| contact.has_touched) {
            let ElementContact { fixture, element, ref sum, depth, .. } = *contact;
            let (link, force) = (&self.elements[element].link, sum / self.steps.max(1.0));
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
