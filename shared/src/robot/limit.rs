use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A joint value outside the limits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LimitRefusal {
    /// 0: wrong number of joints.
    JointCount {
        /// Joints in the request.
        got: u8,
        /// Joints of the robot.
        expected: u8,
    },
    /// 1: a value is not finite.
    NotFinite {
        /// The joint.
        joint: u8,
    },
    /// 2: an angle outside the limits [rad].
    OutsideLimits {
        /// The joint.
        joint: u8,
        /// The angle.
        value: f32,
        /// The lower limit.
        lower: f32,
        /// The upper limit.
        upper: f32,
    },
    /// 3: a speed above the limit [rad/s]: of a point, or from the differences of a stream.
    TooFast {
        /// The joint.
        joint: u8,
        /// The speed.
        value: f32,
        /// The limit.
        limit: f32,
    },
    /// 4: a streamed point too far from the last reference [rad].
    Jump {
        /// The joint.
        joint: u8,
        /// The distance.
        value: f32,
        /// The limit.
        limit: f32,
    },
    /// 5: an acceleration that requires more than the maximum torque, for the joint's own inertia [rad/s²].
    TooMuchAcceleration {
        /// The joint.
        joint: u8,
        /// The acceleration.
        value: f32,
        /// The limit.
        limit: f32,
    },
    /// 6: a torque above the limit [N·m].
    TooMuchTorque {
        /// The joint.
        joint: u8,
        /// The torque.
        value: f32,
        /// The limit.
        limit: f32,
    },
}

/// The part of the robot that a refusal concerns.
pub trait Concerns {
    /// Index of the joint, if it concerns one.
    fn joint(&self) -> Option<u8> {
        None
    }

    /// Index of the chain, if it concerns one.
    fn chain(&self) -> Option<u8> {
        None
    }
}

impl Concerns for LimitRefusal {
    fn joint(&self) -> Option<u8> {
        match *self {
            Self::JointCount { .. } => None,
            Self::NotFinite { joint }
            | Self::OutsideLimits { joint, .. }
            | Self::TooFast { joint, .. }
            | Self::Jump { joint, .. }
            | Self::TooMuchAcceleration { joint, .. }
            | Self::TooMuchTorque { joint, .. } => Some(joint),
        }
    }
}

impl fmt::Display for LimitRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::JointCount { got, expected } => write!(f, "{got} joints given, the robot has {expected}"),
            Self::NotFinite { joint } => write!(f, "joint {joint}: the value is not finite"),
            Self::OutsideLimits { joint, value, lower, upper } => {
                write!(f, "joint {joint}: {value} rad is outside its limits {lower} to {upper} rad")
            }
            Self::TooFast { joint, value, limit } => {
                write!(f, "joint {joint}: {value} rad/s is beyond its limit of {limit} rad/s")
            }
            Self::Jump { joint, value, limit } => write!(
                f,
                "joint {joint}: the point is {value} rad from the reference, at most {limit} rad is allowed: \
                 start the stream at the joint's position"
            ),
            Self::TooMuchAcceleration { joint, value, limit } => write!(
                f,
                "joint {joint}: {value} rad/s² exceeds the {limit} rad/s² of its maximum torque: use a slower \
                 trajectory"
            ),
            Self::TooMuchTorque { joint, value, limit } => {
                write!(f, "joint {joint}: {value} N·m is beyond its limit of {limit} N·m")
            }
        }
    }
}

impl core::error::Error for LimitRefusal {}
