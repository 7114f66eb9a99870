use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Why the arm stops, or does not take a set-point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ArmError {
    /// 0: the tool's place is too far from its set-point [m].
    Distance {
        /// How far.
        value: f32,
        /// The most.
        limit: f32,
    },
    /// 1: the tool is turned too far from its set-point [rad].
    Turn {
        /// How far.
        value: f32,
        /// The most.
        limit: f32,
    },
    /// 2: a number is not finite.
    NotFinite,
    /// 3: the orientation is no unit quaternion.
    NotAUnit {
        /// Its norm.
        norm: f32,
    },
    /// 4: the arm was not told how to behave.
    NoSettings,
    /// 5: the elbow's set-point is too far from the elbow [rad].
    Elbow {
        /// How far.
        value: f32,
        /// The most.
        limit: f32,
    },
}

impl fmt::Display for ArmError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Distance { value, limit } => {
                write!(f, "the set-point is {value} m from the tool; at most {limit} m is allowed")
            }
            Self::Turn { value, limit } => {
                write!(
                    f,
                    "the set-point is turned by {value} rad from the tool; at most {limit} rad is allowed"
                )
            }
            Self::NotFinite => f.write_str("a number of the set-point is not finite"),
            Self::NotAUnit { norm } => {
                write!(f, "the orientation of the set-point is a quaternion of norm {norm}; it must be 1")
            }
            Self::NoSettings => f.write_str("the arm has no impedance yet: send its settings first"),
            Self::Elbow { value, limit } => {
                write!(
                    f,
                    "the elbow's set-point is {value} rad from the elbow; at most {limit} rad is allowed"
                )
            }
        }
    }
}
