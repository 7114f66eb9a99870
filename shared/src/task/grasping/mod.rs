//! Grasping: three fingers search for an object, grasp it, hold it under changing loads, move it and put it
//! down (Hand3 sections 5 to 7).
//!
//! ```text
//!                         ┌───────┬────── failure: opens ─────────────────────┐
//!                         │       │                                           ▼
//!  Ready ─► Approach ─► Touch ─► Squeeze ─► ProbeFriction ─► Hold ─► Lower ─► Open ─► Ready
//!                                                            ▲ │
//!                                                            └─┘ Move
//! ```
//!
//! [`GraspState::tick`] is a function of its state and of the measurements of the fingers ([`FingerSense`]).
//! Its outputs are set-points of the joints, and feed-forward torques for the forces on the object
//! ([`HandOutput`]). It runs on a board with all nine joints, or on a PC that commands three boards with a
//! finger each. Both use the same joint servos.
//!
//! Glossary
//! - *object frame*: the paper's frame of the fingertips' triangle
//!   ([`object_frame`](crate::grasp::object_frame)), fixed to the object when it is grasped;
//! - *anchor*: position of a fingertip's centre in the object frame without slip. It moves as the tip rolls;
//! - *load*: the wrench of the fingers on the object, against gravity, pushes and inertia;
//! - *internal forces*: contact forces without a resulting wrench, the null space of the grasp map. Control
//!   is hybrid: position control in the six directions of the object's motion, force control in the three
//!   internal ones.

mod approach;
mod forces;
mod gains;
mod hand;
mod hold;
mod phase;
mod phases;
mod plan;
mod plan_validation;
mod pose;
mod state;
mod task;
mod tracker;
mod tuning;
mod wrench;

#[cfg(test)]
mod plan_tests;

pub use hand::{FingerSense, GraspFinger, GraspHand, HandOutput};
pub use phase::{Failure, GraspFault, GraspRefusal, GraspTelemetry, Phase};
pub use plan::{
    GraspCommand, GraspPlan, InternalForce, InvalidPlan, JointTargets, LoadSource, ObjectControl,
    ObjectFrame, PlanField, PlannedContact, WrenchGains,
};
pub use pose::Frame;
pub use state::GraspState;
pub use task::Grasping;
pub use tuning::ASSUMED_FRICTION;

/// Fingers of a hand that grasps.
pub const FINGERS: usize = 3;

/// A value for each finger.
pub type PerFinger<T> = [T; FINGERS];
