//! Identification of a hand's joints, from what its board tells: torque constants and friction.
//!
//! A joint's torque is `gain · told = weight + load + coulomb · sign(velocity) + viscous · velocity`: `told`
//! is what its drive was told to make (`JointTelemetry::torque`), `load` what the tip's force sensor says by
//! way of the Jacobian, `weight` that of the links by the URDF, with an unknown share for each link. The
//! readings of a joint in motion, free and under load, forth and back, give gain and friction by least
//! squares ([`fit`]); [`identify`] makes the motions. The reference is the force sensor: a gain error of its
//! own is in every torque constant.
//!
//! The result is a [`Calibration`](tesaki_description::calibration::Calibration), a file of the machine, and
//! with it a model for the board. A drive makes a current of torque over `motor.torque_constant` of that
//! model; so from then on it makes the torque that it is told.

mod calibration;
mod procedure;
mod regression;

pub use calibration::{identified, update, with_head};
pub use procedure::{FailedGrip, Identification, IdentifyError, Machine, Sense, Settings, identify};
pub use regression::{Doubt, Estimate, Fit, Reading, fit};
