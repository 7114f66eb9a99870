//! The command line.

mod papers;
mod render_knob;
mod view;

use std::error::Error;
use std::io::IsTerminal;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use sha2::{Digest, Sha256};
use tesaki::model::RobotModel;
use tesaki_description::approach;
use tesaki_description::robot::RobotFolder;
use tesaki_output::{note, say};
use tesaki_sim::camera::CameraValues;
use tesaki_sim::controller::{Controller, Native, Watched};
use tesaki_sim::door::{KnobDoor, hand_joints, hand_pose};
use tesaki_sim::faults::{self, Report, Schedule, Violation};
use tesaki_sim::law::LawFile;
use tesaki_sim::live_run::LiveRun;
use tesaki_sim::qemu::Qemu;
use tesaki_sim::report::{Metric, Page, Summary, Verdict, figure_files, table, write};
use tesaki_sim::scenario::{Outcome, SCENARIOS, Scenario, Setting, encode_record};
use tesaki_supervisor::Board;

const EXIT_CODES: &str = "Exit codes: 0, done, or nobody reads the output any more; 1, a limit or a rule is broken; \
2, an error, which standard error tells";

/// Runs the control core against simulated robots. Without a command, runs a short demonstration.
#[derive(Parser)]
#[command(version, about, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// List the scenarios
    List,
    /// Run a scenario: prints a table of results, writes CSV, JSON and a page with figures
    Run(Run),
    /// Tell for which limits of a scenario a machine leaves a controller no room, by its physics; runs nothing
    Limits(Limits),
    /// Draw the figures of the papers anew, for the pages in docs/papers/
    Papers(papers::Papers),
    /// Run seeded schedules of faults, judged by an oracle of safety; see docs/fault-schedules.md
    Faults(Faults),
    /// Render what a hand-eye camera sees of a door knob: a PNG for each seed, or with --views many of one door
    /// and a table for `tesaki calibrate camera`; one JSON line for each with the truth
    RenderKnob(render_knob::RenderKnob),
    /// Serve a simulated board in real time on a pseudo-terminal and a socket, for `tesaki` and other
    /// supervisors
    #[cfg(unix)]
    #[command(after_help = format!("Commands on standard input while it runs:\n{}", tesaki_sim::serve::COMMANDS))]
    Serve(Serve),
}

#[cfg(unix)]
#[derive(Args)]
struct Serve {
    /// Robot folder
    #[arg(long, default_value_os_t = workspace().join("robots/hand3"))]
    robot: PathBuf,
    /// Where the control core runs
    #[arg(long, value_enum, default_value_t = ControllerKind::Native)]
    controller: ControllerKind,
    /// Address for clients: unix://PATH or tcp://HOST:PORT; default: a new Unix socket
    #[arg(long, value_parser = tesaki_supervisor::port::Address::socket)]
    listen: Option<tesaki_supervisor::port::Address>,
    /// Key file for a TCP address that other machines reach; `tesaki key FILE` makes one
    #[arg(long, env = "TESAKI_KEY", value_name = "FILE")]
    key: Option<PathBuf>,
    /// Seed of the machine's deviations and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Start with the fingers open around the object of this grasp, for example robots/hand3/grasps/box.toml
    #[arg(long)]
    grasp: Option<PathBuf>,
    /// Object on a support at the pose that `--grasp` expects, for example robots/hand3/objects/box.toml
    #[arg(long, requires = "grasp")]
    object: Option<PathBuf>,
    /// Put the arm before a door with this seed: of its surfaces, its light, and of where it is. The robot needs
    /// camera.toml and approach.toml; the camera in its hand takes ten pictures a second
    #[arg(long, value_name = "SEED", conflicts_with = "grasp")]
    door: Option<u64>,
    /// Radius of the rose of that door [m]; default: 0.035 to 0.045, by the seed
    #[arg(long, value_name = "RADIUS", requires = "door", allow_negative_numbers = true)]
    rose: Option<f64>,
    /// Address for programs that want the pictures: unix://PATH or tcp://localhost:PORT; default: a new Unix
    /// socket
    #[arg(
        long, value_name = "ADDRESS", requires = "door", value_parser = tesaki_supervisor::port::Address::socket
    )]
    camera: Option<tesaki_supervisor::port::Address>,
    /// Firmware image for `--controller qemu`
    #[arg(long, env = "TESAKI_ELF", default_value_os_t = default_image())]
    elf: PathBuf,
}

