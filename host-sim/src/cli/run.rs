//! `host-sim run`.

use std::error::Error;
use std::io::IsTerminal;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::Args;
use sha2::{Digest, Sha256};
use tesaki_description::robot::RobotFolder;
use tesaki_output::{note, say};
use tesaki_sim::controller::{Controller, Native, Watched};
use tesaki_sim::law::LawFile;
use tesaki_sim::live_run::LiveRun;
use tesaki_sim::qemu::Qemu;
use tesaki_sim::report::{Metric, Page, Summary, Verdict, create, figure_files, table, write};
use tesaki_sim::scenario::{Outcome, Scenario, Setting, encode_record};
use tesaki_supervisor::Board;

use super::{ControllerKind, default_image, find_scenario, progress_bar, seeds, view, workspace};

#[derive(Args)]
pub struct Run {
    /// Name of the scenario, see `host-sim list`
    scenario: String,
    /// Where the control core runs
    #[arg(long, value_enum, default_value_t = ControllerKind::Native)]
    pub(super) controller: ControllerKind,
    /// Seed of the machine's deviations and noise; a range such as 1-20 runs all of them in turn
    #[arg(long, default_value = "1", value_parser = seeds)]
    pub(super) seed: RangeInclusive<u64>,
    /// Simulated time [s]; default: that of the scenario
    #[arg(long)]
    duration: Option<f64>,
    /// Folder for the results
    #[arg(long, default_value_os_t = PathBuf::from("out"))]
    out: PathBuf,
    /// Print one JSON object per seed instead of the table
    #[arg(long)]
    json: bool,
    /// Show the run on a page in a browser while it is computed, and until Ctrl-C. The page is at an address
    /// of this machine alone: HOST:PORT
    #[arg(
        long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true,
        default_missing_value = view::ADDRESS, value_parser = view::address, conflicts_with = "json"
    )]
    view: Option<SocketAddr>,
    /// Robot folder; default: that of the scenario
    #[arg(long)]
    robot: Option<PathBuf>,
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
}

/// Runs a scenario on each seed; `false` if a metric failed.
pub fn run(options: &Run) -> Result<bool, Box<dyn Error>> {
    let scenario = find_scenario(&options.scenario)?;
    create(&options.out)?;
    match options.view {
        Some(address) => view::run(scenario, options, address),
        None => compute(scenario, options, None),
    }
}

/// Runs all seeds and saves the report; `false` if a metric failed.
pub(super) fn compute(
    scenario: &Scenario,
    options: &Run,
    live: Option<&LiveRun>,
) -> Result<bool, Box<dyn Error>> {
    let mut summaries = Vec::new();
    let mut written = None;
    for seed in options.seed.clone() {
        let (summary, outcome, record) = run_seed(scenario, options, seed, live)?;
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
            say!("Report: {}", page.display());
        }
    }
    Ok(passed)
}

pub(super) fn robot_folder(scenario: &Scenario, options: &Run) -> PathBuf {
    options.robot.clone().unwrap_or_else(|| workspace().join("robots").join(scenario.robot))
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
    let robot = robot_folder(scenario, options);
    let laws = LawFile::find(scenario, &robot, &options.law)?;
    let (mut native, mut qemu);
    let controller: &mut dyn Controller = match options.controller {
        ControllerKind::Native => {
            native = Native::default();
            &mut native
        }
        ControllerKind::Qemu => {
            qemu = Qemu::boot(&options.elf)?;
            &mut qemu
        }
    };
    let in_qemu = options.controller == ControllerKind::Qemu;
    let mut watched = Watched::new(controller, in_qemu);
    let mut setting = Setting {
        robot: &robot,
        controller: &mut watched,
        seed,
        duration: options.duration.unwrap_or(scenario.duration),
        laws: &laws,
        progress: &progress,
        intervention: None,
        live,
    };
    let outcome = scenario.run(&mut setting)?;
    outcome.motion.show_last();
    let mut summary = outcome.summary.clone();
    summary.controller = options.controller.name().to_owned();
    summary = summary.frames_sha256(watched.frames_sha256());
    if in_qemu {
        let board = watched.status()?.board;
        let stack =
            Metric::at_most("Stack used on the board", board.stack_used.into(), board.stack_size.into(), "B");
        summary.insert("stack_used", stack);
        let lost = board.plant.frames;
        let damaged =
            lost.overlong + lost.framing + lost.checksum + lost.malformed + board.plant.receive_overflow;
        summary.insert(
            "plant_link_damage",
            Metric::at_most("Damaged plant-link frames", damaged.into(), 0.0, ""),
        );
        let digest = Sha256::digest(std::fs::read(&options.elf)?);
        summary = summary.elf_sha256(digest.iter().map(|byte| format!("{byte:02x}")).collect::<String>());
    }
    if let Some(identical) = watched.identical() {
        summary = summary.identical(identical);
    }
    if let Some((tick, board, here)) = &watched.difference {
        note!("first difference in tick {tick}:\n  board {board:?}\n  here  {here:?}");
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
    let dir = options.out.join(scenario.name);
    let lines: Vec<String> = summaries.iter().map(serde_json::to_string).collect::<Result<_, _>>()?;
    let json = lines.join("\n") + "\n";
    let command = format!(
        "cargo sim run {} --controller {} --seed {}",
        scenario.name,
        options.controller.name(),
        if options.seed.start() == options.seed.end() {
            options.seed.start().to_string()
        } else {
            format!("{}-{}", options.seed.start(), options.seed.end())
        }
    );
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
    let page = Page::new(scenario.title, summaries)
        .lead(scenario.lead)
        .figures(&outcome.figures)
        .command(&command)
        .files(&names);
    let folder = robot_folder(scenario, options);
    let replay = replay(&folder, outcome)?;
    let page = replay.as_deref().map_or(page.clone(), |replay| page.replay(replay));
    let html = commit.as_deref().map_or(page.clone(), |commit| page.commit(commit)).html();
    let mut files = vec![("summary.json", json.as_str()), ("index.html", html.as_str())];
    files.extend(outcome.tables.iter().map(|(name, text)| (name.as_str(), text.as_str())));
    write(&dir, &files)?;
    write(&dir.join("figures"), &figure_files(&outcome.figures))?;
    std::fs::write(dir.join("frames.log"), record)?;
    let urdf = std::fs::read_to_string(folder.join("robot.urdf"))?;
    outcome.motion.write(&dir.join("recording.mcap"), &urdf)?;
    Ok(std::path::absolute(dir.join("index.html"))?)
}
