//! `tesaki view`: messages to pages, commands from pages, and invalid input.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::protocol::{Role, WebSocket};
use tungstenite::{Error, Message};

use super::server::{Server, finish, hand3, said, signal};

/// `tesaki view`, stopped at the end of the test.
pub struct View {
    child: Child,
    host: String,
}

impl View {
    pub fn start(server: &Server, arguments: &[&str]) -> Self {
        Self::start_with(server, &hand3(), arguments)
    }

    /// Starts it with the files of a robot folder.
    fn start_with(server: &Server, folder: &Path, arguments: &[&str]) -> Self {
        let listen = ["--json", "view", "--listen", "localhost:0", "--robot", folder.to_str().unwrap()];
        let mut command = server.command(&[&listen[..], arguments].concat());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut line = Vec::new();
        let output = child.stdout.as_mut().unwrap();
        while !line.ends_with(b"\n") {
            let mut byte = [0];
            assert_eq!(output.read(&mut byte).unwrap(), 1, "it ended: {}", String::from_utf8_lossy(&line));
            line.push(byte[0]);
        }
        let value: Value = serde_json::from_slice(&line).unwrap();
        let host = value["url"].as_str().unwrap().strip_prefix("http://").unwrap().to_owned();
        Self { child, host }
    }

    /// Returns the server's answer to a request.
    fn request(&self, text: &str) -> String {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        stream.write_all(text.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    /// Opens a page that has taken command of the board, which is disabled.
    #[track_caller]
    pub fn open_commanding(&self) -> Page {
        let mut page = self.open();
        page.wait("scene", |value| value["kind"] == "scene");
        page.mode("disabled");
        page.succeeds(json!({ "do": "take" }));
        page
    }

    pub fn open(&self) -> Page {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
        let host = &self.host;
        let request = format!(
            "GET /live HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nConnection: Upgrade\r\n\
             Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut head = Vec::new();
        let deadline = Instant::now() + Duration::from_secs(5);
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            if stream.read(&mut byte).is_ok_and(|length| length == 1) {
                head.push(byte[0]);
            }
            assert!(Instant::now() < deadline, "no answer: {}", String::from_utf8_lossy(&head));
        }
        let head = String::from_utf8(head).unwrap();
        assert!(head.contains("101") && head.contains("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="), "{head}");
        Page(WebSocket::from_raw_socket(stream, Role::Client, None))
    }
}

impl Drop for View {
    fn drop(&mut self) {
        signal(&self.child, nix::sys::signal::Signal::SIGINT);
        let _ = self.child.wait();
    }
}

/// A page that answers every state, as a browser does.
pub struct Page(WebSocket<TcpStream>);

impl Page {
    pub fn send(&mut self, value: &Value) {
        self.0.send(Message::text(value.to_string())).unwrap();
    }

    /// Waits for the next message that is `accepted`.
    #[track_caller]
    pub fn wait(&mut self, what: &str, accepted: impl Fn(&Value) -> bool) -> Value {
        let deadline = Instant::now() + Duration::from_secs(8);
        while Instant::now() < deadline {
            let text = match self.0.read() {
                Ok(Message::Text(text)) => text,
                Ok(_) => continue,
                Err(Error::Io(_)) => continue,
                Err(error) => panic!("{what}: {error}"),
            };
            let value: Value = serde_json::from_str(&text).unwrap();
            if value["kind"] == "state" {
                self.send(&json!({ "do": "seen", "n": value["n"] }));
            }
            if accepted(&value) {
                return value;
            }
        }
        panic!("not in time: {what}");
    }

    /// Sends a command; returns whether it was carried out, and the text.
    #[track_caller]
    fn command(&mut self, value: &Value) -> (bool, String) {
        self.send(value);
        let answer = self.wait(&value.to_string(), |value| value["kind"] == "answer");
        (answer["ok"].as_bool().unwrap(), answer["text"].as_str().unwrap().to_owned())
    }

    #[track_caller]
    pub fn succeeds(&mut self, value: Value) {
        let (ok, text) = self.command(&value);
        assert!(ok, "{value}: {text}");
    }

    #[track_caller]
    pub fn fails(&mut self, value: Value, words: &str) {
        let (ok, text) = self.command(&value);
        assert!(!ok && text.contains(words), "{value}: {text}");
    }

    /// Enables the joint servo.
    #[track_caller]
    pub fn enables(&mut self) {
        self.succeeds(json!({ "do": "enable", "task": "joint servo" }));
        self.mode("enabled");
    }

    /// Clears the faults that it has been shown.
    #[track_caller]
    pub fn clears(&mut self) {
        let status = self.wait("the faults", |value| value["total"].is_u64());
        self.succeeds(json!({ "do": "clear", "total": status["total"] }));
    }

    #[track_caller]
    pub fn mode(&mut self, mode: &str) -> Value {
        self.wait(mode, |value| value["kind"] == "state" && value["mode"] == mode)
    }
}

#[test]
fn one_page_commands_and_every_page_stops() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    let mut first = view.open();
    let scene = first.wait("scene", |value| value["kind"] == "scene");
    assert_eq!(scene["scene"]["joints"].as_array().unwrap().len(), 9);
    assert_eq!(scene["scene"]["solids"].as_array().unwrap().len(), 16, "the <visual>s of hand3");

    first.fails(json!({ "do": "enable", "task": "joint servo" }), "this page does not command");
    first.succeeds(json!({ "do": "take" }));
    first.fails(json!({ "do": "goal", "joint": 0, "angle": 0.2 }), "not enabled by this page");
    first.succeeds(json!({ "do": "enable", "task": "joint servo" }));
    first.mode("enabled");
    first.succeeds(json!({ "do": "goal", "joint": 0, "angle": 0.3 }));
    let moved = |value: &Value| (value["joints"][0][0].as_f64().unwrap() - 0.3).abs() < 0.01;
    first.wait("the joint at its goal", |value| value["kind"] == "state" && moved(value));
    // Limits of finger1_swing: ±1 rad.
    first.fails(json!({ "do": "goal", "joint": 0, "angle": 1.01 }), "outside its limits -1 to 1 rad");
    first.fails(json!({ "do": "goal", "joint": 9, "angle": 0.0 }), "hand3 has 9 joints");

    let mut second = view.open();
    second.wait("another page", |value| value["commander"] == "page");
    second.fails(json!({ "do": "take" }), "another page commands");
    second.fails(json!({ "do": "goal", "joint": 0, "angle": 0.0 }), "another page commands");
    // The board's lease keeps another program out. Meanwhile the page must keep answering, or it would be
    // stopped.
    let mut other = server.start_command(&["move", "finger1_swing=0"]);
    while other.try_wait().unwrap().is_none() {
        assert!(moved(&first.mode("enabled")));
    }
    let (code, text) = said(&finish(other));
    assert!(code == 7 && text.contains("another client"), "{code}: {text}");
    second.succeeds(json!({ "do": "stop" }));
    let fault =
        second.wait("the fault", |value| value["faults"].as_array().is_some_and(|faults| !faults.is_empty()));
    let fault = &fault["faults"][0];
    assert!(fault["remedy"].as_str().unwrap().contains("clear the fault"), "{fault}");
    first.mode("fault");
    first.clears();
    first.mode("disabled");
    first.succeeds(json!({ "do": "release" }));
    second.wait("nobody commands", |value| value["commander"] == "nobody");
    second.succeeds(json!({ "do": "take" }));
}

#[test]
fn a_stop_that_the_page_has_not_shown_is_not_cleared() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    let mut page = view.open();
    page.mode("disabled");
    page.succeeds(json!({ "do": "take" }));
    page.fails(json!({ "do": "clear" }), "not understood");
    server.succeeds(&["stop"]);
    let shown = page.wait("the fault", |value| value["total"].is_u64())["total"].as_u64().unwrap();
    // Another stop. It is shown by now, and was not when the button was pressed.
    server.succeeds(&["stop"]);
    let next = page.wait("the next", |value| value["total"].as_u64().is_some_and(|total| total != shown));
    assert_eq!(next["total"], shown + 1);
    page.fails(json!({ "do": "clear", "total": shown }), "nothing was cleared");
    page.mode("fault");
    page.clears();
    page.mode("disabled");
    // There is nothing to clear any more.
    page.wait("the end of it", |value| value["kind"] == "status" && value["total"].is_null());
}

