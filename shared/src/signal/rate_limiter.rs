use crate::{TICK, math};

/// Limits the change of a value to `rate · T` per tick.
#[derive(Clone, Copy, Debug)]
pub struct RateLimiter {
    step: f32,
}

impl RateLimiter {
    /// Limits the change to `rate` per second, which must be positive.
    pub const fn new(rate: f32) -> Self {
        Self { step: rate * TICK }
    }

    /// The value nearest to `target` within the rate limit from `last`.
    ///
    /// ```
    /// let limiter = tesaki::signal::RateLimiter::new(10.0);
    /// assert!((limiter.limit(0.0, 1.0) - 0.1).abs() < 1e-7);
    /// assert_eq!(limiter.limit(0.0, 0.0625), 0.0625);
    /// ```
    #[inline]
    pub const fn limit(&self, last: f32, target: f32) -> f32 {
        math::clamp(target, last - self.step, last + self.step)
    }
}
