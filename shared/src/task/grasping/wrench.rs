use nalgebra::{IsometryMatrix3, Vector6};

use super::WrenchGains;
use super::tuning::{MAX_INTEGRAL_FORCE, MAX_INTEGRAL_MOMENT};
use crate::TICK;
use crate::math::{self, abs};
use crate::zip::zip;

/// Proportional-integral control of an object's pose: the wrench `−K_p e − K_i ∫ e` of (Hand3 eq. 19) with
/// `e = [p − p_d; log(R R_dᵀ)]` [N, N·m], and its integral part `K_i ∫ e` for [`integrate`].
pub(super) fn wrench(
    gains: &WrenchGains,
    integral: &[f32; 6],
    object: &IsometryMatrix3<f32>,
    target: &IsometryMatrix3<f32>,
) -> (Vector6<f32>, [f32; 6]) {
    let gains = [(gains.position, MAX_INTEGRAL_FORCE), (gains.orientation, MAX_INTEGRAL_MOMENT)];
    let (mut wrench, mut integral) = (Vector6::zeros(), *integral);
    for (error, output, integral, ([proportional, rate], max)) in zip((
        math::displacement(target, object),
        wrench.as_mut_slice().chunks_exact_mut(3),
        integral.chunks_exact_mut(3),
        gains,
    )) {
        for (error, output, integral) in zip((&error, output, integral)) {
            *integral = math::clamp(*integral + rate * TICK * error, -max, max);
            *output = -(proportional * error + *integral);
        }
    }
    (wrench, integral)
}

/// Takes over the `next` integral part. While the wrench is `at_limit`, no part grows (anti-windup).
pub(super) fn integrate(integral: &mut [f32; 6], next: &[f32; 6], at_limit: bool) {
    for (integral, next) in integral.iter_mut().zip(next) {
        if !at_limit || abs(*next) < abs(*integral) {
            *integral = *next;
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Translation3, Vector3};

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
            let (mut output, mut integral) = Default::default();
            for _ in 0..3 {
                (output, integral) = wrench(gains, &integral, &object, &target);
            }
            output
        };
        let found = after_three(&gains([1000.0, 500.0], [20.0, 10.0]));
        let expected = Vector6::new(-2.03, 0.0, 0.0, 0.0, -0.406, 0.0);
        assert!((found - expected).norm() < 1e-5, "{found}");
        assert_eq!(after_three(&gains([0.0; 2], [0.0; 2])), Vector6::zeros());
    }

    /// A wrench at its limit keeps parts that would grow, in both directions, and takes over the others.
    #[test]
    fn the_integral_does_not_grow_at_the_limit() {
        let before = [1.0, -1.0, 1.0, -1.0, 0.0, 0.5];
        let next = [1.1, -1.1, 0.9, 0.2, 0.1, 0.5];
        for (at_limit, expected) in [(true, [1.0, -1.0, 0.9, 0.2, 0.0, 0.5]), (false, next)] {
            let mut integral = before;
            integrate(&mut integral, &next, at_limit);
            assert_eq!(integral.map(f32::to_bits), expected.map(f32::to_bits));
        }
    }
}
