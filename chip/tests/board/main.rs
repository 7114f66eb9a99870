//! The images of `board-weact`, `board-odrive` and `board-bare` on the modelled chip.
#![allow(clippy::unwrap_used, reason = "tests")]

mod current;
mod force;
mod links;
mod measures;
mod mistakes;
mod odrive;
mod rig;
mod supply;
mod timing;
mod weact;
