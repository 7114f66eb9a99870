use core::fmt;

/// Why a sample was rejected or the clutch stayed open. The state is unchanged.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FollowerError {
    /// The hand is farther from where it should be than it can be [m]. If all samples are refused so, it is
    /// elsewhere: open the clutch.
    Distance {
        /// How far.
        value: f32,
        /// The most.
        limit: f32,
    },
    /// Hand or elbow is turned farther from where it should be than it can be [rad].
    Angle {
        /// How far.
        value: f32,
        /// The most.
        limit: f32,
    },
    /// The sample is too old, or, negative, from the future: the clocks differ [s].
    Age {
        /// How old.
        value: f32,
        /// The most; of the future, none at all.
        limit: f32,
    },
    /// A later sample was there before [s].
    OutOfOrder {
        /// By how much it is later.
        by: f32,
    },
    /// A number is not finite.
    NotFinite,
    /// The orientation is no unit quaternion.
    NotUnit {
        /// Its norm.
        norm: f32,
    },
    /// The clutch cannot be closed: nobody knows where the hand is.
    NoSample,
}

impl core::error::Error for FollowerError {}

impl fmt::Display for FollowerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Distance { value, limit } => {
                write!(f, "the hand is {value} m from where it should be; at most {limit} m is possible")
            }
            Self::Angle { value, limit } => {
                write!(
                    f,
                    "hand or elbow is turned by {value} rad from where it should be; at most {limit} rad is possible"
                )
            }
            Self::Age { value, limit } if *value > *limit => {
                write!(f, "the sample is {value} s old; at most {limit} s is useful")
            }
            Self::Age { value, .. } => {
                write!(f, "the sample is {} s ahead of now: the clocks differ", -value)
            }
            Self::OutOfOrder { by } => write!(f, "a sample that is {by} s later was there before"),
            Self::NotFinite => f.write_str("a number of the sample is not finite"),
            Self::NotUnit { norm } => {
                write!(f, "the orientation of the sample is a quaternion of norm {norm}; it must be 1")
            }
            Self::NoSample => f.write_str("there is no recent sample of the hand: the clutch stays open"),
        }
    }
}

/// A value of [`FollowerSettings`](super::FollowerSettings) outside its limits.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InvalidFollowerSettings {
    /// The field.
    pub field: &'static str,
    /// Its value.
    pub value: f32,
    /// Minimum.
    pub min: f32,
    /// Maximum.
    pub max: f32,
}

impl core::error::Error for InvalidFollowerSettings {}

impl fmt::Display for InvalidFollowerSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, value, min, max } = self;
        write!(f, "{field} is {value}; it must be between {min} and {max}")
    }
}
