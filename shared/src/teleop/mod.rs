//! A slave arm follows a master's hand over a link that delays, shuffles and loses (Arm7, sections 2.2 and
//! 3.2: unilateral master-slave).
//!
//! ```text
//!  samples with        ┌─ estimate of the hand ─► prediction ─► offset of ─► limits of ──► PosePoint
//!  time stamps ───────►│  (late, shuffled,        to now        the clutch   speed and     ElbowPoint
//!  (pose; elbow)       └─  or none at all)                                   acceleration   each tick
//! ```
//!
//! The paper puts the master's pose into the slave's impedance (`X₀ = X_M`): damping and link then hold the
//! tool back by their time times the hand's speed. Here the set-point carries where the hand is *now*, its
//! velocity and its acceleration, so that mass, damping and stiffness of the slave act on the error alone and
//! may be as soft as contact wants them.
//!
//! - [`OperatorModel`]: what is known of a hand beforehand. Its jerk wanders; on top of it the hand trembles
//!   at 8 to 12 Hz, which is told apart and not followed.
//! - [`Follower`] is the configuration, [`FollowerState`] what changes. Samples come when they come
//!   ([`Follower::add_sample`], [`Follower::add_elbow_sample`]), set-points leave each control period
//!   ([`Follower::tick`]). Time is passed in.
//! - The clutch: [`Follower::close_clutch`] takes the offset between hand and tool as they are, so that
//!   nothing jumps; [`Follower::open_clutch`] lets the tool come to rest, and the hand is free. A state
//!   begins with an open clutch. Translations and rotations are followed in the axes of the base: turned
//!   about the vertical, the hand turns the tool about the vertical, however the one is held against the
//!   other. The elbow has an offset too.
//! - No sample, however wrong, makes the set-point faster than its limits. One that is farther from where the
//!   hand should be than a hand can get is refused by name. If all are, then the hand is elsewhere: open the
//!   clutch, and close it again.
//! - While samples stay away the prediction comes to rest.
//!
//! Where the hand is to feel what the arm touches, a [`PowerPort`] at each end keeps the link from making
//! energy.
//!
//! ```
//! use tesaki::teleop::{Follower, FollowerSettings, FollowerState, Instant, MasterSample};
//! let follower = Follower::try_new(FollowerSettings::HUMAN)?;
//! // The tool stands in the origin.
//! let mut state = FollowerState::at([0.0; 3], [0.0, 0.0, 0.0, 1.0], 0.0);
//! let mut point = None;
//! for millisecond in 0..2000 {
//!     let now = Instant(1000 * millisecond);
//!     // A hand at x = 0.5 m, from 1 s on at 0.1 m/s; 240 samples a second come 20 ms late.
//!     if millisecond % 4 == 0 && millisecond >= 20 {
//!         let time = 1e-3 * (millisecond as f32 - 20.0);
//!         let position = [0.5 + 0.1 * (time - 1.0).max(0.0), 0.0, 0.0];
//!         let sample = MasterSample { time: Instant(1000 * (millisecond - 20)), position, rotation: [0.0, 0.0, 0.0, 1.0] };
//!         follower.add_sample(&mut state, now, &sample)?;
//!     }
//!     if millisecond == 500 {
//!         follower.close_clutch(&mut state, now)?;
//!     }
//!     if millisecond % 10 == 0 {
//!         point = Some(follower.tick(&mut state, now).0);
//!     }
//! }
//! // At 1.99 s the hand went 99 mm.
//! assert!((point.unwrap().position[0] - 0.099).abs() < 1e-4);
//! # Ok::<(), Box<dyn core::error::Error>>(())
//! ```

mod error;
mod follower;
mod motion_limits;
mod operator_estimate;
mod passivity;

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "tests"
)]
mod tests;

pub use error::{FollowerError, InvalidFollowerSettings};
pub use follower::{Follower, FollowerSettings, FollowerState, Instant, MasterSample};
pub use motion_limits::MotionLimits;
pub use operator_estimate::OperatorModel;
pub use passivity::{PowerPort, PowerPortLimits};
