//! Rigid-body dynamics of serial chains: `τ = M(q) q̈ + h(q, q̇) − Jᵀ F`.
//!
//! - [`Chain::inverse_dynamics`] gives `τ` by the recursive Newton–Euler algorithm, also
//!   [with a wrench](Chain::inverse_dynamics_with_wrench) `F` of the world on the tip; without accelerations
//!   it gives `h`, the centrifugal, Coriolis and gravity torques;
//! - [`Chain::mass_matrix`] gives `M`;
//! - [`Posture::bias_acceleration`] gives `J̇ q̇` of `ẍ = J q̈ + J̇ q̇`.
//!
//! `M` and `τ` include the rotors' reflected inertia if the chain has it, but not friction: see
//! [`FrictionFeedforward`](crate::control::FrictionFeedforward).

mod mass_matrix;
mod newton_euler;

#[cfg(test)]
#[allow(clippy::indexing_slicing, clippy::float_cmp, reason = "tests, some of the very bits")]
mod tests;

pub use mass_matrix::MassMatrix;

#[cfg(doc)]
use crate::kinematics::{Chain, Posture};
