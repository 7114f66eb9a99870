//! `ros2`: a program of its own, so that this one is built without DDS.

use std::env;
use std::ffi::OsString;
use std::io;
use std::os::unix::process::CommandExt as _;
use std::path::PathBuf;
use std::process::Command;

use crate::failure::Failure;

const PROGRAM: &str = "tesaki-ros2";

/// Becomes that program, with all other arguments.
pub fn start() -> Result<(), Failure> {
    let mut arguments: Vec<OsString> = env::args_os().skip(1).collect();
    if let Some(command) = arguments.iter().position(|argument| argument == "ros2") {
        arguments.remove(command);
    }
    // A node prints no result, and asks nothing.
    arguments.retain(|argument| argument != "--json" && argument != "--non-interactive");
    let beside =
        env::current_exe().ok().map(|path| path.with_file_name(PROGRAM)).filter(|path| path.is_file());
    let error = Command::new(beside.unwrap_or_else(|| PathBuf::from(PROGRAM))).args(arguments).exec();
    Err(match error.kind() {
        io::ErrorKind::NotFound => Failure::Usage(format!(
            "there is no program {PROGRAM} beside this one or in PATH. In a checkout `cargo ros2 …` builds \
             and starts it; `cargo install --path ros2` puts it beside an installed tesaki"
        )),
        _ => Failure::Other(format!("cannot start {PROGRAM}: {error}")),
    })
}
