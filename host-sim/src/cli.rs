//! The command line.

mod chip;
mod faults;
mod interrupt;
mod papers;
mod render_knob;
mod run;
#[cfg(unix)]
mod serve;
mod speed;
mod view;

use std::error::Error;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Args, Parser, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use tesaki_description::robot::RobotFolder;
use tesaki_description::spelling::meant;
use tesaki_output::say;
use tesaki_sim::scenario::{Impossible, Kind, SCENARIOS, Scenario};

const EXIT_CODES: &str = "Exit codes: 0, done, or nobody reads the output any more; 1, a limit or a rule is broken; \
2, an error, which standard error tells";

/// Run the control core against simulated robots; without a command, a short demonstration
#[derive(Parser)]
#[command(version, after_help = EXIT_CODES, bin_name = "cargo sim")]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// List the scenarios
    List,
    /// Run a scenario: prints a table of results, writes CSV, JSON and a page with figures
    Run(run::Run),
    /// List the limits of a scenario that are not demanded of a machine, because its torque or
    /// friction leaves no room for them; runs nothing
    Limits(Limits),
    /// Measure how many seconds of a machine one core simulates per second
    Speed(speed::Speed),
    /// Draw the figures of the papers anew, for the pages in docs/papers/
    Papers(papers::Papers),
    /// Run one finger of the three-finger hand on the image of `board-weact`, on the modelled chip of
    /// `chip/`: both servos through pulses, encoders and converters, against the simulated finger
    Chip(chip::Chip),
    /// Run seeded schedules of faults, judged by an oracle of safety; see docs/fault-schedules.md
    Faults(faults::Faults),
    /// Render what a hand-eye camera sees of a door knob: a PNG for each seed, or with --views many of one
    /// door and a table for `tesaki calibrate camera`; one JSON line for each with the truth
    RenderKnob(render_knob::RenderKnob),
    /// Serve a simulated board in real time on a pseudo-terminal and a socket, for `tesaki` and other
    /// supervisors
    #[cfg(unix)]
    #[command(after_help = format!("Commands on standard input while it runs:\n{}", tesaki_sim::serve::COMMANDS))]
    Serve(serve::Serve),
}

#[derive(Args)]
struct Limits {
    /// Name of the scenario, see `cargo sim list`
    scenario: String,
    /// Seed of the machine, or a range such as 1-20
    #[arg(long, default_value = "1", value_parser = seeds, allow_hyphen_values = true)]
    seed: RangeInclusive<u64>,
    /// Print one JSON object per seed: the metrics, each with the reason; null if that is not computed
    #[arg(long)]
    json: bool,
    /// Robot folder; default: that of the scenario
    #[arg(long)]
    robot: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ControllerKind {
    /// In this process
    Native,
    /// In the firmware image, on an emulated STM32F405. `run` compares each tick with the core in this
    /// process; `serve` keeps the amplifiers' torque constants of the folder whatever model is pushed
    Qemu,
}

impl ControllerKind {
    const fn name(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Qemu => "qemu",
        }
    }
}

fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("{text:?} is not a seed: expected one number, such as 7"))
}

/// Most seeds of a run: more is a typing error.
const MAX_SEEDS: u64 = 100_000;

fn seeds(text: &str) -> Result<RangeInclusive<u64>, String> {
    let number = |number: &str| {
        number
            .parse::<u64>()
            .map_err(|_| format!("{text:?} is not a seed: expected a number or a range, such as 7 or 1-20"))
    };
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let (first, last) = (number(first)?, number(last)?);
    match last.checked_sub(first) {
        None => Err(format!("{text}: the first seed is larger than the last")),
        Some(more) if more >= MAX_SEEDS => Err(format!("{text}: expected at most {MAX_SEEDS} seeds")),
        Some(_) => Ok(first..=last),
    }
}

fn default_image() -> PathBuf {
    target().join("thumbv7em-none-eabihf/firmware/tesaki-firmware-board-bare")
}

/// Where cargo builds.
fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace().join("target"), PathBuf::from)
}

