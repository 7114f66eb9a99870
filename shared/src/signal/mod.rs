//! Discrete filters of one value, period [`crate::TICK`]. One algorithm a file; configuration and state apart.

mod pseudo_differentiator;
mod rate_limiter;
mod trajectory_filter;

pub use pseudo_differentiator::PseudoDifferentiator;
pub use rate_limiter::RateLimiter;
pub use trajectory_filter::{TrajectoryFilter, TrajectoryState};
