//! Motions from rest to rest.

/// The minimum-jerk motion (Flash and Hogan 1985) from 0 to 1 at the given `fraction` of its duration: its
/// value and its first and second derivative with respect to the fraction. At rest before 0 and after 1.
pub fn minimum_jerk(fraction: f64) -> [f64; 3] {
    let s = fraction.clamp(0.0, 1.0);
    [
        s * s * s * (10.0 + s * (-15.0 + 6.0 * s)),
        30.0 * s * s * (1.0 - s) * (1.0 - s),
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    ]
}
