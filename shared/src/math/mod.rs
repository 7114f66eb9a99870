//! The one door to elementary functions, the same bits on every machine.
//!
//! `sin_cos` is this module's own, because libm's single-precision sine works in double precision, which the
//! Cortex-M4F has no hardware for. Everything else is libm's. The methods of `f32` are off limits (they call whatever
//! the platform has; `clippy.toml` bans them), and so is the fused multiply-add.

mod sincos;

pub use sincos::sin_cos;

/// `√x`; NaN for negative `x`.
#[inline]
pub fn sqrt(x: f32) -> f32 {
    libm::sqrtf(x)
}

/// The angle of the point `(x, y)` [rad], −π to π.
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}

/// `e^x`.
#[inline]
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
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
