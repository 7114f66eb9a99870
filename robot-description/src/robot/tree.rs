//! From the URDF's tree of links to the serial chains that a controller drives: fixed joints are folded in.

use nalgebra::Isometry3;
use tesaki::model::{
    Friction, Inertial, JointLimits, MAX_CHAIN_JOINTS, MAX_CHAINS, MAX_JOINTS, MAX_MIMICS, MAX_NAME, Pose,
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

/// A joint of a chain that has no motor and follows another joint.
pub struct SerialMimic {
    pub joint: SerialJoint,
    /// How many joints of the chain are before it.
    pub place: usize,
    /// The joint with a motor that it follows, through other mimic joints too.
    pub follows: String,
    pub multiplier: f32,
    pub offset: f32,
}

/// Moving joints in series, and what they end in.
pub struct SerialChain {
    /// Its joints with a motor.
    pub joints: Vec<SerialJoint>,
    /// Those without.
    pub mimics: Vec<SerialMimic>,
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

impl SerialChain {
    /// All joints, base to tip; those without motor with what they follow.
    pub fn all(&self) -> Vec<(&SerialJoint, Option<&SerialMimic>)> {
        let mut all: Vec<_> = self.joints.iter().map(|joint| (joint, None)).collect();
        for mimic in &self.mimics {
            all.insert(mimic.place.min(all.len()), (&mimic.joint, Some(mimic)));
        }
        all
    }
}

/// The chains that leave the base, each from base to tip, in the order of the file. What no controller can
/// drive is reported.
pub fn serial_chains(urdf: &Urdf, report: &mut Report) -> Vec<SerialChain> {
    let first = RigidBody::new(&urdf.robot, urdf.base()).joints;
    let chains: Vec<SerialChain> =
        first.into_iter().map(|(joint, offset)| chain(urdf, joint, offset, report)).collect();
    mimics(urdf, &chains, report);
    sizes(urdf, &chains, report);
    chains
}

fn chain(urdf: &Urdf, first: &Joint, offset: Isometry3<f64>, report: &mut Report) -> SerialChain {
    let (mut joints, mut mimics) = (Vec::<SerialJoint>::new(), Vec::<SerialMimic>::new());
    let mut tip = None;
    let mut next = Some((first, offset));
    while let Some((joint, offset)) = next {
        let mut body = RigidBody::new(&urdf.robot, &joint.child.link);
        tip = body.tip(&urdf.robot);
        carry_followers(urdf, &mut body);
        if let [(one, _), (other, _), ..] = &*body.joints {
            let message = format!(
                "the chain branches behind joint {} into {} and {}: chains on a board may branch only at the base",
                joint.name, one.name, other.name
            );
            let advice = "put one of them into its own robot folder; `tesaki eval` computes each tip";
            report.dynamics(urdf.line_of_joint(&other.name), message, advice);
        }
        revolute(urdf, joint, report);
        next = body.joints.first().copied();
        let serial = serial_joint(joint, &offset, &body);
        match &joint.mimic {
            Some(of) => {
                let place = joints.len() + mimics.len();
                let direct = (of.joint.as_str(), of.multiplier.unwrap_or(1.0), of.offset.unwrap_or(0.0));
                let (follows, multiplier, offset) = urdf
                    .mimicked(joint)
                    .map_or(direct, |(leader, ratio, offset)| (&leader.name, ratio, offset));
                mimics.extend(serial.map(|joint| SerialMimic {
                    joint,
                    place,
                    follows: follows.to_owned(),
                    multiplier: narrow(multiplier),
                    offset: narrow(offset),
                }));
            }
            None => joints.extend(serial),
        }
    }
    if let Some(joint) = joints.last().filter(|joint| mimics.is_empty() && joint.link.mass <= 0.0) {
        let message = format!("joint {} moves no mass", joint.name);
        let advice = "give the links behind it <inertial>: they are needed for the feed-forward of gravity and inertia";
        report.warning(urdf.line_of_joint(&joint.name), message, advice);
    }
    // In a tree the last body has a link at its end.
    let (link, place) = tip.unzip();
    let inertial = link.map(|link| &link.inertial);
    SerialChain {
        joints,
        mimics,
        tip: link.map_or_else(String::new, |link| link.name.clone()),
        pose: pose(&place.unwrap_or_else(Isometry3::identity)),
        mass: narrow(inertial.map_or(0.0, |inertial| inertial.mass.value)),
        center_of_mass: inertial.map_or([0.0; 3], |inertial| inertial.origin.xyz.0.map(narrow)),
        radius: narrow(link.and_then(sphere).unwrap_or(0.0)),
    }
}

/// Takes joints without motor out of a branch, such as the fingers of a gripper that one motor moves: mimic
/// joints with nothing behind them that moves. To the controller their links are fixed to the body that
/// carries them, at the angle 0.
fn carry_followers<'a>(urdf: &'a Urdf, body: &mut RigidBody<'a>) {
    let of_joint = |joint: &'a Joint| RigidBody::new(&urdf.robot, &joint.child.link);
    let follows = |joint: &'a Joint| {
        joint.mimic.is_some() && joint.joint_type == JointType::Revolute && of_joint(joint).joints.is_empty()
    };
    let (followers, others): (Vec<_>, Vec<_>) = body.joints.iter().partition(|(joint, _)| follows(joint));
    if others.is_empty() {
        return;
    }
    for (joint, place) in followers {
        let place: Isometry3<f64> = place * isometry(&joint.origin);
        body.links.extend(of_joint(joint).links.into_iter().map(|(link, frame)| (link, place * frame)));
    }
    body.joints = others;
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

/// By how much a mimic joint may pass its limits [rad]: URDFs round them, often to three digits.
const ROUNDING: f32 = 1e-3;

/// Reports a mimic joint that no motor can move.
fn mimics(urdf: &Urdf, chains: &[SerialChain], report: &mut Report) {
    let driven = || chains.iter().flat_map(|chain| &chain.joints);
    for (chain, mimic) in chains.iter().flat_map(|chain| chain.mimics.iter().map(move |mimic| (chain, mimic)))
    {
        let SerialMimic { joint, follows, multiplier, offset, .. } = mimic;
        let line = urdf.line_of_joint(&joint.name);
        let name = &joint.name;
        let names: Vec<&str> = driven().map(|joint| joint.name.as_str()).collect();
        let followed = driven().find(|joint| joint.name == *follows);
        if chain.joints.is_empty() {
            let message = format!("joint {name} mimics {follows}, and its chain has no joint with a motor");
            report.dynamics(line, message, "make it fixed, or remove <mimic> if it has a motor of its own");
        } else if let Some(followed) = followed {
            let ends = [followed.limits.lower, followed.limits.upper].map(|end| multiplier * end + offset);
            let (least, most) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
            if least < joint.limits.lower - ROUNDING || most > joint.limits.upper + ROUNDING {
                let message = format!(
                    "joint {name} moves from {least} to {most} rad while {follows} keeps its limits; its own are {} \
                     to {} rad",
                    joint.limits.lower, joint.limits.upper
                );
                report.dynamics(line, message, format!("narrow the limits of {follows}, or widen these"));
            }
            if *multiplier == 0.0 {
                let message = format!("joint {name} mimics {follows} with the multiplier 0");
                report.dynamics(line, message, "make it fixed");
            }
        } else if urdf.robot.joints.iter().any(|other| other.name == *follows && is_driven(other)) {
            let message = format!(
                "joint {name} mimics {follows}, which has a motor, but is on a branch that is not on this board"
            );
            let advice =
                format!("make the branch of {follows} part of this robot folder, or make {name} fixed");
            report.dynamics(line, message, advice);
        } else {
            // That a joint does not exist has been told.
            let message = format!("joint {name} mimics {follows}, which has no motor on this board");
            let advice = format!("name the joint that has the motor: {}", names.join(", "));
            report.dynamics(line, message, advice);
        }
    }
}

/// Whether a motor could move it.
fn is_driven(joint: &Joint) -> bool {
    joint.mimic.is_none() && joint.joint_type == JointType::Revolute
}

/// Reports a joint that is not rotary with limits.
fn revolute(urdf: &Urdf, joint: &Joint, report: &mut Report) {
    let line = urdf.line_of_joint(&joint.name);
    if joint.joint_type != JointType::Revolute {
        let kind = format!("{:?}", joint.joint_type).to_lowercase();
        let message = format!("joint {} is of type {kind}", joint.name);
        let advice = match joint.joint_type {
            JointType::Continuous => "a controller drives revolute joints: make it revolute, with limits",
            _ => {
                "a controller drives revolute joints (with limits); a joint that is made fixed is locked at 0, the \
                 place of its <origin>"
            }
        };
        report.dynamics(line, message, advice);
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
    most(line, "mimic joints", chains.iter().map(|chain| chain.mimics.len()).sum(), MAX_MIMICS);
    for chain in chains {
        let line = urdf.line_of_link(&chain.tip);
        let count = chain.joints.len() + chain.mimics.len();
        most(line, &format!("joints in the chain of {}", chain.tip), count, MAX_CHAIN_JOINTS);
    }
    if all == 0 && report.has_no_kinematics() {
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
