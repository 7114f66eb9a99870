//! The program `tesaki` against a simulated board: what people type, what they read, and the exit codes for scripts.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use tesaki_description::grasp::load_placed;
use tesaki_description::robot::RobotFolder;
use tesaki_sim::grasp_scene::{on_support, open_posture};
use tesaki_sim::plant::{Drive, ObjectValues, Plant, PlantOptions, PlantValues};
use tesaki_sim::serve::{home_command, serve};
use tesaki_sim::virtual_board::VirtualBoard;
use tesaki_supervisor::hub::Hub;
use tesaki_supervisor::port::Address;

fn hand3() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3")
}

fn arm7() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7")
}

/// What `host-sim serve` runs, in a thread.
struct Server {
    address: Address,
    terminal: PathBuf,
    home: Vec<String>,
    trouble: Sender<String>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    folder: tempfile::TempDir,
}

impl Server {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self::start_at(folder)
    }

    fn start_at(folder: tempfile::TempDir) -> Self {
        Self::start_with(folder, &PlantOptions::mismatched(1))
    }

    /// Homed, tared, and with the fingers open around where a box is to be grasped.
    fn ready_to_grasp(with_box: bool) -> Self {
        let robot = RobotFolder::load(&hand3()).unwrap();
        let grasp = load_placed(&hand3().join("grasps/box.toml")).unwrap();
        let mut options = PlantOptions::mismatched(1);
        options.posture = Some(open_posture(&robot.model, &grasp.plan).unwrap());
        if with_box {
            let text = std::fs::read_to_string(hand3().join("objects/box.toml")).unwrap();
            options.object = Some(on_support(ObjectValues::from_toml(&text).unwrap(), &grasp));
        }
        let server = Self::start_with(tempfile::tempdir().unwrap(), &options);
        server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
        server.home();
        server
    }

    fn start_with(folder: tempfile::TempDir, options: &PlantOptions) -> Self {
        Self::start_robot(&hand3(), folder, options)
    }

    /// An arm on the board, with a longer command timeout.
    fn ready_arm() -> Self {
        let options = PlantOptions::mismatched(1);
        let server = Self::start_robot(&arm7(), tempfile::tempdir().unwrap(), &options);
        server.succeeds(&["model", "push", arm7().to_str().unwrap()]);
        server.succeeds(&["set", "safety.command_timeout", "1"]);
        server
    }

    fn start_robot(folder_of_robot: &Path, folder: tempfile::TempDir, options: &PlantOptions) -> Self {
        let robot = RobotFolder::load(folder_of_robot).unwrap();
        let drives: Vec<Drive> = robot.model.joints.iter().map(Drive::from).collect();
        let values = PlantValues::load(folder_of_robot).unwrap();
        let mut plant = Plant::new(&robot.urdf, &drives, &values, options).unwrap();
        let mut hub = Hub::listen(&Address::Unix(folder.path().join("board"))).unwrap();
        let address = hub.address().clone();
        let terminal = hub.add_pty().unwrap();
        let home = home_command(&plant, &robot.model).split(' ').skip(1).map(str::to_owned).collect();
        let stop = Arc::new(AtomicBool::new(false));
        let (trouble, lines) = channel();
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut board = VirtualBoard::default();
            let stop = || flag.load(Ordering::Relaxed);
            serve(&mut hub, &mut board, &mut plant, &robot.model, &lines, &stop).unwrap();
        });
        Self { address, terminal, home, trouble, stop, thread: Some(thread), folder }
    }

    /// With a model on the board, and homed.
    fn ready() -> Self {
        let server = Self::start();
        server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
        server.home();
        server
    }

    /// Homes, and allows a busy machine more than the 100 ms between two commands that a real one has to keep.
    fn home(&self) {
        let home: Vec<&str> = self.home.iter().map(String::as_str).collect();
        self.succeeds(&home);
        self.succeeds(&["set", "safety.command_timeout", "1"]);
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = tesaki_tests::tesaki();
        command.env("TESAKI_PORT", self.address.to_string()).args(arguments).stdin(Stdio::null());
        command
    }

    fn run(&self, arguments: &[&str]) -> (i32, String) {
        said(&finish(self.start_command(arguments)))
    }

    #[track_caller]
    fn succeeds(&self, arguments: &[&str]) -> String {
        let (code, text) = self.run(arguments);
        assert_eq!(code, 0, "{arguments:?}: {text}");
        text
    }

    /// Fails with this exit code and says this.
    #[track_caller]
    fn fails(&self, arguments: &[&str], code: i32, words: &[&str]) {
        let (got, text) = self.run(arguments);
        assert_eq!(got, code, "{arguments:?}: {text}");
        for word in words {
            assert!(text.contains(word), "{arguments:?}: no {word:?} in: {text}");
        }
    }

    fn start_command(&self, arguments: &[&str]) -> Child {
        let mut command = self.command(arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    fn make_trouble(&self, line: &str) {
        self.trouble.send(line.to_owned()).unwrap();
        std::thread::sleep(Duration::from_millis(60));
    }

    fn json(&self, arguments: &[&str]) -> serde_json::Value {
        let mut all = vec!["--json"];
        all.extend(arguments);
        serde_json::from_str(&self.succeeds(&all)).unwrap()
    }

    /// Waits until the board is in this mode.
    fn wait_for(&self, mode: &str) {
        for _ in 0..200 {
            if self.succeeds(&["info"]).contains(&format!("mode           {mode}")) {
                return;
            }
            std::thread::sleep(Duration::from_millis(30));
        }
        panic!("never {mode}");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the command said. One that does not end is a failure, and says so too.
fn finish(child: Child) -> Output {
    let pid = nix::unistd::Pid::from_raw(i32::try_from(child.id()).unwrap());
    let (done, waiting) = channel::<()>();
    let watchdog = std::thread::spawn(move || {
        if waiting
            .recv_timeout(Duration::from_secs(30))
            .is_err_and(|error| error == RecvTimeoutError::Timeout)
        {
            let _ = nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGKILL);
        }
    });
    let output = child.wait_with_output().unwrap();
    drop(done);
    watchdog.join().unwrap();
    output
}

fn said(output: &Output) -> (i32, String) {
    let text = [&output.stdout[..], &output.stderr[..]].concat();
    (output.status.code().unwrap_or(-1), String::from_utf8(text).unwrap())
}

fn signal(child: &Child, signal: nix::sys::signal::Signal) {
    let pid = nix::unistd::Pid::from_raw(i32::try_from(child.id()).unwrap());
    nix::sys::signal::kill(pid, signal).unwrap();
}

#[test]
fn from_a_fresh_board_to_a_moved_recorded_and_replayed_joint() {
    let server = Server::start();
    server.fails(&["move", "finger1_swing=0.3"], 7, &["no robot model", "tesaki model push"]);
    server.fails(&["doctor"], 1, &["no robot model", "tesaki model push", "1 to mend"]);
    let pushed = server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    assert!(pushed.contains("9 joints"), "{pushed}");
    server.fails(
        &["move", "finger1_swing=0.3"],
        7,
        &["finger1_swing has a relative encoder and was not homed", "tesaki home"],
    );
    server.fails(&["home", "finger1_swing=0"], 2, &["finger1_bend has no angle", "--others"]);
    server.home();
    let well = server.succeeds(&["doctor"]);
    assert!(well.contains("everything is well"), "{well}");
    server.fails(&["model", "check", "/nowhere"], 1, &["/nowhere", "robot.urdf"]);
    let other = server.succeeds(&["doctor", "--robot", hand3().to_str().unwrap()]);
    assert!(other.contains("is not the one in") && other.contains("tesaki model push"), "{other}");
    server.fails(&["move", "thumb=0.3"], 2, &["no joint \"thumb\"", "finger3_curl"]);
    server.fails(
        &["move", "finger1_swing=9"],
        2,
        &["finger1_swing: 9 rad is outside its limits -1 to 1 rad"],
    );
    server.fails(&["move", "finger1_swing"], 2, &["JOINT=ANGLE"]);

    let name = server.folder.path().join("run");
    let mut recorder = server.start_command(&["record", name.to_str().unwrap()]);
    std::thread::sleep(Duration::from_millis(300));
    let moved = server.succeeds(&["move", "finger1_swing=20", "finger2_bend=30", "--degrees"]);
    assert!(moved.contains("arrived") && moved.contains("disarmed"), "{moved}");
    signal(&recorder, nix::sys::signal::Signal::SIGINT);
    assert!(recorder.wait().unwrap().success());
    let state = server.json(&["read"]);
    let angle = state["joints"][0]["position"].as_f64().unwrap();
    assert!((angle - 0.349_066).abs() < 0.02, "{angle}");
    let log = name.with_extension("log");
    let replayed = server.succeeds(&["replay", log.to_str().unwrap()]);
    let ticks: u32 = replayed.split(' ').next().unwrap().parse().unwrap();
    assert!(ticks > 100 && replayed.contains("identical"), "{replayed}");
    assert!(std::fs::metadata(name.with_extension("mcap")).unwrap().len() > 10_000);

    // One flipped bit in a recorded torque is found and named, whatever the checksum says.
    let mut records = decode(&std::fs::read(&log).unwrap());
    let spoilt = records.iter_mut().rev().find_map(|record| match record {
        tesaki::protocol::LogRecord::Actuators(frame) => Some(frame),
        _ => None,
    });
    let torque = &mut spoilt.unwrap().torques[4];
    *torque = f32::from_bits(torque.to_bits() ^ 1);
    std::fs::write(&log, encode(&records)).unwrap();
    server.fails(&["replay", log.to_str().unwrap()], 1, &["torque of joint 4 was"]);
    server.fails(&["replay", "/nowhere"], 1, &["/nowhere"]);
}

#[test]
fn a_fingertip_is_led_to_a_place_and_what_it_cannot_do_is_said_before_anything_moves() {
    let server = Server::ready();
    // All fingers bent, away from the straight ones.
    server.succeeds(&[
        "move",
        "finger1_bend=0.1",
        "finger1_curl=1.3",
        "finger2_curl=1.3",
        "finger3_curl=1.3",
    ]);
    let arrived = server.succeeds(&["reach", "--relative", "finger1_tip=0.01,-0.005,0.008"]);
    assert!(arrived.contains("arrived") && arrived.contains("disarmed"), "{arrived}");
    // Back by the same way to the angles from which it came.
    server.succeeds(&["reach", "--relative", "finger1_tip=-0.01,0.005,-0.008", "finger2_tip=0,0.005,0"]);
    let state = server.json(&["read"]);
    for (joint, angle) in [(0, 0.0), (1, 0.1), (2, 1.3)] {
        let position = state["joints"][joint]["position"].as_f64().unwrap();
        assert!((position - angle).abs() < 0.03, "joint {joint} at {position}");
    }
    server.fails(&["reach", "thumb=0,0,0"], 2, &["no tip \"thumb\"", "finger3_tip"]);
    server.fails(&["reach", "finger1_tip=0,0"], 2, &["no place"]);
    server.fails(
        &["reach", "finger1_tip=0.5,0.04,0.1"],
        2,
        &["finger1_tip", "does not reach", "mm on its way"],
    );
    server.fails(
        &["reach", "--relative", "finger1_tip=-0.045,0.05,0"],
        2,
        &["finger1_swing", "outside its limits"],
    );
    server.fails(&["reach", "--relative", "finger1_tip=0,0.08,0"], 2, &["would turn at", "lower --speed"]);
    server.fails(&["reach", "--speed", "0", "finger1_tip=0,0,0.1"], 2, &["above 0"]);
    server.fails(&["reach", "--speed", "1e-9", "--relative", "finger1_tip=0,0,0.01"], 2, &["600 s"]);
}

/// The grasp of the box.
fn box_grasp() -> String {
    hand3().join("grasps/box.toml").to_str().unwrap().to_owned()
}

#[test]
fn a_box_is_grasped_lifted_turned_and_put_down_in_one_command() {
    let server = Server::ready_to_grasp(true);
    let file = box_grasp();
    server.fails(&["grasp", "run", &file], 7, &["finger1_tip was not tared", "tesaki tare"]);
    server.succeeds(&["tare"]);
    server.fails(&["grasp", "run", &file, "lift=high"], 2, &["lift", "no number"]);
    server.fails(&["grasp", "run", &file, "turn=0,1"], 2, &["turn", "three numbers"]);
    server.fails(&["grasp", "run", &file, "juggle"], 2, &["juggle", "lift=M"]);
    server.fails(&["grasp", "run", &file, "--speed", "0"], 2, &["--speed", "above 0"]);
    server.fails(&["grasp", "run", &file, "--speed", "1e-9", "lift=0.01"], 2, &["--speed", "600 s"]);
    assert!(server.succeeds(&["grasp", "status"]).contains("is ready"));

    let run =
        server.start_command(&["grasp", "run", &file, "lift=0.01", "turn=0,0.1,0", "hold=2", "turn=0,0,0"]);
    let held = (0..400).find_map(|_| {
        std::thread::sleep(Duration::from_millis(50));
        let status = server.json(&["grasp", "status"]);
        (status["phase"] == "Hold").then_some(status)
    });
    let held = held.expect("never held");
    assert!(held["failure"].is_null() && held["friction"].as_f64().unwrap() > 0.3, "{held}");
    let words = server.succeeds(&["grasp", "status"]);
    assert!(words.contains("finger 3") && words.contains("N wanted"), "{words}");
    let (code, text) = said(&finish(run));
    assert_eq!(code, 0, "{text}");
    for word in
        ["approaches", "feels for", "takes hold", "moves", "lowers", "lets go", "disarmed", "done: held for"]
    {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }

    // A motion that is refused costs nothing but itself: the box is put down all the same.
    server.fails(
        &["grasp", "run", &file, "lift=0.2"],
        7,
        &["lowers an object", "is ready", "does not reach so far", "disarmed"],
    );
}

#[test]
fn ctrl_c_puts_the_box_down_and_a_fault_says_what_became_of_it() {
    let server = Server::ready_to_grasp(true);
    server.succeeds(&["tare"]);
    let file = box_grasp();
    let wait_until_held = || {
        while server.json(&["grasp", "status"])["phase"] != "Hold" {
            std::thread::sleep(Duration::from_millis(50));
        }
        std::thread::sleep(Duration::from_millis(200));
    };
    let run = server.start_command(&["grasp", "run", &file]);
    wait_until_held();
    signal(&run, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(run));
    assert_eq!(code, 0, "{text}");
    assert!(text.contains("lowers an object") && text.contains("interrupted: disarmed"), "{text}");

    let run = server.start_command(&["--json", "grasp", "run", &file, "hold"]);
    wait_until_held();
    server.make_trouble("estop on");
    let (code, text) = said(&finish(run));
    assert_eq!(code, 5, "{text}");
    assert!(text.contains("emergency stop") && text.contains("`tesaki disarm` lets go"), "{text}");
    for line in text.lines() {
        assert!(serde_json::from_str::<serde_json::Value>(line).is_ok(), "{line}");
    }
    assert!(text.contains("\"phase\":\"Hold\""), "{text}");
}

#[test]
fn a_board_of_one_finger_gets_its_own_model() {
    let server = Server::start();
    let robot = hand3();
    let robot = robot.to_str().unwrap();
    server.fails(&["model", "push", robot, "--chain", "thumb"], 2, &["no tip \"thumb\"", "finger3_tip"]);
    let pushed = server.succeeds(&["model", "push", robot, "--chain", "finger2_tip"]);
    assert!(pushed.contains("hand3.finger2_tip: 3 joints"), "{pushed}");
    let model = server.json(&["model", "show"]);
    assert_eq!(model["joints"][0]["name"], "finger2_swing");
    assert_eq!(model["chains"].as_array().unwrap().len(), 1);
}

#[test]
fn a_hand_that_finds_nothing_says_so_and_opens() {
    let server = Server::ready_to_grasp(false);
    server.succeeds(&["tare"]);
    let file = box_grasp();
    server.fails(
        &["grasp", "run", &file, "lift=0.01"],
        8,
        &["felt nothing within 0.02 m: the hand opened", "[object] in", "clearance", "is ready", "disarmed"],
    );
    server.fails(&["grasp", "run", "/nowhere"], 1, &["/nowhere"]);
    let status = server.json(&["grasp", "status"]);
    assert!(!status["failure"]["NothingThere"].is_null(), "{status}");
}

#[test]
#[ignore = "needs Python: cargo xtask test"]
fn the_example_client_in_python_moves_a_joint_and_is_told_why_not() {
    let server = Server::ready();
    let python = std::env::var_os("TESAKI_PYTHON").unwrap_or_else(|| "python3".into());
    let client = |arguments: &[&str]| {
        let mut command = Command::new(&python);
        command.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/examples/client.py"));
        command.arg(server.address.to_string()).args(arguments);
        said(&finish(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()))
    };
    let (code, text) = client(&["--move", "0", "0.2", "--seconds", "2.5"]);
    assert!(code == 0 && text.contains("board with schema") && text.contains("hand3"), "{text}");
    let state = server.json(&["read"]);
    let angle = state["joints"][0]["position"].as_f64().unwrap();
    assert!((angle - 0.2).abs() < 0.02, "{angle}: {text}");
    let (code, text) = client(&["--move", "0", "9"]);
    assert!(code != 0 && text.contains("outside the limits"), "{text}");
}

#[test]
fn a_recording_goes_on_when_the_board_was_reset() {
    let server = Server::ready();
    let name = server.folder.path().join("run");
    let mut recorder = server.start_command(&["record", name.to_str().unwrap()]);
    std::thread::sleep(Duration::from_millis(500));
    server.make_trouble("reset");
    // Its streams are asked for again after a second of silence.
    std::thread::sleep(Duration::from_millis(1700));
    server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    server.home();
    server.succeeds(&["move", "finger1_swing=0.2"]);
    signal(&recorder, nix::sys::signal::Signal::SIGINT);
    assert!(recorder.wait().unwrap().success());
    let log = name.with_extension("log");
    let records = decode(&std::fs::read(&log).unwrap());
    let enabled = records
        .iter()
        .filter(|record| matches!(record, tesaki::protocol::LogRecord::Actuators(frame) if frame.enabled));
    let enabled = enabled.count();
    assert!(enabled > 50, "the move is missing: {enabled} armed ticks");
    let replayed = server.json(&["replay", log.to_str().unwrap()]);
    assert!(replayed["identical_ticks"].as_u64().unwrap() > 150, "{replayed}");
    assert_eq!(replayed["gaps"], 1, "{replayed}");
}

fn decode(bytes: &[u8]) -> Vec<tesaki::protocol::LogRecord> {
    let mut decoder = tesaki::protocol::codec::Decoder::new();
    bytes.iter().filter_map(|&byte| decoder.push(byte)).map(Result::unwrap).collect()
}

fn encode(records: &[tesaki::protocol::LogRecord]) -> Vec<u8> {
    let mut frame = [0; tesaki::protocol::codec::MAX_FRAME];
    let mut bytes = Vec::new();
    for record in records {
        let length = tesaki::protocol::codec::encode(record, &mut frame).unwrap();
        bytes.extend_from_slice(&frame[..length]);
    }
    bytes
}

#[test]
fn ctrl_c_disarms_a_second_commander_is_refused_and_anyone_may_stop() {
    let server = Server::ready();
    let mut first = server.start_command(&["arm"]);
    server.wait_for("armed");
    server.fails(&["arm"], 7, &["another client"]);
    server.fails(&["--take-over", "arm"], 7, &["another client"]);
    signal(&first, nix::sys::signal::Signal::SIGINT);
    assert!(first.wait().unwrap().success());
    assert!(server.succeeds(&["info"]).contains("mode           disarmed"));

    let second = server.start_command(&["arm"]);
    server.wait_for("armed");
    assert!(server.succeeds(&["stop"]).contains("stopped"));
    let (code, text) = said(&finish(second));
    assert_eq!(code, 5, "{text}");
    assert!(text.contains("fault 17") && text.contains("tesaki faults --clear"), "{text}");
    server.fails(&["move", "finger1_swing=0"], 5, &["fault 17"]);
    server.fails(&["doctor"], 5, &["in fault", "tesaki faults --clear"]);
    assert!(server.succeeds(&["faults", "--clear"]).contains("disarmed"));
    server.succeeds(&["move", "finger1_swing=0.05"]);
}

#[test]
fn a_supervisor_that_dies_leaves_a_board_that_stops_by_itself_and_serves_the_next_one() {
    let server = Server::ready();
    let mut victim = server.start_command(&["arm"]);
    server.wait_for("armed");
    victim.kill().unwrap();
    victim.wait().unwrap();
    server.wait_for("in fault");
    server.fails(&["move", "finger1_swing=0"], 5, &["fault 0", "limit 1 s"]);
    server.succeeds(&["faults", "--clear"]);
    server.succeeds(&["move", "finger1_swing=0.05"]);
}

#[test]
fn faults_of_the_machine_are_named_by_joint_value_and_limit() {
    let server = Server::ready();
    let armed = server.start_command(&["arm"]);
    server.wait_for("armed");
    server.make_trouble("encoder finger2_curl 9000");
    let (code, text) = said(&finish(armed));
    assert_eq!(code, 5, "{text}");
    assert!(text.contains("finger2_curl: the encoder jumped") && text.contains("limit 0.12"), "{text}");
    let faults = server.json(&["faults"]);
    assert_eq!(faults["faults"][0]["number"], 4);
    assert_eq!(faults["faults"][0]["fault"]["joint"], 5);
    server.make_trouble("estop on");
    server.succeeds(&["faults", "--clear"]);
    server.fails(&["arm"], 7, &["emergency stop"]);
    server.make_trouble("estop off");
    server.make_trouble("supply 15");
    server.fails(&["doctor"], 1, &["supply 15.0 V, outside 20 to 28 V"]);
    server.make_trouble("reset");
    server.make_trouble("nonsense");
    // The faults are still there after a reset, the model is not.
    server.fails(&["read"], 7, &["no robot model"]);
    assert_eq!(server.json(&["faults"])["total"], 1);
}

#[test]
fn parameters_are_read_changed_and_refused_by_name() {
    let server = Server::ready();
    assert!(server.succeeds(&["read", "safety.command_timeout"]).contains("safety.command_timeout = 1"));
    server.succeeds(&["set", "safety.reaction", "off"]);
    assert!(server.succeeds(&["read", "safety"]).contains("safety.reaction = \"Off\""));
    server.succeeds(&["set", "joints.*.limits.velocity", "4.5"]);
    assert!(server.succeeds(&["read", "joints.finger3_curl.limits"]).contains("limits.velocity = 4.5"));
    server.fails(&["set", "safety.damping", "-1"], 2, &["safety.damping", "-1"]);
    server.fails(&["set", "safety.reaction", "sleep"], 2, &["sleep", "Hold"]);
    server.fails(&["set", "safety.colour", "red"], 2, &["colour", "command_timeout"]);
    server.fails(&["set", "safety", "1"], 2, &["is a group"]);
    // Homed joints stay homed: their encoders are the same.
    server.succeeds(&["move", "finger1_swing=0.02"]);
    assert_eq!(server.json(&["model", "show"])["safety"]["reaction"], "Off");
}

#[test]
fn ports_that_are_not_there_and_words_that_make_no_sense_are_told_apart() {
    let server = Server::start();
    server.fails(&["--port", "/dev/nowhere", "info"], 3, &["/dev/nowhere does not exist"]);
    server.fails(&["--port", "tcp://localhost:1", "info"], 3, &["nobody answers"]);
    server.fails(&["--port", "quantum://x", "info"], 2, &["quantum://x"]);
    server.fails(&["--timeout", "0", "info"], 2, &["--timeout"]);
    server.fails(&["--link-faults", "flip=2", "info"], 2, &["flip"]);
    server.fails(&["dance"], 2, &["dance"]);
    server.fails(&["--json", "--port", "/dev/nowhere", "info"], 3, &["\"exit_code\":3"]);
    // A socket at which nobody speaks our language.
    let silent = server.folder.path().join("silent");
    let _listener = std::os::unix::net::UnixListener::bind(&silent).unwrap();
    let port = format!("unix://{}", silent.display());
    server.fails(&["--timeout", "0.3", "--port", &port, "info"], 6, &["no answer"]);
    server.fails(&["--timeout", "0.3", "--port", &port, "doctor"], 6, &["no answer", "RX and TX"]);
    assert!(server.succeeds(&["completions", "bash"]).contains("_tesaki"));
}

#[test]
fn a_bad_line_costs_repeats_and_nothing_else() {
    let server = Server::ready();
    let faults = "seed=3,flip=2e-4,drop=2e-4,splice=5e-3,duplicate=2e-2";
    for angle in ["0.1", "0.2", "0.0"] {
        server.succeeds(&[
            "--timeout",
            "10",
            "--link-faults",
            faults,
            "move",
            &format!("finger1_swing={angle}"),
        ]);
    }
    let status = server.json(&["info"]);
    let frames = &status["status"]["board"]["supervisor_link"]["frames"];
    let damaged: u64 = ["overlong", "framing", "checksum", "malformed"]
        .map(|kind| frames[kind].as_u64().unwrap())
        .iter()
        .sum();
    assert!(damaged > 0, "{frames}");
    let terminal = server.terminal.to_str().unwrap();
    server.succeeds(&["--port", terminal, "move", "finger1_swing=0.05"]);
}

#[test]
fn a_monitor_goes_on_by_itself_when_the_board_comes_back() {
    let server = Server::ready();
    let mut monitor = server.start_command(&["--json", "monitor"]);
    let folder = tempfile::tempdir().unwrap();
    let path = server.folder.path().to_owned();
    std::thread::sleep(Duration::from_millis(300));
    server.stop.store(true, Ordering::Relaxed);
    std::thread::sleep(Duration::from_millis(300));
    drop(folder);
    // Another board appears at the same place.
    let mut server = server;
    if let Some(thread) = server.thread.take() {
        thread.join().unwrap();
    }
    let _ = std::fs::remove_file(path.join("board"));
    let again = Server::start_at(std::mem::replace(&mut server.folder, tempfile::tempdir().unwrap()));
    std::thread::sleep(Duration::from_millis(2500));
    monitor.kill().unwrap();
    let text = String::from_utf8(monitor.wait_with_output().unwrap().stdout).unwrap();
    let ticks: Vec<u64> = text
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["tick"].as_u64().unwrap())
        .collect();
    assert!(ticks.windows(2).any(|pair| pair[1] != pair[0] + 4), "no telemetry of the new board: {ticks:?}");
    drop(again);
}

#[test]
fn an_arm_yields_until_ctrl_c() {
    let server = Server::ready_arm();
    let soft = arm7().join("impedances/soft.toml").to_str().unwrap().to_owned();
    server.fails(&["impedance", "hold", &soft], 7, &["hand was not tared", "tesaki tare"]);
    server.succeeds(&["tare"]);
    server.fails(&["impedance", "hold", "nowhere.toml"], 1, &["nowhere.toml"]);
    let spoilt = server.folder.path().join("spoilt.toml");
    let text =
        std::fs::read_to_string(&soft).unwrap().replace("translation = 300.0", "translation = 30000.0");
    std::fs::write(&spoilt, text).unwrap();
    let spoilt = spoilt.to_str().unwrap();
    server.fails(&["impedance", "hold", spoilt], 1, &["spoilt.toml", "stiffness along x", "0 to 3750 N/m"]);
    // The tool is seen before the arm is armed, too.
    let before = server.json(&["impedance", "status"]);
    assert!((before["position"][0].as_f64().unwrap() - 0.36).abs() < 0.01, "{before}");

    let run = server.start_command(&["impedance", "hold", &soft]);
    let held = (0..100).find_map(|_| {
        std::thread::sleep(Duration::from_millis(50));
        (server.json(&["impedance", "status"])["weakest"].as_f64().unwrap() > 0.1).then_some(())
    });
    held.expect("never armed");
    std::thread::sleep(Duration::from_millis(1200));
    let words = server.succeeds(&["impedance", "status"]);
    assert!(words.contains("off its place") && words.contains("contact        no"), "{words}");
    signal(&run, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(run));
    assert_eq!(code, 0, "{text}");
    for word in ["armed", "mm off", "N, free", "elbow", "interrupted: disarmed", "done: yielded for"] {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }

    // What is printed for programs is JSON, and a recording that starts meanwhile repeats.
    let run = server.start_command(&["--json", "impedance", "hold", &soft, "--duration", "4"]);
    while server.json(&["info"])["status"]["node"]["mode"] == "Disarmed" {
        std::thread::sleep(Duration::from_millis(20));
    }
    let recording = server.folder.path().join("arm").to_str().unwrap().to_owned();
    server.succeeds(&["record", &recording, "--duration", "1"]);
    server.succeeds(&["replay", &format!("{recording}.log")]);
    let (code, text) = said(&finish(run));
    assert_eq!(code, 0, "{text}");
    assert!(text.lines().count() > 3 && text.contains("\"contact\":false"), "{text}");
    assert!(text.contains("largest_force"), "{text}");
}

#[test]
fn a_hand_is_no_arm() {
    let server = Server::ready();
    server.fails(&["impedance", "status"], 7, &["the robot is not an arm"]);
    let soft = arm7().join("impedances/soft.toml").to_str().unwrap().to_owned();
    server.fails(&["impedance", "hold", &soft], 1, &["only an arm of seven joints has an arm angle"]);
}
