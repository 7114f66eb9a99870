//! Errors in the frames of a source.

use tesaki::teleop::{GloveError, HumanFinger};
use tesaki_description::retargeting::Side;

/// Reasons why a frame cannot belong to the operator's hand, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// Time does not increase.
    #[error("time {time} s does not follow {before} s: times must rise; sort the frames, or start anew")]
    Time {
        /// Time of the frame [s].
        time: f64,
        /// Time of the previous frame [s].
        before: f64,
    },
    /// A number is not finite.
    #[error("{0} holds a number that is not finite: leave out what was not measured")]
    NotFinite(String),
    /// An orientation cannot be used.
    #[error("{0}")]
    Glove(#[from] GloveError),
    /// A length is not that of a hand.
    #[error("{what} is {value}, limits {min} and {max}: {hint}")]
    Size {
        /// Name of the length.
        what: &'static str,
        /// The value.
        value: f32,
        /// Value for the smallest hand.
        min: f32,
        /// Value for the largest hand.
        max: f32,
        /// What to do.
        hint: String,
    },
    /// The palm has no extent.
    #[error("the landmarks of wrist and knuckles (0, 5, 9, 13, 17) lie in one line: no palm")]
    Flat,
    /// A bone is too short or too long for the size of the palm.
    #[error(
        "landmarks {from} and {to} are {length:.4} m apart, limits {min:.4} and {max:.4} m for a palm of this size: \
         check the order of the landmarks"
    )]
    Bone {
        /// Index of the first landmark.
        from: usize,
        /// Index of the second landmark.
        to: usize,
        /// Distance [m].
        length: f32,
        /// Smallest allowed distance [m].
        min: f32,
        /// Largest allowed distance [m].
        max: f32,
    },
    /// Image coordinates instead of lengths.
    #[error(
        "all x and y are within 0 to 1 and z of the wrist is 0: these are normalised image coordinates; send the world \
         landmarks, in metres"
    )]
    Normalised,
    /// A finger is on the wrong side of its neighbour.
    #[error(
        "the {what} of the {finger} is {beyond:.3} m beyond that of the {neighbour} on the thumb's side, limit \
         {limit} m: are the two swapped?"
    )]
    Order {
        /// The finger.
        finger: HumanFinger,
        /// The finger that should be nearer to the thumb.
        neighbour: HumanFinger,
        /// "tip" or "knuckle".
        what: &'static str,
        /// The distance [m].
        beyond: f32,
        /// Limit [m].
        limit: f32,
    },
    /// The fingers are in reverse order.
    #[error(
        "index to little finger stand as on a {} hand, and the robot follows a {} hand: y = z × x must point to the \
         thumb of a right hand; is the input mirrored?", .follows.other().name(), .follows.name()
    )]
    Reversed {
        /// The operator's hand of the settings.
        follows: Side,
    },
    /// The fingertips are behind the hand.
    #[error(
        "the fingertips are {mean:.3} m behind the back of the hand, limit {limit} m: x must point out of the palm; is \
         the input mirrored?"
    )]
    Behind {
        /// Mean of the fingers without the thumb [m].
        mean: f32,
        /// Limit [m].
        limit: f32,
    },
    /// The fingers are in reverse order, and the fingertips are behind the hand.
    #[error("the fingertips are turned by 180° about the fingers: x must point out of the palm")]
    Turned,
    /// A fingertip is farther from the wrist than fingers reach.
    #[error(
        "the tip of the {finger} is {distance:.3} m from the wrist, limit {limit} m: is it that of another finger, or \
         not in metres?"
    )]
    Reach {
        /// The finger.
        finger: HumanFinger,
        /// Distance from the wrist [m].
        distance: f32,
        /// Limit [m].
        limit: f32,
    },
    /// The other hand, or a mirrored one.
    #[error(
        "the fingers bend like those of a {} hand, and the robot follows a {} hand: show this hand; if it is, the \
         picture is mirrored: do not flip it", .0.name(), .0.other().name()
    )]
    OtherHand(Side),
    /// The source labels it as the other hand.
    #[error(
        "the source calls it a {} hand{}, and the robot follows a {} hand: show this hand; if it is, the picture is \
         mirrored or the source names hands as in a mirror: then do not flip it, or leave out `handedness`",
        .label.name(), if *.bends_otherwise { ", but it bends like the other one" } else { "" },
        .label.other().name()
    )]
    Label {
        /// The label.
        label: Side,
        /// Whether its fingers bend like those of the hand that the robot follows.
        bends_otherwise: bool,
    },
}