/// The checkout that this program was built from, relative to the current folder.
fn workspace() -> PathBuf {
    shown(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")))
}

/// Runs the command of the command line; `false` if a metric failed.
pub fn run() -> Result<bool, Box<dyn Error>> {
    match read().command {
        None => demonstrate(),
        Some(Command::List) => {
            say!("Scenarios; run one with `cargo sim run NAME`:\n");
            let width = SCENARIOS.iter().map(|scenario| scenario.name.len()).max().unwrap_or_default();
            for scenario in SCENARIOS {
                say!("  {:<width$}  {} ({} s simulated)", scenario.name, scenario.about, scenario.duration);
            }
            Ok(true)
        }
        Some(Command::Run(options)) => run::run(&options),
        Some(Command::Papers(options)) => papers::run(&options).map(|()| true),
        Some(Command::Limits(options)) => tell_limits(&options).map(|()| true),
        Some(Command::Speed(options)) => speed::run(&options).map(|()| true),
        Some(Command::Chip(options)) => chip::run(&options),
        Some(Command::Faults(options)) => faults::run(&options),
        Some(Command::RenderKnob(options)) => render_knob::run(&options).map(|()| true),
        #[cfg(unix)]
        Some(Command::Serve(options)) => serve::run(&options).map(|()| true),
    }
}

/// The command line of this process; ends it where that is wrong.
fn read() -> Cli {
    Cli::try_parse().unwrap_or_else(|mut error| {
        let text = |value: &ContextValue| value.to_string().contains("<SCENARIO>");
        if error.kind() == ErrorKind::MissingRequiredArgument
            && error.get(ContextKind::InvalidArg).is_some_and(text)
        {
            let tip = "name a scenario, such as hand3-servo; `cargo sim list` shows all".into();
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip]));
        }
        error.exit()
    })
}

fn demonstrate() -> Result<bool, Box<dyn Error>> {
    say!(
        "A simulated three-finger hand with nine joints. Friction, noise and masses differ from the controller's\n\
         model. The control core is the one that runs on the joint-controller board.\n"
    );
    let passed = run::run(&run::Run::plain(SCENARIOS[0].name))?;
    say!(
        "\nTry next:\n\
         \x20 cargo sim list                                       the other scenarios\n\
         \x20 cargo sim run hand3-servo --seed 1-20                twenty different machines\n\
         \x20 cargo xtask firmware                                 build the image for the board; then\n\
         \x20 cargo sim run hand3-servo --controller qemu          that image on an emulated board, bit for bit"
    );
    Ok(passed)
}

fn find_scenario(name: &str) -> Result<&'static Scenario, String> {
    Scenario::find(name).ok_or_else(|| {
        let names: Vec<_> = SCENARIOS.iter().map(|scenario| scenario.name).collect();
        let meant = meant(name, &names)
            .map_or_else(|| ".".to_owned(), |nearest| format!("; did you mean {nearest}?"));
        format!("no scenario {name:?}{meant} `cargo sim list` shows all")
    })
}

/// The folder of the scenario's robot, or the `other` one that is asked for.
fn robot_folder(scenario: &Scenario, other: Option<&Path>) -> Result<PathBuf, String> {
    match other {
        Some(_) if scenario.kind == Kind::None => {
            Err(format!("no robot takes part in {}; leave out --robot", scenario.name))
        }
        Some(other) => Ok(other.to_owned()),
        None => Ok(workspace().join("robots").join(scenario.robot)),
    }
}

fn tell_limits(options: &Limits) -> Result<(), Box<dyn Error>> {
    let scenario = find_scenario(&options.scenario)?;
    let robot = robot_folder(scenario, options.robot.as_deref())?;
    // Not every scenario reads it.
    RobotFolder::load(&robot)?;
    for seed in options.seed.clone() {
        let impossible = scenario.impossible(&robot, seed)?;
        if options.json {
            let metrics = |limits: Vec<Impossible>| {
                limits.into_iter().map(|limit| (limit.metric, limit.why.into())).collect()
            };
            let metrics: Option<serde_json::Map<_, serde_json::Value>> = impossible.map(metrics);
            say!("{}", serde_json::json!({ "seed": seed, "impossible": metrics }));
            continue;
        }
        match impossible.as_deref() {
            None => {
                say!("seed {seed}: not computed for {}", scenario.name)
            }
            Some([]) => say!("seed {seed}: there is room for every limit"),
            Some(limits) => {
                limits.iter().for_each(|limit| say!("seed {seed}: {}: {}", limit.metric, limit.why))
            }
        }
    }
    Ok(())
}

/// The path relative to the current folder.
fn shown(path: &Path) -> PathBuf {
    let Ok(path) = path.canonicalize() else { return path.to_owned() };
    let here = std::env::current_dir().unwrap_or_default();
    match path.strip_prefix(here) {
        Ok(relative) if relative.as_os_str().is_empty() => PathBuf::from("."),
        Ok(relative) => relative.to_owned(),
        Err(_) => path,
    }
}

/// An error of a file, with the file.
fn of_file<E: Display>(path: &Path) -> impl FnOnce(E) -> String + '_ {
    move |error| format!("{}: {error}", path.display())
}

fn progress_bar(name: &str) -> ProgressBar {
    // Drawn only on a terminal.
    let bar = ProgressBar::new(1000).with_message(name.to_owned());
    if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent:>3} %  {eta} left") {
        bar.set_style(style);
    }
    bar
}
