//! Fixed joints folded away: what they join is one rigid body.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use tesaki::model::{Inertial, Pose};
use urdf_rs::{Joint, JointType, Link, Robot};

/// A link and all that is fixed to it. Its frame is that of the link.
#[derive(Clone, Debug)]
pub struct RigidBody<'a> {
    /// Its links with their frames in that of the body: each behind the one that carries it, in the order of
    /// the file.
    pub links: Vec<(&'a Link, Isometry3<f64>)>,
    /// The joints that move and leave it, in the order of its links, with the frame of their parent link in
    /// that of the body.
    pub joints: Vec<(&'a Joint, Isometry3<f64>)>,
}

impl<'a> RigidBody<'a> {
    /// The body of the link called `link`, which must be in a tree.
    pub fn new(robot: &'a Robot, link: &'a str) -> Self {
        let mut body = Self { links: Vec::new(), joints: Vec::new() };
        let mut open = Vec::new();
        body.visit(robot, link, Isometry3::identity(), &mut open);
        while let Some((joint, place)) = open.pop() {
            if joint.joint_type == JointType::Fixed {
                body.visit(robot, &joint.child.link, place * isometry(&joint.origin), &mut open);
            } else {
                body.joints.push((joint, place));
            }
        }
        body
    }

    fn visit(
        &mut self,
        robot: &'a Robot,
        name: &str,
        place: Isometry3<f64>,
        open: &mut Vec<(&'a Joint, Isometry3<f64>)>,
    ) {
        let link = robot.links.iter().find(|link| link.name == name);
        self.links.extend(link.map(|link| (link, place)));
        let behind = robot.joints.iter().rev().filter(|joint| joint.parent.link == name);
        open.extend(behind.map(|joint| (joint, place)));
    }

    /// Its mass properties: the sum over its links.
    pub fn mass_properties(&self) -> MassProperties {
        let mut sum = Moments::default();
        for (link, place) in &self.links {
            sum.add(&link.inertial, place);
        }
        sum.about_center()
    }

    /// The link at its end: of those that carry nothing the one farthest from the body's origin, the last of
    /// several that are as far.
    pub fn tip(&self, robot: &Robot) -> Option<(&'a Link, Isometry3<f64>)> {
        let carries = |link: &Link| robot.joints.iter().any(|joint| joint.parent.link == link.name);
        let distance = |place: &Isometry3<f64>| place.translation.vector.norm();
        let leaves = self.links.iter().filter(|(link, _)| !carries(link));
        leaves.max_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b))).copied()
    }
}

/// Mass, centre of mass and inertia of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassProperties {
    /// [kg].
    pub mass: f64,
    /// In the frame of the body [m]; its origin for a body without mass.
    pub center_of_mass: Vector3<f64>,
    /// About the centre of mass, axes of the body's frame [kg·m²].
    pub inertia: Matrix3<f64>,
}

impl MassProperties {
    /// The same in the controller's precision.
    pub(crate) fn inertial(&self) -> Inertial {
        let i = &self.inertia;
        let six = [i.m11, i.m22, i.m33, i.m12, i.m13, i.m23];
        Inertial {
            mass: narrow(self.mass),
            center_of_mass: single(self.center_of_mass),
            inertia: six.map(narrow),
        }
    }
}

/// Mass, first and second moments about the origin of the body's frame.
#[derive(Default)]
struct Moments {
    mass: f64,
    first: Vector3<f64>,
    second: Matrix3<f64>,
}

impl Moments {
    fn add(&mut self, inertial: &urdf_rs::Inertial, place: &Isometry3<f64>) {
        let place = place * isometry(&inertial.origin);
        let (mass, center) = (inertial.mass.value, place.translation.vector);
        self.mass += mass;
        self.first += mass * center;
        self.second += rotated_inertia(inertial, &place) + point_inertia(mass, &center);
    }

    /// By the parallel axis theorem.
    fn about_center(&self) -> MassProperties {
        let center_of_mass = if self.mass > 0.0 { self.first / self.mass } else { Vector3::zeros() };
        let inertia = self.second - point_inertia(self.mass, &center_of_mass);
        MassProperties { mass: self.mass, center_of_mass, inertia }
    }
}

/// A link's inertia about its centre of mass [kg·m²], in a frame in which the frame of that inertia is at
/// `place`.
pub fn rotated_inertia(inertial: &urdf_rs::Inertial, place: &Isometry3<f64>) -> Matrix3<f64> {
    let i = &inertial.inertia;
    let tensor = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
    let rotation = place.rotation.to_rotation_matrix().into_inner();
    rotation * tensor * rotation.transpose()
}

/// Inertia of a point mass [kg] at `center` [m] about the origin [kg·m²].
pub fn point_inertia(mass: f64, center: &Vector3<f64>) -> Matrix3<f64> {
    mass * (Matrix3::identity() * center.norm_squared() - center * center.transpose())
}

/// A pose of a URDF.
pub fn isometry(pose: &urdf_rs::Pose) -> Isometry3<f64> {
    let [roll, pitch, yaw] = pose.rpy.0;
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Isometry3::from_parts(Translation3::from(Vector3::from(pose.xyz.0)), rotation)
}

/// The direction of a joint's axis; `None` when it has none.
pub fn axis(joint: &Joint) -> Option<Vector3<f64>> {
    let axis = Vector3::from(joint.axis.xyz.0);
    let length = axis.norm();
    (length.is_finite() && length > 1e-6).then(|| axis / length)
}

pub(crate) fn pose(place: &Isometry3<f64>) -> Pose {
    Pose { translation: single(place.translation.vector), rotation: place.rotation.coords.map(narrow).into() }
}

pub(crate) fn single(vector: Vector3<f64>) -> [f32; 3] {
    vector.map(narrow).into()
}

#[expect(clippy::cast_possible_truncation, reason = "the controller works in single precision")]
pub(crate) const fn narrow(value: f64) -> f32 {
    value as f32
}
