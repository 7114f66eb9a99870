//! `host-sim run`.

use std::error::Error;
use std::io::IsTerminal;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::Args;
use sha2::{Digest, Sha256};
use tesaki_description::read_text;
use tesaki_description::robot::RobotFolder;
use tesaki_output::{note, quoted, say};
use tesaki_sim::controller::{Controller, Native, Watched};
use tesaki_sim::law::LawFile;
use tesaki_sim::live_run::LiveRun;
use tesaki_sim::qemu::{Machine, Qemu};
use tesaki_sim::report::{Figure, Metric, Page, Summary, Verdict, create, figure_files, table, write};
use tesaki_sim::scenario::{Outcome, Scenario, Setting, encode_record};
use tesaki_supervisor::Board;

use super::interrupt::{self, Interruptible};
use super::{
    ControllerKind, default_image, find_scenario, of_file, progress_bar, robot_folder, seeds, view, workspace,
};

#[derive(Args)]
pub struct Run {
    /// Name of the scenario, see `cargo sim list`
    scenario: String,
    /// Where the control core runs
    #[arg(long, value_enum, default_value_t = ControllerKind::Native)]
    pub(super) controller: ControllerKind,
    /// Seed of the machine's deviations and noise; a range such as 1-20 runs all of them in turn
    #[arg(long, default_value = "1", value_parser = seeds, allow_hyphen_values = true)]
    pub(super) seed: RangeInclusive<u64>,
    /// Simulated time [s]; default: that of the scenario. Most scenarios have no other
    #[arg(long, allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Folder for the results
    #[arg(long, default_value_os_t = PathBuf::from("out"))]
    out: PathBuf,
    /// Print one JSON object per seed instead of the table
    #[arg(long)]
    json: bool,
    /// Show the run on a page in a browser while it is computed, and until Ctrl-C. The page is at an address
    /// of this machine alone: HOST:PORT, localhost:7481 where none is given
    #[arg(
        long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true,
        default_missing_value = view::ADDRESS, value_parser = view::address, conflicts_with = "json"
    )]
    view: Option<SocketAddr>,
    /// Robot folder; default: that of the scenario
    #[arg(long)]
    pub(super) robot: Option<PathBuf>,
    /// Law to compare: a name in the robot's laws/, or a file; may be given more than once
    #[arg(long, value_name = "LAW")]
    law: Vec<String>,
    /// Firmware image for `--controller qemu`
    #[arg(long, env = "TESAKI_ELF", default_value_os_t = default_image())]
    elf: PathBuf,
}

impl Run {
    /// A scenario on the first machine, without any option.
    pub fn plain(scenario: &str) -> Self {
        Self {
            scenario: scenario.to_owned(),
            controller: ControllerKind::Native,
            seed: 1..=1,
            duration: None,
            out: PathBuf::from("out"),
            json: false,
            view: None,
            robot: None,
            law: Vec::new(),
            elf: default_image(),
        }
    }

    /// The command that gives the same numbers: with every option on which they depend, unless it is default.
    fn command(&self) -> String {
        let seed = if self.seed.start() == self.seed.end() {
            self.seed.start().to_string()
        } else {
            format!("{}-{}", self.seed.start(), self.seed.end())
        };
        let controller = self.controller.name();
        let mut command = format!("cargo sim run {} --controller {controller} --seed {seed}", self.scenario);
        let mut add = |option: &str, value: &str| command.extend([" --", option, " ", &quoted(value)]);
        if let Some(duration) = self.duration {
            add("duration", &duration.to_string());
        }
        if let Some(robot) = &self.robot {
            add("robot", &robot.display().to_string());
        }
        self.law.iter().for_each(|law| add("law", law));
        if self.controller == ControllerKind::Qemu && self.elf != default_image() {
            add("elf", &self.elf.display().to_string());
        }
        command
    }
}

/// A robot of the user's in a scenario that was made for another one.
pub(super) struct OtherRobot {
    name: String,
    joints: usize,
}

impl OtherRobot {
    /// `None` for the robot of the scenario, and for a changed copy, which keeps its name.
    ///
    /// # Errors
    /// The folder is wrong.
    pub fn of(scenario: &Scenario, options: &Run) -> Result<Option<Self>, Box<dyn Error>> {
        let Some(folder) = &options.robot else { return Ok(None) };
        let model = RobotFolder::load(folder)?.model;
        let other = Self { name: model.name.to_string(), joints: model.joints.len() };
        Ok((other.name != scenario.robot).then_some(other))
    }

    /// The title of the report.
    pub fn title(&self, scenario: &Scenario) -> String {
        format!("{} with {}, {}", scenario.name, self.name, self.count())
    }

