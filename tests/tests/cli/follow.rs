//! `tesaki follow`: an arm on a board that follows lines of input and a recorded hand.

use std::f64::consts::{PI, TAU};
use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::process::{Child, ChildStdin, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::{Value, json};

use super::feed::feed;
use super::server::{Server, arm7, finish, said, signal};

const CIRCLE: &str = include_str!("../../../docs/examples/circle.csv");

fn firm() -> String {
    file_of("firm")
}

pub fn file_of(impedance: &str) -> String {
    arm7().join(format!("impedances/{impedance}.toml")).to_str().unwrap().to_owned()
}

/// Starts an arm that is ready to be enabled.
pub fn arm() -> Server {
    let server = Server::ready_arm();
    server.succeeds(&["tare"]);
    server
}

/// The running program that leads the arm, with its output.
pub struct Leading {
    pub child: Child,
    said: Arc<Mutex<Vec<Value>>>,
    reader: JoinHandle<()>,
}

impl Leading {
    pub fn start(server: &Server, arguments: &[&str]) -> (Self, ChildStdin) {
        Self::start_as(server, "firm", arguments)
    }

    /// Starts it with the arm's impedance of this name.
    pub fn start_as(server: &Server, impedance: &str, arguments: &[&str]) -> (Self, ChildStdin) {
        let file = file_of(impedance);
        let mut all = vec!["--json", "follow", "--no-hold", "--impedance", &file];
        all.extend(arguments);
        let mut command = server.command(&all);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let said = Arc::new(Mutex::new(Vec::new()));
        let lines = Arc::clone(&said);
        let reader = std::thread::spawn(move || {
            for line in output.lines().map(Result::unwrap) {
                lines.lock().unwrap().push(serde_json::from_str(&line).unwrap());
            }
        });
        let stdin = child.stdin.take().unwrap();
        (Self { child, said, reader }, stdin)
    }

    pub fn count(&self, is_it: impl Fn(&Value) -> bool) -> usize {
        self.said.lock().unwrap().iter().filter(|value| is_it(value)).count()
    }

    /// The last telemetry of the arm, if there is any.
    pub fn telemetry(&self) -> Option<Value> {
        self.said.lock().unwrap().iter().rfind(|value| value.get("sigma_min").is_some()).cloned()
    }

    /// Position of the tool.
    pub fn tool(&self) -> [f64; 3] {
        numbers(&self.telemetry().unwrap()["position"])
    }

    /// Waits for the end; returns exit code, output and errors.
    pub fn finish(mut self) -> (i32, Vec<Value>, String) {
        let mut errors = self.child.stderr.take().unwrap();
        let (code, _) = said(&finish(self.child));
        self.reader.join().unwrap();
        let mut text = String::new();
        errors.read_to_string(&mut text).unwrap();
        let values = Arc::into_inner(self.said).unwrap().into_inner().unwrap();
        let error = values.last().and_then(|last| last["error"].as_str()).unwrap_or_default().to_owned();
        (code, values, error + &text)
    }
}

pub fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let list: Vec<f64> = value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect();
    list.try_into().unwrap()
}

pub fn distance(one: [f64; 3], other: [f64; 3]) -> f64 {
    one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f64>().sqrt()
}

/// A hand whose samples carry their sending times: a busy machine sends fewer samples, but none too late.
pub struct Hand {
    begin: Instant,
    stdin: ChildStdin,
    position: [f64; 3],
    elbow: f64,
}

impl Hand {
    pub fn new(stdin: ChildStdin) -> Self {
        Self { begin: Instant::now(), stdin, position: [0.0; 3], elbow: 0.0 }
    }

    fn sample(&self) -> Value {
        json!({
            "time": self.begin.elapsed().as_secs_f64(), "position": self.position,
            "quaternion": [0.0, 0.0, 0.0, 1.0], "elbow": self.elbow,
        })
    }

    fn say(&mut self, line: &Value) {
        // Near the program's end, nobody reads it.
        let _ = self.stdin.write_all(format!("{line}\n").as_bytes());
        std::thread::sleep(Duration::from_millis(8));
    }

    fn send(&mut self) {
        let sample = self.sample();
        self.say(&sample);
    }

