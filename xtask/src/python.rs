//! The Python package: built from the tree, tried and measured from Python.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use anyhow::{Context, Result};

use crate::test::out;
use crate::{firmware, test, tools};

/// What the tests of the package need, as pip calls it.
const PACKAGES: &[&str] = &["numpy>=2,<3", "gymnasium>=1,<2", "mcap>=1.2,<2", "pytest>=8,<10"];

/// Where the package lies in the tree.
const SOURCE: &str = "python";

/// Options of `cargo xtask python`.
#[derive(clap::Args)]
pub struct Options {
    /// Measure its speed in place of testing it
    #[arg(long)]
    speed: bool,
}

/// Tests the package, or measures its speed, which belongs to no test: other programs take time, too.
pub fn run(options: &Options) -> Result<()> {
    if options.speed {
        tools::run(build()?.arg(Path::new(SOURCE).join("tests/benchmark.py")))
    } else {
        check()
    }
}

/// Runs the package's tests.
pub fn check() -> Result<()> {
    let mut tests = build()?;
    tests.args(["-m", "pytest", "--quiet", "-p", "no:cacheprovider"]).arg(Path::new(SOURCE).join("tests"));
    tools::run(&mut tests)
}

/// Builds the extension and puts the package together as its wheel does; a Python that imports it.
///
/// Not by maturin, which builds a package with the features that it needs alone: every dependency would be
/// compiled a second time. The selection of all other builds here gives the same library in seconds.
fn build() -> Result<Command> {
    let python = tools::provide_python(&out("python"), PACKAGES, "numpy, gymnasium, mcap, pytest")?;
    tools::run(test::cargo(&["build"]).args(test::HOST).args(["--lib", "--bin", "host-sim"]))?;
    let release = firmware::target().join("release");
    let package = out("python-package");
    assemble(&release.join("lib_tesaki.so"), &package.join("tesaki"))?;
    let mut command = Command::new(python);
    command.env("PYTHONPATH", env::current_dir()?.join(&package)).env("PYTHONDONTWRITEBYTECODE", "1");
    command.env("TESAKI_SIM", std::path::absolute(release.join("host-sim"))?);
    Ok(command)
}

/// The package in `folder`: its Python files, the robots, and the extension.
fn assemble(extension: &Path, folder: &Path) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder)?;
    }
    copy(&Path::new(SOURCE).join("tesaki"), folder)?;
    let place = folder.join("_tesaki.abi3.so");
    fs::copy(extension, &place).with_context(|| format!("cannot copy {}", extension.display()))?;
    Ok(())
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from).with_context(|| format!("cannot read {}", from.display()))? {
        let path: PathBuf = entry?.path();
        let Some(place) = path.file_name().map(|name| to.join(name)) else { continue };
        if path.is_dir() {
            copy(&path, &place)?;
        } else {
            fs::copy(&path, place)?;
        }
    }
    Ok(())
}
