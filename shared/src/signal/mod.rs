//! Discrete-time filters with period [`crate::TICK`], and the minimum-jerk motion. One algorithm per file;
//! configuration and state are separate types.

mod minimum_jerk;
mod pseudo_differentiator;
mod rate_limiter;
mod trajectory_filter;

pub use minimum_jerk::minimum_jerk;
pub use pseudo_differentiator::PseudoDifferentiator;
pub use rate_limiter::RateLimiter;
pub use trajectory_filter::{TrajectoryFilter, TrajectoryState};