    /// Holds still until something has happened.
    #[track_caller]
    pub fn until(&mut self, what: &str, mut has_happened: impl FnMut() -> bool) {
        let start = Instant::now();
        while !has_happened() {
            self.send();
            assert!(start.elapsed() < Duration::from_secs(60), "never: {what}");
        }
    }

    /// Moves to a position at 0.08 m/s.
    pub fn move_to(&mut self, goal: [f64; 3]) {
        let (start, from) = (Instant::now(), self.position);
        let duration = distance(from, goal) / 0.08;
        loop {
            let part = (start.elapsed().as_secs_f64() / duration).min(1.0);
            let part = part * part * (3.0 - 2.0 * part);
            for (axis, value) in self.position.iter_mut().enumerate() {
                *value = from[axis] + part * (goal[axis] - from[axis]);
            }
            self.send();
            if part >= 1.0 {
                break;
            }
        }
    }
}

pub fn is_clutch(value: &Value, state: &str, reason: &str) -> bool {
    value["clutch"] == state && value["reason"].as_str().unwrap_or_default().contains(reason)
}

/// The tool is on the hand's circle, by Pythagoras: 4 cm, in y and z, from its start.
#[test]
fn a_stream_of_poses_leads_the_tool_on_a_circle() {
    const RADIUS: f64 = 0.04;
    let server = arm();
    let (leading, stdin) = Leading::start(&server, &[]);
    let mut hand = Hand::new(stdin);
    hand.until("the clutch closes", || leading.count(|value| is_clutch(value, "closed", "")) == 1);
    hand.until("telemetry", || leading.telemetry().is_some());
    let (first, begin) = (leading.telemetry().unwrap(), Instant::now());
    let start = leading.tool();
    // One turn in three seconds, while the elbow moves by 0.1 rad.
    loop {
        let part = (begin.elapsed().as_secs_f64() / 3.0).min(1.0);
        let (sin, cos) = (TAU * part * part * (3.0 - 2.0 * part)).sin_cos();
        hand.position = [0.0, RADIUS * sin, RADIUS * (cos - 1.0)];
        hand.elbow = 0.1 * part;
        hand.send();
        if part >= 1.0 {
            break;
        }
    }
    let arrived = |leading: &Leading| distance(leading.tool(), start) < 2e-3;
    hand.until("the tool is back", || arrived(&leading));
    let rest = Instant::now();
    hand.until("it rests", || rest.elapsed() > Duration::from_millis(500));
    assert!(arrived(&leading), "{:?} from {start:?}", leading.tool());
    let elbow = leading.telemetry().unwrap()["elbow"].as_f64().unwrap() - first["elbow"].as_f64().unwrap();
    assert!((elbow - 0.1).abs() < 0.02, "{elbow} rad");
    drop(hand);
    let (code, values, error) = leading.finish();
    assert_eq!(code, 0, "{error}");
    let mut quadrants = [0; 4];
    for value in values.iter().filter(|value| value.get("sigma_min").is_some()) {
        let [x, y, z] = numbers(&value["position"]);
        let (across, up) = (y - start[1], z - start[2] + RADIUS);
        assert!((x - start[0]).abs() < 3e-3, "{value}");
        assert!((across.hypot(up) - RADIUS).abs() < 5e-3, "{value}");
        quadrants[2 * usize::from(across > 0.0) + usize::from(up > 0.0)] += 1;
    }
    assert!(quadrants.iter().all(|count| *count > 0), "{quadrants:?}");
    let summary = values.last().unwrap();
    let rejected = json!({ "late": 0, "out_of_order": 0, "jumped": 0, "bad": 0, "elbows": 0 });
    assert!(summary["samples"].as_u64().unwrap() > 100, "{summary}");
    assert_eq!((&summary["rejected"], &summary["lost"]), (&rejected, &Value::Null));
    assert!(summary["largest_distance"].as_f64().unwrap() < 0.02, "{summary}");
    assert_eq!(server.json(&["faults"])["total"], 0);
}

