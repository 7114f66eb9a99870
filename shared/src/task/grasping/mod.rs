//! An object in the hand: three fingers find it, grasp it, hold it under changing loads, move it and put it down (Hand3,
//! sections 5 to 7).
//!
//! ```text
//!            ┌────────────── failure: opens ──────────────┐
//!  Ready ─► Approach ─► Touch ─► Squeeze ─► Feel ─► Hold ─► Lower ─► Open ─► Ready
//!                                                   ▲ │
//!                                                   └─┘ Move
//! ```
//!
//! [`GraspState::tick`] is a function of its state and of what the fingers sense ([`FingerSense`]); it says where each joint
//! is to be and which torque it is to add for the forces on the object ([`HandOutput`]). It runs on the board that has
//! all nine joints, or on a PC over three boards with a finger each: the joint servos under it are the same.
//!
//! Glossary
//! - *object frame*: the paper's frame of the three fingertips' triangle ([`object_frame`](crate::grasp::object_frame)),
//!   fixed to the object when it is grasped;
//! - *anchor*: where the middle of a fingertip belongs in the object frame. It moves as the fingertip rolls;
//! - *load*: the wrench that the fingers have to make on the object, against weight, pushes and inertia;
//! - *internal forces*: those that move nothing. Positions are controlled in the six directions in which the object moves,
//!   forces in the three in which it does not.

mod approach;
mod forces;
mod hand;
mod hold;
mod phase;
mod phases;
mod plan;
mod pose;
mod state;
mod task;
mod tracker;
mod wrench;

pub use hand::{FingerSense, Hand, HandFinger, HandOutput};
pub use phase::{Failure, GraspFault, GraspRefusal, GraspTelemetry, Phase};
pub use plan::{
    GraspCommand, GraspPlan, InternalForce, InvalidPlan, ObjectControl, PlanField, PlannedContact,
    WrenchGains,
};
pub use pose::Frame;
pub use state::GraspState;
pub use task::Grasping;

/// Fingers of a hand that grasps.
pub const FINGERS: usize = 3;

/// A value for each finger.
pub type PerFinger<T> = [T; FINGERS];