#[test]
fn a_refused_enable_leaves_the_motion_as_it_is() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    let mut page = view.open_commanding();
    page.enables();
    page.succeeds(json!({ "do": "goal", "joint": 0, "angle": 0.8 }));
    page.fails(json!({ "do": "enable", "task": "joint servo" }), "refused to enable");
    let arrived = |value: &Value| (value["joints"][0][0].as_f64().unwrap() - 0.8).abs() < 0.01;
    page.wait("the joint at its goal", |value| value["kind"] == "state" && arrived(value));
}

/// A plan whose forces would be a fault of the robot drops the object.
#[test]
fn a_grasp_that_does_not_suit_the_robot_is_refused() {
    let server = Server::ready_to_grasp(false);
    server.succeeds(&["tare"]);
    let folder = server.folder.path().join("hand3");
    std::fs::create_dir_all(folder.join("grasps")).unwrap();
    for file in ["robot.urdf", "controller.toml", "plant.toml"] {
        std::fs::copy(hand3().join(file), folder.join(file)).unwrap();
    }
    let text = std::fs::read_to_string(hand3().join("grasps/box.toml")).unwrap();
    let strong = text.replace("force_limit = 9.0", "force_limit = 90.0");
    std::fs::write(folder.join("grasps/strong.toml"), strong).unwrap();
    let view = View::start_with(&server, &folder, &[]);
    let mut page = view.open();
    page.wait("the plan", |value| value["plans"][0]["name"] == "strong.toml");
    page.mode("disabled");
    page.succeeds(json!({ "do": "take" }));
    let enable = json!({ "do": "enable", "task": "grasping", "plan": "strong.toml" });
    page.fails(enable, "force_limit = 90 N: more than 10 N at finger1_tip is a fault");
    page.mode("disabled");
}

