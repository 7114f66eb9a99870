use std::fmt;

use tesaki::fault::FaultCause;
use tesaki::protocol::Refusal;
use tesaki::task::TaskFault;
use tesaki::task::grasping::{GraspFault, GraspRefusal};

use crate::{BoardError, troubleshooting};

/// Reasons why a hand of several boards failed. Boards have the names of their fingertips.
#[derive(Debug, thiserror::Error)]
pub enum HandError {
    /// The robot is not a hand.
    #[error(
        "{robot} is not a hand for grasping: three fingers of three joints, each with a force sensor, are needed, but {why}"
    )]
    NotAHand {
        /// Its name.
        robot: String,
        /// The missing property.
        why: String,
    },
    /// The link to a board failed, or the board refused.
    #[error("{board}: {source}")]
    Board {
        /// The board.
        board: String,
        /// The error.
        source: BoardError,
    },
    /// A board is in fault.
    #[error("{board} is in fault{}", .fault.as_ref().map_or_else(String::new, |fault| format!(": {fault}")))]
    Fault {
        /// The board.
        board: String,
        /// Description of its fault and the entry of the document that explains it, if it could be read.
        fault: Option<String>,
    },
    /// A board is no longer enabled.
    #[error("{board} was disabled by another program, or reset")]
    Disabled {
        /// The board.
        board: String,
    },
    /// A board is silent.
    #[error("no new data from {board} for {steps} ticks: check cable and power")]
    Stale {
        /// The board.
        board: String,
        /// Ticks without new data.
        steps: u32,
    },
    /// A board refused a set-point.
    #[error("{board} refused a set-point: {refusal}; see {}", troubleshooting::refusal(refusal))]
    Refused {
        /// The board.
        board: String,
        /// Its reason.
        refusal: Refusal,
    },
    /// A force sensor whose offset is unknown.
    #[error(
        "the force sensor of {board} was not tared since the model was pushed or the joints were homed: tare it while nothing touches \
         the tips"
    )]
    NotTared {
        /// The board.
        board: String,
    },
    /// Object control by wrench needs a hand on one board.
    #[error(
        "object control by wrench needs all fingers on one board: separate boards control joint positions"
    )]
    WrenchControl,
    /// Forces that are only fed forward need a hand on one board.
    #[error(
        "a plan without force feedback needs all fingers on one board: it restarts the joint servos, which \
         separate boards cannot be told"
    )]
    OpenLoop,
    /// The grasp command was refused.
    #[error("{0}; see {entry}", entry = troubleshooting::grasp_refusal(.0))]
    GraspRefusal(GraspRefusal),
    /// The object was lost.
    #[error("{}; see {}", Description(.0), troubleshooting::fault(cause(*.0)))]
    Lost(GraspFault),
    /// The boards are not enabled.
    #[error("the hand is not enabled")]
    NotEnabled,
}

/// Returns the cause that a single board reports for this fault.
fn cause(fault: GraspFault) -> FaultCause {
    TaskFault::from(fault).cause
}

/// Description of a lost object.
struct Description<'a>(&'a GraspFault);

impl fmt::Display for Description<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            GraspFault::ContactLost { finger, force, limit } => write!(
                f,
                "finger {} lost contact with the object: {force:.3} N, limit {limit:.3} N",
                finger + 1
            ),
            GraspFault::Deformed { distance, limit } => {
                write!(f, "the object slipped between the fingers: {distance:.4} m, limit {limit} m")
            }
            GraspFault::Displaced { distance, limit } => {
                write!(f, "the object was moved from its target: {distance:.4} m, limit {limit} m")
            }
            GraspFault::NoFrame => {
                write!(f, "the fingertips are collinear: the pose of the object cannot be computed")
            }
        }
    }
}
