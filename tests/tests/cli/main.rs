//! The program `tesaki` against a simulated board: what people type, what they read, and the exit codes for
//! scripts.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

mod arm;
mod calibrate;
mod commanding;
mod configuring;
mod connection;
mod faults;
mod grasping;
mod init;
mod moving;
mod network;
mod recording;
mod server;
