use core::fmt;

use super::human_hand::{GloveError, HumanFinger};
use crate::OutOfRange;

/// A movement of a finger's joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Movement {
    /// Bend the joint at the palm; for the thumb, the joint at the wrist.
    BendBase,
    /// Spread the fingers; for the thumb, rotate about the second axis of the joint at the wrist.
    Spread,
    /// Bend the middle joint.
    BendMiddle,
    /// Bend the joint next to the tip.
    BendEnd,
}

impl Movement {
    pub(super) const ALL: [Self; 4] = [Self::BendBase, Self::Spread, Self::BendMiddle, Self::BendEnd];
}

/// A movement of one finger, as an instruction to the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FingerMovement {
    /// The finger.
    pub finger: HumanFinger,
    /// The movement.
    pub movement: Movement,
}

impl fmt::Display for FingerMovement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { finger, movement } = self;
        match (movement, finger) {
            (Movement::BendBase, HumanFinger::Thumb) => f.write_str("move the thumb across the palm"),
            (Movement::Spread, HumanFinger::Thumb) => f.write_str("lift the thumb off the palm"),
            (Movement::Spread, _) => write!(f, "spread the {finger} sideways"),
            (Movement::BendBase, _) => write!(f, "bend the {finger} at the palm"),
            (Movement::BendMiddle, _) => write!(f, "bend the middle joint of the {finger}"),
            (Movement::BendEnd, _) => write!(f, "bend the end joint of the {finger}"),
        }
    }
}

/// Why a posture or a calibration is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CalibrationError {
    /// An invalid orientation.
    Glove(GloveError),
    /// A marker that is not finite or too far from the hand.
    Marker {
        /// Its finger.
        finger: HumanFinger,
        /// Distance from the back of the hand [m].
        distance: f32,
    },
    /// A setting outside its limits.
    Setting(OutOfRange),
    /// Too few postures show the finger's marker.
    TooFewPostures {
        /// The finger.
        finger: HumanFinger,
        /// Number of postures.
        postures: u32,
        /// Minimum number.
        min: u32,
    },
    /// The standard deviation of no joint of the finger is above 2°.
    PosturesAlike {
        /// The finger.
        finger: HumanFinger,
    },
    /// The postures lack a movement, so the tip would be predicted badly.
    MissingMovement {
        /// The movement to make.
        movement: FingerMovement,
        /// Standard deviation of the predicted tip [m].
        deviation: f32,
        /// Limit [m].
        limit: f32,
    },
    /// The residual is larger than noise explains.
    Residual {
        /// The finger.
        finger: HumanFinger,
        /// Root mean square of the tip's residual [m].
        value: f32,
        /// Limit for the stated noise [m].
        limit: f32,
    },
    /// A finger's orientations fit another finger's marker.
    Swapped {
        /// The finger.
        finger: HumanFinger,
        /// The finger whose marker fits better.
        marker_of: HumanFinger,
        /// Residual with its own marker [m].
        own: f32,
        /// Residual with the other's [m].
        other: f32,
    },
    /// Fewer than two calibrated fingers, from which others could be inferred.
    TooFewFingers,
}

impl From<GloveError> for CalibrationError {
    fn from(error: GloveError) -> Self {
        Self::Glove(error)
    }
}

impl core::error::Error for CalibrationError {}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mm = |length: &f32| 1e3 * length;
        match self {
            Self::Glove(error) => error.fmt(f),
            Self::Marker { finger, distance } => write!(
                f,
                "the marker of the {finger} is {distance} m from the back of the hand; at most 0.4 m is a hand's: \
                 give positions in metres in the frame of the back of the hand"
            ),
            Self::Setting(number) => number.fmt(f),
            Self::TooFewPostures { finger, postures, min } => {
                write!(f, "{postures} postures show the marker of the {finger}; at least {min} are needed: add postures")
            }
            Self::PosturesAlike { finger } => {
                write!(f, "all postures of the {finger} are alike: bend each joint, and spread the fingers")
            }
            Self::MissingMovement { movement, deviation, limit } => write!(
                f,
                "the tip of the {} would be predicted with a standard deviation of {:.1} mm, above {:.1} mm: {movement}",
                movement.finger,
                mm(deviation),
                mm(limit)
            ),
            Self::Residual { finger, value, limit } => write!(
                f,
                "the marker of the {finger} is {:.1} mm rms from where the orientations put it; the stated noise \
                 explains {:.1} mm: check that markers and sensors are on the fingers that their columns name, and \
                 do not slip",
                mm(value),
                mm(limit)
            ),
            Self::Swapped { finger, marker_of, own, other } => write!(
                f,
                "the orientations of the {finger} fit the marker of the {marker_of} ({:.1} mm) better than its own \
                 ({:.1} mm): the columns are swapped",
                mm(other),
                mm(own)
            ),
            Self::TooFewFingers => f.write_str(
                "fewer than two of the four fingers are calibrated by a marker: mark the index and little finger",
            ),
        }
    }
}
