//! Conversions between the plant's double precision and rapier's types, which have single precision.

use rapier3d::dynamics::MassProperties;
use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::na::{Isometry3, Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Converts a mass [kg], its centre [m] and its inertia about the centre [kg·m²].
pub fn mass_properties(mass: f64, center: &Vector3<f64>, inertia: Matrix3<f64>) -> MassProperties {
    let eigen = inertia.symmetric_eigen();
    let mut axes: Matrix3<f64> = eigen.eigenvectors;
    if axes.determinant() < 0.0 {
        axes.column_mut(0).neg_mut();
    }
    let frame = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    MassProperties::with_principal_inertia_frame(
        vector(center),
        narrow(mass),
        vector(&eigen.eigenvalues),
        rotation(&frame),
    )
}

pub fn pose(pose: &Isometry3<f64>) -> Pose {
    Pose::from_parts(vector(&pose.translation.vector), rotation(&pose.rotation))
}

/// Converts a position [m] and a quaternion `[x, y, z, w]`.
pub fn isometry(position: [f64; 3], orientation: [f64; 4]) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(position), unit_quaternion(orientation))
}

/// Converts a quaternion `[x, y, z, w]`.
pub fn unit_quaternion([x, y, z, w]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

/// Converts a pose to double precision.
pub fn isometry_of(pose: &Pose) -> Isometry3<f64> {
    isometry(pose.translation.to_array().map(f64::from), pose.rotation.to_array().map(f64::from))
}

pub fn vector(vector: &Vector3<f64>) -> Vector {
    Vector::new(narrow(vector.x), narrow(vector.y), narrow(vector.z))
}

/// Converts a vector to double precision.
pub fn wide(vector: Vector) -> Vector3<f64> {
    Vector3::from(vector.to_array().map(f64::from))
}

fn rotation(rotation: &UnitQuaternion<f64>) -> Rotation {
    let [x, y, z, w] = rotation.coords.into();
    Rotation::from_xyzw(narrow(x), narrow(y), narrow(z), narrow(w)).normalize()
}

/// Rounds to the single precision of rapier.
#[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
pub const fn narrow(value: f64) -> f32 {
    value as f32
}
