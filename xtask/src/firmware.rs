//! Building the image, and what it takes on the chip.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use sha2::{Digest, Sha256};
use tesaki_output::{note, say};

use crate::footprint::Footprint;
use crate::prove;
use crate::sweep::Simulator;
use crate::tools::{self, ArmCompiler, TARGET};

/// The image that is flashed, as cargo calls it.
pub const IMAGE: &str = "tesaki-firmware";
/// The feature of the default board.
pub const BOARD: &str = "board-bare";

/// Where cargo builds.
pub fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| PathBuf::from("target"), PathBuf::from)
}

/// The programs that run on the emulated board alone.
const ON_TARGET: &[&str] = &["bench", "replay", "selftest", "vision"];

/// Builds the programs of [`ON_TARGET`], all at once: each is optimised as a whole, by one core. Returns
/// their folder.
pub fn build_on_target(compiler: ArmCompiler) -> Result<PathBuf> {
    let mut command = compiler.cargo_build()?;
    command.args(ON_TARGET.iter().flat_map(|binary| ["--bin", binary])).args(["--features", "on-target"]);
    tools::run(&mut command)?;
    built()
}

/// The folder with images and programs.
fn built() -> Result<PathBuf> {
    std::path::absolute(target().join(TARGET).join("firmware")).context("the folder with the images")
}

/// Builds the image of a board: `board` is its feature. Cargo puts every board's image at the same path, so
/// it is copied to one with the feature in its name.
pub fn build_for_board(compiler: ArmCompiler, board: &str) -> Result<PathBuf> {
    let mut command = compiler.cargo_build()?;
    tools::run(command.args(["--bin", IMAGE, "--features", board]))?;
    let built = built()?.join(IMAGE);
    let image = built.with_file_name(format!("{IMAGE}-{board}"));
    std::fs::copy(&built, &image).with_context(|| image.display().to_string())?;
    Ok(image)
}

/// SHA-256 of a file, as hexadecimal digits.
pub fn sha256(file: &Path) -> Result<String> {
    Ok(format!("{:x}", Sha256::digest(std::fs::read(file)?)))
}

/// `cargo xtask firmware`.
pub fn run() -> Result<()> {
    let compiler = ArmCompiler::provide()?;
    tools::provide_qemu()?;
    let image = build_for_board(compiler, BOARD)?;
    report(&image, &Simulator::build()?)
}

/// Prints what the image takes, and checks it against the limits. The stack is measured in a scenario:
/// the image paints it at boot and tells how far it was used.
pub fn report(image: &Path, simulator: &Simulator) -> Result<()> {
    let footprint = Footprint::of(image)?;
    footprint.print();
    let mut host_sim = simulator.command();
    host_sim.args(["run", "arm7-elbow", "--controller", "qemu", "--json", "--elf"]).arg(image);
    host_sim.args(["--out"]).arg(crate::test::out("firmware"));
    note!("\narm7-elbow on the image in QEMU, for its stack");
    let summary: serde_json::Value = serde_json::from_str(&tools::output(&mut host_sim)?)?;
    let stack = |name: &str| summary["metrics"][name]["value"].as_f64().unwrap_or(f64::NAN);
    say!("image    {}", image.display());
    say!("SHA-256  {}", sha256(image)?);
    say!("flash    {} of {} bytes", footprint.flash(), 1024 * 1024);
    say!("RAM      {} bytes of static data", footprint.ram());
    let seen = stack("stack_used");
    say!(
        "stack    {seen} of {} bytes at most, seen in {} ticks of arm7-elbow in QEMU",
        summary["metrics"]["stack_used"]["limit"].as_f64().unwrap_or(f64::NAN),
        summary["ticks"]
    );
    footprint.check()?;
    note!("\nwhat holds for the image, from its instructions");
    let bound = prove::check(image)?;
    ensure!(seen <= f64::from(bound), "{seen} bytes of stack were seen, and {bound} proved to be the most");
    Ok(())
}
