//! Motions from rest to rest.

/// The minimum-jerk motion (Flash and Hogan 1985) from 0 to 1 at `share` of its time, 0 to 1: its value, and
/// its first and second derivative by the share. Before and after it stands still.
pub fn minimum_jerk(share: f64) -> [f64; 3] {
    let s = share.clamp(0.0, 1.0);
    [
        s * s * s * (10.0 + s * (-15.0 + 6.0 * s)),
        30.0 * s * s * (1.0 - s) * (1.0 - s),
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    ]
}
