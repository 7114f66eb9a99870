//! Discrete-time filters with period [`crate::TICK`], the minimum-jerk motion, and motion within limits. One
//! algorithm per file; configuration and state are separate types.

mod minimum_jerk;
mod motion_limits;
mod pseudo_differentiator;
mod rate_limiter;
mod trajectory_filter;

pub use minimum_jerk::{MINIMUM_JERK_PEAK, minimum_jerk};
pub use motion_limits::MotionLimits;
pub(crate) use motion_limits::MotionTarget;
pub use pseudo_differentiator::PseudoDifferentiator;
pub use rate_limiter::RateLimiter;
pub use trajectory_filter::{TrajectoryFilter, TrajectoryState};
