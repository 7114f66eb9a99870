//! From the URDF's tree of links to serial chains of moving joints: fixed joints are folded in.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use tesaki::model::{Friction, Inertial, JointLimits, Pose};
use urdf_rs::{Joint, JointType, Robot};

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
    /// The link at its end: of those that are fixed to the last body and carry nothing, the one farthest from its joint.
    pub tip: String,
    /// Its frame in the last joint's.
    pub pose: Pose,
}

/// The chains that leave the base, each from base to tip, in the order of the file.
pub fn serial_chains(robot: &Robot) -> Result<Vec<SerialChain>, String> {
    let is_child = |link: &str| robot.joints.iter().any(|joint| joint.child.link == link);
    let mut roots = robot.links.iter().filter(|link| !is_child(&link.name));
    let base = roots.next().ok_or("no base: every link hangs on another, so the joints form a loop")?;
    if let Some(other) = roots.next() {
        return Err(format!(
            "two bases, {:?} and {:?}: a joint between them is missing",
            base.name, other.name
        ));
    }
    for joint in &robot.joints {
        for link in [&joint.parent.link, &joint.child.link] {
            if !robot.links.iter().any(|known| known.name == *link) {
                return Err(format!("joint {:?} names the link {link:?}, which does not exist", joint.name));
            }
        }
        if robot.joints.iter().filter(|other| other.child.link == joint.child.link).count() > 1 {
            return Err(format!(
                "the link {:?} hangs on two joints: a loop, only trees work",
                joint.child.link
            ));
        }
    }
    let mut base_body = Body::default();
    collect(robot, &base.name, Isometry3::identity(), &mut base_body)?
        .into_iter()
        .map(|(joint, offset)| chain(robot, joint, offset))
        .collect()
}

fn chain(robot: &Robot, first: &Joint, offset: Isometry3<f64>) -> Result<SerialChain, String> {
    let mut joints = Vec::new();
    let mut last = &first.child.link;
    let mut next = Some((first, offset));
    while let Some((joint, offset)) = next {
        let mut body = Body::default();
        let mut children = collect(robot, &joint.child.link, Isometry3::identity(), &mut body)?;
        if children.len() > 1 {
            return Err(format!(
                "the chain branches behind joint {:?} (into {:?} and {:?}): chains may branch at the base only",
                joint.name, children[0].0.name, children[1].0.name
            ));
        }
        next = children.pop();
        last = &joint.child.link;
        joints.push(serial_joint(joint, &offset, &body)?);
    }
    let (tip, place) = tip(robot, last, Isometry3::identity());
    Ok(SerialChain { joints, tip: tip.to_owned(), pose: pose(&place) })
}

/// The leaf farthest from the joint among `link`, which stands at `place`, and what is fixed to it.
fn tip<'a>(robot: &'a Robot, link: &'a str, place: Isometry3<f64>) -> (&'a str, Isometry3<f64>) {
    let distance = |tip: &(&str, Isometry3<f64>)| tip.1.translation.vector.norm();
    robot
        .joints
        .iter()
        .filter(|joint| joint.parent.link == link)
        .map(|joint| tip(robot, &joint.child.link, place * isometry(&joint.origin)))
        .max_by(|a, b| distance(a).total_cmp(&distance(b)))
        .unwrap_or((link, place))
}

/// Adds the mass of `link`, and of all that is fixed to it, to `body`; returns the moving joints that follow, with
/// the place of their parent link in the body's frame.
fn collect<'a>(
    robot: &'a Robot,
    link: &str,
    place: Isometry3<f64>,
    body: &mut Body,
) -> Result<Vec<(&'a Joint, Isometry3<f64>)>, String> {
    if let Some(link) = robot.links.iter().find(|known| known.name == link) {
        body.add(&link.inertial, &place);
    }
    let mut moving = Vec::new();
    for joint in robot.joints.iter().filter(|joint| joint.parent.link == link) {
        match joint.joint_type {
            JointType::Fixed => {
                moving.extend(collect(robot, &joint.child.link, place * isometry(&joint.origin), body)?);
            }
            JointType::Revolute => moving.push((joint, place)),
            ref other => {
                return Err(format!(
                    "joint {:?} is of type {other:?}: revolute (with limits) and fixed joints are supported",
                    joint.name
                ));
            }
        }
    }
    Ok(moving)
}

fn serial_joint(joint: &Joint, offset: &Isometry3<f64>, body: &Body) -> Result<SerialJoint, String> {
    let origin = offset * isometry(&joint.origin);
    let axis = Vector3::from(joint.axis.xyz.0);
    let length = axis.norm();
    if !(length.is_finite() && length > 1e-6) {
        return Err(format!("joint {:?}: its axis {:?} is no direction", joint.name, joint.axis.xyz.0));
    }
    let dynamics = joint.dynamics.as_ref();
    Ok(SerialJoint {
        name: joint.name.clone(),
        origin: pose(&origin),
        axis: single(axis / length),
        link: body.inertial(),
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

/// Mass, first and second moments about the origin of a joint frame.
#[derive(Default)]
struct Body {
    mass: f64,
    first: Vector3<f64>,
    second: Matrix3<f64>,
}

impl Body {
    fn add(&mut self, inertial: &urdf_rs::Inertial, place: &Isometry3<f64>) {
        let place = place * isometry(&inertial.origin);
        let (mass, i) = (inertial.mass.value, &inertial.inertia);
        let tensor = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
        let rotation: Rotation3<f64> = place.rotation.to_rotation_matrix();
        let center = (place * Point3::origin()).coords;
        self.mass += mass;
        self.first += center * mass;
        self.second += rotation * tensor * rotation.transpose() + steiner(mass, &center);
    }

    fn inertial(&self) -> Inertial {
        let center = if self.mass > 0.0 { self.first / self.mass } else { Vector3::zeros() };
        let tensor = self.second - steiner(self.mass, &center);
        let six = [tensor.m11, tensor.m22, tensor.m33, tensor.m12, tensor.m13, tensor.m23];
        Inertial { mass: narrow(self.mass), center_of_mass: single(center), inertia: six.map(narrow) }
    }
}

/// Inertia of a point mass at `center` about the origin.
fn steiner(mass: f64, center: &Vector3<f64>) -> Matrix3<f64> {
    (Matrix3::identity() * center.norm_squared() - center * center.transpose()) * mass
}

fn isometry(pose: &urdf_rs::Pose) -> Isometry3<f64> {
    let [roll, pitch, yaw] = pose.rpy.0;
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Isometry3::from_parts(Translation3::from(Vector3::from(pose.xyz.0)), rotation)
}

fn pose(place: &Isometry3<f64>) -> Pose {
    Pose { translation: single(place.translation.vector), rotation: place.rotation.coords.map(narrow).into() }
}

fn single(vector: Vector3<f64>) -> [f32; 3] {
    vector.map(narrow).into()
}

#[expect(clippy::cast_possible_truncation, reason = "the controller works in single precision")]
const fn narrow(value: f64) -> f32 {
    value as f32
}
