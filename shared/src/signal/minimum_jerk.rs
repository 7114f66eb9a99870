/// Peak speed of a minimum-jerk motion over its mean.
pub const MINIMUM_JERK_PEAK: f32 = 1.875;

/// The minimum-jerk motion (Flash and Hogan 1985) from 0 to 1 at `fraction` of its duration: the value and
/// its first two derivatives with respect to `fraction`. Outside 0 … 1 the motion is at rest.
///
/// ```
/// // Half way, at 15/8 of the mean speed.
/// assert_eq!(tesaki::signal::minimum_jerk(0.5), [0.5, tesaki::signal::MINIMUM_JERK_PEAK, 0.0]);
/// // 10 s³ − 15 s⁴ + 6 s⁵ and its derivatives at 1/4.
/// assert_eq!(tesaki::signal::minimum_jerk(0.25), [0.103_515_625, 1.054_687_5, 5.625]);
/// ```
pub const fn minimum_jerk(fraction: f32) -> [f32; 3] {
    let s = crate::math::clamp(fraction, 0.0, 1.0);
    [
        s * s * s * (10.0 + s * (-15.0 + 6.0 * s)),
        30.0 * s * s * (1.0 - s) * (1.0 - s),
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    ]
}