#[derive(Args)]
struct Run {
    /// Name of the scenario, see `host-sim list`
    scenario: String,
    /// Where the control core runs
    #[arg(long, value_enum, default_value_t = ControllerKind::Native)]
    controller: ControllerKind,
    /// Seed of the machine's deviations and noise; a range such as 1-20 runs all of them in turn
    #[arg(long, default_value = "1", value_parser = seeds)]
    seed: RangeInclusive<u64>,
    /// Simulated time [s]; default: that of the scenario
    #[arg(long)]
    duration: Option<f64>,
    /// Folder for the results
    #[arg(long, default_value_os_t = PathBuf::from("out"))]
    out: PathBuf,
    /// Print one JSON object per seed instead of the table
    #[arg(long)]
    json: bool,
    /// Show the run on a page in a browser while it is computed, and until Ctrl-C. The page is at an address of this
    /// machine alone: HOST:PORT
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

#[derive(Args)]
struct Limits {
    /// Name of the scenario, see `host-sim list`
    scenario: String,
    /// Seed of the machine; a range such as 1-20 is about all of them
    #[arg(long, default_value = "1", value_parser = seeds)]
    seed: RangeInclusive<u64>,
    /// Print one JSON object per seed: the metrics, each with the reason
    #[arg(long)]
    json: bool,
    /// Robot folder; default: that of the scenario
    #[arg(long)]
    robot: Option<PathBuf>,
}

#[derive(Args)]
struct Faults {
    /// Seed of a schedule; a range such as 1-200 runs all of them in turn
    #[arg(long, default_value = "1", value_parser = seeds, conflicts_with = "schedule")]
    seeds: RangeInclusive<u64>,
    /// A schedule as JSON, as a failing one prints it
    #[arg(long)]
    schedule: Option<String>,
    /// Print a line for each tick
    #[arg(long)]
    trace: bool,
    /// Do not look for the smallest schedule that fails
    #[arg(long)]
    no_shrink: bool,
    /// Print one JSON object per seed
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ControllerKind {
    /// In this process
    Native,
    /// In the firmware image, on an emulated STM32F405; `run` compares each tick with the core in this process
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

fn seeds(text: &str) -> Result<RangeInclusive<u64>, String> {
    let number = |text: &str| {
        text.parse::<u64>()
            .map_err(|_| format!("{text:?} is not a seed: expected a number or a range, such as 7 or 1-20"))
    };
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let seeds = number(first)?..=number(last)?;
    if seeds.is_empty() { Err(format!("{text}: the first seed is larger than the last")) } else { Ok(seeds) }
}

fn default_image() -> PathBuf {
    let target =
        std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace().join("target"), PathBuf::from);
    target.join("thumbv7em-none-eabihf/firmware/tesaki-firmware")
}

/// The checkout that this program was built from, relative to the current folder.
fn workspace() -> PathBuf {
    shown(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")))
}

/// Runs the command of the command line; `false` if a metric failed.
pub fn run() -> Result<bool, Box<dyn Error>> {
    match Cli::parse().command {
        None => demonstrate(),
        Some(Command::List) => {
            say!("Scenarios; run one with `cargo sim run NAME`:\n");
            for scenario in SCENARIOS {
                say!("  {:<14} {} ({} s)", scenario.name, scenario.about, scenario.duration);
            }
            Ok(true)
        }
        Some(Command::Run(options)) => run_scenario(&options),
        Some(Command::Papers(options)) => papers::run(&options).map(|()| true),
        Some(Command::Limits(options)) => tell_limits(&options).map(|()| true),
        Some(Command::Faults(options)) => run_faults(&options),
        Some(Command::RenderKnob(options)) => render_knob::run(&options).map(|()| true),
        #[cfg(unix)]
        Some(Command::Serve(options)) => serve(&options).map(|()| true),
    }
}

fn demonstrate() -> Result<bool, Box<dyn Error>> {
    say!(
        "A simulated three-finger hand with nine joints. Friction, noise and masses differ from the controller's\n\
         model. The control core is the one that runs on the joint-controller board.\n"
    );
    let run = Run {
        scenario: SCENARIOS[0].name.to_owned(),
        controller: ControllerKind::Native,
        seed: 1..=1,
        duration: None,
        out: PathBuf::from("out"),
        json: false,
        view: None,
        robot: None,
        law: Vec::new(),
        elf: default_image(),
    };
    let passed = run_scenario(&run)?;
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
        let known: Vec<&str> = SCENARIOS.iter().map(|scenario| scenario.name).collect();
        format!("no scenario {name:?}; the scenarios are: {}", known.join(", "))
    })
}

fn tell_limits(options: &Limits) -> Result<(), Box<dyn Error>> {
    let scenario = find_scenario(&options.scenario)?;
    let robot = options.robot.clone().unwrap_or_else(|| workspace().join("robots").join(scenario.robot));
    for seed in options.seed.clone() {
        let impossible = scenario.impossible(&robot, seed)?;
        if options.json {
            let metrics: serde_json::Map<_, serde_json::Value> =
                impossible.into_iter().map(|limit| (limit.metric, limit.why.into())).collect();
            say!("{}", serde_json::json!({ "seed": seed, "impossible": metrics }));
        } else if impossible.is_empty() {
            say!("seed {seed}: there is room for every limit");
        } else {
            impossible.iter().for_each(|limit| say!("seed {seed}: {}: {}", limit.metric, limit.why));
        }
    }
    Ok(())
}

fn run_scenario(options: &Run) -> Result<bool, Box<dyn Error>> {
    let scenario = find_scenario(&options.scenario)?;
    match options.view {
        Some(address) => view::run(scenario, options, address),
        None => compute(scenario, options, None),
    }
}

/// Runs all seeds and saves the report; `false` if a metric failed.
fn compute(scenario: &Scenario, options: &Run, live: Option<&LiveRun>) -> Result<bool, Box<dyn Error>> {
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

/// Runs schedules of faults; `false` if a rule was broken.
fn run_faults(options: &Faults) -> Result<bool, Box<dyn Error>> {
    let robots = workspace().join("robots");
    let schedules: Box<dyn Iterator<Item = Schedule>> = match &options.schedule {
        Some(text) => Box::new(std::iter::once(serde_json::from_str(text)?)),
        None => Box::new(options.seeds.clone().map(Schedule::draw)),
    };
    let mut passed = true;
    for schedule in schedules {
        let (report, trace) = faults::run_traced(&schedule, &robots, options.trace.then(Vec::new))?;
        trace.iter().for_each(|line| say!("{line}"));
        passed &= report.violations.is_empty();
        if options.json {
            say!("{}", serde_json::to_string(&report)?);
        } else {
            let families: Vec<String> = report.families.iter().map(ToString::to_string).collect();
            let state = if report.violations.is_empty() { "safe" } else { "UNSAFE" };
            let Report { seed, scenario, ticks: [ran, planned], .. } = &report;
            say!("seed {seed}: {scenario}: {}: {ran} of {planned} ticks: {state}", families.join(", "));
        }
        let [ran, planned] = report.ticks;
        if options.schedule.is_some() || (!report.violations.is_empty() || ran < planned) && !options.json {
            report.faults.iter().for_each(|fault| say!("  log: {fault}"));
            report.error.iter().for_each(|error| say!("  ended: {error}"));
        }
        for violation in &report.violations {
            let Violation { rule, tick, text } = violation;
            note!("seed {}, tick {tick}: {rule} is broken: {text}", schedule.seed);
            if options.no_shrink || options.schedule.is_some() {
                note!("  repeat: {}", schedule.command());
            } else {
                note!("  repeat: {}", faults::shrink(&schedule, violation, &robots).command());
            }
        }
    }
    Ok(passed)
}

#[cfg(unix)]
fn serve(options: &Serve) -> Result<(), Box<dyn Error>> {
    use std::sync::atomic::{AtomicBool, Ordering};
    use tesaki_sim::plant::{Drive, Plant, PlantValues};
    use tesaki_sim::serve::{ServedBoard, home_command, input_lines, serve};
    use tesaki_sim::served_camera::ServedCamera;
    use tesaki_sim::virtual_board::VirtualBoard;
    use tesaki_supervisor::hub::Hub;
    use tesaki_supervisor::port::{Address, Announcement, Key};

    static STOP: AtomicBool = AtomicBool::new(false);
    ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed))?;
    let robot = RobotFolder::load(&options.robot)?;
    let name = robot.model.name.as_str();
    let values = PlantValues::load(&options.robot)?;
    let drives: Vec<Drive> = robot.model.joints.iter().map(Drive::from).collect();
    let mut machine = machine_options(options, &robot.model)?;
    let mut plant = Plant::new(&robot.urdf, &drives, &values, &machine)?;
    let (mut native, mut qemu);
    let board: &mut dyn ServedBoard = match options.controller {
        ControllerKind::Native => {
            native = VirtualBoard::default();
            &mut native
        }
        ControllerKind::Qemu => {
            qemu = Qemu::boot(&options.elf)?;
            &mut qemu
        }
    };
    let folder = tempfile::Builder::new().prefix("tesaki-").tempdir()?;
    let camera = match served_door(options, &robot.model, &plant)? {
        Some((door, values, joints)) => {
            machine.fixtures = door.fixtures();
            plant = Plant::new(&robot.urdf, &drives, &PlantValues::load(&options.robot)?, &machine)?;
            let default = || Address::Unix(folder.path().join("camera"));
            let address = options.camera.clone().unwrap_or_else(default);
            Some(ServedCamera::listen(&address, values, door, joints)?)
        }
        None => None,
    };
    let listen = options.listen.clone().unwrap_or_else(|| Address::Unix(folder.path().join("board")));
    let key = options
        .key
        .as_ref()
        .map(|path| Key::read(path).map_err(|error| format!("{}: {error}", path.display())));
    let mut hub = Hub::listen(&listen, key.transpose()?.as_ref())?;
    let terminal = hub.add_pty()?;
    let kind = match options.controller {
        ControllerKind::Native => "simulated",
        ControllerKind::Qemu => "simulated, its firmware in QEMU",
    };
    let _announcement = Announcement::new(name, hub.address(), &format!("{name}, {kind}"))?;
    say!(
        "{name}, {kind}, seed {}: a board without a model, as after power-on.\n\
         \x20 socket           {} (found by `--port auto`; can be shared by several programs)\n\
         \x20 pseudo-terminal  {} (like a serial port)\n{}\n\
         In another terminal, with `alias tesaki='cargo tesaki'`:\n\
         \x20 tesaki doctor\n\
         \x20 tesaki model push {}\n\
         {}\x20 {}\n\n\
         Ctrl-C stops; `help` lists the faults that can be injected here.",
        options.seed,
        hub.address(),
        terminal.display(),
        camera.as_ref().map_or_else(String::new, |camera| format!(
            "\x20 camera           {} (pictures of the door, for `tesaki look`)\n",
            camera.address()
        )),
        shown(&options.robot).display(),
        home_command(&plant, &robot.model).map_or_else(String::new, |home| format!("  {home}\n")),
        example_command(options, &robot.model),
    );
    let stop = || STOP.load(Ordering::Relaxed);
    serve(&mut hub, board, &mut plant, &robot.model, camera.as_ref(), &input_lines(), &stop)?;
    Ok(())
}

