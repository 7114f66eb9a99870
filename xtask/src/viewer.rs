//! `cargo xtask viewer`: the page that shows a robot, from its sources and in a browser.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::sweep::Simulator;
use crate::test::out;
use crate::tools;

const EXAMPLES: &str = "Examples:
  cargo xtask viewer           after a change in viewer/web: makes viewer/bundle anew
  cargo xtask viewer --check   compares the bundle with its sources, and tries the page in a browser
  cargo xtask viewer --film    the animated picture of README.md";

/// Where the sources of the page are.
const WEB: &str = "viewer/web";

/// Options of `cargo xtask viewer`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Options {
    /// Compare the bundle with its sources, and try the page in Chromium
    #[arg(long)]
    check: bool,
    /// Make docs/hand3-turn.gif: the box being turned, as in the replay of a report
    #[arg(long, conflicts_with = "check")]
    film: bool,
}

/// Makes the bundle, the film, or checks them.
pub fn run(options: &Options) -> Result<()> {
    let binaries = ["build", "--release", "--quiet", "--bin", "tesaki", "--bin", "host-sim"];
    if options.check || options.film {
        tools::run(Command::new("cargo").args(binaries))?;
    }
    match options {
        Options { check: true, .. } => check_built(),
        Options { film: true, .. } => film(),
        _ => {
            provide_packages()?;
            npm(&["run", "build"])
        }
    }
}

/// Compares the bundle with its sources and tries the page in a browser, with the programs that are built.
pub fn check_built() -> Result<()> {
    provide_packages()?;
    tools::provide_chromium()?;
    npm(&["run", "check"])?;
    npm(&["test"])
}

fn film() -> Result<()> {
    provide_packages()?;
    tools::provide_chromium()?;
    let folder = out("film");
    let mut host_sim = Simulator::built().command();
    tools::run(host_sim.args(["run", "hand3-turn", "--seed", "1", "--out"]).arg(&folder))?;
    let report = std::path::absolute(folder.join("hand3-turn/index.html"))?;
    let mut node = Command::new("node");
    node.arg(format!("{WEB}/film.mjs")).arg(report).args(["docs/hand3-turn.gif", "1", "21", "2"]);
    tools::run(&mut node)
}

/// What `package-lock.json` says, installed unless it already is.
fn provide_packages() -> Result<()> {
    tools::provide_node()?;
    let time = |path: &str| Path::new(WEB).join(path).metadata().and_then(|file| file.modified()).ok();
    let (lock, installed) = (time("package-lock.json"), time("node_modules/.package-lock.json"));
    if installed.is_some() && installed >= lock {
        return Ok(());
    }
    npm(&["ci", "--no-audit", "--no-fund"])
        .context("npm could not install what the page is made of: is there a way to registry.npmjs.org?")
}

fn npm(arguments: &[&str]) -> Result<()> {
    tools::run(Command::new("npm").args(["--prefix", WEB, "--silent"]).args(arguments))
}
