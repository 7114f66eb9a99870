//! The behaviour that leads the [visual approach](crate::task::visual_approach): from the circles that vision
//! finds and from what the board reports it decides where the hand goes (Knob §4.5).
//!
//! It is the master behaviour of the paper, and runs beside the board: on the PC, or in a simulator.

mod approach;
mod phase;
mod rose;
mod settings;
#[cfg(test)]
mod tests;

pub use approach::{Approach, MIN_CONFIDENCE, Order};
pub use phase::{Phase, Reason};
pub use rose::{KnobExpectation, Rim, RoseEstimate};
pub use settings::{ApproachSettings, InvalidApproach};
