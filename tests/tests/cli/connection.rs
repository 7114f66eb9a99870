//! The link to the board: absent, bad, or interrupted.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use tesaki::protocol::codec::{Decoder, MAX_FRAME, encode};
use tesaki::protocol::{FromBoard, Identity, Reply, ReplyFrame, Request, RequestFrame};

use super::server::{Server, finish, hand3, said, signal, unread};
use super::view_line::Line;

#[test]
fn missing_ports_and_invalid_arguments_have_their_own_exit_codes() {
    let server = Server::start();
    server.fails(&["--port", "/dev/nowhere", "info"], 3, &["/dev/nowhere does not exist"]);
    server.fails(&["--port", "tcp://localhost:1", "info"], 3, &["nobody answers"]);
    server.fails(&["--port", "quantum://x", "info"], 2, &["quantum://x"]);
    server.fails(&["--timeout", "0", "info"], 2, &["--timeout"]);
    server.fails(
        &["--timeout", "1e300", "info"],
        2,
        &["1e300 s: expected a time above 0 s, at most 1000000 s"],
    );
    server.fails(&["--timeout", "nan", "info"], 2, &["nan s: expected a time above 0 s"]);
    for command in [
        &["move", "finger1_swing=0", "--within", "-1"][..],
        &["enable", "--duration", "-1"],
        &["record", "--duration", "-1"],
        &["--timeout", "-1", "info"],
    ] {
        server.fails(command, 2, &["-1 s: expected a time above 0 s"]);
    }
    for tolerance in ["nan", "0", "-1", "inf"] {
        let words = format!("{tolerance}: expected a number above 0");
        server.fails(&["move", "finger1_swing=0", "--tolerance", tolerance], 2, &[&words]);
        server.fails(&["reach", "finger1_tip=0,0,0", "--tolerance", tolerance], 2, &[&words]);
    }
    // A key only applies to TCP.
    server.succeeds(&["--key", "/nowhere/lab.key", "info"]);
    server.fails(
        &["--key", "/nowhere/lab.key", "--port", "tcp://localhost:1", "info"],
        1,
        &["no such key file"],
    );
    server.fails(
        &["replay", "/nowhere/run.mcap"],
        2,
        &["run.mcap is the file for viewers: replay /nowhere/run.log"],
    );
    server.fails(&["--link-faults", "flip=2", "info"], 2, &["flip"]);
    server.fails(&["dance"], 2, &["dance"]);
    server.fails(&["--json", "move", "--sped", "1"], 2, &["{\"error\":\"", "'--sped'", "\"exit_code\":2}"]);
    server.fails(&["--json", "--port", "/dev/nowhere", "info"], 3, &["\"exit_code\":3"]);
    // A socket at which nothing answers.
    let silent = server.folder.path().join("silent");
    let _listener = UnixListener::bind(&silent).unwrap();
    let port = format!("unix://{}", silent.display());
    server.fails(&["--timeout", "0.3", "--port", &port, "info"], 6, &["no answer"]);
    server.fails(&["--timeout", "0.3", "--port", &port, "doctor"], 6, &["no answer", "RX and TX"]);
    assert!(server.succeeds(&["completions", "bash"]).contains("_tesaki"));
    let (code, text) = unread(server.start_command(&["completions", "bash"]));
    assert_eq!((code, &*text), (0, ""));
    // What was found does not depend on who reads it.
    let doctor = server.start_command(&["--timeout", "0.3", "--port", &port, "doctor"]);
    assert_eq!(unread(doctor), (6, String::new()));
    let check = server.start_command(&["model", "check", server.folder.path().to_str().unwrap()]);
    assert_eq!(unread(check).0, 1);
}

#[test]
fn a_client_is_told_that_its_board_was_reset_or_is_gone() {
    let mut server = Server::ready();
    let enabled = server.start_command(&["enable"]);
    server.wait_for("enabled");
    server.make_trouble("reset");
    let (code, text) = said(&finish(enabled));
    assert_eq!(code, 1, "{text}");
    assert!(text.contains("the board was reset meanwhile") && text.contains("tesaki model push"), "{text}");

    server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    server.home();
    let enabled = server.start_command(&["enable"]);
    server.wait_for("enabled");
    server.stop.store(true, Ordering::Relaxed);
    server.thread.take().unwrap().join().unwrap();
    let (code, text) = said(&finish(enabled));
    assert_eq!(code, 6, "{text}");
    // After 2 s, or later on a busy machine.
    let told = text.split_once("no answer from the board for ").and_then(|(_, told)| told.split_once(" s: "));
    let seconds: f64 = told.unwrap_or_else(|| panic!("{text}")).0.parse().unwrap();
    assert!((2.0..20.0).contains(&seconds) && text.contains("1 s after the last command"), "{text}");
}

