//! Confirmation prompts on a terminal before a robot is powered on or off.

use std::fs::File;
use std::io::{Read, Write};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::follow::{arm, file_of};
use super::server::{Server, finish, said, signal};

/// A command on a terminal that has asked for confirmation.
pub(super) struct Asked {
    child: Child,
    terminal: File,
    /// Its output so far.
    said: String,
}

impl Asked {
    pub(super) fn start(server: &Server, arguments: &[&str]) -> Self {
        let nix::pty::OpenptyResult { master, slave } = nix::pty::openpty(None, None).unwrap();
        let mut terminal = File::from(master);
        let end = || Stdio::from(slave.try_clone().unwrap());
        let child =
            server.command(arguments).stdin(end()).stderr(end()).stdout(Stdio::piped()).spawn().unwrap();
        // Only the child keeps the terminal open.
        drop(slave);
        let (mut said, mut buffer) = (String::new(), [0; 4096]);
        while !said.contains("[y/N]") {
            let length = terminal.read(&mut buffer).unwrap_or_else(|error| panic!("{error} after {said:?}"));
            said += &String::from_utf8_lossy(&buffer[..length]);
        }
        Self { child, terminal, said }
    }

    pub(super) fn answer(mut self, answer: &str) -> Child {
        writeln!(self.terminal, "{answer}").unwrap();
        // Read its output, so that it does not block.
        std::thread::spawn(move || std::io::copy(&mut self.terminal, &mut std::io::sink()));
        self.child
    }
}

/// Lines that lead a robot are no answers to questions: there the warning is told, and nothing is asked.
#[test]
fn nothing_is_asked_where_standard_input_leads_the_robot() {
    let server = arm();
    let nix::pty::OpenptyResult { master, slave } = nix::pty::openpty(None, None).unwrap();
    let mut terminal = File::from(master);
    let end = || Stdio::from(slave.try_clone().unwrap());
    let mut command = server.command(&["follow", "--no-hold", "--impedance", &file_of("firm")]);
    let mut child = command.stdin(end()).stderr(end()).stdout(Stdio::piped()).spawn().unwrap();
    // Only the child keeps the terminal open.
    drop((slave, command));
    let mut output = terminal.try_clone().unwrap();
    let said = std::thread::spawn(move || {
        let (mut said, mut buffer) = (String::new(), [0; 4096]);
        while let Ok(length @ 1..) = output.read(&mut buffer) {
            said += &String::from_utf8_lossy(&buffer[..length]);
        }
        said
    });
    let begun = Instant::now();
    while !server.succeeds(&["info"]).contains("mode           enabled") {
        let time = begun.elapsed().as_secs_f64();
        writeln!(terminal, r#"{{"time":{time},"position":[0,0,0],"quaternion":[0,0,0,1]}}"#).unwrap();
        assert!(child.try_wait().unwrap().is_none(), "it has ended");
        assert!(begun.elapsed() < Duration::from_secs(60), "it waits");
    }
    signal(&child, nix::sys::signal::Signal::SIGINT);
    let code = finish(child).status.code();
    drop(terminal);
    let said = said.join().unwrap();
    assert!(code == Some(0) && said.contains("The tool of arm7 will follow standard input"), "{said}");
    assert!(!said.contains("[y/N]"), "{said}");
}

/// Angle and reference of the first joint [rad].
fn first_joint(server: &Server) -> (f64, f64) {
    let joint = &server.json(&["read"])["joints"][0];
    (joint["position"].as_f64().unwrap(), joint["reference"].as_f64().unwrap())
}

#[test]
fn what_moves_during_a_question_stays_where_it_is_then() {
    let server = Server::ready();
    server.succeeds(&["move", "finger1_curl=1.3", "finger2_curl=1.3", "finger3_curl=1.3"]);
    for command in [
        &["enable"][..],
        &["move", "--hold", "finger2_bend=0.05"],
        &["reach", "--hold", "--relative", "finger2_tip=0,0,0.002"],
    ] {
        let (before, _) = first_joint(&server);
        let asked = Asked::start(&server, command);
        // 0.09 rad: small enough not to count as a jump of the encoder, after which the joint would no longer
        // be homed.
        server.make_trouble("encoder finger1_swing 900");
        let (moved, _) = first_joint(&server);
        assert!((moved - before).abs() > 0.05, "{before} {moved}");
        let child = server.wait_with(asked.answer("y"), "enabled");
        std::thread::sleep(Duration::from_millis(300));
        let (angle, reference) = first_joint(&server);
        signal(&child, nix::sys::signal::Signal::SIGINT);
        let (code, text) = said(&finish(child));
        // Whether it had already arrived.
        let done = if command == ["enable"] || text.contains("arrived") { 0 } else { 130 };
        assert_eq!(code, done, "{text}");
        assert!((angle - moved).abs() < 0.02, "{command:?}: from {moved} to {angle}");
        assert!((reference - moved).abs() < 0.02, "{command:?}: {moved}, held at {reference}");
    }
}

#[test]
fn an_arm_that_is_held_is_not_dropped_without_a_word() {
    let server = Server::ready_arm();
    let held = server.start_command(&["enable"]);
    server.wait_for("enabled");
    let stopped = server.succeeds(&["stop"]);
    assert!(stopped.contains("`tesaki disable` switches the outputs off"), "{stopped}");
    assert_eq!(finish(held).status.code(), Some(5));
    let on = "in fault, and its outputs are on: it brakes or holds the robot";
    assert!(server.succeeds(&["info"]).contains(on) && server.succeeds(&["faults"]).contains(on));
    assert_eq!(server.json(&["info"])["outputs"], true);
    server.fails(&["doctor"], 5, &["its outputs are on, until then it brakes or holds the robot"]);

    let asked = Asked::start(&server, &["faults", "--clear"]);
    for word in ["clearing the faults switches the outputs off", "without power arm7 falls"] {
        assert!(asked.said.contains(word), "no {word:?} in: {}", asked.said);
    }
    let (code, text) = said(&finish(asked.answer("n")));
    assert_eq!(code, 2, "{text}");
    assert_eq!(server.json(&["info"])["status"]["node"]["mode"], "Fault");

    // A stop while it asks was not shown, and stays.
    let asked = Asked::start(&server, &["faults", "--clear"]);
    server.succeeds(&["stop"]);
    assert_eq!(finish(asked.answer("y")).status.code(), Some(5));
    assert_eq!(server.json(&["info"])["status"]["node"]["mode"], "Fault");

    let disabled = server.succeeds(&["disable"]);
    assert!(disabled.contains("outputs off") && disabled.contains("without power arm7 falls"), "{disabled}");
    assert!(server.succeeds(&["info"]).contains("in fault, and its outputs are off"));
    assert_eq!(server.json(&["faults"])["outputs"], false);
    let stopped = server.succeeds(&["stop"]);
    assert!(stopped.contains("its outputs are off") && !stopped.contains("stopped"), "{stopped}");
    let cleared = server.succeeds(&["faults", "--clear"]);
    assert!(cleared.contains("the faults are cleared") && !cleared.contains("falls"), "{cleared}");
    let again = server.succeeds(&["faults", "--clear"]);
    assert!(again.contains("no fault to clear. Past faults"), "{again}");
}
