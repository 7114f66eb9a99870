use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::OutOfRange;
use crate::control::ServoMode;
use crate::kinematics::Hand;
use crate::teleop::{RetargetField, RetargetSettings};

/// Lag of a joint behind its reference [s]. While it catches up it is faster than the reference, by the
/// acceleration times this lag.
pub(super) const LAG: f32 = 0.025;
/// The same for a joint whose speed limit is so low that it reverses repeatedly at full acceleration, so that
/// the lags of successive reversals add up [s].
pub(super) const REVERSING_LAG: f32 = 0.03;

/// Settings of telexistence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct TelexistenceSettings {
    /// Mapping of the operator's fingertips to those of the hand.
    pub retargeting: RetargetSettings,
    /// Feedback law of the joint servos.
    pub servo_mode: ServoMode,
    /// Largest acceleration of the joints' references [rad/s²]: 1 to 10⁴.
    pub acceleration: f32,
    /// A fingertip without a sample for this time counts as unknown [s]: 0.02 to 2.
    pub max_sample_age: f32,
}

impl TelexistenceSettings {
    /// A hand of the operator's size, whose fingertips are known up to 0.2 s after a sample.
    pub const DEFAULT: Self = Self {
        retargeting: RetargetSettings::DEFAULT,
        servo_mode: ServoMode::Observer,
        acceleration: 100.0,
        max_sample_age: 0.2,
    };

    /// Lowers the speeds of the joints' references so that the joints keep their velocity limits [rad/s]
    /// while they catch up, but not below half of the limit: there the task lowers the acceleration instead.
    pub fn limit_speeds(&mut self, velocity_limits: impl Iterator<Item = f32>) {
        for (speed, limit) in self.retargeting.speeds.iter_mut().zip(velocity_limits) {
            *speed = speed.min((limit - LAG * self.acceleration).max(0.5 * limit));
        }
    }

    /// Checks the settings for `hand`.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn validate(&self, hand: &Hand) -> Result<(), InvalidTelexistenceSettings> {
        self.retargeting.validate(hand).map_err(InvalidTelexistenceSettings::Retargeting)?;
        let value = self.acceleration;
        if !(1.0..=1e4).contains(&value) {
            return Err(InvalidTelexistenceSettings::Acceleration { value });
        }
        let value = self.max_sample_age;
        if !(0.02..=2.0).contains(&value) {
            return Err(InvalidTelexistenceSettings::MaxSampleAge { value });
        }
        Ok(())
    }
}

/// A setting out of its range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InvalidTelexistenceSettings {
    /// 0: a setting of the retargeting.
    Retargeting(OutOfRange<RetargetField>),
    /// 1: the acceleration [rad/s²].
    Acceleration {
        /// The value.
        value: f32,
    },
    /// 2: the largest age of a sample [s].
    MaxSampleAge {
        /// The value.
        value: f32,
    },
}

impl fmt::Display for InvalidTelexistenceSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Retargeting(invalid) => invalid.fmt(f),
            Self::Acceleration { value } => {
                write!(f, "the acceleration is {value} rad/s²; it must be 1 to 10000 rad/s²")
            }
            Self::MaxSampleAge { value } => {
                write!(f, "the largest age of a sample is {value} s; it must be 0.02 to 2 s")
            }
        }
    }
}

impl core::error::Error for InvalidTelexistenceSettings {}
