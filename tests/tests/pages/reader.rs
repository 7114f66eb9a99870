//! Simulates a reader who types the commands of a page.

use std::fs::File;
use std::path::Path;
use std::process::{Child, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;

use super::board::{Kind, Served, interrupt, tesaki};
use super::page::{Step, prints_as_shown};

/// Commands that are not run, with the reason.
const EXCUSED: &[(&str, &str)] = &[
    ("alias tesaki='cargo tesaki'", "it is for the reader's shell"),
    ("cargo sim", "host-sim/tests/cli.rs runs the demonstration"),
    ("cargo xtask test --fast", "it is what runs this test"),
    ("cargo xtask firmware", "`cargo xtask test` builds the image"),
    ("cargo sim run hand3-servo --seed 1-20", "minutes; `cargo xtask sweep check` runs all scenarios"),
    ("cargo sim run hand3-grasp", "likewise"),
    ("cargo sim run arm7-follow", "likewise"),
    ("cargo sim run hand3-servo --controller qemu", "tests/image.rs runs it"),
    (
        "cargo sim run hand3-turn --view",
        "it takes a port of the machine, until Ctrl-C; viewer/web/test/run.mjs opens the page at another",
    ),
    (
        "tesaki identify robots/hand3/grasps/box.toml --out calibration.toml",
        "two minutes; the scenario hand3-force identifies the joints in simulated time",
    ),
    ("tesaki identify --joints --out calibration.toml", "11 s; cli/identify.rs runs it"),
    ("tesaki --port /dev/ttyUSB0 share", "it needs a serial port; cli/network.rs shares a simulated board"),
    ("tesaki --port /dev/ttyUSB0 share unix:///tmp/hand", "likewise"),
    ("tesaki --port unix:///tmp/hand monitor", "likewise"),
    (
        "tesaki view --robot robots/hand3",
        "it takes a port of the machine; cli/view.rs opens the page at another",
    ),
    ("cargo tesaki view --robot robots/hand3", "likewise"),
    (
        "tesaki share foxglove://localhost:8765 --robot robots/hand3",
        "it takes a port of the machine; cli/foxglove.rs connects at another",
    ),
    ("scp -p lab.key robot:", "it needs another machine"),
    ("tesaki --key lab.key --port /dev/ttyUSB0 share tcp://0.0.0.0:7400", "likewise"),
    ("tesaki --key lab.key --port tcp://robot:7400 monitor", "likewise"),
    (
        "python3 docs/examples/hand_landmarks.py hand_landmarker.task --udp 7500",
        "it needs a webcam; cli/retarget.rs reads its lines",
    ),
    (
        "python3 docs/examples/play_tips.py tests/oracles/data/hand5_tips.csv | tesaki retarget --live --robot \
         robots/hand5",
        "it needs Python; cli/retarget.rs reads its lines",
    ),
    ("tesaki retarget --live --udp 7500 --robot robots/hand5", "cli/retarget.rs sends it datagrams"),
    ("glove | tesaki retarget --live --operator aiko.toml", "cli/retarget.rs runs it with a simulated glove"),
    ("tesaki calibrate postures.csv --name Aiko --out aiko.toml", "cli/calibrate.rs runs it"),
    ("glove | tesaki calibrate --live --out aiko.toml", "likewise"),
    (
        "python3 docs/examples/lead_arm.py | tesaki follow --impedance robots/arm7/impedances/firm.toml --duration 10",
        "it needs Python; cli/follow.rs runs it",
    ),
    ("cargo sim serve --robot robots/arm7 --listen tcp://localhost:7401", "cli/follow.rs runs two arms"),
    ("cargo sim serve --robot robots/arm7 --listen tcp://localhost:7402", "likewise"),
    (
        "tesaki --port tcp://localhost:7402 follow --impedance robots/arm7/impedances/firm.toml --from \
         board:tcp://localhost:7401",
        "likewise",
    ),
    (
        "tesaki --port tcp://localhost:7402 follow --impedance robots/arm7/impedances/soft.toml --from \
         board:tcp://localhost:7401 --reflect robots/arm7/impedances/handle.toml",
        "likewise",
    ),
    (
        "python3 docs/examples/camera.py 0 | tesaki look --delay 0.05 --to tcp://localhost:7800",
        "it needs a camera; cli/look.rs pipes pictures",
    ),
    (
        "ffmpeg -f v4l2 -i /dev/video0 -vf crop=ih*16/15:ih,scale=256:240 -pix_fmt gray -f image2pipe -c:v pgm - | tesaki look --delay 0.08 --to tcp://localhost:7800",
        "likewise",
    ),
    ("cargo sim run knob-grasp", "13 s; `cargo xtask sweep check` runs all scenarios"),
    ("python3 tests/oracles/find_circle.py set 250 8 DIR", "it needs Python's NumPy, and minutes"),
    ("python3 tests/oracles/find_circle.py opencv DIR", "it needs OpenCV"),
    (
        "cargo run --release -p tesaki --example circle_accuracy -- DIR list",
        "it reads what the first one drew",
    ),
];

/// Commands that fail: command, beginning of the comment, exit code.
const FAILING: &[(&str, &str, i32)] = &[
    ("tesaki doctor", "diagnosis", 1), // the board has no model yet
    ("cargo tesaki doctor", "", 1),
    ("tesaki grasp run robots/hand3/grasps/box.toml lift=0.2", "", 7),
    ("tesaki grasp run robots/hand3/grasps/box.toml hold=5", "", 8),
];

/// Commands that are typed in another terminal while the previous one runs, as soon as it prints what is
/// shown.
const MEANWHILE: &[&str] = &["tesaki grasp status"];

/// Commands that run until Ctrl-C, and the commands that are run before that.
const UNTIL_CTRL_C: &[(&str, &[&str])] = &[("tesaki record grip", &["move", "finger1_swing=0.2"])];

/// Commands that run in a separate terminal until the end of the page.
const ASIDE: &[&str] = &["tesaki look --from unix://camera --to unix://circles"];

/// Commands that need a preparation described by the page: a board without an object, a program that was
/// killed.
const WITHOUT_OBJECT: &str = "tesaki grasp run robots/hand3/grasps/box.toml hold=5";
const AFTER_A_KILL: &str = "tesaki faults";

/// A command that fills the terminal until `q` is pressed.
const FULL_SCREEN: &str = "tesaki monitor";

/// Sections that refer to "push the model, home and tare as above".
const SET_UP: &[&str] = &["Grasping", "Impedance control of an arm"];

/// Replaces the result of the identification.
const CALIBRATION: &str = "[joints.finger1_bend]\ntorque_constant = 1.9\n";

/// A command that has not ended after this time hangs.
const PATIENCE: Duration = Duration::from_secs(60);

/// Returns the commands that are named above.
pub fn exceptions() -> impl Iterator<Item = &'static str> {
    let excused = EXCUSED.iter().map(|(command, _)| *command);
    let failing = FAILING.iter().map(|(command, ..)| *command);
    let interrupted = UNTIL_CTRL_C.iter().map(|(command, _)| *command);
    let others = [WITHOUT_OBJECT, AFTER_A_KILL, FULL_SCREEN].into_iter().chain(MEANWHILE.iter().copied());
    let others = others.chain(ASIDE.iter().copied());
    excused.chain(failing).chain(interrupted).chain(others)
}

