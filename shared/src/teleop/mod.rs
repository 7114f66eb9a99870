//! Unilateral master-slave control of an arm over a link with delay, reordering and loss (Arm7 sections 2.2
//! and 3.2).
//!
//! ```text
//!  samples with        ┌─ estimate of the hand ─► prediction ─► offset of ─► limits of ──► PosePoint
//!  time stamps ───────►│  (late, shuffled,        to now        the clutch   speed and     ElbowSetpoint
//!  (pose; elbow)       └─  or none at all)                                   acceleration   each tick
//! ```
//!
//! The paper uses the master's pose as equilibrium of the slave's impedance (`X₀ = X_M`), so damping and link
//! delay cause a lag in proportion to the hand's speed. Here the set-point is the *predicted* present pose
//! with velocity and acceleration, so that the impedance acts on the error only and can be as soft as contact
//! requires.
//!
//! - [`OperatorModel`]: the prior model of the operator. The jerk is a random walk; physiological tremor at 8
//!   to 12 Hz is estimated separately and not followed.
//! - [`Follower`] is the configuration, [`FollowerState`] the state. Samples arrive at any time
//!   ([`Follower::add_sample`], [`Follower::add_elbow_sample`]); [`Follower::tick`] returns the set-points
//!   once per control period. Time is passed in.
//! - Clutch: [`Follower::close_clutch`] stores the offset between hand and tool, so that the set-point does
//!   not jump; [`Follower::open_clutch`] stops the tool and decouples the hand. The clutch is open initially.
//!   Motion is transferred in the axes of the base. The elbow has its own offset.
//! - No sample can move the set-point faster than its limits. A sample whose innovation exceeds
//!   `max_innovation` is rejected with a typed error. If all samples are rejected, open the clutch and close
//!   it again.
//! - Without samples the prediction comes to rest.
//!
//! [`Retargeting`] maps an operator's fingertips to a robot hand (Hand5).
//!
//! With force feedback, a [`PowerPort`] at each end keeps the link passive. [`MatchedImpedance`] is the
//! bilateral control that the paper proposes as future work.
//!
//! # The operator's fingers
//!
//! ```text
//!  16 orientations ─► GloveFilter ─► HumanHand ─► fingertips: position, direction, velocity
//!  postures, markers ► HandCalibration ► links ──┘
//! ```
//!
//! [`HumanHand`] computes the fingertips in the frame of the back of the hand from absolute orientations
//! (Hand5 section 2.1); [`HandCalibration`] estimates the links from markers on the tips.
//!
//! # An example
//!
//! ```
//! use tesaki::teleop::{Follower, FollowerSettings, FollowerState, Instant, MasterSample};
//! let follower = Follower::try_new(FollowerSettings::HUMAN)?;
//! // The tool rests at the origin.
//! let mut state = FollowerState::at([0.0; 3], [0.0, 0.0, 0.0, 1.0], 0.0);
//! let mut point = None;
//! for millisecond in 0..2000 {
//!     let now = Instant(1000 * millisecond);
//!     // A hand at x = 0.5 m, from 1 s on at 0.1 m/s; 250 samples per second arrive 20 ms late.
//!     if millisecond % 4 == 0 && millisecond >= 20 {
//!         let time = 1e-3 * (millisecond as f32 - 20.0);
//!         let position = [0.5 + 0.1 * (time - 1.0).max(0.0), 0.0, 0.0];
//!         let time = Instant(1000 * (millisecond - 20));
//!         let sample = MasterSample { time, position, rotation: [0.0, 0.0, 0.0, 1.0] };
//!         follower.add_sample(&mut state, now, &sample)?;
//!     }
//!     if millisecond == 500 {
//!         follower.close_clutch(&mut state, now)?;
//!     }
//!     if millisecond % 10 == 0 {
//!         point = Some(follower.tick(&mut state, now).0);
//!     }
//! }
//! // By 1.99 s the hand has moved 99 mm.
//! assert!((point.unwrap().position[0] - 0.099).abs() < 1e-4);
//! # Ok::<(), Box<dyn core::error::Error>>(())
//! ```

mod anatomy;
mod calibration;
mod calibration_error;
mod error;
mod follower;
mod hand_calibration;
mod human_hand;
mod joint_movements;
mod matched;
mod operator_estimate;
mod passivity;
mod retarget;
mod retarget_settings;
mod workspace;

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "tests"
)]
mod tests;

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "tests"
)]
mod calibration_tests;

pub use calibration::{
    CalibrationAccuracy, CalibrationSettings, FingerCalibration, LinkPrior, MAX_TIP_DEVIATION,
};
pub use calibration_error::{CalibrationError, FingerMovement, Movement};
pub use error::FollowerError;
pub use follower::{Follower, FollowerSettings, FollowerState, Instant, MasterSample};
pub use hand_calibration::HandCalibration;
pub use human_hand::{
    FingerLinks, FingerRotations, Fingertip, GloveError, GloveFilter, GloveFilterState, GloveSample,
    GloveSensor, HUMAN_FINGERS, HumanFinger, HumanHand, InvalidLink, SENSORS,
};
pub use matched::{MatchedImpedance, UnsuitableImpedance};
pub use operator_estimate::OperatorModel;
pub use passivity::{PowerPort, PowerPortLimits, UnsuitableLink};
pub use retarget::{InvalidFingertip, OperatorFingertips, RetargetReport, RetargetState, Retargeting};
pub(crate) use retarget::{MAX_COORDINATE, is_near, is_unit};
pub use retarget_settings::{RetargetField, RetargetSettings};
pub use workspace::Workspace;
