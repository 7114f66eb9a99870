/// `√x` within one unit in the last place; NaN for negative `x` and NaN. Not for subnormal numbers, whose
/// root is tiny but inexact.
///
/// An approximate `1/√x` from the exponent, two Newton steps, and one for the root itself. The processor's
/// own instruction is not available in stable Rust, and libm's function takes three times as many
/// instructions.
///
/// ```
/// assert_eq!(tesaki::math::sqrt(2.25), 1.5);
/// ```
// Not inlined on the microcontroller, where all its places take 10 KB of flash.
#[cfg_attr(target_os = "none", inline(never))]
#[cfg_attr(not(target_os = "none"), inline)]
pub fn sqrt(x: f32) -> f32 {
    inlined_sqrt(x)
}

/// The same, for places where a call takes too long.
#[inline(always)]
pub(crate) fn inlined_sqrt(x: f32) -> f32 {
    // One comparison: the bits of negative and non-finite numbers are larger than those of every positive
    // number.
    if x.to_bits() >= f32::INFINITY.to_bits() {
        // Infinity and -0 are their own roots.
        return if x >= 0.0 { x } else { f32::NAN };
    }
    finite_sqrt(x)
}

/// The same for arguments that are known to be finite and not negative: without a branch, so that the
/// compiler can vectorise it.
#[inline]
pub(crate) fn finite_sqrt(x: f32) -> f32 {
    // Halves and negates the exponent. The constants of this and the next line minimise the largest error
    // after that line over all x (Walczyk, Moroz and Cieśliński 2021).
    let y = f32::from_bits(0x5f1f_fff9_u32.wrapping_sub(x.to_bits() >> 1));
    let y = y * (1.681_912_4 - 0.703_952_25 * x * y * y);
    let y = y * (1.5 - 0.5 * x * y * y);
    let root = x * y;
    root + 0.5 * y * (x - root * root)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_within_one_unit_in_the_last_place_over_all_exponents() {
        let mut worst = 0;
        for bits in (f32::MIN_POSITIVE.to_bits()..f32::MAX.to_bits()).step_by(997) {
            let x = f32::from_bits(bits);
            let (own, exact) = (sqrt(x), libm::sqrtf(x));
            worst = worst.max(own.to_bits().abs_diff(exact.to_bits()));
        }
        assert!(worst <= 1, "{worst} units");
    }

    #[test]
    fn zero_squares_and_what_has_no_root() {
        for whole in 0..2048_u16 {
            let whole = f32::from(whole);
            assert!((sqrt(whole * whole) - whole).abs() <= whole * f32::EPSILON);
        }
        assert!(
            sqrt(0.0) == 0.0
                && sqrt(f32::INFINITY) == f32::INFINITY
                && sqrt(-1.0).is_nan()
                && sqrt(f32::NAN).is_nan()
        );
        assert!(sqrt(1e-40) < 2e-20);
    }
}
