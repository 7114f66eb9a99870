//! The images of `board-weact` and `board-bare` on the modelled chip.
#![allow(clippy::unwrap_used, reason = "tests")]

mod current;
mod links;
mod measures;
mod mistakes;
mod rig;
mod timing;
mod weact;
