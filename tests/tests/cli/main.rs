//! The program `tesaki` with a simulated board: commands, output, and exit codes for scripts.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

mod approach;
mod arm;
mod asking;
mod calibrate;
mod calibrate_camera;
mod commanding;
mod configuring;
mod connection;
mod faults;
#[path = "../../../supervisor/tests/common/feed.rs"]
mod feed;
mod find_circle;
mod follow;
mod follow_master;
mod foxglove;
mod grasping;
mod identify;
mod init;
mod look;
mod machine;
mod moving;
mod network;
mod recording;
mod retarget;
mod retarget_hands;
mod retarget_live;
mod server;
mod view;
mod view_line;
