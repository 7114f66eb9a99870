//! `tesaki look` and `tesaki approach`: an arm with its camera in front of a door, simulated in real time.

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::{Value, json};
use tesaki_sim::door::KNOB;

use super::asking::Asked;
use super::server::{Server, finish, said, signal};

/// Minimum force of each finger on a gripped knob [N].
const GRIPPED: f64 = 5.0;
/// Doors that are tried one after the other: not every knob can be gripped (docs/measurements.md), and this
/// tests how the programs work together.
const DOORS: [u64; 3] = [2, 11, 14];

fn robot() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/knob-arm")
}

/// Returns a robot folder whose behaviour gives up at the first failure, after 3 s of patience.
fn impatient(folder: &Path) -> PathBuf {
    let copy = folder.join("impatient");
    std::fs::create_dir(&copy).unwrap();
    for name in ["robot.urdf", "controller.toml", "hand_eye.toml", "approach.toml"] {
        let mut text = std::fs::read_to_string(robot().join(name)).unwrap();
        if name == "approach.toml" {
            assert!(text.contains("retries = 3") && text.contains("patience = 8.0"));
            text = text.replace("retries = 3", "retries = 0").replace("patience = 8.0", "patience = 3.0");
        }
        std::fs::write(copy.join(name), text).unwrap();
    }
    copy
}

/// The three programs; board and camera run in this process.
struct Scene {
    server: Server,
    circles: String,
}

impl Scene {
    fn new() -> Self {
        Self::before(DOORS[0])
    }

    fn before(door: u64) -> Self {
        let server = Server::before_door(door);
        let circles = format!("unix://{}", server.folder.path().join("circles").display());
        Self { server, circles }
    }

    fn look(&self) -> Program {
        let camera = format!("unix://{}", self.server.folder.path().join("camera").display());
        let mut command = self.server.command(&["--json", "look", "--from", &camera, "--to", &self.circles]);
        Program::start(&mut command)
    }

    fn approach(&self, robot: &Path, arguments: &[&str]) -> Approach {
        let mut all = vec!["--json", "approach", "--robot", robot.to_str().unwrap(), "--from", &self.circles];
        all.extend(arguments);
        Approach::start(self.server.command(&all))
    }