/// A door, the camera, and the indices of the tip that is the hand and of the gripper's joint.
#[cfg(unix)]
type ServedDoor = (KnobDoor, CameraValues, [usize; 2]);

/// What `--door` asks for.
#[cfg(unix)]
fn served_door(
    options: &Serve,
    model: &RobotModel,
    plant: &tesaki_sim::plant::Plant,
) -> Result<Option<ServedDoor>, Box<dyn Error>> {
    let Some(seed) = options.door else { return Ok(None) };
    if let (Some(listen), Some(camera)) = (&options.listen, &options.camera)
        && listen == camera
    {
        return Err(format!(
            "--listen and --camera are both {camera}: the pictures need an address of their own"
        )
        .into());
    }
    let (camera, files) = (CameraValues::load(&options.robot)?, approach::load(&options.robot, model)?);
    let [hand, gripper] = hand_joints(model, &files.task, plant);
    let mut door = KnobDoor::draw(seed, &hand_pose(plant, hand, gripper));
    if let Some(radius) = options.rose {
        let range = door.scene.knob.radius + 0.005..=0.1;
        if !range.contains(&radius) {
            let [from, to] = [range.start(), range.end()];
            return Err(format!("--rose is {radius} m: it must be from {from:.3} to {to} m").into());
        }
        door.scene.rose.radius = radius;
    }
    Ok(Some((door, camera, [hand, gripper])))
}

