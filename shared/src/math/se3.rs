use nalgebra::{IsometryMatrix3, Vector3, Vector6};

use super::rotation_vector;

/// The displacement of a frame's origin, and its rotation vector, from one pose to another, in base axes [m,
/// rad].
pub(crate) fn displacement(from: &IsometryMatrix3<f32>, to: &IsometryMatrix3<f32>) -> [Vector3<f32>; 2] {
    let rotation = to.rotation.matrix() * from.rotation.matrix().transpose();
    [to.translation.vector - from.translation.vector, rotation_vector(&rotation)]
}

/// A twist, a wrench or a displacement from its linear and its angular half.
#[inline]
pub(crate) fn stack([linear, angular]: [Vector3<f32>; 2]) -> Vector6<f32> {
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

/// The linear and the angular half of a twist, a wrench or a displacement.
#[inline]
pub(crate) fn halves(six: &Vector6<f32>) -> [Vector3<f32>; 2] {
    [Vector3::new(six.x, six.y, six.z), Vector3::new(six.w, six.a, six.b)]
}