/// Returns the arguments of `cargo sim serve …` that are common to all kinds of board.
fn serve(step: &Step) -> Option<Vec<&str>> {
    let arguments = step.command.strip_prefix("cargo sim ")?.split(' ');
    let arguments: Vec<&str> = arguments.filter(|word| !["--controller", "qemu"].contains(word)).collect();
    (arguments[0] == "serve").then_some(arguments)
}

/// Splits the commands of a page by board: those of the first board, and those of each section with its own.
pub fn split(steps: Vec<Step>) -> Vec<Vec<Step>> {
    let first = steps.iter().find(|step| serve(step).is_some()).map(|step| step.section.clone());
    let has_board = |section: &str| {
        Some(section) != first.as_deref()
            && steps.iter().any(|step| step.section == section && serve(step).is_some())
    };
    let mut boards: Vec<Vec<Step>> = vec![Vec::new()];
    for step in &steps {
        let own = boards.iter().skip(1).position(|board| board[0].section == step.section);
        match own {
            Some(own) => boards[own + 1].push(step.clone()),
            None if has_board(&step.section) => boards.push(vec![step.clone()]),
            None => boards[0].push(step.clone()),
        }
    }
    boards
}

/// Creates a folder with the robots, the data of the oracles, the documents and a calibration.
pub fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["robots", "tests", "docs"] {
        let there = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name).canonicalize().unwrap();
        std::os::unix::fs::symlink(there, folder.path().join(name)).unwrap();
    }
    std::fs::write(folder.path().join("calibration.toml"), CALIBRATION).unwrap();
    folder
}

