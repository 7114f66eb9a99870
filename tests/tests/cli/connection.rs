//! The link to the board: absent, bad, or interrupted.

use std::io::{BufRead, BufReader};
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::server::{Server, finish, hand3, said, unread};

#[test]
fn missing_ports_and_invalid_arguments_have_their_own_exit_codes() {
    let server = Server::start();
    server.fails(&["--port", "/dev/nowhere", "info"], 3, &["/dev/nowhere does not exist"]);
    server.fails(&["--port", "tcp://localhost:1", "info"], 3, &["nobody answers"]);
    server.fails(&["--port", "quantum://x", "info"], 2, &["quantum://x"]);
    server.fails(&["--timeout", "0", "info"], 2, &["--timeout"]);
    server.fails(&["--link-faults", "flip=2", "info"], 2, &["flip"]);
    server.fails(&["dance"], 2, &["dance"]);
    server.fails(&["--json", "--port", "/dev/nowhere", "info"], 3, &["\"exit_code\":3"]);
    // A socket where nothing answers.
    let silent = server.folder.path().join("silent");
    let _listener = std::os::unix::net::UnixListener::bind(&silent).unwrap();
    let port = format!("unix://{}", silent.display());
    server.fails(&["--timeout", "0.3", "--port", &port, "info"], 6, &["no answer"]);
    server.fails(&["--timeout", "0.3", "--port", &port, "doctor"], 6, &["no answer", "RX and TX"]);
    assert!(server.succeeds(&["completions", "bash"]).contains("_tesaki"));
    let (code, text) = unread(server.start_command(&["completions", "bash"]));
    assert_eq!((code, &*text), (0, ""));
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
    // After 2 s; a busy machine tells it later.
    let told = text.split_once("no answer from the board for ").and_then(|(_, told)| told.split_once(" s: "));
    let seconds: f64 = told.unwrap_or_else(|| panic!("{text}")).0.parse().unwrap();
    assert!((2.0..20.0).contains(&seconds) && text.contains("1 s after the last command"), "{text}");
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
fn a_monitor_resumes_when_the_board_comes_back() {
    let mut server = Server::ready();
    let mut monitor = server.start_command(&["--json", "monitor"]);
    let lines = BufReader::new(monitor.stdout.take().unwrap()).lines();
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
    // Another board appears at the same address.
    let _ = std::fs::remove_file(server.folder.path().join("board"));
    let again = Server::start_at(std::mem::replace(&mut server.folder, tempfile::tempdir().unwrap()));
    next(30).expect("telemetry of the new board");
    monitor.kill().unwrap();
    monitor.wait().unwrap();
    drop(again);
}
