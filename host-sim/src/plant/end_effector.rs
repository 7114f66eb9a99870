//! Tips: the ends of the chains. A fingertip is the sphere that the URDF has on its last links; the tip of an
//! arm is its last link.

use rapier3d::na::{Isometry3, Matrix3, Vector3};
use tesaki_description::urdf::{RigidBody, isometry, rotated_inertia};
use urdf_rs::{Geometry, Link, Robot};

use super::tree::Body;

/// The end of a chain.
#[derive(Clone, Debug)]
pub struct Tip {
    /// Its link in the URDF.
    pub link: String,
    /// The moving body that it is part of.
    pub body: usize,
    /// Frame of its link in the frame of the body; also the frame of its force sensor.
    pub frame: Isometry3<f64>,
    /// Centre of the sphere in the frame of the link [m]. Without a sphere the origin makes the contact.
    pub center: Vector3<f64>,
    /// Radius of the sphere [m]; 0 without one.
    pub radius: f64,
    /// Mass beyond the force sensor: that of the link alone [kg].
    pub mass: f64,
    /// Centre of mass in the frame of the link [m].
    pub center_of_mass: Vector3<f64>,
    /// Inertia about the centre of mass, in the axes of the link [kg·m²].
    pub inertia: Matrix3<f64>,
}

/// Finds the tips of a robot. The tip of a body that carries no other is its own link or one fixed to it: the
/// first with a sphere; else, of the links without children, the one farthest from the joint, the last if
/// several are equally far (the controller uses the same rule).
pub fn tips(robot: &Robot, bodies: &[Body]) -> Vec<Tip> {
    let is_last = |body: usize| !bodies.iter().any(|other| other.parent == Some(body));
    let last = bodies.iter().enumerate().filter(|(index, _)| is_last(*index));
    last.filter_map(|(index, body)| {
        let joint = robot.joints.iter().find(|joint| joint.name == body.joint)?;
        let end = RigidBody::new(robot, &joint.child.link);
        let round = end.links.iter().find_map(|&(link, frame)| Some((link, frame, sphere(link)?)));
        let (link, frame, (center, radius)) =
            round.or_else(|| end.tip(robot).map(|(link, frame)| (link, frame, (Vector3::zeros(), 0.0))))?;
        Some(tip(link, index, &frame, center, radius))
    })
    .collect()
}

/// Returns centre and radius of a link's sphere, from a collision element, else from a visual one.
fn sphere(link: &Link) -> Option<(Vector3<f64>, f64)> {
    let collision = link.collision.iter().map(|element| (&element.origin, &element.geometry));
    let visual = link.visual.iter().map(|element| (&element.origin, &element.geometry));
    collision.chain(visual).find_map(|(origin, geometry)| match geometry {
        Geometry::Sphere { radius } if *radius > 0.0 => Some((Vector3::from(origin.xyz.0), *radius)),
        _ => None,
    })
}

fn tip(link: &Link, body: usize, frame: &Isometry3<f64>, center: Vector3<f64>, radius: f64) -> Tip {
    let place = isometry(&link.inertial.origin);
    Tip {
        link: link.name.clone(),
        body,
        frame: *frame,
        center,
        radius,
        mass: link.inertial.mass.value,
        center_of_mass: place.translation.vector,
        inertia: rotated_inertia(&link.inertial, &place),
    }
}
