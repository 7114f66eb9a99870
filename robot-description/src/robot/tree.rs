//! From the URDF's tree of links to the serial chains that a controller drives: fixed joints are folded in.

use nalgebra::Isometry3;
use tesaki::model::{
    Friction, Inertial, JointLimits, MAX_CHAIN_JOINTS, MAX_CHAINS, MAX_JOINTS, MAX_NAME, Pose,
};
use urdf_rs::{Geometry, Joint, JointType, Link};

use crate::finding::Report;
use crate::urdf::{RigidBody, Urdf, axis, isometry, narrow, pose, single};

/// A moving joint with the link behind it and everything that is fixed to that link.
pub struct SerialJoint {
    pub name: String,
    pub origin: Pose,
    pub axis: [f32; 3],
    pub link: Inertial,
    pub limits: JointLimits,
    pub friction: Friction,
}

/// Moving joints in series, and what they end in.
pub struct SerialChain {
    pub joints: Vec<SerialJoint>,
    /// The link at its end: of those that are fixed to the last body and carry nothing, the one farthest from
    /// its joint; the last in the file of several that are as far.
    pub tip: String,
    /// Its frame in the last joint's.
    pub pose: Pose,
    /// Its own mass [kg] and centre of mass in its frame [m]: what a force sensor behind it carries.
    pub mass: f32,
    pub center_of_mass: [f32; 3],
    /// Radius of the sphere about its origin [m]; 0 without one.
    pub radius: f32,
}

/// The chains that leave the base, each from base to tip, in the order of the file. What no controller can
/// drive is reported.
pub fn serial_chains(urdf: &Urdf, report: &mut Report) -> Vec<SerialChain> {
    let first = RigidBody::new(&urdf.robot, urdf.base()).joints;
    let chains: Vec<SerialChain> =
        first.into_iter().map(|(joint, offset)| chain(urdf, joint, offset, report)).collect();
    sizes(urdf, &chains, report);
    chains
}

fn chain(urdf: &Urdf, first: &Joint, offset: Isometry3<f64>, report: &mut Report) -> SerialChain {
    let mut joints = Vec::new();
    let mut tip = None;
    let mut next = Some((first, offset));
    while let Some((joint, offset)) = next {
        let body = RigidBody::new(&urdf.robot, &joint.child.link);
        if let [(one, _), (other, _), ..] = &*body.joints {
            let message = format!(
                "the chain branches behind joint {} into {} and {}: chains on a board may branch only at the base",
                joint.name, one.name, other.name
            );
            let advice = "put one of them into its own robot folder; `tesaki eval` computes each tip";
            report.dynamics(urdf.line_of_joint(&other.name), message, advice);
        }
        driven(urdf, joint, report);
        next = body.joints.first().copied();
        tip = body.tip(&urdf.robot);
        joints.extend(serial_joint(joint, &offset, &body));
    }
    if let Some(joint) = joints.last().filter(|joint: &&SerialJoint| joint.link.mass <= 0.0) {
        let message = format!("joint {} moves no mass", joint.name);
        let advice = "give the links behind it <inertial>: they are needed for the feed-forward of gravity and inertia";
        report.warning(urdf.line_of_joint(&joint.name), message, advice);
    }
    // In a tree the last body has a link at its end.
    let (link, place) = tip.unzip();
    let inertial = link.map(|link| &link.inertial);
    SerialChain {
        joints,
        tip: link.map_or_else(String::new, |link| link.name.clone()),
        pose: pose(&place.unwrap_or_else(Isometry3::identity)),
        mass: narrow(inertial.map_or(0.0, |inertial| inertial.mass.value)),
        center_of_mass: inertial.map_or([0.0; 3], |inertial| inertial.origin.xyz.0.map(narrow)),
        radius: narrow(link.and_then(sphere).unwrap_or(0.0)),
    }
}