#[test]
fn a_bad_line_costs_repeats_and_nothing_else() {
    let server = Server::ready();
    // Repeats take time, on a busy machine much of it.
    server.succeeds(&["set", "safety.command_timeout", "2"]);
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

/// Over a link on which every command comes too late nothing is enabled; over one that is only slow a task
/// runs.
#[test]
fn a_slow_link_is_told_before_anything_is_enabled() {
    let server = Server::ready();
    server.succeeds(&["set", "safety.command_timeout", "0.3"]);
    let slow = ["--link-faults", "stall=160ms@1"];
    let words =
        ["nothing was enabled: a request takes", "300 ms after the last command", "use a faster link"];
    server.fails(&[&slow[..], &["enable"]].concat(), 6, &words);
    server.fails(&[&slow[..], &["doctor"]].concat(), 6, &["300 ms after the last command"]);
    assert_eq!(server.json(&["info"])["status"]["node"]["mode"], "Disabled");
    server.succeeds(&["--link-faults", "stall=100ms@1", "move", "finger1_swing=0.1"]);
}

/// With `--json` too, why a command failed is told somewhere.
#[test]
fn a_full_disk_is_told_on_standard_error() {
    let server = Server::ready();
    for command in ["info", "read"] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = server.command(&["--json", command]).stdout(full).output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(1) && text.contains("standard output: No space left"), "{text}");
    }
}

#[test]
fn a_monitor_resumes_when_the_board_comes_back() {
    let mut server = Server::ready();
    let mut monitor = server.start_command(&["--timeout", "1", "--json", "monitor"]);
    let lines = BufReader::new(monitor.stdout.take().unwrap()).lines();
    let mut complaints = BufReader::new(monitor.stderr.take().unwrap()).lines();
    let mut complaint = || complaints.next().unwrap().unwrap();
    let (sender, ticks) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for line in lines.map_while(Result::ok) {
            let telemetry: serde_json::Value = serde_json::from_str(&line).unwrap();
            let _ = sender.send(telemetry["tick"].as_u64().unwrap());
        }
    });
    let next = |seconds| ticks.recv_timeout(Duration::from_secs(seconds));
    next(30).expect("telemetry");
    server.stop.store(true, Ordering::Relaxed);
    server.thread.take().unwrap().join().unwrap();
    while next(1).is_ok() {}
    let said = complaint();
    assert!(said.contains("no telemetry from the board: its port has disappeared"), "{said}");
    // Another board appears at the same address.
    let _ = std::fs::remove_file(server.folder.path().join("board"));
    let again = Server::start_at(std::mem::replace(&mut server.folder, tempfile::tempdir().unwrap()));
    next(30).expect("telemetry of the new board");
    assert_eq!(complaint(), "the board is heard again");
    let said = complaint();
    assert!(said.contains("the board was reset: the board has no robot model: push one"), "{said}");
    monitor.kill().unwrap();
    monitor.wait().unwrap();
    drop(again);
}

