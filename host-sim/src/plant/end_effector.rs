//! Tips: what the chains end in. A fingertip is the sphere that the URDF draws on its last links, a hand the
//! link itself.

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
    /// Frame of its link in that of the body: also the frame of its force sensor.
    pub frame: Isometry3<f64>,
    /// Middle of the sphere in the frame of the link [m]; without a sphere its origin touches.
    pub center: Vector3<f64>,
    /// 0 without a sphere [m].
    pub radius: f64,
    /// What is behind the force sensor: the link alone.
    pub mass: f64,
    /// In the frame of the link.
    pub center_of_mass: Vector3<f64>,
    /// About the centre of mass, axes of the link.
    pub inertia: Matrix3<f64>,
}

/// Of each body that carries no other, its own link or one fixed to it: the first with a sphere; else of the
/// links that carry nothing the one farthest from the joint, the last of several that are as far (the
/// controller's rule).
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

/// Middle and radius of a link's sphere: a collision element, else a visual one.
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
