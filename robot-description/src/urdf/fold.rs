//! Fixed joints folded away: one body with the mass of all links that are fixed to each other.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use tesaki::model::{Inertial, Pose};
use urdf_rs::{Joint, JointType, Robot};

/// Adds the mass of `link`, and of all that is fixed to it, to `body`; returns the other joints that follow, with
/// the place of their parent link in the body's frame, in the order of the file.
pub fn collect<'a>(robot: &'a Robot, link: &'a str, body: &mut Body) -> Vec<(&'a Joint, Isometry3<f64>)> {
    let mut moving = Vec::new();
    let mut open = Vec::new();
    let mut visit = |link: &'a str, place: Isometry3<f64>, open: &mut Vec<_>| {
        if let Some(link) = robot.links.iter().find(|known| known.name == link) {
            body.add(&link.inertial, &place);
        }
        let behind = robot.joints.iter().rev().filter(|joint| joint.parent.link == link);
        open.extend(behind.map(|joint| (joint, place)));
    };
    visit(link, Isometry3::identity(), &mut open);
    while let Some((joint, place)) = open.pop() {
        if joint.joint_type == JointType::Fixed {
            visit(&joint.child.link, place * isometry(&joint.origin), &mut open);
        } else {
            moving.push((joint, place));
        }
    }
    moving
}

/// Mass, first and second moments about the origin of a joint frame.
#[derive(Default)]
pub struct Body {
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

    /// The same about the centre of mass.
    pub fn inertial(&self) -> Inertial {
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

pub fn isometry(pose: &urdf_rs::Pose) -> Isometry3<f64> {
    let [roll, pitch, yaw] = pose.rpy.0;
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Isometry3::from_parts(Translation3::from(Vector3::from(pose.xyz.0)), rotation)
}

pub fn pose(place: &Isometry3<f64>) -> Pose {
    Pose { translation: single(place.translation.vector), rotation: place.rotation.coords.map(narrow).into() }
}

/// The direction of a joint's axis; `None` when it has none.
pub fn axis(joint: &Joint) -> Option<[f32; 3]> {
    let axis = Vector3::from(joint.axis.xyz.0);
    let length = axis.norm();
    (length.is_finite() && length > 1e-6).then(|| single(axis / length))
}

pub fn single(vector: Vector3<f64>) -> [f32; 3] {
    vector.map(narrow).into()
}

#[expect(clippy::cast_possible_truncation, reason = "the controller works in single precision")]
pub const fn narrow(value: f64) -> f32 {
    value as f32
}