#[test]
fn ctrl_c_with_a_silent_board_does_not_wait_for_all_of_the_timeout() {
    let server = Server::ready();
    let link = Muted::start(&server);
    let enabled = server.start_command(&["--port", &link.address, "--timeout", "60", "enable"]);
    let enabled = server.wait_with(enabled, "enabled");
    link.mute.store(true, Ordering::Relaxed);
    std::thread::sleep(Duration::from_millis(200));
    let begun = Instant::now();
    signal(&enabled, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(enabled));
    assert_eq!(code, 6, "{text}");
    for word in ["no answer from the board yet", "it stops by itself 1 s after the last command"] {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
}

/// While an answer is awaited, Ctrl-C disables as well, and at once.
#[test]
fn ctrl_c_ends_the_wait_for_an_answer() {
    let server = Server::ready();
    let (line, port) = Line::start(&server);
    line.loses_enables.store(true, Ordering::Relaxed);
    let enabling = server.start_command(&["--port", &port, "--timeout", "60", "enable"]);
    let enables = |request: &Request| matches!(request, Request::Enable(_));
    let begun = Instant::now();
    while line.last(enables).is_none() {
        assert!(begun.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(10));
    }
    let begun = Instant::now();
    signal(&enabling, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(enabling));
    assert!(code == 130 && text.contains("interrupted: the board is disabled"), "{code}: {text}");
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    // The farewell was sent, and answered.
    assert!(line.last(|request| *request == Request::Disable) > line.last(enables));
    server.wait_for("disabled");
}

/// A link to a server's board for one client that can be muted.
struct Muted {
    address: String,
    mute: Arc<AtomicBool>,
}

impl Muted {
    fn start(server: &Server) -> Self {
        let path = server.folder.path().join("muted");
        let listener = UnixListener::bind(&path).unwrap();
        let board = server.folder.path().join("board");
        let mute = Arc::new(AtomicBool::new(false));
        let muted = Arc::clone(&mute);
        std::thread::spawn(move || {
            let client = listener.accept().unwrap().0;
            let board = UnixStream::connect(board).unwrap();
            for (from, to) in [(&client, &board), (&board, &client)] {
                let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                let muted = Arc::clone(&muted);
                std::thread::spawn(move || {
                    let mut buffer = [0; 4096];
                    while let Ok(length @ 1..) = from.read(&mut buffer) {
                        if !muted.load(Ordering::Relaxed) && to.write_all(&buffer[..length]).is_err() {
                            break;
                        }
                    }
                    let _ = to.shutdown(std::net::Shutdown::Both);
                });
            }
        });
        Self { address: format!("unix://{}", path.display()), mute }
    }
}

/// A board of another version, which answers `Hello`, `Disable` and `Stop`; returns what it was asked.
fn other_version(listener: UnixListener) -> impl FnOnce() -> Vec<Request> {
    let board = std::thread::spawn(move || {
        let mut link = listener.accept().unwrap().0;
        let (mut decoder, mut asked, mut buffer) = (Decoder::new(), Vec::new(), [0; 4096]);
        while let Ok(length @ 1..) = link.read(&mut buffer) {
            let mut bytes = &buffer[..length];
            while decoder.take(&mut bytes) {
                let RequestFrame { client, sequence, request } = decoder.message().unwrap();
                let reply = match request {
                    Request::Hello { schema } => {
                        let identity =
                            Identity { firmware: [9, 9, 9], image: [0; 8], board: [0; 12], capabilities: 0 };
                        Reply::Hello { schema: schema + 1, identity }
                    }
                    _ => Reply::Done,
                };
                asked.push(request);
                let mut frame = [0; MAX_FRAME];
                let frame_length =
                    encode(&FromBoard::Reply(ReplyFrame { client, sequence, tick: 0, reply }), &mut frame)
                        .unwrap();
                link.write_all(&frame[..frame_length]).unwrap();
            }
        }
        asked
    });
    move || board.join().unwrap()
}

/// Whoever stands beside a robot that must stop need not look for the right version.
#[test]
fn a_board_of_another_version_is_stopped() {
    let folder = tempfile::tempdir().unwrap();
    for (command, request, word) in
        [("stop", Request::Stop, "stop"), ("disable", Request::Disable, "disable its outputs")]
    {
        let path = folder.path().join(command);
        let board = other_version(UnixListener::bind(&path).unwrap());
        let port = format!("unix://{}", path.display());
        let output = tesaki_tests::tesaki().args(["--port", &port, command]).output().unwrap();
        let (code, text) = said(&output);
        assert_eq!(code, 4, "{text}");
        assert!(text.contains(&format!("the request to {word} was confirmed")), "{text}");
        assert!(text.contains("9.9.9"), "{text}");
        assert_eq!(board()[0], request);
    }
}

#[test]
fn a_switch_may_be_set_in_the_environment_in_any_usual_way() {
    for (value, is_json) in
        [("1", true), ("true", true), ("yes", true), ("0", false), ("false", false), ("", false)]
    {
        for name in ["TESAKI_JSON", "TESAKI_TAKE_OVER", "TESAKI_NON_INTERACTIVE"] {
            let mut command = tesaki_tests::tesaki();
            let (code, text) = said(&command.arg("list").env(name, value).output().unwrap());
            assert_eq!(code, 0, "{name}={value}: {text}");
            assert_eq!(text.starts_with('['), is_json && name == "TESAKI_JSON", "{name}={value}: {text}");
        }
    }
}

#[test]
fn a_variable_that_is_empty_is_none_and_a_wrong_one_is_named() {
    let list = |name: &str, value: &str| {
        said(&tesaki_tests::tesaki().arg("list").env(name, value).output().unwrap())
    };
    for name in ["TESAKI_PORT", "TESAKI_TIMEOUT", "TESAKI_KEY", "TESAKI_LINK_FAULTS", "TESAKI_ROBOT"] {
        let (code, text) = list(name, "");
        assert_eq!(code, 0, "{name}: {text}");
    }
    for (name, value) in [("TESAKI_PORT", "foo:bar"), ("TESAKI_TIMEOUT", "2s"), ("TESAKI_LINK_FAULTS", "x")] {
        let (code, text) = list(name, value);
        assert!(code == 2 && text.contains(&format!("of the environment variable {name}")), "{text}");
    }
    let mut given = tesaki_tests::tesaki();
    let (code, text) =
        said(&given.args(["list", "--timeout=x"]).env("TESAKI_TIMEOUT", "x").output().unwrap());
    assert!(code == 2 && !text.contains("environment"), "{text}");
}
