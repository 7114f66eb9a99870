//! Discrete filters of one value, period [`crate::TICK`], and the shape of motions. One algorithm a file; configuration
//! and state apart.

mod minimum_jerk;
mod pseudo_differentiator;
mod rate_limiter;
mod trajectory_filter;

pub use minimum_jerk::minimum_jerk;
pub use pseudo_differentiator::PseudoDifferentiator;
pub use rate_limiter::RateLimiter;
pub use trajectory_filter::{TrajectoryFilter, TrajectoryState};
