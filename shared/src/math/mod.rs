//! Elementary functions, SO(3) and small solvers, with identical bits on every machine.
//!
//! All elementary functions of the crate are here. The methods of `f32` call the platform's library, so
//! `clippy.toml` bans them, and with them the fused multiply-add.
//!
//! `sin_cos` is implemented here because libm computes the single-precision sine in double precision, for
//! which the Cortex-M4F has no hardware. `atan2` and `sqrt` are implemented here for speed. All other
//! functions are libm's.

mod atan2;
mod ldlt;
mod least_squares;
mod sincos;
mod so3;
mod sqrt;

pub use atan2::atan2;
pub(crate) use ldlt::Ldlt;
pub(crate) use least_squares::{IncrementalQr, Svd};
pub use sincos::sin_cos;
pub(crate) use so3::{rotated_by, rotation_between};
pub use so3::{rotation_matrix, rotation_vector};
pub(crate) use sqrt::finite_sqrt;
pub use sqrt::sqrt;

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

/// `|x|`.
#[inline]
pub const fn abs(x: f32) -> f32 {
    x.abs()
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
