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
    let bytes = std::fs::read(&image)?;
    for (folder, _) in tools::source_folders()? {
        let name = folder.as_os_str().as_encoded_bytes();
        let named = bytes.windows(name.len()).any(|window| window == name);
        ensure!(
            !named,
            "{} names {}: another folder would make another image",
            image.display(),
            folder.display()
        );
    }
    Ok(image)
}

/// SHA-256 of a file, as hexadecimal digits.
pub fn sha256(file: &Path) -> Result<String> {
    Ok(format!("{:x}", Sha256::digest(std::fs::read(file)?)))
}

/// What `cargo xtask firmware` is to build.
#[derive(clap::Args)]
pub struct Options {
    /// Feature of the board in firmware/Cargo.toml, such as board-weact
    #[arg(default_value = BOARD)]
    board: String,
}

/// `cargo xtask firmware`.
pub fn run(options: &Options) -> Result<()> {
    let compiler = ArmCompiler::provide()?;
    let image = build_for_board(compiler, &options.board)?;
    // QEMU has the pins and drivers of no other board.
    let simulator = (options.board == BOARD).then(|| {
        tools::provide_qemu()?;
        Simulator::build()
    });
    report(&image, simulator.transpose()?.as_ref())
}

/// Prints what the image takes, and checks it against the limits. With a simulator the stack is measured,
/// too.
pub fn report(image: &Path, simulator: Option<&Simulator>) -> Result<()> {
    let footprint = Footprint::of(image)?;
    footprint.print();
    let seen = simulator.map(|simulator| StackUse::of(image, simulator)).transpose()?;
    say!("image    {}", image.display());
    say!("SHA-256  {}", sha256(image)?);
    say!("flash    {} of {} bytes", footprint.flash(), 1024 * 1024);
    say!("RAM      {} bytes of static data", footprint.ram());
    if let Some(StackUse { bytes, available, ticks }) = &seen {
        say!(
            "stack    {bytes} of {available} bytes at most, seen in {ticks} ticks of {STACK_SCENARIO} in QEMU"
        );
    }
    footprint.check()?;
    note!("\nwhat holds for the image, from its instructions");
    let bound = prove::check(image)?;
    if let Some(StackUse { bytes, .. }) = seen {
        ensure!(bytes <= bound, "{bytes} bytes of stack were seen, and {bound} proved to be the most");
    }
    Ok(())
}

/// The scenario in which the use of the stack is measured.
const STACK_SCENARIO: &str = "arm7-elbow";

/// How far the stack was used in QEMU: the image paints it at boot.
struct StackUse {
    bytes: u32,
    available: u32,
    ticks: u64,
}

impl StackUse {
    fn of(image: &Path, simulator: &Simulator) -> Result<Self> {
        let mut host_sim = simulator.command();
        host_sim.args(["run", STACK_SCENARIO, "--controller", "qemu", "--json", "--elf"]).arg(image);
        host_sim.args(["--out"]).arg(crate::test::out("firmware"));
        note!("\n{STACK_SCENARIO} on the image in QEMU, for its stack");
        let summary: serde_json::Value = serde_json::from_str(&tools::output(&mut host_sim)?)?;
        let metric = &summary["metrics"]["stack_used"];
        let bytes = |name: &str| metric[name].as_f64().with_context(|| format!("no {name}: {metric}"));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "bytes of a small memory"
        )]
        let [used, available] = [bytes("value")? as u32, bytes("limit")? as u32];
        let ticks = summary["ticks"].as_u64().context("no ticks")?;
        Ok(Self { bytes: used, available, ticks })
    }
}
