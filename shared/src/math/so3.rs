use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::{atan2, norm, sin_cos, sqrt};

/// Within this angle of π [rad] the axis is taken from the symmetric part of the matrix: the skew part
/// vanishes there.
const NEARLY_HALF_A_TURN: f32 = 0.05;

/// Exponential map of SO(3): the rotation matrix of a rotation vector (axis · angle) [rad], by Rodrigues'
/// formula.
///
/// ```
/// let vector = nalgebra::Vector3::new(0.0, 0.0, core::f32::consts::FRAC_PI_2);
/// let quarter = tesaki::math::rotation_matrix(&vector);
/// assert!((quarter * nalgebra::Vector3::x() - nalgebra::Vector3::y()).norm() < 1e-6);
/// ```
pub fn rotation_matrix(vector: &Vector3<f32>) -> Matrix3<f32> {
    let square = vector.norm_squared();
    // sin a / a and (1 − cos a) / a²
    let (first, second) = if square < 1e-4 {
        (1.0 - square / 6.0, 0.5 - square / 24.0)
    } else {
        let angle = sqrt(square);
        let (half_sine, _) = sin_cos(0.5 * angle);
        (sin_cos(angle).0 / angle, 2.0 * half_sine * half_sine / square)
    };
    let cross = vector.cross_matrix();
    Matrix3::identity() + cross * first + cross * cross * second
}

/// Logarithm of SO(3): the rotation vector (axis · angle) [rad] of a rotation matrix, with an angle of at
/// most π.
///
/// ```
/// let half = nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(-1.0, -1.0, 1.0));
/// let vector = tesaki::math::rotation_vector(&half);
/// assert!((vector.z.abs() - core::f32::consts::PI).abs() < 1e-6 && vector.x == 0.0);
/// ```
pub fn rotation_vector(rotation: &Matrix3<f32>) -> Vector3<f32> {
    let r = rotation;
    // Twice the axis times the sine of the angle; twice its cosine.
    let twice = Vector3::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12);
    let sine = norm(&twice);
    let cosine = r.trace() - 1.0;
    let angle = atan2(sine, cosine);
    if cosine > 0.0 && sine < 1e-3 {
        // angle / (2 sin angle) = (1 + angle²/6 + …)/2
        return twice * (0.5 + angle * angle / 12.0);
    }
    if core::f32::consts::PI - angle > NEARLY_HALF_A_TURN {
        return twice * (angle / sine);
    }
    // R + Rᵀ = 2 cos · 1 + 2 (1 − cos) · axis axisᵀ: its longest column is along the axis.
    let symmetric = r + r.transpose() - Matrix3::from_diagonal_element(cosine);
    let longest = if symmetric.m11 >= symmetric.m22 && symmetric.m11 >= symmetric.m33 {
        symmetric.column(0)
    } else if symmetric.m22 >= symmetric.m33 {
        symmetric.column(1)
    } else {
        symmetric.column(2)
    };
    let length = norm(&longest);
    let toward = if longest.dot(&twice) < 0.0 { -angle } else { angle };
    longest * (toward / length)
}

/// Rotates an orientation by a rotation vector [rad] in the axes of the base.
pub(crate) fn rotated_by(rotation: &UnitQuaternion<f32>, by: &Vector3<f32>) -> UnitQuaternion<f32> {
    let half = by * 0.5;
    let square = half.norm_squared();
    let (scalar, factor) = if square < 1e-4 {
        (1.0 - 0.5 * square, 1.0 - square / 6.0)
    } else {
        let angle = sqrt(square);
        let (sine, cosine) = sin_cos(angle);
        (cosine, sine / angle)
    };
    let product = Quaternion::from_parts(scalar, half * factor) * rotation.quaternion();
    UnitQuaternion::new_unchecked(product * (1.0 / sqrt(product.norm_squared())))
}

/// A quaternion `[x, y, z, w]`, as on the wire.
pub(crate) const fn quaternion([x, y, z, w]: [f32; 4]) -> Quaternion<f32> {
    Quaternion::new(w, x, y, z)
}

/// The orientation of a quaternion `[x, y, z, w]` of norm 1.
pub(crate) const fn orientation(xyzw: [f32; 4]) -> UnitQuaternion<f32> {
    UnitQuaternion::new_unchecked(quaternion(xyzw))
}

/// The rotation vector [rad], at most π long, that takes one orientation to another, in the axes of the base.
pub(crate) fn rotation_between(from: &UnitQuaternion<f32>, to: &UnitQuaternion<f32>) -> Vector3<f32> {
    let between = to.quaternion() * from.quaternion().conjugate();
    let between = if between.w < 0.0 { -between } else { between };
    let sine = norm(&between.imag());
    let factor = if sine < 1e-4 { 2.0 } else { 2.0 * atan2(sine, between.w) / sine };
    between.imag() * factor
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, reason = "tests")]
mod tests {
    use super::*;

    /// Rodrigues' formula in double precision.
    fn matrix(axis: [f64; 3], angle: f64) -> Matrix3<f32> {
        let length = axis.iter().map(|x| x * x).sum::<f64>().sqrt();
        let axis = Vector3::from(axis) / length;
        let cross = Matrix3::new(0.0, -axis.z, axis.y, axis.z, 0.0, -axis.x, -axis.y, axis.x, 0.0);
        let exact = Matrix3::identity() + cross * libm::sin(angle) + cross * cross * (1.0 - libm::cos(angle));
        exact.map(|value: f64| value as f32)
    }

    #[test]
    fn gives_back_axis_and_angle_from_nothing_to_half_a_turn() {
        let axes =
            [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.3, -0.2, 0.9], [-1.0, 1e-3, 2e-3], [1.0, 1.0, -1.0]];
        for axis in axes {
            let length = axis.iter().map(|x: &f64| x * x).sum::<f64>().sqrt();
            for step in 0..=2000 {
                let angle = std::f64::consts::PI * f64::from(step) / 2000.0;
                for angle in [angle, 1e-3 * angle, std::f64::consts::PI - 1e-3 * angle] {
                    let vector = rotation_vector(&matrix(axis, angle));
                    let expected = Vector3::from(axis).map(|x| (x / length * angle) as f32);
                    // Half a turn has two rotation vectors.
                    let miss = (vector - expected).norm().min(if angle > std::f64::consts::PI - 1e-4 {
                        (vector + expected).norm()
                    } else {
                        f32::INFINITY
                    });
                    assert!(miss < 4e-6, "{axis:?} {angle}: {vector} is off by {miss}");
                }
            }
        }
    }

    #[test]
    fn a_turn_comes_back_from_nothing_to_half_a_turn() {
        let from = UnitQuaternion::from_euler_angles(0.3, -1.2, 2.5);
        for step in 0..1000_u16 {
            let angle = f32::from(step) * 3.14e-3;
            let by = Vector3::new(0.6, -0.64, 0.48) * angle;
            let to = rotated_by(&from, &by);
            let exact = UnitQuaternion::new(by.map(f64::from)) * from.cast::<f64>();
            assert!(to.cast::<f64>().angle_to(&exact) < 1e-6, "{angle}");
            assert!(
                (rotation_between(&from, &to) - by).norm() < 3e-6,
                "{angle}: {}",
                rotation_between(&from, &to)
            );
        }
    }
}
