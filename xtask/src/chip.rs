//! `cargo xtask chip`: the images of the boards that drive motors, and that of the chip alone, on a model of
//! the chip.

use std::path::{Path, PathBuf};
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
    tools::provide_unicorn_builder()?;
    Model::build(ArmCompiler::provide()?)?.check(&Simulator::build()?)
}

/// The model of the chip and the images that are flashed, built.
pub struct Model {
    /// With the board's name.
    images: Vec<(&'static str, PathBuf)>,
    target: PathBuf,
}

impl Model {
    /// Builds both.
    pub fn build(compiler: ArmCompiler) -> Result<Self> {
        let images = [BOARDS[0], BOARDS[1], firmware::BOARD].map(|board| {
            let name = board.trim_start_matches("board-");
            Ok((name, firmware::build_for_board(compiler, board)?))
        });
        let images = images.into_iter().collect::<Result<Vec<_>>>()?;
        let model = Self { images, target: std::path::absolute(firmware::target().join(FOLDER))? };
        tools::run(&mut model.cargo(&["fmt", "--check"]))?;
        let lints = ["clippy", "--release", "--quiet", "--all-targets", "--", "-D", "warnings"];
        tools::run(&mut model.cargo(&lints))?;
        tools::run(&mut model.cargo(&["test", "--release", "--quiet", "--no-run"]))?;
        tools::run(&mut model.cargo(&["build", "--release", "--quiet", "--bin", "tesaki-chip"]))?;
        Ok(model)
    }

    fn cargo(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new("cargo");
        command.args(arguments).current_dir(Path::new(FOLDER)).env("CARGO_TARGET_DIR", &self.target);
        let images = self.images.iter();
        command.envs(images.map(|(name, image)| (format!("TESAKI_{}_ELF", name.to_uppercase()), image)));
        command
    }

    /// Tries the images on the model, alone and with a finger that is simulated.
    pub fn check(&self, simulator: &Simulator) -> Result<()> {
        for (_, image) in &self.images {
            say!("image    {}\nSHA-256  {}", image.display(), firmware::sha256(image)?);
        }
        // With their tables.
        tools::run(&mut self.cargo(&["test", "--release", "--quiet", "--", "--show-output"]))?;
        let mut host_sim = simulator.command();
        host_sim.args(["chip", "--seed", SEED, "--chip"]).arg(self.target.join("release/tesaki-chip"));
        host_sim.arg("--elf").arg(&self.images[0].1);
        tools::run(&mut host_sim)
    }
}
