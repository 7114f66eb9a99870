//! The behaviour that guides the [visual approach](crate::task::visual_approach): it computes the targets of
//! the hand from the circles that vision finds and from the board's reports (Knob §4.5).
//!
//! It is the master behaviour of the paper, and does not run on the board but on the PC or in a simulator.

mod approach;
mod phase;
mod rose;
mod settings;
#[cfg(test)]
mod tests;

pub use approach::{Approach, Order};
pub use phase::{ApproachPhase, Reason};
pub use rose::{KnobExpectation, Rim, RoseEstimate};
pub use settings::ApproachSettings;
