//! Links that no machine is likely to have.

use nalgebra::Vector3;

use crate::finding::{Finding, Report};
use crate::urdf::{RigidBody, Urdf, four};

/// A radius of gyration above this multiple of the link's size is suspicious.
const WIDE: f64 = 3.0;
/// Density of lead [kg/m³].
pub const LEAD: f64 = 11_340.0;
/// Masses above this one may be meant in grams [kg].
const HEAVY: f64 = 1.0;
/// Sizes of links below this one are not trusted [m].
const SMALL_LINK: f64 = 0.05;

/// Links that would be denser than lead: of a mass, a ball of lead has the least moment of inertia.
pub fn dense(urdf: &Urdf, report: &mut Report) {
    for link in urdf.robot.links.iter().filter(|link| link.name != urdf.base()) {
        let (i, mass) = (&link.inertial.inertia, link.inertial.mass.value);
        let largest = i.ixx.max(i.iyy).max(i.izz);
        let radius = libm::cbrt(mass / (4.0 / 3.0 * core::f64::consts::PI * LEAD));
        // No moment at all is a finding of its own.
        if mass >= HEAVY && largest > 0.0 && largest < 0.4 * mass * radius * radius {
            let message = format!(
                "link {}: {mass} kg with an inertia of at most {largest:.1e} kg·m² is denser than lead: grams?",
                link.name
            );
            let advice = format!("masses are in kg: {mass} g are {}", four(mass / 1000.0));
            report.warning(urdf.line_of_link(&link.name), message, advice);
        }
    }
}

/// Links whose mass would lie far outside of them.
pub fn gyration(urdf: &Urdf, report: &mut Report) {
    for joint in &urdf.robot.joints {
        let Some(link) = urdf.robot.links.iter().find(|link| link.name == joint.child.link) else { continue };
        let i = &link.inertial.inertia;
        let mass = link.inertial.mass.value;
        if mass <= 0.0 || joint.joint_type == urdf_rs::JointType::Fixed {
            continue;
        }
        let largest = i.ixx.max(i.iyy).max(i.izz);
        let radius = libm::sqrt(largest.max(0.0) / mass);
        let size = size(urdf, link).max(SMALL_LINK);
        if radius > WIDE * size {
            let message = format!(
                "link {}: an inertia of {largest:.1e} kg·m² for {mass} kg is a radius of gyration of {radius:.3} m; \
                 the link is about {size:.3} m long: a placeholder?",
                link.name
            );
            report.warning(
                urdf.line_of_link(&link.name),
                message,
                "compute it by the CAD program, or from the link's shape",
            );
        }
    }
}

/// The link of the largest mass that a joint moves, and its line.
pub fn heaviest(urdf: &Urdf) -> String {
    let moved = urdf.robot.links.iter().filter(|link| link.name != urdf.base());
    let heaviest = moved.max_by(|a, b| a.inertial.mass.value.total_cmp(&b.inertial.mass.value));
    let Some(link) = heaviest.filter(|link| link.inertial.mass.value > 0.0) else { return String::new() };
    let line = urdf.line_of_link(&link.name).map_or_else(String::new, |line| format!(", robot.urdf:{line}"));
    format!(" (the heaviest link is {} with {} kg{line})", link.name, link.inertial.mass.value)
}

/// Bodies that cannot be simulated, without those of whose links something is wrong.
pub fn bodies(urdf: &Urdf, known: &[Finding], report: &mut Report) {
    let is_wrong = |link: &str| known.iter().any(|known| known.is_error() && known.is_about_link(link));
    for (joint, link) in urdf.bodies_without_inertia() {
        if RigidBody::new(&urdf.robot, &link).links.iter().any(|(link, _)| is_wrong(&link.name)) {
            continue;
        }
        let message =
            format!("link {link}, moved by joint {joint}: without mass or inertia it cannot be simulated");
        let advice = "give it an <inertial>; or accept a gram: its name in accept_inertia of controller.toml \
            (`tesaki model init --accept-inertia`)";
        report.dynamics(urdf.line_of_link(&link), message, advice);
    }
}

/// About the size of a link [m]: the distance of what is joined to it, or of its centre of mass.
fn size(urdf: &Urdf, link: &urdf_rs::Link) -> f64 {
    let body = RigidBody::new(&urdf.robot, &link.name);
    let norm = |pose: &urdf_rs::Pose| Vector3::from(pose.xyz.0).norm();
    let links =
        body.links.iter().map(|(link, place)| place.translation.vector.norm() + norm(&link.inertial.origin));
    let joints =
        body.joints.iter().map(|(joint, place)| place.translation.vector.norm() + norm(&joint.origin));
    let shapes = link.collision.iter().map(|shape| extent(&shape.geometry) + norm(&shape.origin));
    links.chain(joints).chain(shapes).fold(0.0, f64::max)
}

/// Half of the largest extent of a shape [m]; 0 for a mesh.
fn extent(geometry: &urdf_rs::Geometry) -> f64 {
    match geometry {
        urdf_rs::Geometry::Box { size } => 0.5 * Vector3::from(size.0).norm(),
        urdf_rs::Geometry::Cylinder { radius, length } | urdf_rs::Geometry::Capsule { radius, length } => {
            0.5 * length + radius
        }
        urdf_rs::Geometry::Sphere { radius } => *radius,
        urdf_rs::Geometry::Mesh { .. } => 0.0,
    }
}
