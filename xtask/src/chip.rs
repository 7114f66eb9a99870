//! `cargo xtask chip`: the image of the board that drives motors, on a model of its chip.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use tesaki_output::say;

use crate::firmware;
use crate::tools::{self, ArmCompiler};

/// A workspace of its own, see its README.
const FOLDER: &str = "chip";
/// The feature of the board with motors.
const BOARD: &str = "board-weact";

/// `cargo xtask chip`.
pub fn run() -> Result<()> {
    check(ArmCompiler::provide()?)
}

/// Builds the image that is flashed and the model, and tries the one on the other.
pub fn check(compiler: ArmCompiler) -> Result<()> {
    tools::provide_unicorn_builder()?;
    let image = firmware::build_for_board(compiler, BOARD)?;
    say!("image    {}\nSHA-256  {}", image.display(), firmware::sha256(&image)?);
    let target = std::path::absolute(firmware::target().join(FOLDER))?;
    let cargo = |arguments: &[&str]| {
        let mut command = Command::new("cargo");
        command.args(arguments).current_dir(Path::new(FOLDER));
        command.env("CARGO_TARGET_DIR", &target).env("TESAKI_WEACT_ELF", &image);
        command
    };
    tools::run(&mut cargo(&["fmt", "--check"]))?;
    tools::run(&mut cargo(&["clippy", "--release", "--quiet", "--all-targets", "--", "-D", "warnings"]))?;
    tools::run(&mut cargo(&["test", "--release", "--quiet"]))
}
