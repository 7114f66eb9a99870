//! Settings of the retargeting, and their ranges.

use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::OutOfRange;
use crate::kinematics::{Hand, MAX_FINGERS};
use crate::math::abs;
use crate::model::MAX_JOINTS;

/// Settings of a [`Retargeting`](super::Retargeting).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct RetargetSettings {
    /// Which of the operator's fingers each finger of the hand follows: 0 is the thumb, 4 the little finger.
    /// The hand's first finger is its thumb and follows the thumb.
    pub follows: [u8; MAX_FINGERS],
    /// Weight of each finger's vector, 0.001 to 1000; that of the thumb has no effect.
    pub weights: [f32; MAX_FINGERS],
    /// Scale from the operator's hand to the robot's, 0.1 to 10; 1 in the paper.
    pub scale: f32,
    /// Gap between the operator's thumb and a fingertip below which precision pinch has full priority [m].
    pub near: f32,
    /// Gap above which precision pinch has no priority [m].
    pub far: f32,
    /// Distance between the measured points of the operator's thumb and fingertip when these touch [m].
    pub operator_contact: f32,
    /// Distance between the centres of the robot's tips when their surfaces touch: twice their radius [m].
    pub robot_contact: f32,
    /// Maximum speed of each actuated joint [rad/s], 0.001 to 1000.
    pub speeds: [f32; MAX_JOINTS],
    /// Maximum distance of a fingertip from its target; a larger one is reported as missed [m].
    pub tolerance: f32,
    /// Whether the directions of fingertips are followed as far as their positions leave them free.
    pub directions: bool,
}

impl RetargetSettings {
    /// Five fingers of equal weight, full priority of precision pinch below a gap of 5 mm, none above 25 mm.
    pub const DEFAULT: Self = Self {
        follows: [0, 1, 2, 3, 4],
        weights: [1.0; MAX_FINGERS],
        scale: 1.0,
        near: 5e-3,
        far: 25e-3,
        operator_contact: 0.0,
        robot_contact: 0.0,
        speeds: [6.0; MAX_JOINTS],
        tolerance: 1e-4,
        directions: false,
    };
}

/// A setting of a [`Retargeting`](super::Retargeting).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RetargetField {
    /// 0: number of fingers of the hand.
    Fingers,
    /// 1: an entry of `follows`.
    Follows,
    /// 2: an entry of `weights`.
    Weights,
    /// 3: `scale`.
    Scale,
    /// 4: `near`.
    Near,
    /// 5: `far`, whose minimum depends on `near` and on the distances at contact.
    Far,
    /// 6: `operator_contact`.
    OperatorContact,
    /// 7: `robot_contact`.
    RobotContact,
    /// 8: an entry of `speeds`.
    Speeds,
    /// 9: `tolerance`.
    Tolerance,
}

impl RetargetSettings {
    /// Checks the settings for `hand`.
    ///
    /// # Errors
    /// The first setting that is out of range, or that contradicts another one.
    pub fn validate(&self, hand: &Hand) -> Result<(), OutOfRange<RetargetField>> {
        let check = |field, value, min, max| OutOfRange::check(field, value, [min, max]);
        let fingers = hand.len();
        #[expect(clippy::cast_precision_loss, reason = "at most 5")]
        check(RetargetField::Fingers, fingers as f32, 2.0, MAX_FINGERS as f32)?;
        for (finger, (&follows, &weight)) in self.follows.iter().zip(&self.weights).enumerate().take(fingers)
        {
            let (min, max) = if finger == 0 { (0.0, 0.0) } else { (1.0, 4.0) };
            check(RetargetField::Follows, f32::from(follows), min, max)?;
            check(RetargetField::Weights, weight, 1e-3, 1e3)?;
        }
        check(RetargetField::Scale, self.scale, 0.1, 10.0)?;
        check(RetargetField::Near, self.near, 0.0, 0.1)?;
        check(RetargetField::OperatorContact, self.operator_contact, 0.0, 0.1)?;
        check(RetargetField::RobotContact, self.robot_contact, 0.0, 0.1)?;
        // The target's distance must grow with the operator's; the steepest slope of β is 1.5 / (far − near).
        let change = abs(self.robot_contact - self.scale * self.operator_contact);
        check(RetargetField::Far, self.far, self.near + 1e-3 + 2.0 * change / self.scale, 0.5)?;
        for &speed in self.speeds.iter().take(hand.limits().len()) {
            check(RetargetField::Speeds, speed, 1e-3, 1e3)?;
        }
        check(RetargetField::Tolerance, self.tolerance, 1e-6, 0.1)
    }
}

impl fmt::Display for RetargetField {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Fingers => "the number of fingers",
            Self::Follows => "follows",
            Self::Weights => "a weight",
            Self::Scale => "scale",
            Self::Near => "near",
            Self::Far => "far",
            Self::OperatorContact => "operator_contact",
            Self::RobotContact => "robot_contact",
            Self::Speeds => "a speed",
            Self::Tolerance => "tolerance",
        })
    }
}