/// Jumps, silence, a workspace border and invalid lines in succession: the tool stays each time, and the
/// reason is reported.
#[test]
fn what_no_arm_may_follow_opens_the_clutch_and_the_tool_stays() {
    let server = arm();
    let start: [f64; 3] = numbers(&server.json(&["read"])["tips"]["hand"]["position"]);
    // The tool may move 5 cm along y.
    let border = start[1] + 0.05;
    let [x, y, z] = start;
    let workspace = format!("{},{},{},{border},{},{}", x - 0.2, x + 0.2, y - 0.2, z - 0.2, z + 0.2);
    let (leading, stdin) = Leading::start(&server, &["--workspace", &workspace]);
    let mut hand = Hand::new(stdin);
    let closed = |number: usize| leading.count(|value| is_clutch(value, "closed", "")) == number;
    let opened = |reason: &str| leading.count(|value| is_clutch(value, "open", reason)) == 1;
    hand.until("the clutch closes", || closed(1) && leading.telemetry().is_some());
    let stays = |leading: &Leading, place: [f64; 3]| {
        let tool = leading.tool();
        assert!(distance(tool, place) < 2e-3, "{tool:?} is not {place:?}");
    };

    hand.position[1] += 0.3;
    hand.until("the clutch opens", || opened("from its prediction; at most 0.1 m is accepted"));
    stays(&leading, start);
    hand.say(&json!({ "clutch": true }));
    hand.until("the clutch closes again", || closed(2));
    stays(&leading, start);

    // While the hand moves.
    let there = [0.0, hand.position[1] - 0.04, 0.0];
    hand.move_to(there);
    let wait = Instant::now();
    while !opened("no sample for 0.5 s") {
        std::thread::sleep(Duration::from_millis(20));
        assert!(wait.elapsed() < Duration::from_secs(60), "the clutch is still closed");
    }
    let (tool, reports) = (leading.tool(), leading.said.lock().unwrap().len());
    while leading.said.lock().unwrap().len() < reports + 5 {
        std::thread::sleep(Duration::from_millis(20));
    }
    stays(&leading, tool);
    assert!(distance(tool, start) > 0.03, "{tool:?}");

    hand.position[1] += 1.0;
    hand.until("an open clutch does not care", || leading.said.lock().unwrap().len() > reports + 8);
    stays(&leading, tool);
    hand.say(&json!({ "clutch": true }));
    hand.until("the clutch closes a third time", || closed(3));
    // From 4 cm below to 16 cm above its start.
    let there = [0.0, hand.position[1] + 0.2, 0.0];
    hand.move_to(there);
    hand.until("the border is told", || leading.count(|value| value["workspace"] == "y") == 1);
    hand.until("the tool is there", || (leading.tool()[1] - border).abs() < 2e-3);
    stays(&leading, [x, border, z]);

    let good = hand.sample();
    let changed = |key: &str, value: Value| {
        let mut line = good.clone();
        line[key] = value;
        line
    };
    let mut missing = good.clone();
    missing.as_object_mut().unwrap().remove("position");
    for line in [
        changed("quaternion", json!([0.0, 0.0, 0.5, 1.0])),
        missing,
        changed("position", json!([0.0, null, 0.0])),
        changed("elbo", json!(0.0)),
    ] {
        hand.say(&line);
        hand.send();
    }
    // A sample that was overtaken.
    let before = hand.sample();
    (0..3).for_each(|_| hand.send());
    hand.say(&before);
    hand.send();
    stays(&leading, [x, border, z]);
    hand.say(&json!({ "clutch": false }));
    let wait = Instant::now();
    while !opened("it was asked for") {
        std::thread::sleep(Duration::from_millis(20));
        assert!(wait.elapsed() < Duration::from_secs(60), "the clutch is still closed");
    }
    drop(hand);
    let (code, values, error) = leading.finish();
    assert_eq!(code, 0, "{error}");
    let summary = values.last().unwrap();
    assert_eq!((&summary["stops"], &summary["rejected"]["bad"]), (&json!(2), &json!(4)), "{summary}");
    // A busy machine may also send it late.
    assert!(summary["rejected"]["out_of_order"] == 1 || summary["rejected"]["late"] != 0, "{summary}");
    assert!(summary["rejected"]["jumped"].as_u64().unwrap() > 5, "{summary}");
    let highest = values.iter().filter(|value| value.get("sigma_min").is_some());
    let highest = highest.map(|value| value["position"][1].as_f64().unwrap()).fold(f64::MIN, f64::max);
    assert!(highest < border + 2e-3, "{highest} beyond {border}");
    assert_eq!(server.json(&["faults"])["total"], 0);
}

