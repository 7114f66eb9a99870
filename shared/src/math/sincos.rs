use core::f32::consts::FRAC_2_PI;

/// Beyond this the three-part π/2 no longer reduces exactly; the reduction of Payne and Hanek takes over
/// [rad].
const FAST_RANGE: f32 = 8192.0;

/// π/2 in three parts with at most 11 significant bits in the first two, so that `k · part` is exact for
/// `|k| < 2¹³`; the last holds what remains.
const PI_2_HIGH: f32 = 1.570_312_5;
const PI_2_MIDDLE: f32 = 4.837_513e-4;
const PI_2_LOW: f32 = 7.549_79e-8;

/// Adding and subtracting 1.5·2²³ rounds to the nearest integer.
const ROUND: f32 = 12_582_912.0;

/// Sine and cosine of `x` [rad], within 1.2e-7 of the exact values; NaN for a non-finite `x`.
///
/// The argument is reduced to ±π/4 by multiples of π/2, where two minimax polynomials take over (`Cephes`'
/// `sinf`/`cosf` coefficients). Identical bits on every IEEE machine: no fused operation, no table.
///
/// ```
/// let (s, c) = tesaki::math::sin_cos(0.5);
/// assert!((s - 0.479_425_54).abs() < 1e-7 && (c - 0.877_582_56).abs() < 1e-7);
/// ```
#[cfg_attr(target_os = "none", inline(never))]
#[cfg_attr(not(target_os = "none"), inline)]
pub fn sin_cos(x: f32) -> (f32, f32) {
    inlined_sin_cos(x)
}

/// The same, for places where a call takes too long.
#[inline(always)]
pub(crate) fn inlined_sin_cos(x: f32) -> (f32, f32) {
    // False for NaN, too.
    if !(x > -FAST_RANGE && x < FAST_RANGE) {
        return slow(x);
    }
    let rounded = x * FRAC_2_PI + ROUND;
    let quadrant = rounded.to_bits();
    let k = rounded - ROUND;
    let r = ((x - k * PI_2_HIGH) - k * PI_2_MIDDLE) - k * PI_2_LOW;
    of_reduced(r, quadrant)
}

/// Sine and cosine of `r`, within ±π/4, plus `quadrant` quarter turns.
#[inline(always)]
fn of_reduced(r: f32, quadrant: u32) -> (f32, f32) {
    let r2 = r * r;
    let sine = r + r * r2 * (-1.666_665_5e-1 + r2 * (8.332_161e-3 + r2 * -1.951_529_6e-4));
    let cosine = 1.0 - 0.5 * r2 + r2 * r2 * (4.166_664_6e-2 + r2 * (-1.388_731_6e-3 + r2 * 2.443_315_7e-5));
    let (s, c) = if quadrant & 1 == 0 { (sine, cosine) } else { (cosine, sine) };
    // Quadrants 2 and 3 negate the sine, 1 and 2 the cosine: flip the sign bit.
    let s_sign = (quadrant & 2) << 30;
    let c_sign = (quadrant.wrapping_add(1) & 2) << 30;
    (f32::from_bits(s.to_bits() ^ s_sign), f32::from_bits(c.to_bits() ^ c_sign))
}

/// The binary digits of 2/π, after 32 zeros.
const TWO_OVER_PI: [u32; 7] =
    [0, 0xA2F9_836E, 0x4E44_1529, 0xFC27_57D1, 0xF534_DDC0, 0xDB62_9599, 0x3C43_9041];

/// Sine and cosine of a large `x` [rad], by the reduction of Payne and Hanek (1983): of the product of its
/// mantissa and 2/π only the digits of the last quarter turns and those after the point are computed.
#[cold]
#[inline(never)]
fn slow(x: f32) -> (f32, f32) {
    if !x.is_finite() {
        return (f32::NAN, f32::NAN);
    }
    let bits = x.to_bits();
    let mantissa = bits & 0x7F_FFFF | 0x80_0000;
    // |x| = mantissa · 2^(exponent − 150). The digits of 2/π before `first` contribute only full turns.
    let first = (bits >> 23 & 0xFF) - 120;
    let word = |index: u32| u64::from(TWO_OVER_PI.get(index as usize).copied().unwrap_or(0));
    let (index, shift) = (first / 32, first % 32);
    let window = (word(index) << 32 | word(index + 1)) << shift | (word(index + 2) << shift >> 32);
    // Quarter turns modulo 4, with 62 binary digits after the point.
    let turns = u64::from(mantissa).wrapping_mul(window);
    let quadrant = turns.wrapping_add(1 << 61) >> 62;
    let rest = turns.wrapping_sub(quadrant << 62).cast_signed();
    #[expect(clippy::cast_precision_loss, reason = "24 of 32 digits are enough")]
    let r = (rest >> 32) as i32 as f32 * (core::f32::consts::FRAC_PI_2 / (1 << 30) as f32);
    let (s, c) = of_reduced(r, quadrant as u32);
    (if x < 0.0 { -s } else { s }, c)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worst(values: impl Iterator<Item = f32>) -> f64 {
        values
            .map(|x| {
                let (s, c) = sin_cos(x);
                let exact = f64::from(x);
                (f64::from(s) - libm::sin(exact)).abs().max((f64::from(c) - libm::cos(exact)).abs())
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn is_within_its_stated_error_of_double_precision() {
        // Every 97th float from the smallest up to the end of the fast range, and its mirror image.
        let fast = (0..FAST_RANGE.to_bits()).step_by(97).map(f32::from_bits);
        assert!(worst(fast.clone()) < 1.2e-7, "{}", worst(fast));
        let mirrored = (0..FAST_RANGE.to_bits()).step_by(9973).map(|bits| -f32::from_bits(bits));
        assert!(worst(mirrored) < 1.2e-7);
        // Large arguments, up to the largest float.
        let large = (FAST_RANGE.to_bits()..f32::MAX.to_bits()).step_by(9973).map(f32::from_bits);
        assert!(worst(large) < 1.2e-7);
    }

    #[test]
    fn keeps_the_values_that_people_expect() {
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        let (s, c) = sin_cos(f32::NAN);
        assert!(s.is_nan() && c.is_nan());
        assert!(sin_cos(f32::INFINITY).0.is_nan());
    }
}
