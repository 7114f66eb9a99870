//! Cartesian impedance control with redundancy resolution (Arm7, sections 2.1 and 2.2).
//!
//! ```text
//!  set-point ─► target impedance ─► redundancy ─► joint accelerations ─► inverse dynamics ─► torques
//!                   ▲      ▲        resolution      │       ▲
//!     force sensor ─┘      └── reference arm ◄──────┘       │ feedback
//!                                  │ tracking error         │
//!                                  └─► disturbance observer ┘
//! ```
//!
//! [`Law::Direct`] is the paper's loop: the impedance acts on the measured state. Its [`DirectLaw`] selects
//! which of the terms that the paper omits are added. [`Law::ModelFollowing`] adds a *reference arm*:
//! simulated joint angles and velocities that follow the target impedance exactly. The real arm tracks them
//! under a disturbance observer, so that friction and model errors do not change the motion of the tool in
//! free space. During *contact* the reference arm is reset to the measured state: the tool then has the
//! target impedance, and the environment may be stiff.
//!
//! [`ImpedanceState::tick`] is a function of the state and of one measurement.

mod arm;
mod contact;
mod derating;
mod elbow;
mod error;
mod external_torque;
mod redundancy;
mod response;
mod setpoint;
mod settings;
mod state;
mod task;
mod telemetry;
mod tuning;

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    clippy::cast_precision_loss,
    clippy::float_cmp,
    reason = "tests"
)]
pub(crate) mod tests;

pub use arm::{Arm, ArmMeasurement, ArmOutput};
pub use contact::own_mass;
pub use elbow::ArmAngle;
pub use error::{ImpedanceRefusal, SetpointError};
pub use settings::{DirectLaw, ForceSource, ImpedanceSettings, InvalidImpedanceSettings, Law, Redundancy};
pub use state::ImpedanceState;
pub use task::{ImpedanceCommand, ImpedanceControl};
pub use telemetry::ImpedanceTelemetry;
