//! An arm that yields at its tool as it is told: impedance control of the pose, and what becomes of the elbow (Arm7,
//! sections 2.1 and 2.2).
//!
//! ```text
//!  set-point ─► target impedance ─► accelerations of the joints ─► Newton–Euler ─► torques
//!                   ▲      ▲           of an ideal arm ▲  │
//!     force sensor ─┘      └── its own state ◄────────────┘──► observer of the difference to the real one
//! ```
//!
//! [`Law::Direct`] is the paper's loop: the state is the measured one. [`Law::ModelFollowing`] carries an *ideal arm* along,
//! a state of joint angles and velocities that moves exactly as the target impedance says, and the real arm follows it
//! under an observer of the disturbances, so that neither friction nor a wrong model change how the tool moves. While
//! something pushes the tool, the ideal arm is where the real one is (*contact*): then the tool is as soft as it was asked
//! to be, and what it touches may be hard.
//!
//! [`ImpedanceState::tick`] is a function of its state and of what the arm senses.

mod elbow;
mod error;
mod momentum;
mod redundancy;
mod settings;
mod state;
mod task;

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    clippy::cast_precision_loss,
    clippy::float_cmp,
    reason = "tests"
)]
pub(crate) mod tests;

pub use elbow::ArmAngle;
pub use error::{ImpedanceRefusal, SetpointError};
pub use settings::{ForceSource, ImpedanceSettings, InvalidSettings, Law, Redundancy};
pub use state::{Arm, ArmOutput, ArmSense, ImpedanceState, ImpedanceTelemetry};
pub use task::{ImpedanceCommand, ImpedanceControl};
