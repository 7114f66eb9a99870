//! The images of `board-weact` and `board-bare` on the modelled chip.
#![allow(clippy::unwrap_used, reason = "tests")]

mod links;
mod mistakes;
mod rig;
mod timing;
mod weact;
