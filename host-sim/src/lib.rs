//! Simulated plants and scenarios for tesaki.
#![allow(clippy::disallowed_methods, reason = "the plant and the reports are not the control core")]
#![allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "plots and seeds"
)]

pub mod boards;
pub mod camera;
pub mod chip;
pub mod controller;
pub mod digest;
pub mod door;
pub mod faults;
mod image;
pub mod law;
pub mod live_run;
pub mod motion;
pub mod operator;
pub mod papers;
pub mod plant;
mod purpose;
pub mod qemu;
pub mod report;
pub mod scenario;
#[cfg(unix)]
pub mod serve;
#[cfg(unix)]
pub mod serve_folder;
#[cfg(unix)]
pub mod served_camera;
pub mod stepped;
pub mod virtual_board;
