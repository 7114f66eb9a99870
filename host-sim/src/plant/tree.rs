//! From the URDF to moving bodies: fixed joints are folded in.

use rapier3d::na::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use urdf_rs::{JointType, Robot};

use super::PlantError;

/// A link that a joint moves, with everything that is fixed to it. Its frame is the joint's.
#[derive(Clone, Debug)]
pub struct Body {
    pub joint: String,
    /// The moving body before it; `None` for the base.
    pub parent: Option<usize>,
    /// Joint frame in the frame of the body before it, at angle 0.
    pub origin: Isometry3<f64>,
    pub axis: Vector3<f64>,
    pub mass: f64,
    pub center_of_mass: Vector3<f64>,
    /// About the centre of mass, axes of the joint frame.
    pub inertia: Matrix3<f64>,
    /// End stops; `None` for a joint that turns without end.
    pub stops: Option<[f64; 2]>,
    /// Largest torque [N·m].
    pub effort: f64,
    /// Coulomb [N·m] and viscous friction [N·m·s/rad].
    pub coulomb: f64,
    pub viscous: f64,
}

/// A mass with its first and second moments about the origin of a body frame.
struct Moments {
    mass: f64,
    first: Vector3<f64>,
    /// Inertia tensor.
    second: Matrix3<f64>,
}

/// The moving bodies, each after the one that carries it.
pub fn bodies(robot: &Robot) -> Result<Vec<Body>, PlantError> {
    let base = find_base(robot)?;
    let mut bodies = Vec::new();
    let mut ignored = Moments { mass: 0.0, first: Vector3::zeros(), second: Matrix3::zeros() };
    visit(robot, base, None, &Isometry3::identity(), &mut ignored, &mut bodies)?;
    match unreached(robot, base).as_slice() {
        [] => Ok(bodies),
        lost => Err(PlantError::Tree(format!(
            "the joints {} run in a circle; let one of their links hang on the base {base:?}",
            lost.join(", ")
        ))),
    }
}

fn find_base(robot: &Robot) -> Result<&str, PlantError> {
    let error = |text: String| Err(PlantError::Tree(text));
    for (index, joint) in robot.joints.iter().enumerate() {
        for link in [&joint.parent.link, &joint.child.link] {
            if !robot.links.iter().any(|known| known.name == *link) {
                return error(format!(
                    "joint {:?} names the link {link:?}, which does not exist",
                    joint.name
                ));
            }
        }
        for other in robot.joints.iter().take(index) {
            if other.child.link == joint.child.link {
                return error(format!(
                    "joints {:?} and {:?} both carry the link {:?}; take one away",
                    other.name, joint.name, joint.child.link
                ));
            }
            if other.name == joint.name {
                return error(format!("two joints are called {:?}; rename one", joint.name));
            }
        }
    }
    let is_child = |name: &str| robot.joints.iter().any(|joint| joint.child.link == name);
    let mut bases = robot.links.iter().map(|link| link.name.as_str()).filter(|name| !is_child(name));
    match (bases.next(), bases.next()) {
        (Some(base), None) => Ok(base),
        (None, _) => error("every link hangs on another; one must be the base".to_owned()),
        (Some(one), Some(two)) => {
            error(format!("the links {one:?} and {two:?} both hang on nothing; join them by a fixed joint"))
        }
    }
}

/// The joints to which no path leads from `base`.
fn unreached<'a>(robot: &'a Robot, base: &'a str) -> Vec<&'a str> {
    let mut reached = vec![base];
    let mut next = 0;
    while let Some(&link) = reached.get(next) {
        let behind = robot.joints.iter().filter(|joint| joint.parent.link == link);
        reached.extend(behind.map(|joint| joint.child.link.as_str()));
        next += 1;
    }
    let lost = robot.joints.iter().filter(|joint| !reached.contains(&joint.parent.link.as_str()));
    lost.map(|joint| joint.name.as_str()).collect()
}

