use std::fmt;

use tesaki::protocol::Refusal;
use tesaki::task::grasping::{GraspFault, GraspRefusal};

use crate::BoardError;

/// Why a hand of several boards did not go on. Boards have the names of their fingertips.
#[derive(Debug, thiserror::Error)]
pub enum HandError {
    /// The robot is no hand.
    #[error(
        "{robot} is no hand that grasps: it needs three fingers of three joints, each with a force sensor: {why}"
    )]
    NotAHand {
        /// Its name.
        robot: String,
        /// What is missing.
        why: String,
    },
    /// The link to a board failed, or the board refused.
    #[error("{board}: {source}")]
    Board {
        /// Which.
        board: String,
        /// Why.
        source: BoardError,
    },
    /// A board is in fault.
    #[error("{board} is in fault{}", .fault.as_ref().map_or_else(String::new, |fault| format!(": {fault}")))]
    Fault {
        /// Which.
        board: String,
        /// Its fault in words, if it could be asked.
        fault: Option<String>,
    },
    /// A board that was armed is not any more.
    #[error("{board} was disarmed by somebody else, or reset")]
    Disarmed {
        /// Which.
        board: String,
    },
    /// A board is not heard.
    #[error("nothing new came from {board} for {steps} ticks: check cable and power")]
    Stale {
        /// Which.
        board: String,
        /// Ticks without news.
        steps: u32,
    },
    /// A board did not take a set-point.
    #[error("{board} refused a set-point: {refusal}")]
    Refused {
        /// Which.
        board: String,
        /// Its reason.
        refusal: Refusal,
    },
    /// A force sensor whose offset is not known.
    #[error(
        "the force sensor of {board} was not tared since the model was pushed: tare it while nothing touches the tips"
    )]
    NotTared {
        /// Which.
        board: String,
    },
    /// Object control by wrench needs a hand on one board.
    #[error(
        "object control by wrench needs all fingers on one board: boards of their own servo their joints"
    )]
    WrenchControl,
    /// The hand cannot do what it is told now.
    #[error(transparent)]
    GraspRefusal(GraspRefusal),
    /// The object was lost.
    #[error("{}", Words(.0))]
    Lost(GraspFault),
    /// The boards are not armed.
    #[error("the hand is not armed")]
    NotArmed,
}

/// A loss in words.
struct Words<'a>(&'a GraspFault);

impl fmt::Display for Words<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            GraspFault::Contact { finger, force, limit } => write!(
                f,
                "finger {} no longer touches the object in the hand: {force:.3} N, limit {limit:.3} N",
                finger + 1
            ),
            GraspFault::Deformed { distance, limit } => {
                write!(f, "the object in the hand slid between the fingers: {distance:.4} m, limit {limit} m")
            }
            GraspFault::Moved { distance, limit } => {
                write!(f, "the object in the hand was moved: {distance:.4} m, limit {limit} m")
            }
            GraspFault::NoFrame => write!(f, "the fingertips are in line: where the object is is not known"),
        }
    }
}
