//! `cargo xtask chip`: the images of the boards that drive motors, and that of the chip alone, on a model of
//! the chip.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use tesaki_output::say;

use crate::firmware;
use crate::sweep::Simulator;
use crate::tools::{self, ArmCompiler};

/// A workspace of its own, see its README.
const FOLDER: &str = "chip";
/// The features of the boards with motors. The first one is tried with a simulated finger, too.
pub const BOARDS: [&str; 2] = ["board-weact", "board-odrive"];

/// The machine that the finger is tried on; all twenty: `cargo sim chip --seed 1-20`.
const SEED: &str = "1";

/// `cargo xtask chip`.
pub fn run() -> Result<()> {
    check(ArmCompiler::provide()?, &Simulator::build()?)
}

/// Builds the images that are flashed and the model, and tries the ones on the other, alone and with a finger
/// that is simulated.
pub fn check(compiler: ArmCompiler, simulator: &Simulator) -> Result<()> {
    tools::provide_unicorn_builder()?;
    let images = [BOARDS[0], BOARDS[1], firmware::BOARD].map(|board| {
        let name = board.trim_start_matches("board-");
        Ok((name, firmware::build_for_board(compiler, board)?))
    });
    let images = images.into_iter().collect::<Result<Vec<_>>>()?;
    for (_, image) in &images {
        say!("image    {}\nSHA-256  {}", image.display(), firmware::sha256(image)?);
    }
    let target = std::path::absolute(firmware::target().join(FOLDER))?;
    let cargo = |arguments: &[&str]| {
        let mut command = Command::new("cargo");
        command.args(arguments).current_dir(Path::new(FOLDER));
        command.env("CARGO_TARGET_DIR", &target);
        command
            .envs(images.iter().map(|(name, image)| (format!("TESAKI_{}_ELF", name.to_uppercase()), image)));
        command
    };
    tools::run(&mut cargo(&["fmt", "--check"]))?;
    tools::run(&mut cargo(&["clippy", "--release", "--quiet", "--all-targets", "--", "-D", "warnings"]))?;
    // With their tables.
    tools::run(&mut cargo(&["test", "--release", "--quiet", "--", "--show-output"]))?;
    tools::run(&mut cargo(&["build", "--release", "--quiet", "--bin", "tesaki-chip"]))?;
    let mut host_sim = simulator.command();
    host_sim.args(["chip", "--seed", SEED, "--chip"]).arg(target.join("release/tesaki-chip"));
    host_sim.arg("--elf").arg(&images[0].1);
    tools::run(&mut host_sim)
}
