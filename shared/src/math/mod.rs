//! The one door to elementary functions, the same bits on every machine.
//!
//! `sin_cos` is this module's own, because libm's single-precision sine works in double precision, which the
//! Cortex-M4F has no hardware for. `atan2` and `sqrt` are for their speed. Everything else is libm's. The methods of `f32` are off limits (they call whatever
//! the platform has; `clippy.toml` bans them), and so is the fused multiply-add.

mod atan2;
mod ldlt;
mod sincos;
mod so3;
mod sqrt;

pub use atan2::atan2;
pub(crate) use ldlt::Ldlt;
pub use sincos::sin_cos;
pub(crate) use so3::{rotated_by, rotation_between};
pub use so3::{rotation_matrix, rotation_vector};
pub use sqrt::sqrt;

/// `e^x`.
#[inline]
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// The nearest whole number; exact below 2²².
#[inline]
pub const fn round(x: f32) -> f32 {
    // Adding and subtracting 1.5·2²³ leaves no bits behind the point.
    const SHIFT: f32 = 12_582_912.0;
    (x + SHIFT) - SHIFT
}

/// `|x|`.
#[inline]
pub const fn abs(x: f32) -> f32 {
    x.abs()
}

/// `x` between `lower` and `upper`; NaN stays NaN. Two comparisons, no call.
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
