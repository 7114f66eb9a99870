//! `cargo xtask ros2`: the ROS 2 node, with Cyclone DDS as the other side.

use std::process::Command;
use std::time::Instant;

use anyhow::Result;
use tesaki_output::say;

use crate::test::out;
use crate::{firmware, test, tools};

/// What its tests need, as pip calls it.
const PACKAGES: &[&str] = &["cyclonedds>=11,<12", "numpy>=2,<3", "pytest>=8,<10"];

/// For how long joint states are received at least [s].
const SECONDS: f64 = 5.0;

/// Options of `cargo xtask ros2`.
#[derive(clap::Args)]
pub struct Options {
    /// For how long joint states are received at least [s]
    #[arg(long, default_value_t = SECONDS)]
    seconds: f64,
}

/// Runs the tests for as long as the checks do.
pub fn check() -> Result<()> {
    run(&Options { seconds: SECONDS })
}

/// Builds everything and runs the tests.
pub fn run(options: &Options) -> Result<()> {
    let start = Instant::now();
    let python = tools::provide_python(&out("ros2"), PACKAGES, "cyclonedds, numpy, pytest")?;
    let binaries = ["host-sim", "tesaki", "tesaki-ros2"].iter().flat_map(|name| ["--bin", name]);
    tools::run(test::cargo(&["build"]).args(test::HOST).args(binaries))?;
    let release = std::path::absolute(firmware::target().join("release"))?;
    let mut tests = Command::new(python);
    tests.args(["-m", "pytest", "--quiet", "-p", "no:cacheprovider", "-rP", "--no-header", "ros2/tests"]);
    tests.env("PYTHONDONTWRITEBYTECODE", "1");
    tests.env("TESAKI_SIM", release.join("host-sim")).env("TESAKI", release.join("tesaki"));
    tests.env("TESAKI_ROS2", release.join("tesaki-ros2"));
    tests.env("TESAKI_ROS2_SECONDS", options.seconds.to_string());
    tools::run(&mut tests)?;
    say!("{:.0} s for the ROS 2 node", start.elapsed().as_secs_f64());
    Ok(())
}
