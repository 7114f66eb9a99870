//! Elementary functions, SO(3), SE(3) and small solvers, with identical bits on every machine.
//!
//! The elementary functions of the crate are here, except those in nalgebra's constructors and norms, which
//! are libm's as well (its feature `libm-force`). The methods of `f32` call the platform's library, so
//! `clippy.toml` bans them, and with them the fused multiply-add.
//!
//! `sin_cos` is implemented here because libm computes the single-precision sine in double precision, for
//! which the Cortex-M4F has no hardware. `atan2` and `sqrt` are implemented here for speed. All other
//! functions are libm's.

use nalgebra::{Dim, Matrix3, Storage, Vector};

mod atan2;
mod eigen;
mod ldlt;
mod least_squares;
mod se3;
mod sincos;
mod so3;
mod sqrt;

pub use atan2::atan2;
pub(crate) use atan2::inlined_atan2;
pub(crate) use eigen::diagonalize;
pub(crate) use ldlt::Ldlt;
pub(crate) use least_squares::{IncrementalQr, Svd};
pub(crate) use se3::{displacement, halves, stack};
pub(crate) use sincos::inlined_sin_cos;
pub use sincos::sin_cos;
pub(crate) use so3::{orientation, quaternion, rotated_by, rotation_between};
pub use so3::{rotation_matrix, rotation_vector};
pub use sqrt::sqrt;
pub(crate) use sqrt::{finite_sqrt, inlined_sqrt};

/// `e^x`.
#[inline]
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// The nearest integer; exact below 2²².
#[inline]
pub const fn round(x: f32) -> f32 {
    // Adding and subtracting 1.5·2²³ clears all fraction bits.
    const SHIFT: f32 = 12_582_912.0;
    (x + SHIFT) - SHIFT
}

/// Euclidean norm.
#[inline(always)]
pub(crate) fn norm<D: Dim, S: Storage<f32, D>>(vector: &Vector<f32, D, S>) -> f32 {
    sqrt(vector.norm_squared())
}

/// `a b`, as nalgebra's product to the last bit, but without a call.
#[inline(always)]
pub(crate) fn product(a: &Matrix3<f32>, b: &Matrix3<f32>) -> Matrix3<f32> {
    Matrix3::new(
        a.m11 * b.m11 + a.m12 * b.m21 + a.m13 * b.m31,
        a.m11 * b.m12 + a.m12 * b.m22 + a.m13 * b.m32,
        a.m11 * b.m13 + a.m12 * b.m23 + a.m13 * b.m33,
        a.m21 * b.m11 + a.m22 * b.m21 + a.m23 * b.m31,
        a.m21 * b.m12 + a.m22 * b.m22 + a.m23 * b.m32,
        a.m21 * b.m13 + a.m22 * b.m23 + a.m23 * b.m33,
        a.m31 * b.m11 + a.m32 * b.m21 + a.m33 * b.m31,
        a.m31 * b.m12 + a.m32 * b.m22 + a.m33 * b.m32,
        a.m31 * b.m13 + a.m32 * b.m23 + a.m33 * b.m33,
    )
}

/// `|x|`.
#[inline]
pub const fn abs(x: f32) -> f32 {
    x.abs()
}

/// The larger one; `a` if they do not compare. A comparison, where [`f32::max`] is a call.
#[inline]
pub const fn max(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// The smaller one; `a` if they do not compare.
#[inline]
pub const fn min(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

/// Limits `x` to `lower` … `upper`; NaN stays NaN. Two comparisons, no call.
#[inline]
pub const fn clamp(x: f32, lower: f32, upper: f32) -> f32 {
    if x < lower {
        lower
    } else if x > upper {
        upper
    } else {
        x
    }
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, clippy::float_cmp, reason = "tests")]
mod tests {
    use tesaki_rng::Rng;

    use super::*;

    #[test]
    fn the_product_has_the_bits_of_nalgebras() {
        let mut rng = Rng::new(1, 0);
        let mut matrix = || Matrix3::from_fn(|_, _| 3.0 * rng.symmetric() as f32);
        for _ in 0..1000 {
            let (a, b) = (matrix(), matrix());
            assert_eq!(product(&a, &b).map(f32::to_bits), (a * b).map(f32::to_bits));
        }
    }

    #[test]
    fn the_first_argument_remains_if_they_do_not_compare() {
        assert_eq!((max(1.0, 2.0), min(1.0, 2.0), max(2.0, 1.0), min(2.0, 1.0)), (2.0, 1.0, 2.0, 1.0));
        assert_eq!((max(0.0, f32::NAN), min(0.0, f32::NAN)), (0.0, 0.0));
        assert!(max(f32::NAN, 0.0).is_nan() && min(f32::NAN, 0.0).is_nan());
    }
}
