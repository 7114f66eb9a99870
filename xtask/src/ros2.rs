//! `cargo xtask ros2`: the ROS 2 node, with Cyclone DDS as the other side.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::Result;
use tesaki_output::say;

use crate::test::out;
use crate::{firmware, test, tools};

/// A workspace of its own: nothing else is built any slower for the DDS in it. It is built where everything
/// is, with what others have built.
const FOLDER: &str = "ros2";
/// What its tests need, as pip calls it.
const PACKAGES: &[&str] = &["cyclonedds>=11,<12", "numpy>=2,<3", "pytest>=8,<10"];

/// Options of `cargo xtask ros2`.
#[derive(clap::Args)]
pub struct Options {
    /// For how long joint states are received at least [s]
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
}

/// Builds everything and runs the tests.
pub fn run(options: &Options) -> Result<()> {
    let binaries = ["build", "--release", "--quiet", "-p", "tesaki-supervisor", "-p", "tesaki-sim"];
    tools::run(&mut test::cargo(&binaries))?;
    check(options)
}

/// The same with the programs that are built.
pub fn check_built() -> Result<()> {
    check(&Options { seconds: 5.0 })
}

fn check(options: &Options) -> Result<()> {
    let start = Instant::now();
    let python = tools::provide_python(&out("ros2"), PACKAGES, "cyclonedds, numpy, pytest")?;
    let target = std::path::absolute(firmware::target())?;
    let cargo = |arguments: &[&str]| {
        let mut command = test::cargo(arguments);
        command.current_dir(FOLDER).env("CARGO_TARGET_DIR", &target);
        command
    };
    tools::run(&mut cargo(&["fmt", "--check"]))?;
    let all = ["clippy", "--release", "--quiet", "--all-targets", "--", "-D", "warnings"];
    tools::run(&mut cargo(&all))?;
    tools::run(&mut cargo(&["test", "--release", "--quiet"]))?;
    tools::run(&mut cargo(&["build", "--release", "--quiet"]))?;
    let release = target.join("release");
    let mut tests = Command::new(python);
    tests.args(["-m", "pytest", "--quiet", "-p", "no:cacheprovider", "-rP", "--no-header"]);
    tests.arg(Path::new(FOLDER).join("tests")).env("PYTHONDONTWRITEBYTECODE", "1");
    tests.env("TESAKI_SIM", release.join("host-sim")).env("TESAKI", release.join("tesaki"));
    tests.env("TESAKI_ROS2", release.join("tesaki-ros2"));
    tests.env("TESAKI_ROS2_SECONDS", options.seconds.to_string());
    tools::run(&mut tests)?;
    say!("{:.0} s for the ROS 2 node", start.elapsed().as_secs_f64());
    Ok(())
}
