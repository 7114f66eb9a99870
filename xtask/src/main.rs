//! `cargo xtask`: the one way in, for people and for automatic checks.

mod bench;
mod chip;
mod commit;
mod faults;
mod firmware;
mod footprint;
mod fuzz;
mod prove;
mod python;
mod results;
mod ros2;
mod sweep;
mod test;
mod tools;
mod viewer;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use tesaki_output::note;

/// Builds, tests and measures tesaki.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Run every test there is, those on the emulated board included; installs what is missing where it can
    Test(test::Options),
    /// Build the firmware image of a board; print what takes its flash, its RAM, worst stack and SHA-256
    Firmware(firmware::Options),
    /// Prove from the instructions of the images: no panic, no recursion, bounded stack
    Prove(prove::Options),
    /// Try the images of the boards that drive motors on a model of their chip
    Chip,
    /// Run scenarios on many machines; record, check and tabulate the results
    Sweep(sweep::Options),
    /// Run seeded schedules of faults; record and check what the oracle of safety finds
    Faults(faults::Options),
    /// Let libFuzzer look for inputs that break the control core or the readers of files
    Fuzz(fuzz::Options),
    /// Make the page that shows a robot from its sources, or try it in a browser
    Viewer(viewer::Options),
    /// Build the Python package and run its tests, or measure its speed
    Python(python::Options),
    /// Build the ROS 2 node and try it with Cyclone DDS as the other side
    Ros2(ros2::Options),
    /// Measure executed instructions on the emulated Cortex-M4F, and the speed of the simulation
    Bench(bench::Options),
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        // Where in this program it was found that another one failed is of no use to anybody.
        Err(error) => {
            note!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> anyhow::Result<()> {
    let Cli { task } = Cli::parse();
    // All paths below are relative to the workspace.
    std::env::set_current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))?;
    match task {
        Task::Test(options) => test::run(&options),
        Task::Firmware(options) => firmware::run(&options),
        Task::Prove(options) => prove::run(&options),
        Task::Chip => chip::run(),
        Task::Bench(options) => bench::run(&options),
        Task::Sweep(options) => sweep::run(options),
        Task::Faults(options) => faults::run(options),
        Task::Fuzz(options) => fuzz::run(&options),
        Task::Python(options) => python::run(&options),
        Task::Ros2(options) => ros2::run(&options),
        Task::Viewer(options) => viewer::run(&options),
    }
}

/// A path among the arguments, which is relative to where the user is.
fn given_path(text: &str) -> std::io::Result<std::path::PathBuf> {
    std::path::absolute(text)
}
