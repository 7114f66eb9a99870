//! Laws: control laws as data, with the experiments of a paper, in the folder `laws` of a robot.

pub mod hand;

use std::io;
use std::path::{Path, PathBuf};

/// The folder of the laws in a robot's folder.
pub const FOLDER: &str = "laws";

/// The law files of a robot, in the order of their names; none without the folder.
///
/// # Errors
/// The folder cannot be read.
pub fn files(robot: &Path) -> io::Result<Vec<PathBuf>> {
    let folder = robot.join(FOLDER);
    if folder.symlink_metadata().is_err() {
        return Ok(Vec::new());
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|end| end == "toml") {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}