/// A running command; its output goes to a file in one stream, as to a terminal.
struct Running {
    child: Child,
    output: tempfile::NamedTempFile,
}

impl Running {
    fn printed(&self) -> String {
        std::fs::read_to_string(self.output.path()).unwrap()
    }

    /// Waits for its end, or interrupts it once it has printed what is shown up to `^C`.
    fn finish(mut self, shown: &[String]) -> (Option<i32>, String) {
        let before = shown.iter().position(|line| line == "^C").map(|end| &shown[..end]);
        let mut is_interrupted = false;
        let status: Option<ExitStatus> = wait_for(|| {
            if let Some(before) = before.filter(|_| !is_interrupted)
                && prints_as_shown(before, &self.printed())
            {
                interrupt(&self.child, Signal::SIGINT);
                is_interrupted = true;
            }
            self.child.try_wait().unwrap()
        });
        if status.is_none() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
        (status.and_then(|status| status.code()), self.printed())
    }
}

fn wait_for<T>(mut event: impl FnMut() -> Option<T>) -> Option<T> {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        if let Some(found) = event() {
            return Some(found);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    None
}

pub struct Reader {
    page: &'static str,
    folder: tempfile::TempDir,
    steps: Vec<Step>,
    failures: Vec<String>,
}

impl Reader {
    pub fn new(page: &'static str, folder: tempfile::TempDir, steps: Vec<Step>) -> Self {
        Self { page, folder, steps, failures: Vec::new() }
    }

    /// Types all commands. Returns the differences from the page.
    pub fn read(&mut self, kind: Kind) -> Vec<String> {
        let steps = std::mem::take(&mut self.steps);
        let mut board: Option<(Vec<&str>, Served)> = None;
        let mut aside = Vec::new();
        let mut steps = steps.iter().peekable();
        while let Some(step) = steps.next() {
            if EXCUSED.iter().any(|(command, _)| *command == step.command) {
                continue;
            }
            if let Some(arguments) = serve(step) {
                // The same board with the other controller is covered by the other test.
                if board.as_ref().is_none_or(|(present, _)| *present != arguments) {
                    drop(board.take());
                    board = Some((arguments.clone(), self.serve(kind, &arguments, &step.section)));
                }
                continue;
            }
            if let Some(arguments) = step.command.strip_prefix("cargo sim ") {
                let mut command = tesaki_tests::program("host-sim");
                self.check(step, command.args(arguments.split(' ')).current_dir(self.folder.path()));
                continue;
            }
            let Some(arguments) = step.arguments("tesaki") else {
                self.fail(
                    step,
                    "the test does not know how to run this command; say so in EXCUSED, with the reason",
                );
                continue;
            };
            if step.command == WITHOUT_OBJECT
                && let Some((mut arguments, _)) = board.take()
            {
                let object = arguments.iter().position(|word| *word == "--object").unwrap();
                arguments.drain(object..object + 2);
                board = Some((arguments.clone(), self.serve(kind, &arguments, &step.section)));
            }
            if ASIDE.contains(&&*step.command) {
                aside.push((
                    step,
                    self.start(tesaki_tests::tesaki().args(arguments).current_dir(self.folder.path())),
                ));
                continue;
            }
            let Some((_, board)) = &board else {
                // A page about tools that need no board.
                let mut command = tesaki_tests::tesaki();
                self.check(step, command.args(arguments).current_dir(self.folder.path()));
                continue;
            };
            let next = steps.next_if(|next| MEANWHILE.contains(&&*next.command));
            self.type_command(board, step, &arguments, next);
        }
        for (step, running) in aside {
            interrupt(&running.child, Signal::SIGINT);
            self.judge(step, running);
        }
        std::mem::take(&mut self.failures)
    }

    fn fail(&mut self, step: &Step, message: &str) {
        let Self { page, .. } = self;
        self.failures.push(format!("{page}, section {:?}: `{}`: {message}", step.section, step.command));
    }

    fn serve(&mut self, kind: Kind, arguments: &[&str], section: &str) -> Served {
        let board = Served::start(kind, arguments, self.folder.path());
        if SET_UP.contains(&section) {
            for command in board.set_up() {
                self.succeeds(&board, &command.split(' ').collect::<Vec<_>>());
            }
        }
        board
    }

    /// Runs a command that is not in the page. After `model push`, the command timeout of 100 ms is extended
    /// for busy machines.
    fn succeeds(&mut self, board: &Served, arguments: &[&str]) {
        let running = self.start(tesaki(&board.port, self.folder.path()).args(arguments));
        let (code, printed) = running.finish(&[]);
        if code != Some(0) {
            self.failures
                .push(format!("{}: tesaki {arguments:?}: exit code {code:?}:\n{printed}", self.page));
        }
        self.grant_time(board, arguments);
    }

    fn grant_time(&mut self, board: &Served, arguments: &[&str]) {
        if arguments.starts_with(&["model", "push"]) {
            self.succeeds(board, &["set", "safety.command_timeout", "1"]);
        }
    }

    fn start(&self, command: &mut std::process::Command) -> Running {
        let output = tempfile::NamedTempFile::new_in(self.folder.path()).unwrap();
        let appended = || Stdio::from(File::options().append(true).open(output.path()).unwrap());
        let child = command.stdout(appended()).stderr(appended()).spawn().unwrap();
        Running { child, output }
    }

    fn type_command(&mut self, board: &Served, step: &Step, arguments: &[&str], meanwhile: Option<&Step>) {
        let mut command = tesaki(&board.port, self.folder.path());
        match arguments.split_last() {
            // As printed by the board.
            Some((&"…", name)) => {
                let words = board.told(&name.join(" ")).unwrap_or_else(|| panic!("{name:?} was not told"));
                command.args(name).args(words);
            }
            _ => drop(command.args(arguments)),
        }
        if step.command == FULL_SCREEN {
            return self.full_screen(step, command);
        }
        if step.command == AFTER_A_KILL {
            self.kill_a_commander(board, step);
        }
        let until = UNTIL_CTRL_C.iter().find(|(command, _)| *command == step.command);
        if until.is_none() && meanwhile.is_none() {
            self.check(step, &mut command);
            return self.grant_time(board, arguments);
        }
        let running = self.start(&mut command);
        if let Some((_, others)) = until {
            let starts = || running.printed().contains("Ctrl-C").then_some(());
            if wait_for(starts).is_some() {
                self.succeeds(board, others);
            }
            interrupt(&running.child, Signal::SIGINT);
        }
        if let Some(meanwhile) = meanwhile {
            self.wait_until_shown(board, meanwhile);
        }
        self.judge(step, running);
    }

    /// Runs a command of the page to its end, and checks it.
    fn check(&mut self, step: &Step, command: &mut std::process::Command) {
        let running = self.start(command);
        self.judge(step, running);
    }

    fn judge(&mut self, step: &Step, running: Running) {
        let shown = step.shown.as_deref().unwrap_or_default();
        let (code, printed) = running.finish(shown);
        let failing = FAILING
            .iter()
            .find(|(command, comment, _)| *command == step.command && step.comment.starts_with(comment));
        let expected = failing.map_or(0, |(.., code)| *code);
        if code != Some(expected) {
            self.fail(step, &format!("exit code {code:?}, expected {expected}:\n{printed}"));
        } else if step.shown.is_some() && !prints_as_shown(shown, &printed) {
            self.fail(step, &format!("the page shows something else than it prints:\n{printed}"));
        } else if step.comment == "no problems found"
            && !printed.contains(&step.comment)
            && !is_busy(&printed)
        {
            self.fail(step, &format!("no {:?} in:\n{printed}", step.comment));
        }
    }

    /// Repeats the command until it prints what is shown.
    fn wait_until_shown(&mut self, board: &Served, step: &Step) {
        let arguments = step.arguments("tesaki").unwrap();
        let mut last = String::new();
        let shown = wait_for(|| {
            let running = self.start(tesaki(&board.port, self.folder.path()).args(&arguments));
            let (code, printed) = running.finish(&[]);
            let is_shown = code == Some(0) && prints_as_shown(step.shown.as_ref().unwrap(), &printed);
            last = printed;
            is_shown.then_some(())
        });
        if shown.is_none() {
            self.fail(step, &format!("it never printed what is shown, but:\n{last}"));
        }
    }

    /// "Kill the process instead": the board stops by itself.
    fn kill_a_commander(&mut self, board: &Served, step: &Step) {
        let mut commander = self.start(tesaki(&board.port, self.folder.path()).arg("enable"));
        let enabled = wait_for(|| commander.printed().contains("enabled").then_some(()));
        commander.child.kill().unwrap();
        commander.child.wait().unwrap();
        let mode = || {
            let running = self.start(tesaki(&board.port, self.folder.path()).arg("info"));
            running.finish(&[]).1.contains("in fault").then_some(())
        };
        if enabled.and_then(|()| wait_for(mode)).is_none() {
            self.fail(step, &format!("the board is not in fault before it: {}", commander.printed()));
        }
    }

    /// Runs it on a separate terminal: it draws the joints, and `q` ends it.
    fn full_screen(&mut self, step: &Step, mut command: std::process::Command) {
        use std::io::{Read, Write};
        let size = nix::pty::Winsize { ws_row: 40, ws_col: 120, ws_xpixel: 0, ws_ypixel: 0 };
        let nix::pty::OpenptyResult { master, slave } = nix::pty::openpty(Some(&size), None).unwrap();
        let mut terminal = File::from(master);
        let end = || Stdio::from(slave.try_clone().unwrap());
        let mut child = command.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        // Only the child keeps the terminal open.
        drop((command, slave));
        let (mut drawn, mut buffer) = (String::new(), [0; 4096]);
        let start = Instant::now();
        while !drawn.contains("finger1_swing") && start.elapsed() < PATIENCE {
            let Ok(length) = terminal.read(&mut buffer) else { break };
            drawn += &String::from_utf8_lossy(&buffer[..length]);
        }
        let _ = terminal.write_all(b"q");
        // It keeps writing until it ends, and must not block.
        let mut rest = terminal.try_clone().unwrap();
        std::thread::spawn(move || std::io::copy(&mut rest, &mut std::io::sink()));
        let status = wait_for(|| child.try_wait().unwrap());
        let _ = child.kill();
        if !status.is_some_and(|status| status.success()) || !drawn.contains("finger1_swing") {
            self.fail(step, &format!("{status:?}: {drawn}"));
        }
    }
}

/// Returns whether `tesaki doctor` warns only of a machine that is too busy for its board.
fn is_busy(printed: &str) -> bool {
    let mut warnings = printed.lines().filter(|line| line.starts_with("warn"));
    printed.contains("works; ")
        && warnings.all(|line| line.contains("a request takes") || line.contains("requests were sent again"))
}
