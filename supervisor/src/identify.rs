//! Identification of torque constants and friction of a hand's joints from its telemetry.
//!
//! The torque of a joint is `gain · commanded = weight + load + coulomb · sign(velocity) + viscous ·
//! velocity`: `commanded` is the torque sent to the drive (`JointTelemetry::torque`), `load` the measured tip
//! wrench mapped through the Jacobian, `weight` the weight of the links according to the URDF, with an
//! unknown factor for each link. Gain and friction are found by least squares from readings of the joint in
//! motion, free and under load, in both directions ([`fit`]); [`identify`] makes the motions. The reference
//! is the force sensor: its gain error appears in every torque constant.
//!
//! The result is a [`Calibration`](tesaki_description::calibration::Calibration), a file of the machine,
//! which yields a model for the board. A drive sets its current to the torque divided by
//! `motor.torque_constant` of that model, so with the calibrated value it makes the commanded torque.
//!
//! Without an object only the weight of the links loads a joint. [`identify_joints`] moves the joints of any
//! robot without an object, and [`fit_free`] finds their friction in commanded torque, which is what a
//! feed-forward needs; if the masses in the URDF were weighed, [`fit_gain`] finds the torque constant, too.

mod calibration;
mod joints;
mod procedure;
mod regression;
mod sweep;

pub use calibration::{
    FreeJoint, board_in_head, identified, identified_free, update, update_free, with_head,
};
pub use joints::{JointSettings, duration, identify_joints};
pub use procedure::{FailedGrip, Identification, IdentifyError, Machine, Sense, Settings, identify};
pub use regression::{Estimate, Fit, FreeFit, NotIdentified, Reading, fit, fit_free, fit_gain};
