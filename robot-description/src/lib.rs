//! Robots as users lay them out: a folder with `robot.urdf` (kinematics, inertias, limits) and
//! `controller.toml` (motors, encoders, gains, safety), and the files beside it.
//!
//! - [`robot`] makes a [`RobotModel`](tesaki::model::RobotModel) of the folder, or lists every [`finding`] by
//!   file and line;
//! - [`urdf`] reads any URDF and gives the serial chain from a base to a tip;
//! - [`frames`] says where each link is in the one that carries it;
//! - [`plant`], [`camera`] and [`object`] hold the simulated machine, its camera and what it grasps, [`init`]
//!   writes a folder for a URDF;
//! - [`law`] holds control laws with the experiments of a paper;
//! - [`calibration`] holds the values of one machine, [`hand_eye`] those of its camera, [`grasp`],
//!   [`impedance`], [`retargeting`] and [`approach`] what tasks are given, [`law`] control laws and a paper's
//!   experiments with them.

pub mod approach;
pub mod calibration;
pub mod camera;
mod file;
pub mod finding;
pub mod frames;
pub mod grasp;
pub mod hand_eye;
pub mod impedance;
pub mod init;
pub mod law;
mod line;
mod load;
pub mod object;
pub mod plant;
pub mod retargeting;
pub mod robot;
pub mod spelling;
pub mod urdf;

pub use file::{FileError, in_words, read_text};
