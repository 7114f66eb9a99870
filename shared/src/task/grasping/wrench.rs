use nalgebra::{IsometryMatrix3, Vector3, Vector6};

use super::WrenchGains;
use super::pose::displacement;
use super::tuning::{MAX_INTEGRAL_FORCE, MAX_INTEGRAL_MOMENT};
use crate::TICK;
use crate::math;
use crate::zip::zip;

/// Proportional-integral control of an object's pose, the wrench `−K_p e − K_i ∫ e` of (Hand3 eq. 19) with
/// `e = [p − p_d; log(R R_dᵀ)]` [N, N·m].
pub(super) fn wrench(
    gains: &WrenchGains,
    integral: &mut [f32; 6],
    object: &IsometryMatrix3<f32>,
    target: &IsometryMatrix3<f32>,
) -> Vector6<f32> {
    let gains = [(gains.position, MAX_INTEGRAL_FORCE), (gains.orientation, MAX_INTEGRAL_MOMENT)];
    let mut wrench = [Vector3::zeros(); 2];
    for (error, output, integral, ([proportional, rate], max)) in
        zip((displacement(target, object), &mut wrench, integral.chunks_exact_mut(3), gains))
    {
        for (error, output, integral) in zip((&error, output.iter_mut(), integral)) {
            *integral = math::clamp(*integral + rate * TICK * error, -max, max);
            *output = -(proportional * error + *integral);
        }
    }
    let [force, moment] = wrench;
    Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Translation3};

    use super::*;

    /// 2 mm and 0.02 rad off for three ticks: −(1000·2e-3 + 3·500·0.01·2e-3) N, −(20·0.02 + 3·10·0.01·0.02)
    /// N·m; and no wrench with gains of 0.
    #[test]
    fn the_wrench_is_proportional_and_integral() {
        let target = IsometryMatrix3::identity();
        let rotation = math::rotation_matrix(&Vector3::new(0.0, 0.02, 0.0));
        let object = IsometryMatrix3::from_parts(
            Translation3::new(2e-3, 0.0, 0.0),
            Rotation3::from_matrix_unchecked(rotation),
        );
        let gains =
            |position, orientation| WrenchGains { position, orientation, damping: 0.0, compensated: false };
        let after_three = |gains: &WrenchGains| {
            let mut integral = [0.0; 6];
            let _ = (
                wrench(gains, &mut integral, &object, &target),
                wrench(gains, &mut integral, &object, &target),
            );
            wrench(gains, &mut integral, &object, &target)
        };
        let found = after_three(&gains([1000.0, 500.0], [20.0, 10.0]));
        let expected = Vector6::new(-2.03, 0.0, 0.0, 0.0, -0.406, 0.0);
        assert!((found - expected).norm() < 1e-5, "{found}");
        assert_eq!(after_three(&gains([0.0; 2], [0.0; 2])), Vector6::zeros());
    }
}