/// The machine to serve: with `--grasp` its fingers are open around the object.
#[cfg(unix)]
fn machine_options(
    options: &Serve,
    model: &RobotModel,
) -> Result<tesaki_sim::plant::PlantOptions, Box<dyn Error>> {
    use tesaki_description::grasp::load_placed;
    use tesaki_sim::plant::{ObjectValues, PlantOptions};
    use tesaki_sim::scenario::scene::{on_support, open_posture};

    let mut machine = PlantOptions::mismatched(options.seed);
    if let Some(path) = &options.grasp {
        let grasp = load_placed(path)?;
        machine.posture = Some(open_posture(model, &grasp.plan)?);
        if let Some(object) = &options.object {
            let text =
                std::fs::read_to_string(object).map_err(|error| format!("{}: {error}", object.display()))?;
            machine.object = Some(on_support(ObjectValues::from_toml(&text)?, &grasp));
        }
    }
    Ok(machine)
}

/// A command to try on the machine once it is homed.
#[cfg(unix)]
fn example_command(options: &Serve, model: &RobotModel) -> String {
    if options.door.is_some() {
        return format!("tesaki approach --robot {}", shown(&options.robot).display());
    }
    let impedance = options.robot.join("impedances/soft.toml");
    if impedance.is_file() {
        return format!("tesaki tare\n  tesaki impedance hold {}", shown(&impedance).display());
    }
    match &options.grasp {
        Some(path) => format!("tesaki tare\n  tesaki grasp run {} lift=0.01 hold=5", shown(path).display()),
        None => format!("tesaki move {}=0.3", model.joint_name(0)),
    }
}

/// The path relative to the current folder.
fn shown(path: &Path) -> PathBuf {
    let Ok(path) = path.canonicalize() else { return path.to_owned() };
    let here = std::env::current_dir().unwrap_or_default();
    path.strip_prefix(here).map_or(path.clone(), Path::to_owned)
}

fn robot_folder(scenario: &Scenario, options: &Run) -> PathBuf {
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

fn progress_bar(name: &str) -> ProgressBar {
    // Drawn only on a terminal.
    let bar = ProgressBar::new(1000).with_message(name.to_owned());
    if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent:>3} %  {eta} left") {
        bar.set_style(style);
    }
    bar
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