#[test]
fn a_recorded_hand_is_played_and_what_is_wrong_with_it_is_said_by_line() {
    let server = Server::ready_arm();
    let path = server.folder.path().join("hand.csv");
    let from = format!("file:{}", path.display());
    let firm = firm();
    let command = ["follow", "--no-hold", "--impedance", &firm, "--from", &from];
    let refused = |line: usize, column: usize, cell: &str, words: &str| {
        let mut rows: Vec<Vec<&str>> = CIRCLE.lines().map(|row| row.split(',').collect()).collect();
        rows[line][column] = cell;
        let text: Vec<String> = rows.into_iter().map(|row| row.join(",")).collect();
        std::fs::write(&path, text.join("\n")).unwrap();
        server.fails(&command, 1, &[words]);
    };
    refused(0, 2, "w", "hand.csv:1: no column y (position of the hand [m])");
    refused(4, 0, "0.02", "hand.csv:5: time 0.02 s does not follow 0.04 s");
    refused(
        4,
        0,
        "40",
        "hand.csv:5: time 40 s follows 0.04 s, and a source that is silent for 5 s (--silence)",
    );
    refused(4, 7, "0.9", "hand.csv:5: the quaternion has norm 0.9");
    refused(4, 1, "nan", "hand.csv:5: column x");
    refused(4, 1, "360", "hand.csv:5: the position is 360 m from the origin, limit 100 m");
    // It would be ignored, and the tool followed although the pedal says no.
    std::fs::write(&path, "time,x,y,z,qx,qy,qz,qw,clucth\n0,0,0,0,0,0,0,1,0\n").unwrap();
    server.fails(&command, 1, &["hand.csv:1: unknown column clucth: write clutch, or remove it"]);
    std::fs::write(&path, "time,x,y,z,qx,qy,qz,qw,clutch\n0,0,0,0,0,0,0,1,2\n").unwrap();
    server.fails(&command, 1, &["hand.csv:2: clutch 2: expected 1 (closed) or 0 (open)"]);
    std::fs::write(&path, in_millimetres()).unwrap();
    server.fails(
        &command,
        1,
        &["hand.csv:10: the position moves by 0.050 m in 0.020 s, 2.5 m/s", "limit 2 m/s: is it in metres"],
    );
    std::fs::write(&path, CIRCLE).unwrap();
    server.fails(&command, 7, &["hand was not tared", "tesaki tare"]);
    server.succeeds(&["tare"]);
    let text = server.succeeds(&command);
    for words in
        ["the clutch is closed: the tool follows", "hand.csv has ended", "done: ", "samples followed"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert_eq!(server.json(&["faults"])["total"], 0);
}

/// Also when the time is over an arm does not fall.
#[test]
fn an_arm_that_has_followed_for_its_time_is_held_until_ctrl_c() {
    let server = arm();
    let circle = concat!("file:", env!("CARGO_MANIFEST_DIR"), "/../docs/examples/circle.csv");
    let told = server.folder.path().join("told");
    let mut command =
        server.command(&["follow", "--impedance", &firm(), "--from", circle, "--duration", "0.5"]);
    let mut child = command.stdout(Stdio::null()).stderr(File::create(&told).unwrap()).spawn().unwrap();
    let start = Instant::now();
    while !std::fs::read_to_string(&told).unwrap().contains("holding, because without power arm7 falls") {
        assert!(child.try_wait().unwrap().is_none(), "{}", std::fs::read_to_string(&told).unwrap());
        assert!(start.elapsed() < Duration::from_secs(60), "{}", std::fs::read_to_string(&told).unwrap());
        std::thread::sleep(Duration::from_millis(20));
    }
    server.wait_for("enabled");
    signal(&child, Signal::SIGINT);
    assert_eq!(finish(child).status.code(), Some(0));
    server.wait_for("disabled");
}

/// The recorded circle with its positions in millimetres.
fn in_millimetres() -> String {
    let row = |row: &str| {
        let cells = row.split(',').enumerate().map(|(column, cell)| match cell.parse::<f64>() {
            Ok(value) if (1..4).contains(&column) => (1e3 * value).to_string(),
            _ => cell.to_owned(),
        });
        cells.collect::<Vec<_>>().join(",")
    };
    CIRCLE.lines().map(row).collect::<Vec<_>>().join("\n")
}

#[test]
fn a_stream_in_millimetres_does_not_let_the_arm_leap() {
    let server = arm();
    let start: [f64; 3] = numbers(&server.json(&["read"])["tips"]["hand"]["position"]);
    let (leading, stdin) = Leading::start(&server, &[]);
    let mut hand = Hand::new(stdin);
    hand.until("the clutch closes", || leading.count(|value| is_clutch(value, "closed", "")) == 1);
    let (begin, limit) = (
        Instant::now(),
        "limit 2 m/s: is it in metres and `time` in seconds, or does the hand jump? The arm stays",
    );
    while leading.count(|value| is_clutch(value, "open", limit)) == 0 {
        // Half a turn a second, of 100 mm.
        let elapsed = begin.elapsed().as_secs_f64();
        hand.position = [0.0, 100.0 * (1.0 - (PI * elapsed).cos()), 0.0];
        hand.send();
        assert!(elapsed < 60.0, "the clutch is still closed");
    }
    drop(hand);
    let (code, values, error) = leading.finish();
    assert_eq!(code, 0, "{error}");
    let farthest = values.iter().filter(|value| value.get("sigma_min").is_some());
    let farthest = farthest.map(|value| distance(numbers(&value["position"]), start)).fold(0.0, f64::max);
    assert!(farthest < 0.12, "{farthest}");
}

#[test]
fn what_cannot_be_followed_is_refused_before_anything_is_enabled() {
    let server = arm();
    let firm = firm();
    let refused = |arguments: &[&str], code: i32, words: &[&str]| {
        let mut all = vec!["follow", "--impedance", &firm];
        all.extend(arguments);
        server.fails(&all, code, words);
    };
    refused(&["--from", "tracker"], 2, &["is not a source", "udp://127.0.0.1:PORT"]);
    refused(&["--from", "udp://127.0.0.1:0"], 2, &["port 0 is none"]);
    refused(&["--from", "udp://0.0.0.0:7600"], 2, &["0.0.0.0 is reachable from other machines"]);
    refused(&["--from", "udp://127.0.0.1"], 2, &["expected udp://127.0.0.1:PORT"]);
    refused(&["--scale", "0"], 2, &["scale is 0; it must be 0.001 to 100"]);
    refused(&["--workspace", "0,1,0"], 2, &["is not a box"]);
    refused(
        &["--workspace", "1,0,0,1,0,1"],
        2,
        &["side of the workspace along x, in m, is -1", "0.001 to 100"],
    );
    refused(&["--workspace", "0,1,0.5,1,-1,1"], 2, &["the tool is at", "outside of the box"]);
    refused(&["--from", &format!("board:{}", server.address)], 2, &["--from names the arm's own board"]);
    refused(&["--from", "board:unix:///nowhere/board"], 3, &["the master at unix:///nowhere/board"]);
    refused(&[], 1, &["standard input has ended; nothing was enabled", "--from file:FILE.csv"]);
    let spoilt = server.folder.path().join("spoilt.toml");
    let text = std::fs::read_to_string(&firm).unwrap().replace("\"arm-angle\"", "{ driven = \"finger\" }");
    std::fs::write(&spoilt, text).unwrap();
    let spoilt = spoilt.to_str().unwrap();
    server.fails(&["follow", "--impedance", spoilt], 1, &["spoilt.toml", "arm7 has no joint \"finger\""]);
    let good = json!({ "time": 0, "position": [0, 0, 0], "quaternion": [0, 0, 0, 1] });
    for (key, value, words) in [
        ("time", json!("now"), "line 1: no number \"time\""),
        ("quaternion", json!([0, 0, 0, 1.1]), "line 1: the quaternion has norm 1.1; it must be 1"),
        ("quaternion", json!([0, 0, 1]), "line 1: no \"quaternion\""),
        ("position", json!([0, 1e39, 0]), "line 1: a number is not finite"),
        ("position", json!([360, 0, 0]), "limit 100 m: is it in metres?"),
        ("clutch", json!(1), "\"clutch\" must be true (closed) or false (open)"),
        ("elbo", json!(1), "there is no key \"elbo\": the keys are time, position"),
    ] {
        let mut line = good.clone();
        line[key] = value;
        let mut command = server.command(&["follow", "--impedance", &firm]);
        let (code, _, error) = feed(&mut command, &format!("{line}\n"));
        assert!(
            code == 1 && error.contains(words) && error.contains("nothing was enabled"),
            "{words}: {error}"
        );
    }
    let (code, _, error) = feed(&mut server.command(&["follow", "--impedance", &firm]), "{\"time\": NaN}\n");
    assert!(code == 1 && error.contains("line 1: not valid JSON"), "{error}");
    assert!(server.succeeds(&["info"]).contains("mode           disabled"));

    let hand = Server::start();
    refused(&["--from", &format!("board:{}", hand.address)], 7, &["the master at", "has no robot model"]);
    hand.succeeds(&["model", "push", super::server::hand3().to_str().unwrap()]);
    refused(&["--from", &format!("board:{}", hand.address)], 2, &["hand3 has 3 tips"]);
    hand.fails(&["follow", "--impedance", &firm], 2, &["hand3: the robot is not an arm"]);
}

/// Starts to follow a hand that holds still.
fn following(server: &Server) -> (Leading, Hand) {
    let (leading, stdin) = Leading::start(server, &[]);
    let mut hand = Hand::new(stdin);
    hand.until("the clutch closes", || leading.count(|value| is_clutch(value, "closed", "")) == 1);
    (leading, hand)
}

#[test]
fn faults_of_the_board_and_the_loss_of_command_end_it_by_name() {
    let server = arm();
    let (leading, mut hand) = following(&server);
    server.make_trouble("estop on");
    hand.until("it ends", || leading.count(|value| value["error"].is_string()) == 1);
    let (code, _, error) = leading.finish();
    assert!(code == 5 && error.contains("emergency stop"), "{code}: {error}");
    server.wait_for("in fault");

    // Another program disables the board and takes command while this one is stopped.
    let server = arm();
    let (leading, mut hand) = following(&server);
    signal(&leading.child, Signal::SIGSTOP);
    server.succeeds(&["disable"]);
    std::thread::sleep(Duration::from_millis(1200));
    server.wait_for_rest();
    let other = server.start_command(&["enable"]);
    let other = server.wait_with(other, "enabled");
    signal(&leading.child, Signal::SIGCONT);
    hand.until("it ends", || leading.count(|value| value["error"].is_string()) == 1);
    let (code, _, error) = leading.finish();
    // Whichever it learns first; a board that has since talked to many programs has forgotten this one.
    let reasons = ["another program disabled the board", "has lost command", "it has forgotten"];
    assert!(matches!(code, 1 | 7) && reasons.iter().any(|reason| error.contains(reason)), "{code}: {error}");
    server.wait_for("enabled");
    signal(&other, Signal::SIGINT);
    assert_eq!(said(&finish(other)).0, 0);
}

/// Stamps that stand still, of whole seconds, and in thousands of seconds: a hand at 20 mm/s must not seem to
/// be as fast as the arm can move.
#[test]
fn time_stamps_that_hardly_rise_do_not_let_the_arm_leap() {
    type Stamp = fn(f64) -> f64;
    let stamps: [(Stamp, &str); 3] = [
        (|_| 5.0, "time 5 s does not follow 5 s: times must rise"),
        (f64::floor, "times must rise"),
        (|time| 1e-3 * time, "is `time` in seconds"),
    ];
    for (stamp, message) in stamps {
        let server = arm();
        let start: [f64; 3] = numbers(&server.json(&["read"])["tips"]["hand"]["position"]);
        let (leading, stdin) = Leading::start(&server, &[]);
        let mut hand = Hand::new(stdin);
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_secs(4) {
            hand.position = [0.02 * begin.elapsed().as_secs_f64().sin(), 0.0, 0.0];
            let mut sample = hand.sample();
            sample["time"] = json!(stamp(hand.begin.elapsed().as_secs_f64()));
            hand.say(&sample);
        }
        drop(hand);
        let (_, values, error) = leading.finish();
        let told = error + &values.iter().map(Value::to_string).collect::<String>();
        assert!(told.contains(message), "{told}");
        assert_eq!(server.json(&["faults"])["faults"].as_array().unwrap().len(), 0, "{told}");
        let moved = values.iter().filter(|value| value.get("sigma_min").is_some());
        let moved = moved.map(|value| distance(numbers(&value["position"]), start)).fold(0.0, f64::max);
        assert!(moved < 0.03, "{moved} m: {told}");
    }
}

#[test]
fn a_clock_that_runs_off_and_a_program_that_is_killed_leave_no_arm_that_moves() {
    let server = arm();
    let (leading, mut hand) = following(&server);
    // Milliseconds.
    let error = |leading: &Leading| leading.count(|value| value["error"].is_string()) == 1;
    let start = Instant::now();
    while !error(&leading) {
        let mut sample = hand.sample();
        sample["time"] = json!(1e3 * hand.begin.elapsed().as_secs_f64());
        hand.say(&sample);
        assert!(start.elapsed() < Duration::from_secs(60), "it follows any clock");
    }
    let (code, _, text) = leading.finish();
    assert!(code == 1 && text.contains("run ahead of the clock"), "{code}: {text}");

    let server = arm();
    let (leading, mut hand) = following(&server);
    let there = [0.0, 0.03, 0.0];
    hand.move_to(there);
    let tool = leading.tool();
    signal(&leading.child, Signal::SIGKILL);
    server.wait_for("in fault");
    let faults = server.succeeds(&["faults"]);
    assert!(faults.contains("command timeout") || faults.contains("no command"), "{faults}");
    // It holds in place: the reaction of its model.
    let after: [f64; 3] = numbers(&server.json(&["read"])["tips"]["hand"]["position"]);
    assert!(distance(tool, after) < 0.02, "{tool:?} {after:?}");
    drop(leading.finish());
}

/// Runs the lines as they are printed in the document.
#[test]
#[ignore = "needs Python: cargo xtask test"]
fn the_example_in_python_leads_the_arm() {
    let server = arm();
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/examples/lead_arm.py");
    let python = std::env::var_os("TESAKI_PYTHON").unwrap_or_else(|| "python3".into());
    let mut source = std::process::Command::new(python).arg(example).stdout(Stdio::piped()).spawn().unwrap();
    let mut command =
        server.command(&["--json", "follow", "--impedance", &firm(), "--duration", "3", "--no-hold"]);
    command.stdin(source.stdout.take().unwrap()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let (code, text) = said(&finish(command.spawn().unwrap()));
    let _ = source.kill();
    let _ = source.wait();
    assert_eq!(code, 0, "{text}");
    let summary: Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    assert!(summary["samples"].as_u64().unwrap() > 50, "{summary}");
}

/// The clutch opens by a sample in which the operator has let the pedal go; a sample from before, which the
/// link has delayed, does not close it. An elbow that turns beyond half a turn is followed.
#[test]
fn a_sample_that_was_overtaken_does_not_close_the_clutch() {
    let server = arm();
    let (leading, stdin) = Leading::start(&server, &[]);
    let mut hand = Hand::new(stdin);
    hand.elbow = 3.0;
    hand.until("the clutch closes", || leading.count(|value| is_clutch(value, "closed", "")) == 1);
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(3) {
        let angle = 3.0 + 0.1 * begin.elapsed().as_secs_f64();
        hand.elbow = if angle > PI { angle - TAU } else { angle };
        hand.send();
    }
    let mut before = hand.sample();
    before["clutch"] = json!(true);
    hand.send();
    let mut open = hand.sample();
    open["clutch"] = json!(false);
    hand.say(&open);
    hand.say(&before);
    hand.until("the clutch opens", || {
        leading.count(|value| is_clutch(value, "open", "it was asked for")) == 1
    });
    (0..100).for_each(|_| hand.send());
    assert_eq!(leading.count(|value| is_clutch(value, "closed", "")), 1);
    drop(hand);
    let (code, values, error) = leading.finish();
    assert_eq!(code, 0, "{error}");
    let summary = values.last().unwrap();
    assert_eq!((&summary["rejected"]["elbows"], &summary["stops"]), (&json!(0), &json!(0)), "{summary}");
}
