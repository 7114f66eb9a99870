//! Statics of grasps: the wrench of contact forces on an object, and the contact forces that hold it.
//!
//! - [`object_frame`]: the object's frame from three fingertips; [`ThreeFingers`]: their joints and the
//!   object (Hand3 section 5).
//! - [`GraspMap`] maps forces of up to six [`Contact`]s to the wrench on the object;
//!   [`WrenchInverse`] maps back to the forces of minimum norm, with rank and [`Conditioning`].
//! - [`GraspMap::pairwise`], [`GraspMap::internal_forces`], [`GraspMap::normal_grip`]: internal
//!   forces, in three forms.
//! - [`LeastGrip`]: the smallest forces inside the friction cones that hold a load, or a [`Certificate`] that
//!   the load is infeasible; in one call or over several ticks. [`normal_force_limit`]: maximum normal force
//!   by a finger's joint torques.
//!
//! Forces are those of the fingers on the object. Contacts, wrenches and twists are in one frame.

mod certificate;
mod cone;
mod contact;
mod fingers;
mod frame;
mod grip;
mod internal;
mod inverse;
mod map;
mod normal_force_limit;
mod search;

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::cast_precision_loss, reason = "tests")]
mod tests;

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod grip_tests;

pub use certificate::Certificate;
pub use contact::{Contact, ContactForces, InvalidContact, MAX_CONTACTS};
pub use fingers::{SingularFinger, ThreeFingers};
pub use frame::{ObjectFrameError, object_frame};
pub use grip::{Grip, GripError, GripState, InvalidGripSettings, LeastGrip};
pub use internal::{ContactCountError, InternalForces, NormalGrip, NormalGripError};
pub use inverse::{Conditioning, WrenchInverse, WrenchInverseError};
pub use map::{GraspMap, GraspMapError, GraspMatrix};
pub use normal_force_limit::{NormalForceLimitError, normal_force_limit};