/// Adds the mass of `link` at `place` in the body frame to `moments`, then everything behind it.
fn visit(
    robot: &Robot,
    link: &str,
    body: Option<usize>,
    place: &Isometry3<f64>,
    moments: &mut Moments,
    bodies: &mut Vec<Body>,
) -> Result<(), PlantError> {
    if let Some(link) = robot.links.iter().find(|known| known.name == link) {
        moments.add(&link.inertial, place);
    }
    // First all that is fixed, so that a chain's joints follow each other.
    let (fixed, moving): (Vec<_>, Vec<_>) = robot
        .joints
        .iter()
        .filter(|joint| joint.parent.link == link)
        .partition(|joint| joint.joint_type == JointType::Fixed);
    for joint in fixed {
        visit(robot, &joint.child.link, body, &(place * isometry(&joint.origin)), moments, bodies)?;
    }
    for joint in moving {
        let origin = place * isometry(&joint.origin);
        let index = bodies.len();
        bodies.push(empty_body(joint, body, origin)?);
        let mut own = Moments { mass: 0.0, first: Vector3::zeros(), second: Matrix3::zeros() };
        visit(robot, &joint.child.link, Some(index), &Isometry3::identity(), &mut own, bodies)?;
        if let Some(body) = bodies.get_mut(index) {
            own.give_to(body, &joint.child.link)?;
        }
    }
    Ok(())
}

fn empty_body(
    joint: &urdf_rs::Joint,
    parent: Option<usize>,
    origin: Isometry3<f64>,
) -> Result<Body, PlantError> {
    let name = || joint.name.clone();
    let axis = Vector3::from(joint.axis.xyz.0);
    let length = axis.norm();
    if !(length.is_finite() && length > 1e-6) {
        return Err(PlantError::Axis { joint: name(), axis: joint.axis.xyz.0 });
    }
    let (lower, upper) = (joint.limit.lower, joint.limit.upper);
    let stops = match joint.joint_type {
        JointType::Revolute if lower < upper => Some([lower, upper]),
        JointType::Revolute => return Err(PlantError::Limits { joint: name(), lower, upper }),
        JointType::Continuous => None,
        ref other => {
            return Err(PlantError::JointType { joint: name(), kind: format!("{other:?}").to_lowercase() });
        }
    };
    let dynamics = joint.dynamics.as_ref();
    Ok(Body {
        joint: name(),
        parent,
        origin,
        axis: axis / length,
        mass: 0.0,
        center_of_mass: Vector3::zeros(),
        inertia: Matrix3::zeros(),
        stops,
        effort: joint.limit.effort,
        coulomb: dynamics.map_or(0.0, |dynamics| dynamics.friction),
        viscous: dynamics.map_or(0.0, |dynamics| dynamics.damping),
    })
}

impl Moments {
    fn add(&mut self, inertial: &urdf_rs::Inertial, place: &Isometry3<f64>) {
        let (mass, i) = (inertial.mass.value, &inertial.inertia);
        let place = place * isometry(&inertial.origin);
        let tensor = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
        let rotation = place.rotation.to_rotation_matrix().into_inner();
        let center = place.translation.vector;
        self.mass += mass;
        self.first += mass * center;
        self.second += rotation * tensor * rotation.transpose() + point_inertia(mass, &center);
    }

    fn give_to(self, body: &mut Body, link: &str) -> Result<(), PlantError> {
        let names = || (link.to_owned(), body.joint.clone());
        if !(self.mass.is_finite() && self.mass > 0.0) {
            let (link, joint) = names();
            return Err(PlantError::NoMass { link, joint });
        }
        let center = self.first / self.mass;
        let inertia = self.second - point_inertia(self.mass, &center);
        let moments = inertia.symmetric_eigenvalues();
        // Half the trace less a principal moment is a second moment of mass: none can be negative.
        let possible = moments.min() > 0.0 && moments.max() <= 0.5 * inertia.trace() * (1.0 + 1e-3);
        if !possible {
            let (link, joint) = names();
            return Err(PlantError::Inertia { link, joint, moments: moments.into() });
        }
        (body.mass, body.center_of_mass, body.inertia) = (self.mass, center, inertia);
        Ok(())
    }
}

/// Inertia about the origin of a point mass at `center`.
pub fn point_inertia(mass: f64, center: &Vector3<f64>) -> Matrix3<f64> {
    mass * (Matrix3::identity() * center.norm_squared() - center * center.transpose())
}

/// A pose as URDF has it.
pub fn isometry(pose: &urdf_rs::Pose) -> Isometry3<f64> {
    let [roll, pitch, yaw] = pose.rpy.0;
    Isometry3::from_parts(
        Translation3::from(Vector3::from(pose.xyz.0)),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
}
