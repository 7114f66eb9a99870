//! Kinematics of serial chains: forward, differential and inverse.
//!
//! - [`Chain::posture`] is the forward kinematics; the [`Posture`] gives Jacobian and bias acceleration.
//! - [`Finger`] has the closed-form inverse of a three-joint finger, with all branches.
//! - [`InverseKinematics`] is an iterative solver for any chain, to a position or a pose, within limits.
//! - [`Hand`] solves all fingers of a hand together, with a joint that several of them share.
//!
//! Frames: the base frame of the chain, which is that of the robot. Velocities and accelerations of six
//! components are `[v; ω]` of the tip's point, linear first, in base axes.

mod chain;
mod finger;
mod hand;
mod hand_inverse;
mod hand_search;
mod hand_step;
mod inverse;
mod posture;
mod random_starts;
mod setpoint;

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests;

pub(crate) use chain::Link;
pub use chain::{Chain, InvalidChain};
pub use finger::{Finger, FingerError, FingerShapeError, FingerSolutions};
pub use hand::{Angles, FingerDescription, Hand, InvalidHand, MAX_FINGERS};
pub use hand_inverse::{FingertipTarget, FingertipTargets, HandOptions, HandReport};
pub use inverse::{
    InvalidJoint, InverseKinematics, InverseKinematicsError, SolveReport, SolverOptions, Target,
};
pub use posture::{Jacobian, Posture, TipPoint};
pub(crate) use setpoint::COAST_TIME;
pub use setpoint::{ElbowSetpoint, PosePoint};