    /// Connects a program in place of `tesaki look`; returns its stream and the answers to it.
    fn detector(&self) -> (UnixStream, BufReader<UnixStream>) {
        let deadline = Instant::now() + Duration::from_secs(60);
        let stream = loop {
            match UnixStream::connect(self.server.folder.path().join("circles")) {
                Ok(stream) => break stream,
                Err(error) => assert!(Instant::now() < deadline, "{error}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let mut reader = BufReader::new(stream.try_clone().unwrap());
        assert_eq!(line(&mut reader), json!({ "version": 1 }));
        (stream, reader)
    }

    /// Asserts that both fingers press on the knob, according to the machine's true state.
    fn assert_gripped(self) {
        let contacts = self.server.stop().fixture_contacts();
        for finger in ["left_finger", "right_finger"] {
            let on_knob = contacts.iter().filter(|contact| contact.fixture == KNOB && contact.link == finger);
            let force: f64 = on_knob.map(|contact| contact.force.norm()).sum();
            assert!(force > GRIPPED, "{finger}: {force} N");
        }
    }
}

fn line(reader: &mut BufReader<UnixStream>) -> Value {
    let mut text = String::new();
    reader.read_line(&mut text).unwrap();
    serde_json::from_str(&text).unwrap_or_else(|_| panic!("{text:?}"))
}

/// A program that is killed when the test ends, in any case.
struct Program(Option<Child>);

impl Program {
    fn start(command: &mut Command) -> Self {
        Self(Some(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()))
    }

    fn child(&mut self) -> &mut Child {
        self.0.as_mut().unwrap()
    }

    fn kill(&mut self) {
        let _ = self.child().kill();
        let _ = self.child().wait();
    }

    /// Waits for the end; returns exit code and output.
    fn finish(mut self) -> (i32, String) {
        said(&finish(self.0.take().unwrap()))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if self.0.is_some() {
            self.kill();
        }
    }
}

/// The behaviour program while it runs.
struct Approach {
    program: Program,
    output: BufReader<std::process::ChildStdout>,
    said: Vec<Value>,
}

impl Approach {
    fn start(mut command: Command) -> Self {
        let mut program = Program::start(&mut command);
        let output = BufReader::new(program.child().stdout.take().unwrap());
        Self { program, output, said: Vec::new() }
    }

    /// Returns its next line of output; `None` at the end.
    fn next(&mut self) -> Option<Value> {
        let mut text = String::new();
        self.output.read_line(&mut text).unwrap();
        let value: Value = serde_json::from_str(text.trim()).ok()?;
        self.said.push(value.clone());
        Some(value)
    }

    /// Waits for a line that matches.
    #[track_caller]
    fn until(&mut self, is_it: impl Fn(&Value) -> bool) -> Value {
        while let Some(value) = self.next() {
            if is_it(&value) {
                return value;
            }
        }
        panic!(
            "never; it said {:?}",
            self.said.iter().filter(|value| value["hand"].is_null()).collect::<Vec<_>>()
        );
    }

    /// Waits for the outcome; `None` if the knob is not gripped.
    fn grips(&mut self) -> Option<Value> {
        while let Some(value) = self.next() {
            if !value["gripped"].is_null() {
                return is_gripped(&value).then_some(value);
            }
        }
        None
    }

    /// Waits for a phase.
    #[track_caller]
    fn until_phase(&mut self, phase: &str) {
        self.until(|value| value["phase"] == phase);
    }

    /// Waits for the end; returns exit code and last output.
    fn finish(mut self) -> (i32, String) {
        while self.next().is_some() {}
        let (code, errors) = self.program.finish();
        let last = self.said.last().map_or_else(String::new, Value::to_string);
        (code, last + &errors)
    }
}

fn is_gripped(value: &Value) -> bool {
    value["gripped"] == true
}

#[test]
fn three_programs_grip_a_knob_and_vision_may_be_killed_on_the_way() {
    assert!(DOORS.into_iter().any(grips_although_vision_is_killed_on_the_way), "no knob is gripped");
}

fn grips_although_vision_is_killed_on_the_way(door: u64) -> bool {
    let scene = Scene::before(door);
    // Whichever starts first waits for the other.
    let mut look = scene.look();
    let mut approach = scene.approach(&robot(), &["--hold"]);
    approach.until_phase("going before the knob");
    look.kill();
    std::thread::sleep(Duration::from_millis(400));
    let mut look = scene.look();
    let Some(outcome) = approach.grips() else {
        // It keeps holding in place.
        return false;
    };
    assert!(outcome["bad"] == 0, "{outcome}");
    assert!(outcome["pictures"].as_u64().unwrap() > 15, "{outcome}");
    assert_eq!(scene.server.json(&["faults"])["total"], 0);
    signal(look.child(), Signal::SIGINT);
    let (code, text) = look.finish();
    assert!(code == 0 && text.contains("\"found\""), "{code}: {text}");
    // It keeps holding.
    approach.until(|value| value["gripper"] == "Holding");
    scene.server.stop.store(true, std::sync::atomic::Ordering::Relaxed);
    approach.program.kill();
    scene.assert_gripped();
    true
}

#[test]
fn an_arm_whose_behaviour_is_killed_holds_and_the_next_one_goes_on() {
    assert!(DOORS.into_iter().any(the_next_one_grips), "no knob is gripped");
}

fn the_next_one_grips(door: u64) -> bool {
    let scene = Scene::before(door);
    let mut look = scene.look();
    let mut first = scene.approach(&robot(), &[]);
    first.until_phase("going before the knob");
    std::thread::sleep(Duration::from_millis(200));
    first.program.kill();
    scene.server.wait_for("in fault");
    let angles = || {
        let state = scene.server.json(&["read"]);
        let joints = state["joints"].as_array().unwrap().iter();
        joints.map(|joint| joint["position"].as_f64().unwrap()).collect::<Vec<_>>()
    };
    std::thread::sleep(Duration::from_millis(300));
    let before = angles();
    std::thread::sleep(Duration::from_millis(700));
    for (before, after) in before.iter().zip(angles()) {
        assert!((before - after).abs() < 0.01, "{before} rad, then {after}");
    }
    // Without --resume, a person must check first.
    let robot = robot();
    scene.server.fails(
        &["approach", "--robot", robot.to_str().unwrap(), "--from", &scene.circles],
        5,
        &["no command from the supervisor"],
    );
    let mut second = scene.approach(&robot, &["--resume", "--hold"]);
    let is_gripped = second.grips().is_some();
    look.kill();
    second.program.kill();
    if !is_gripped {
        return false;
    }
    scene.assert_gripped();
    true
}

#[test]
fn the_behaviour_gives_up_with_a_reason_when_vision_is_gone_for_good() {
    let mut scene = Scene::new();
    let robot = impatient(scene.server.folder.path());
    let mut look = scene.look();
    let mut approach = scene.approach(&robot, &["--no-hold"]);
    approach.until_phase("going before the knob");
    look.kill();
    let (code, text) = approach.finish();
    assert!(code == 8 && text.contains("there were no pictures: look at the camera"), "{code}: {text}");
    assert_eq!(scene.server.json(&["faults"])["total"], 0);
    // Its socket is removed with it, and that of the camera with the simulator.
    assert!(!scene.server.folder.path().join("circles").exists());
    let camera = scene.server.folder.path().join("camera");
    assert!(camera.exists());
    scene.server.stop.store(true, std::sync::atomic::Ordering::Relaxed);
    scene.server.thread.take().unwrap().join().unwrap();
    assert!(!camera.exists());
}

#[test]
fn circles_that_jump_lead_the_arm_nowhere() {
    let scene = Scene::new();
    let robot = impatient(scene.server.folder.path());
    let mut approach = scene.approach(&robot, &["--no-hold"]);
    let (mut stream, mut reader) = scene.detector();
    let lies = std::thread::spawn(move || {
        // Circles all over the picture, each with full confidence.
        for picture in 0_u32.. {
            let [u, v, radius] = [37, 61, 23].map(|factor| f64::from(picture * factor % 97) / 97.0);
            let circle = json!({ "center": [250.0 * u, 230.0 * v], "radius": 12.0 + 60.0 * radius });
            let line = json!({ "picture": picture, "age": 0.02, "size": [256, 240], "circle": circle });
            if stream.write_all(format!("{line}\n").as_bytes()).is_err() {
                break;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    });
    let begin = approach.until(|value| value["hand"].is_object())["hand"].clone();
    let (code, text) = {
        let mut farthest = 0.0_f64;
        while let Some(value) = approach.next() {
            if let Some(place) = value["hand"]["translation"].as_array() {
                let at = |place: &[Value], axis: usize| place[axis].as_f64().unwrap();
                let begin = begin["translation"].as_array().unwrap();
                let square: f64 = (0..3).map(|axis| (at(place, axis) - at(begin, axis)).powi(2)).sum();
                farthest = farthest.max(square.sqrt());
            }
        }
        assert!(farthest < 0.05, "the hand went {farthest} m");
        approach.finish()
    };
    // The second reason occurs if the machine is so busy that the lies come too late.
    let is_named = ["no rose was found", "there were no pictures"].iter().any(|reason| text.contains(reason));
    assert!(code == 8 && is_named, "{code}: {text}");
    assert_eq!(scene.server.json(&["faults"])["total"], 0);
    lies.join().unwrap();
    // It got no answer: it had asked nothing, and nothing was invalid.
    let mut rest = String::new();
    let _ = reader.read_line(&mut rest);
    assert_eq!(rest, "");
}

#[test]
fn circles_that_come_before_the_arm_may_move_are_of_no_use() {
    let scene = Scene::new();
    let robot = impatient(scene.server.folder.path());
    let robot = robot.to_str().unwrap();
    let detector = scene.circles.clone();
    let sent = std::thread::spawn(move || {
        let deadline = Instant::now() + Duration::from_secs(60);
        let path = detector.trim_start_matches("unix://").to_owned();
        let mut stream = loop {
            match UnixStream::connect(&path) {
                Ok(stream) => break stream,
                Err(error) => assert!(Instant::now() < deadline, "{error}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        // More data than the program and the socket can hold if nobody reads them.
        stream.set_write_timeout(Some(Duration::from_secs(5))).unwrap();
        let circle = "{\"picture\": 1, \"age\": 0, \"circle\": {\"center\": [127, 140], \"radius\": 22}}\n";
        let written = (0..6000).take_while(|_| stream.write_all(circle.as_bytes()).is_ok()).count();
        (written, stream)
    });
    let asked =
        Asked::start(&scene.server, &["approach", "--robot", robot, "--from", &scene.circles, "--no-hold"]);
    let (written, stream) = sent.join().unwrap();
    std::thread::sleep(Duration::from_millis(200));
    let (code, text) = said(&finish(asked.answer("y")));
    assert_eq!(written, 6000);
    assert!(code == 8 && text.contains("no pictures") && text.contains(" 0 pictures"), "{code}: {text}");
    drop(stream);
}

#[test]
fn what_is_wrong_with_a_line_is_answered_and_nothing_is_enabled() {
    let scene = Scene::new();
    let file = scene.server.folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let (file, folder) = (format!("unix://{}", file.display()), robot());
    let command = ["approach", "--robot", folder.to_str().unwrap(), "--from", &file];
    scene.server.fails(&command, 2, &["cannot listen at", "a regular file is there: choose a new path"]);
    let mut approach = scene.approach(&robot(), &[]);
    let (mut stream, mut reader) = scene.detector();
    let mut ask = |text: &str| {
        stream.write_all(format!("{text}\n").as_bytes()).unwrap();
        line(&mut reader)
    };
    // A query is answered before the arm is enabled.
    let answer = ask("{\"picture\": 3, \"age\": 0.01}");
    assert!(answer["picture"] == 3 && answer["search"]["radius"][1].as_f64().unwrap() > 20.0, "{answer}");
    for (line, words) in [
        (
            "{\"picture\": 3, \"age\": 0.01, \"size\": [640, 480], \"circle\": null}",
            "calibrated with 256 × 240",
        ),
        ("{\"picture\": 3, \"age\": 9, \"circle\": null}", "age 9 s; it must be 0 to 1 s"),
        ("circle 100 100 20", "expected value"),
    ] {
        let answer = ask(line);
        assert!(answer["error"].as_str().is_some_and(|error| error.contains(words)), "{line}: {answer}");
    }
    // A web page in a browser on this machine does not get beyond its first line.
    let (mut browser, mut reader) = scene.detector();
    let page =
        "POST / HTTP/1.1\n\n{\"picture\": 3, \"age\": 0, \"circle\": {\"center\": [9, 9], \"radius\": 9}}\n";
    browser.write_all(page.as_bytes()).unwrap();
    assert!(line(&mut reader)["error"].is_string());
    assert_eq!(reader.read_line(&mut String::new()).unwrap_or(0), 0);
    std::thread::sleep(Duration::from_millis(100));
    signal(approach.program.child(), Signal::SIGINT);
    let (code, text) = approach.finish();
    assert!(code == 130 && text.contains("interrupted: disabled"), "{code}: {text}");
    scene.server.wait_for("disabled");
}
