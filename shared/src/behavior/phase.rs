//! Phases of the behaviour, and why it gives up.

use crate::task::visual_approach::VisualApproachRefusal;

/// Phase of the visual approach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ApproachPhase {
    /// The gripper opens, and the camera searches for the rose.
    Look,
    /// The hand moves in front of the knob.
    Center,
    /// The fingers move beside the knob.
    Advance,
    /// The gripper closes.
    Grip,
    /// The hand pulls the held knob.
    Verify,
    /// The hand retreats for another try.
    Retreat,
    /// The hand holds the knob.
    Done,
    /// The behaviour has given up, and the hand stands.
    Failed(Reason),
}

/// Why the behaviour has given up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    /// No rose was found.
    NotFound,
    /// The rose was lost on the way, in all tries.
    Lost,
    /// There were no pictures.
    NoPictures,
    /// Contacts stopped the hand before it reached the knob, or during its retreat.
    Blocked,
    /// The knob is out of the arm's reach.
    OutOfReach,
    /// The fingers held nothing, or the held object gave way to the pull.
    NotHeld,
    /// The gripper did not open.
    Gripper,
    /// A phase took too long.
    Late,
    /// The board refused a command.
    Refused(VisualApproachRefusal),
}

impl core::fmt::Display for Reason {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotFound => "no rose was found in the pictures",
            Self::Lost => "the rose was lost on the way",
            Self::NoPictures => "there were no pictures: look at the camera",
            Self::Blocked => "a contact stopped the hand before it was at the knob, or on its way back",
            Self::OutOfReach => "the knob is out of the arm's reach",
            Self::NotHeld => "nothing was between the fingers, or it gave way to a pull",
            Self::Gripper => "the gripper did not open: look what is between its fingers",
            Self::Late => "a part of the approach took too long",
            Self::Refused(refusal) => return write!(f, "the board refused a command: {refusal}"),
        })
    }
}
