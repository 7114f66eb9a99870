//! The image of `board-weact` on the modelled chip.
#![allow(clippy::unwrap_used, reason = "tests")]

mod mistakes;
mod rig;
mod weact;
