//! `cargo xtask test`: everything, in the order in which a mistake shows soonest.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::Result;

use crate::tools::{self, ArmCompiler};
use crate::{bench, firmware};

/// Where a step may write.
pub fn out(step: &str) -> PathBuf {
    Path::new("target").join("xtask").join(step)
}

/// Random tests get the same inputs each time here, so that this passes twice or fails twice; `cargo test` tries others.
fn cargo(arguments: &[&str]) -> Command {
    let mut command = Command::new("cargo");
    command.args(arguments).env("PROPTEST_RNG_SEED", "1");
    command
}

/// The test targets called `name`, of the whole workspace: so the same features are on as in the host suite, and nothing
/// is built twice.
fn workspace_tests(name: &str) -> Command {
    cargo(&["test", "--release", "--quiet", "--workspace", "--exclude", "tesaki-firmware", "--test", name])
}

/// Runs all tests; skips nothing.
pub fn run() -> Result<()> {
    let start = Instant::now();
    let step = |text: &str| eprintln!("\n── {text} ({:.0} s)", start.elapsed().as_secs_f64());

    step("tools for recordings and for the emulated board");
    let python = tools::provide_rosbags(&out("rosbags"))?;
    tools::provide_qemu()?;
    let compiler = ArmCompiler::provide()?;

    step("format and lints");
    tools::run(&mut cargo(&["fmt", "--all", "--check"]))?;
    let clippy =
        ["clippy", "--release", "--quiet", "--workspace", "--exclude", "tesaki-firmware", "--all-targets"];
    tools::run(cargo(&clippy).args(["--", "-D", "warnings"]))?;

    step("the control core, with overflow checks");
    tools::run(&mut cargo(&["test", "--quiet", "-p", "tesaki"]))?;

    step("the host suite");
    tools::run(&mut cargo(&["test", "--release", "--quiet", "--workspace", "--exclude", "tesaki-firmware"]))?;

    step("other programs: rosbags reads recordings, the example client moves a joint");
    for name in ["recording", "cli"] {
        let mut tests = workspace_tests(name);
        tools::run(tests.env("TESAKI_PYTHON", &python).args(["--", "--ignored"]))?;
    }

    step("the firmware image");
    let image = firmware::build(compiler, firmware::IMAGE, &[])?;
    let selftest = firmware::build(compiler, "selftest", &["on-target"])?;
    let replay = firmware::build(compiler, "replay", &["on-target"])?;

    step("unit tests on the emulated board");
    print!("{}", bench::semihosted(&selftest, &[])?);

    step("the image in QEMU against the control core on this machine");
    let replay = std::path::absolute(replay)?;
    for name in ["image", "boards"] {
        let mut tests = workspace_tests(name);
        tests.env("TESAKI_ELF", &image).env("TESAKI_REPLAY_ELF", &replay);
        tools::run(tests.args(["--", "--ignored", "--test-threads", "2"]))?;
    }

    step("executed instructions on the emulated Cortex-M4F");
    bench::check(compiler)?;

    step("the image");
    // The simulator that the host suite has built; `cargo run` would build it again, with the features of it alone.
    firmware::report(&image, Command::new(firmware::target().join("release").join("host-sim")))?;
    println!("\nall tests passed in {:.1} min", start.elapsed().as_secs_f64() / 60.0);
    Ok(())
}