/// Radius of a link's sphere about its origin: of a collision element, else of a visual one.
fn sphere(link: &Link) -> Option<f64> {
    let collision = link.collision.iter().map(|element| (&element.origin, &element.geometry));
    let visual = link.visual.iter().map(|element| (&element.origin, &element.geometry));
    collision.chain(visual).find_map(|(origin, geometry)| match geometry {
        Geometry::Sphere { radius } if origin.xyz.0.iter().all(|&part| part == 0.0) => Some(*radius),
        _ => None,
    })
}

/// Reports a joint that has no rotary motor with limits.
fn driven(urdf: &Urdf, joint: &Joint, report: &mut Report) {
    let line = urdf.line_of_joint(&joint.name);
    if let Some(mimic) = &joint.mimic {
        let message = format!("joint {} mimics {}: it has no motor to drive", joint.name, mimic.joint);
        let advice = "`tesaki eval` computes it; for a controller, remove <mimic> if it has a motor of its own, \
            or make it fixed";
        report.dynamics(line, message, advice);
    } else if joint.joint_type != JointType::Revolute {
        let message = format!("joint {} is of type {:?}", joint.name, joint.joint_type);
        report.dynamics(
            line,
            message,
            "a controller drives revolute joints (with limits); make the others fixed",
        );
    }
}

/// Without an axis there is none; that has been reported.
fn serial_joint(joint: &Joint, offset: &Isometry3<f64>, body: &RigidBody<'_>) -> Option<SerialJoint> {
    let dynamics = joint.dynamics.as_ref();
    Some(SerialJoint {
        name: joint.name.clone(),
        origin: pose(&(offset * isometry(&joint.origin))),
        axis: single(axis(joint)?),
        link: body.mass_properties().inertial(),
        limits: JointLimits {
            lower: narrow(joint.limit.lower),
            upper: narrow(joint.limit.upper),
            velocity: narrow(joint.limit.velocity),
            torque: narrow(joint.limit.effort),
            torque_rate: 0.0,
            following_error: 0.0,
        },
        friction: Friction {
            coulomb: dynamics.map_or(0.0, |dynamics| narrow(dynamics.friction)),
            viscous: dynamics.map_or(0.0, |dynamics| narrow(dynamics.damping)),
        },
    })
}

/// Names and numbers of things fit into the board.
fn sizes(urdf: &Urdf, chains: &[SerialChain], report: &mut Report) {
    let mut most = |line, what: &str, count: usize, limit: usize| {
        if count > limit {
            let advice =
                "this is the maximum of a board; split the robot into several folders, one for each board";
            report.dynamics(line, format!("{count} {what}; at most {limit} are supported"), advice);
        }
    };
    let all: usize = chains.iter().map(|chain| chain.joints.len()).sum();
    let line = Some(urdf.line());
    most(line, "chains leave the base", chains.len(), MAX_CHAINS);
    most(line, "joints", all, MAX_JOINTS);
    for chain in chains {
        let line = urdf.line_of_link(&chain.tip);
        most(line, &format!("joints in the chain of {}", chain.tip), chain.joints.len(), MAX_CHAIN_JOINTS);
    }
    if all == 0 {
        report.dynamics(line, "no joint moves", "a controller needs a revolute joint at least");
    }
    let joints = chains.iter().flat_map(|chain| &chain.joints).map(|joint| joint.name.as_str());
    let tips = chains.iter().map(|chain| chain.tip.as_str());
    for name in std::iter::once(urdf.robot.name.as_str()).chain(joints).chain(tips) {
        if name.len() > MAX_NAME {
            let message =
                format!("the name {name:?} has {} bytes; at most {MAX_NAME} are supported", name.len());
            report.dynamics(
                urdf.line_of_joint(name).or_else(|| urdf.line_of_link(name)),
                message,
                "shorten it here and in controller.toml",
            );
        }
    }
    if urdf.robot.name.is_empty() {
        report.dynamics(line, "the robot has no name", "<robot name=\"…\">");
    }
}