    fn count(&self) -> String {
        format!("{} joint{}", self.joints, if self.joints == 1 { "" } else { "s" })
    }

    fn lead(&self, scenario: &Scenario) -> String {
        format!(
            "The motion of the scenario {}, which is made for {}, with the robot {} of {}. No limit is set for this \
             robot: the values here are reported, and none passes or fails. Captions of the scenario are those of {}.",
            scenario.name,
            scenario.robot,
            self.name,
            self.count(),
            scenario.robot
        )
    }
}

/// Runs a scenario on each seed; `false` if a metric failed.
pub fn run(options: &Run) -> Result<bool, Box<dyn Error>> {
    let scenario = find_scenario(&options.scenario)?;
    create(&options.out)?;
    if options.controller == ControllerKind::Qemu {
        // It would outlive this program, in its folder, if a signal ended the run.
        interrupt::handle()?;
    }
    match options.view {
        Some(address) => view::run(scenario, options, address),
        None => interrupt::told(compute(scenario, options, None)),
    }
}

/// Runs all seeds and saves the report, also of those before one that errs; `false` if a metric failed.
pub(super) fn compute(
    scenario: &Scenario,
    options: &Run,
    live: Option<&LiveRun>,
) -> Result<bool, Box<dyn Error>> {
    let mut summaries = Vec::new();
    let (mut written, mut failed) = (None, None);
    for seed in options.seed.clone() {
        let (summary, outcome, record) = match run_seed(scenario, options, seed, live) {
            Ok(result) => result,
            // What came to its end is not lost.
            Err(error) if !summaries.is_empty() => {
                failed = Some(format!("seed {seed}: {error}; it and those after it are not in the report"));
                break;
            }
            Err(error) => return Err(error),
        };
        if options.json {
            say!("{}", serde_json::to_string(&summary)?);
        }
        summaries.push(summary);
        // Figures and recordings are those of the first seed; the other seeds only enter the table.
        written.get_or_insert((outcome, record));
    }
    let passed = summaries.iter().all(Summary::pass);
    if let Some((outcome, record)) = written {
        let page = save(scenario, options, &summaries, &outcome, &record)?;
        if let (Some(live), [summary], Some(folder)) = (live, summaries.as_slice(), page.parent()) {
            live.end(Verdict::of(summary), folder);
        }
        if !options.json {
            let colour = std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
            say!("{}", table(&summaries, colour));
            if !passed {
                say!("How many machines meet the limits: {}", scenario.results);
            }
            say!("Report: {}", page.display());
        }
    }
    failed.map_or(Ok(passed), |error| Err(error.into()))
}

type SeedResult = (Summary, Outcome, Vec<u8>);

fn run_seed(
    scenario: &Scenario,
    options: &Run,
    seed: u64,
    live: Option<&LiveRun>,
) -> Result<SeedResult, Box<dyn Error>> {
    let bar = progress_bar(&format!("{} seed {seed}", scenario.name));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1000")]
    let progress = |fraction: f64| bar.set_position((fraction * 1000.0) as u64);
    let robot = robot_folder(scenario, options.robot.as_deref())?;
    scenario.check_robot(&robot)?;
    let laws = LawFile::find(scenario, &robot, &options.law)?;
    let (mut native, mut qemu, mut interruptible);
    let controller: &mut dyn Controller = match options.controller {
        ControllerKind::Native => {
            native = Native::default();
            &mut native
        }
        ControllerKind::Qemu => {
            qemu = Qemu::boot(&options.elf, &Machine { own_group: true, ..Machine::default() })?;
            interruptible = Interruptible(&mut qemu);
            &mut interruptible
        }
    };
    let in_qemu = options.controller == ControllerKind::Qemu;
    let mut watched = Watched::new(controller, in_qemu);
    let duration = options.duration.unwrap_or(scenario.duration);
    let plain = Setting::plain(&robot, &mut watched, seed, duration);
    let mut setting = Setting { laws: &laws, progress: &progress, live, ..plain };
    let mut outcome = scenario.run(&mut setting)?;
    outcome.motion.show_last();
    let mut summary = outcome.summary.clone();
    if OtherRobot::of(scenario, options)?.is_some() {
        summary.waive_all(&format!(
            "no limit is set for this robot: those of {} are for {}",
            scenario.name, scenario.robot
        ));
        outcome.figures = outcome.figures.into_iter().map(Figure::without_limits).collect();
    }
    summary.controller = options.controller.name().to_owned();
    if in_qemu {
        let board = watched.status()?.board;
        let stack =
            Metric::at_most("Stack used on the board", board.stack_used.into(), board.stack_size.into(), "B");
        summary.insert("stack_used", stack);
        let damaged = board.plant.frames.damaged() + board.plant.receive_overflow;
        summary.insert(
            "plant_link_damage",
            Metric::at_most("Damaged plant-link frames", damaged.into(), 0.0, ""),
        );
        let digest = Sha256::digest(std::fs::read(&options.elf).map_err(of_file(&options.elf))?);
        summary = summary.elf_sha256(format!("{digest:x}"));
    }
    if let Some(identical) = watched.identical() {
        summary = summary.identical(identical);
    }
    if let Some((tick, board, here)) = &watched.difference {
        note!("first difference in tick {tick}:\n  board {board:?}\n  here  {here:?}");
    } else if watched.identical() == Some(false) {
        note!("the frames of all ticks are the same, but replies to requests differ");
    }
    bar.finish_and_clear();
    Ok((summary, outcome, encode_record(&watched.into_record())?))
}

