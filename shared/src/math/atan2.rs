use core::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use super::abs;

/// tan(π/8).
const TAN_PI_8: f32 = 0.414_213_57;

/// The angle of the point `(x, y)` [rad], −π to π, within 3e-7 of the exact value for coordinates of 1e-30 to
/// 1e38; 0 or ±π at the origin, by the signs of the zeros. Infinite coordinates give NaN.
///
/// The angle is reduced to ±π/8, where a minimax polynomial (fitted in double precision, error 2e-8) takes
/// over. Identical bits on every IEEE machine.
///
/// ```
/// assert!((tesaki::math::atan2(1.0, -2.0) - 2.677_945).abs() < 3e-7);
/// ```
#[cfg_attr(target_os = "none", inline(never))]
#[cfg_attr(not(target_os = "none"), inline)]
pub fn atan2(y: f32, x: f32) -> f32 {
    inlined_atan2(y, x)
}

/// The same, for places where a call takes too long.
#[inline(always)]
pub(crate) fn inlined_atan2(y: f32, x: f32) -> f32 {
    let (width, height) = (abs(x), abs(y));
    let steep = height > width;
    let (smaller, larger) = if steep { (width, height) } else { (height, width) };
    // atan a = π/4 + atan((a − 1)/(a + 1))
    let (numerator, denominator, base) = if smaller > TAN_PI_8 * larger {
        (smaller - larger, smaller + larger, FRAC_PI_4)
    } else {
        (smaller, larger, 0.0)
    };
    // At the origin 0 / 0 would be NaN; added to larger numbers the smallest one vanishes.
    let t = numerator / (denominator + f32::MIN_POSITIVE);
    let z = t * t;
    let series = -3.333_295_6e-1 + z * (1.997_792_6e-1 + z * (-1.387_984_5e-1 + z * 8.060_293e-2));
    let mut angle = base + (t + t * z * series);
    if steep {
        angle = FRAC_PI_2 - angle;
    }
    if x.is_sign_negative() {
        angle = PI - angle;
    }
    angle.copysign(y)
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, clippy::float_cmp, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn is_close_to_the_exact_angle_all_around_and_at_all_sizes() {
        let mut worst = 0.0_f64;
        for step in 0..200_000_i32 {
            let angle = f64::from(step) * 3.141_592_7e-5;
            for size in [1e-20, 1e-3, 0.7, 1e18] {
                let (y, x) = ((libm::sin(angle) * size) as f32, (libm::cos(angle) * size) as f32);
                let exact = libm::atan2(f64::from(y), f64::from(x));
                worst = worst.max((f64::from(atan2(y, x)) - exact).abs());
            }
        }
        assert!(worst < 3e-7, "{worst}");
    }

    #[test]
    fn small_angles_keep_their_digits() {
        for y in [1e-30_f32, 1e-9, 3e-5, 0.01] {
            let exact = libm::atan2(f64::from(y), 0.5);
            assert!((f64::from(atan2(y, 0.5)) / exact - 1.0).abs() < 2e-7, "{y}");
        }
    }

    #[test]
    fn axes_and_zeros_are_where_libm_has_them() {
        for (y, x) in
            [(0.0, 1.0), (0.0, -1.0), (-0.0, -1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 0.0), (-0.0, -0.0)]
        {
            assert_eq!(atan2(y, x).to_bits(), libm::atan2f(y, x).to_bits(), "{y} {x}");
        }
        assert!(atan2(f32::NAN, 1.0).is_nan() && atan2(1.0, f32::NAN).is_nan());
    }
}