#[test]
fn the_robot_is_stopped_when_its_page_goes_or_is_silent() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    let mut page = view.open_commanding();
    page.enables();
    let mut watcher = view.open();
    watcher.mode("enabled");
    drop(page);
    watcher.mode("fault");
    watcher.wait("nobody commands", |value| value["commander"] == "nobody");
    // A suspended page keeps its connection, but does not answer.
    watcher.succeeds(json!({ "do": "take" }));
    watcher.clears();
    watcher.mode("disabled");
    watcher.enables();
    std::thread::sleep(Duration::from_millis(2000));
    assert!(server.json(&["info"]).to_string().contains("Fault"));
    watcher.wait("why", |value| value["text"].as_str().is_some_and(|text| text.contains("did not answer")));
    // The same for the last page; command is then free at once.
    watcher.succeeds(json!({ "do": "take" }));
    watcher.clears();
    watcher.mode("disabled");
    watcher.enables();
    drop(watcher);
    server.wait_for("in fault");
    std::thread::sleep(Duration::from_millis(200));
    let info = server.json(&["info"]);
    assert!(info["status"]["node"]["commander"].is_null(), "{info}");
}

/// A page that has died does not keep command, also while nothing is enabled; one that is refused command
/// takes no time from the one that has it.
#[test]
fn a_dead_page_does_not_keep_command() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    let dead = view.open_commanding();
    let mut other = view.open();
    other.fails(json!({ "do": "take" }), "another page commands the board");
    other.wait("free", |value| value["commander"] == "nobody");
    other.succeeds(json!({ "do": "take" }));
    drop(dead);
}

/// A page that says that it has seen what it was not sent, or the same for ever, sees nothing.
#[test]
fn who_only_claims_to_look_is_not_there() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    for n in [0, 1, 1_000_000_000] {
        let mut page = view.open_commanding();
        page.enables();
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_millis(2000) {
            page.send(&json!({ "do": "seen", "n": n }));
            page.send(&json!({ "do": "goal", "joint": 0, "angle": 0.1 }));
            std::thread::sleep(Duration::from_millis(50));
        }
        assert!(server.json(&["info"]).to_string().contains("Fault"), "kept going by {n}");
        page.wait("why", |value| value["text"].as_str().is_some_and(|text| text.contains("did not answer")));
        drop(page);
        let mut next = view.open();
        next.succeeds(json!({ "do": "take" }));
        next.clears();
        next.mode("disabled");
        next.succeeds(json!({ "do": "release" }));
    }
}

