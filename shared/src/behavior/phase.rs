//! Phases of the behaviour, and why it gives up.

use crate::task::visual_approach::VisualApproachRefusal;

/// Part of the behaviour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Phase {
    /// The gripper opens, and the rose is looked for.
    Look,
    /// The hand goes before the knob.
    Center,
    /// The fingers go beside the knob.
    Advance,
    /// The gripper closes.
    Grip,
    /// The hand pulls at what it holds.
    Verify,
    /// It goes back for another try.
    Retreat,
    /// It holds the knob.
    Done,
    /// It has given up, and stands.
    Failed(Reason),
}

/// Why the behaviour has given up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    /// No rose was found.
    NotFound,
    /// It was lost on the way, again and again.
    Lost,
    /// There were no pictures.
    NoPictures,
    /// Contacts stopped the hand before it was at the knob, or on its way back.
    Blocked,
    /// The knob is out of the arm's reach.
    OutOfReach,
    /// Nothing was between the fingers, or it gave way to a pull.
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
