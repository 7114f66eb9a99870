use heapless::Vec;
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use crate::model::{JointModel, MAX_CHAIN_JOINTS};

/// A serial chain of rotary joints with its mass distribution, ready for computing.
#[derive(Clone, Debug)]
pub struct Chain {
    pub(super) links: Vec<Link, MAX_CHAIN_JOINTS>,
}

/// One joint and its link; all in the link's own frame (joint axis z) unless stated.
#[derive(Clone, Debug)]
pub(super) struct Link {
    /// Orientation of the joint frame at angle 0 in the frame of the link before it.
    pub rotation: Matrix3<f32>,
    /// Its origin there [m].
    pub translation: Vector3<f32>,
    /// Mass [kg].
    pub mass: f32,
    /// Centre of mass [m].
    pub center_of_mass: Vector3<f32>,
    /// Inertia about the centre of mass [kg·m²].
    pub inertia: Matrix3<f32>,
}

impl Chain {
    /// The chain of `joints`, base to tip, of a validated model; at most [`MAX_CHAIN_JOINTS`].
    pub fn new(joints: &[JointModel]) -> Self {
        let mut links = Vec::new();
        // Turns vectors of the previous link's frame as the model has it into that frame as used here.
        let mut previous = Matrix3::identity();
        for joint in joints {
            // The model's joint frame → the frame with z along the axis.
            let to_axis = align_with_z(&Vector3::from(joint.axis));
            let [x, y, z, w] = joint.origin.rotation;
            let origin = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
            let [ixx, iyy, izz, ixy, ixz, iyz] = joint.link.inertia;
            let inertia = Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
            let link = Link {
                rotation: previous * origin.matrix() * to_axis.transpose(),
                translation: previous * Vector3::from(joint.origin.translation),
                mass: joint.link.mass,
                center_of_mass: to_axis * Vector3::from(joint.link.center_of_mass),
                inertia: to_axis * inertia * to_axis.transpose(),
            };
            if links.push(link).is_err() {
                break; // a validated model has no longer chain
            }
            previous = to_axis;
        }
        Self { links }
    }

    /// Number of joints.
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Whether the chain has no joint.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }
}

/// The shortest rotation that takes the unit vector `axis` to z.
fn align_with_z(axis: &Vector3<f32>) -> Matrix3<f32> {
    match Rotation3::rotation_between(axis, &Vector3::z()) {
        Some(rotation) => rotation.into_inner(),
        // `axis` = −z: half a turn about x.
        None => Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)),
    }
}
