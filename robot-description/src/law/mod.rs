//! Laws: control laws as data, with the experiments of a paper, in the folder `laws` of a robot.

pub mod hand;

/// The folder of the laws in a robot's folder.
pub const FOLDER: &str = "laws";
