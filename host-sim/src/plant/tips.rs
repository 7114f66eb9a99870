//! Fingertips: spheres on the last links, as the URDF draws them.

use rapier3d::na::{Isometry3, Matrix3, Vector3};
use urdf_rs::{Geometry, JointType, Link, Robot};

use super::tree::{Body, isometry};

/// A spherical fingertip.
#[derive(Clone, Debug)]
pub struct Tip {
    /// Its link in the URDF.
    pub link: String,
    /// The moving body that it is part of.
    pub body: usize,
    /// Frame of its link in that of the body: also the frame of its force sensor.
    pub frame: Isometry3<f64>,
    /// Middle of the sphere in the frame of the link [m].
    pub center: Vector3<f64>,
    pub radius: f64,
    /// What is behind the force sensor: the link alone.
    pub mass: f64,
    /// In the frame of the link.
    pub center_of_mass: Vector3<f64>,
    /// About the centre of mass, axes of the link.
    pub inertia: Matrix3<f64>,
}

/// The first sphere of each body that carries no other: of its link, or of one fixed to it.
pub fn tips(robot: &Robot, bodies: &[Body]) -> Vec<Tip> {
    let is_last = |body: usize| !bodies.iter().any(|other| other.parent == Some(body));
    let last = bodies.iter().enumerate().filter(|(index, _)| is_last(*index));
    last.filter_map(|(index, body)| {
        let joint = robot.joints.iter().find(|joint| joint.name == body.joint)?;
        find(robot, &joint.child.link, index, &Isometry3::identity())
    })
    .collect()
}

fn find(robot: &Robot, link: &str, body: usize, frame: &Isometry3<f64>) -> Option<Tip> {
    let found = robot.links.iter().find(|known| known.name == link)?;
    if let Some((center, radius)) = sphere(found) {
        return Some(tip(found, body, frame, center, radius));
    }
    let fixed = |joint: &&urdf_rs::Joint| joint.parent.link == link && joint.joint_type == JointType::Fixed;
    robot
        .joints
        .iter()
        .filter(fixed)
        .find_map(|joint| find(robot, &joint.child.link, body, &(frame * isometry(&joint.origin))))
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
    let i = &link.inertial.inertia;
    let tensor = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
    let turn = place.rotation.to_rotation_matrix().into_inner();
    Tip {
        link: link.name.clone(),
        body,
        frame: *frame,
        center,
        radius,
        mass: link.inertial.mass.value,
        center_of_mass: place.translation.vector,
        inertia: turn * tensor * turn.transpose(),
    }
}
