use core::fmt;

use crate::OutOfRange;

/// Why a sample is rejected, or why the clutch stays open. The state is unchanged.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FollowerError {
    /// The position innovation exceeds the gate [m]. If all samples are rejected, open the clutch.
    Distance {
        /// The innovation.
        value: f32,
        /// The gate.
        limit: f32,
    },
    /// The innovation of the orientation or of the elbow angle exceeds the gate [rad].
    Angle {
        /// The innovation.
        value: f32,
        /// The gate.
        limit: f32,
    },
    /// The sample is too old, or its time is in the future: the clocks differ [s].
    Age {
        /// The age; negative for a time in the future.
        value: f32,
        /// Maximum age.
        limit: f32,
    },
    /// A later sample arrived before this one [s].
    OutOfOrder {
        /// Difference of their times.
        by: f32,
    },
    /// A number is not finite.
    NotFinite,
    /// The position or the elbow angle is far from every hand's.
    OutOfRange(OutOfRange),
    /// The orientation is not a unit quaternion.
    NotUnit {
        /// Its norm.
        norm: f32,
    },
    /// The clutch cannot be closed without a recent sample of the hand.
    NoSample,
}

impl core::error::Error for FollowerError {}

impl fmt::Display for FollowerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Distance { value, limit } => {
                write!(f, "the hand is {value} m from its prediction; at most {limit} m is accepted")
            }
            Self::Angle { value, limit } => {
                write!(f, "hand or elbow is {value} rad from its prediction; at most {limit} rad is accepted")
            }
            Self::Age { value, limit } if *value > *limit => {
                write!(f, "the sample is {value} s old; at most {limit} s is accepted")
            }
            Self::Age { value, .. } => {
                write!(f, "the time of the sample is {} s in the future: the clocks differ", -value)
            }
            Self::OutOfOrder { by } => write!(f, "a sample that is {by} s later arrived before"),
            Self::NotFinite => f.write_str("a number of the sample is not finite"),
            Self::OutOfRange(number) => number.fmt(f),
            Self::NotUnit { norm } => {
                write!(f, "the orientation of the sample is a quaternion of norm {norm}; it must be 1")
            }
            Self::NoSample => f.write_str("there is no recent sample of the hand: the clutch stays open"),
        }
    }
}