/// A set-point that comes after the fault is refused, which is no news beside the fault.
#[test]
fn a_fault_is_not_followed_by_a_refused_set_point() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    let mut page = view.open_commanding();
    for _ in 0..8 {
        page.enables();
        let mut stop = server.start_command(&["stop"]);
        page.wait("the fault", |value| {
            assert_ne!(value["kind"], "answer", "{value}");
            value["total"].is_u64()
        });
        stop.wait().unwrap();
        page.clears();
        page.mode("disabled");
    }
}

/// The first step of an object that was not lifted presses it against what it stands on.
#[test]
fn an_object_that_was_not_lifted_is_warned_of() {
    let server = Server::ready_to_grasp(true);
    server.succeeds(&["tare"]);
    let view = View::start(&server, &[]);
    let mut page = view.open();
    page.wait("the plans", |value| value["plans"].as_array().is_some_and(|plans| !plans.is_empty()));
    page.mode("disabled");
    page.succeeds(json!({ "do": "take" }));
    page.succeeds(json!({ "do": "enable", "task": "grasping", "plan": "box.toml" }));
    let holds =
        |value: &Value| value["report"]["phase"].as_str().is_some_and(|phase| phase.contains("holds"));
    page.wait("the hold", holds);
    let step =
        |up: f32| json!({ "do": "object", "translation": [0.0, 0.0, up], "rotation": [0.0, 0.0, 0.0] });
    let (ok, text) = page.command(&step(0.001));
    assert!(ok && text.contains("was not lifted") && text.contains("lift it first"), "{text}");
    let moves =
        |value: &Value| value["report"]["phase"].as_str().is_some_and(|phase| phase.contains("moves"));
    page.wait("the motion", moves);
    page.wait("the hold", holds);
    let (ok, text) = page.command(&step(0.005));
    assert!(ok && text.is_empty(), "{text}");
}

#[test]
fn nonsense_gets_an_answer_or_the_door() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    let host = &view.host;
    assert!(view.request(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n")).contains("tv-live"));
    let other = view.request("GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    assert!(other.starts_with("HTTP/1.1 403"), "{other}");
    assert!(view.request(&format!("GET /?a=1 HTTP/1.1\r\nHost: {host}\r\n\r\n")).contains("tv-live"));
    assert!(view.request("\0\0nonsense\r\n\r\n").starts_with("HTTP/1.1 400"));

    let mut page = view.open();
    page.wait("scene", |value| value["kind"] == "scene");
    for nonsense in [
        json!(7),
        json!({ "do": "fly" }),
        json!({ "do": "goal", "joint": -1, "angle": 0 }),
        json!({ "do": "goal", "joint": 0, "angle": null }),
        json!({ "do": "enable" }),
        json!({ "do": "tool", "translation": [0, 0] }),
        json!({ "do": "seen", "n": 1, "more": 2 }),
    ] {
        page.fails(nonsense, "not understood");
    }
    page.succeeds(json!({ "do": "take" }));
    page.fails(json!({ "do": "enable", "task": "fly" }), "cannot enable \"fly\"");
    page.fails(json!({ "do": "enable", "task": "grasping", "plan": "../../../Cargo.toml" }), "--robot DIR");
    page.fails(json!({ "do": "tool", "translation": [0, 0, 0.01] }), "no arm is enabled");
    let mut large = view.open();
    large.0.send(Message::text("x".repeat(10_000))).unwrap();
    let ended = (0..1000).any(|_| matches!(large.0.read(), Err(error) if !matches!(&error, Error::Io(io) if io.kind() == std::io::ErrorKind::WouldBlock)));
    assert!(ended, "a message of 10 kB was taken");
    // The other pages are not affected.
    page.mode("disabled");

    server.fails(&["view", "--listen", "0.0.0.0:0"], 2, &["ssh -L"]);
    server.fails(&["view", "--listen", host], 1, &["another program listens there"]);
}

#[test]
fn a_page_outlives_a_reset_of_the_board() {
    let server = Server::ready();
    let view = View::start(&server, &[]);
    let mut page = view.open();
    page.mode("disabled");
    page.succeeds(json!({ "do": "take" }));
    server.make_trouble("reset");
    page.wait("why", |value| value["text"].as_str().is_some_and(|text| text.contains("was reset")));
    let no_model =
        |value: &Value| value["trouble"].as_str().is_some_and(|text| text.contains("no robot model"));
    page.wait("no model", no_model);
    server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    page.wait("the robot", |value| value["kind"] == "scene" && value["scene"].is_object());
    page.mode("disabled");
}
