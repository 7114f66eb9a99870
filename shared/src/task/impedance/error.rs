use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::InvalidImpedanceSettings;
use crate::robot::Concerns;

/// Why a set-point is refused, or why the control stops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SetpointError {
    /// 0: the tool is too far from the set-point [m].
    Distance {
        /// The distance.
        value: f32,
        /// The limit.
        limit: f32,
    },
    /// 1: the tool is rotated too far from the set-point [rad].
    Rotation {
        /// The angle.
        value: f32,
        /// The limit.
        limit: f32,
    },
    /// 2: a number is not finite.
    NotFinite,
    /// 3: the orientation is not a unit quaternion.
    NotUnit {
        /// Its norm.
        norm: f32,
    },
    /// 4: the elbow set-point is too far from the elbow [rad].
    Elbow {
        /// The angle between them.
        value: f32,
        /// The limit.
        limit: f32,
    },
}

/// Why impedance control refuses a request.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImpedanceRefusal {
    /// 0: the robot is not a single chain of six or seven joints, each with a motor.
    NotAnArm,
    /// 1: the force sensor was not tared since power-on, `Home` or the commit of the model.
    NotTared {
        /// Index of the chain.
        chain: u8,
    },
    /// 2: the settings require a force sensor, and the robot has none.
    NoForceSensor,
    /// 3: the force source cannot change while the arm is enabled.
    ForceSourceInUse,
    /// 4: the settings are invalid.
    Settings(InvalidImpedanceSettings),
    /// 5: the set-point is invalid.
    Setpoint(SetpointError),
}

impl Concerns for ImpedanceRefusal {
    fn chain(&self) -> Option<u8> {
        if let Self::NotTared { chain } = self { Some(*chain) } else { None }
    }
}

impl fmt::Display for SetpointError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Distance { value, limit } => {
                write!(f, "the set-point is {value} m from the tool; at most {limit} m is allowed")
            }
            Self::Rotation { value, limit } => write!(
                f,
                "the set-point is rotated by {value} rad from the tool; at most {limit} rad is allowed"
            ),
            Self::NotFinite => f.write_str("a number of the set-point is not finite"),
            Self::NotUnit { norm } => {
                write!(f, "the orientation of the set-point is a quaternion of norm {norm}; it must be 1")
            }
            Self::Elbow { value, limit } => {
                write!(f, "the elbow set-point is {value} rad from the elbow; at most {limit} rad is allowed")
            }
        }
    }
}

impl core::error::Error for SetpointError {}

impl fmt::Display for ImpedanceRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAnArm => f.write_str("the robot is not an arm: a single chain of six or seven joints, each with a motor"),
            Self::NotTared { chain } => write!(
                f,
                "the force sensor of chain {chain} was not tared since the model was pushed or the joints were \
                 homed: tare it while nothing touches the tool"
            ),
            Self::NoForceSensor => f.write_str(
                "the robot has no force sensor: set the force source to `observer`, which estimates the force from the \
                 motor torques",
            ),
            Self::ForceSourceInUse => {
                f.write_str("the force source cannot change while the arm is enabled: disable it first")
            }
            Self::Settings(invalid) => invalid.fmt(f),
            Self::Setpoint(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for ImpedanceRefusal {}