/// The commit of the checkout that this program was built from, if git knows it.
fn commit() -> Option<String> {
    let arguments = ["describe", "--always", "--dirty", "--abbrev=12"];
    let output =
        std::process::Command::new("git").arg("-C").arg(workspace()).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// The motion of a run for its page; `None` where nothing moved.
fn replay(robot: &Path, outcome: &Outcome) -> Result<Option<String>, Box<dyn Error>> {
    if outcome.motion.ticks() == 0 {
        return Ok(None);
    }
    let robot = RobotFolder::load(robot)?;
    let scene = tesaki_viewer::Scene::new(&robot.model).with_solids(&robot.urdf);
    Ok(Some(tesaki_viewer::script_json(&outcome.motion.replay(scene))?))
}

fn save(
    scenario: &Scenario,
    options: &Run,
    summaries: &[Summary],
    outcome: &Outcome,
    record: &[u8],
) -> Result<PathBuf, Box<dyn Error>> {
    let folder = robot_folder(scenario, options.robot.as_deref())?;
    let other = OtherRobot::of(scenario, options)?;
    // Runs of another folder stand beside those of the scenario's own.
    let name = options.robot.as_ref().and_then(|_| folder.canonicalize().ok());
    let name = name.as_ref().and_then(|folder| folder.file_name()).map(|name| name.to_string_lossy());
    let dir = match name.filter(|name| *name != scenario.robot) {
        Some(name) => options.out.join(format!("{}-{name}", scenario.name)),
        None => options.out.join(scenario.name),
    };
    let lines: Vec<String> = summaries.iter().map(serde_json::to_string).collect::<Result<_, _>>()?;
    let json = lines.join("\n") + "\n";
    let command = options.command();
    let mut names = vec![("summary.json", "measured values and limits, one JSON object per seed")];
    for (name, _) in &outcome.tables {
        names.push((name, "recorded values of the first seed, one row per control period"));
    }
    names.push((
        "recording.mcap",
        "the motion of the first seed with the robot's URDF and frames, for Foxglove, PlotJuggler, Rerun and ROS 2",
    ));
    names.push(("frames.log", "all inputs and outputs of the control core in the run of the first seed"));
    let commit = commit();
    let title = other.as_ref().map_or_else(|| scenario.title.to_owned(), |other| other.title(scenario));
    let lead = other.map(|other| other.lead(scenario));
    let own_lead = lead.as_deref().map(|lead| [lead]);
    let page = Page::new(&title, summaries)
        .lead(own_lead.as_ref().map_or(scenario.lead, |lead| lead.as_slice()))
        .figures(&outcome.figures)
        .command(&command)
        .files(&names);
    let replay = replay(&folder, outcome)?;
    let page = replay.as_deref().map_or(page.clone(), |replay| page.replay(replay));
    let html = commit.as_deref().map_or(page.clone(), |commit| page.commit(commit)).html();
    let mut files = vec![("summary.json", json.as_str()), ("index.html", html.as_str())];
    files.extend(outcome.tables.iter().map(|(name, text)| (name.as_str(), text.as_str())));
    write(&dir, &files)?;
    write(&dir.join("figures"), &figure_files(&outcome.figures))?;
    let log = dir.join("frames.log");
    std::fs::write(&log, record).map_err(of_file(&log))?;
    let urdf = folder.join("robot.urdf");
    let urdf = read_text(&urdf).map_err(of_file(&urdf))?;
    outcome.motion.write(&dir.join("recording.mcap"), &urdf)?;
    Ok(std::path::absolute(dir.join("index.html"))?)
}
