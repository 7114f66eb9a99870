use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::math;

/// The orientation turned on by a rotation vector [rad].
pub fn turned(rotation: &UnitQuaternion<f32>, by: &Vector3<f32>) -> UnitQuaternion<f32> {
    let half = by * 0.5;
    let square = half.norm_squared();
    let (scalar, factor) = if square < 1e-4 {
        (1.0 - 0.5 * square, 1.0 - square / 6.0)
    } else {
        let angle = math::sqrt(square);
        let (sine, cosine) = math::sin_cos(angle);
        (cosine, sine / angle)
    };
    let turned = Quaternion::from_parts(scalar, half * factor) * rotation.quaternion();
    UnitQuaternion::new_unchecked(turned * (1.0 / math::sqrt(turned.norm_squared())))
}

/// The shorter rotation from one orientation to another, as a rotation vector [rad].
pub fn turn(from: &UnitQuaternion<f32>, to: &UnitQuaternion<f32>) -> Vector3<f32> {
    let between = to.quaternion() * from.quaternion().conjugate();
    let between = if between.w < 0.0 { -between } else { between };
    let sine = math::sqrt(between.imag().norm_squared());
    let factor = if sine < 1e-4 { 2.0 } else { 2.0 * math::atan2(sine, between.w) / sine };
    between.imag() * factor
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_comes_back_from_nothing_to_half_a_turn() {
        let from = UnitQuaternion::from_euler_angles(0.3, -1.2, 2.5);
        for step in 0..1000_u16 {
            let angle = f32::from(step) * 3.14e-3;
            let by = Vector3::new(0.6, -0.64, 0.48) * angle;
            let to = turned(&from, &by);
            let exact = UnitQuaternion::new(by.map(f64::from)) * from.cast::<f64>();
            assert!(to.cast::<f64>().angle_to(&exact) < 1e-6, "{angle}");
            assert!((turn(&from, &to) - by).norm() < 3e-6, "{angle}: {}", turn(&from, &to));
        }
    }
}
