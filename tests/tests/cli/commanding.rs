//! Command of a board, and what happens when the commander leaves.

use std::process::Child;
use std::time::{Duration, Instant};

use super::server::{Server, finish, said, signal};

#[test]
fn ctrl_c_disables_a_second_commander_is_refused_and_anyone_may_stop() {
    let server = Server::ready();
    let mut first = server.start_command(&["enable"]);
    server.wait_for("enabled");
    server.fails(&["enable"], 7, &["another client"]);
    server.fails(&["--take-over", "enable"], 7, &["another client"]);
    signal(&first, nix::sys::signal::Signal::SIGINT);
    assert!(first.wait().unwrap().success());
    assert!(server.succeeds(&["info"]).contains("mode           disabled"));

    let second = server.start_command(&["enable"]);
    server.wait_for("enabled");
    assert!(server.succeeds(&["stop"]).contains("stopped"));
    let (code, text) = said(&finish(second));
    assert_eq!(code, 5, "{text}");
    assert!(text.contains("fault 17") && text.contains("tesaki faults --clear"), "{text}");
    server.fails(&["move", "finger1_swing=0"], 5, &["fault 17"]);
    server.fails(&["doctor"], 5, &["in fault", "tesaki faults --clear"]);
    assert!(server.succeeds(&["faults", "--clear"]).contains("disabled"));
    server.succeeds(&["move", "finger1_swing=0.05"]);
}

#[test]
fn a_supervisor_that_dies_leaves_a_board_that_stops_by_itself_and_serves_the_next_one() {
    let server = Server::ready();
    let mut victim = server.start_command(&["enable"]);
    server.wait_for("enabled");
    victim.kill().unwrap();
    victim.wait().unwrap();
    server.wait_for("in fault");
    server.fails(&["move", "finger1_swing=0"], 5, &["fault 0", "limit 1 s"]);
    server.succeeds(&["faults", "--clear"]);
    server.succeeds(&["move", "finger1_swing=0.05"]);
}

/// A command that writes JSON, of which nobody reads more than a few lines.
fn start_unread(server: &Server, arguments: &[&str]) -> Child {
    let child = server.start_command(&[&["--json"], arguments].concat());
    let output = child.stdout.as_ref().unwrap();
    nix::fcntl::fcntl(output, nix::fcntl::FcntlArg::F_SETPIPE_SZ(4096)).unwrap();
    server.wait_with(child, "enabled")
}

#[test]
fn a_reader_that_pauses_stops_neither_the_robot_nor_ctrl_c() {
    let server = Server::ready();
    let mut command = start_unread(&server, &["enable"]);
    // Longer than the pipe lasts, and than the command timeout.
    std::thread::sleep(Duration::from_millis(2500));
    assert!(command.try_wait().unwrap().is_none());
    server.wait_for("enabled");
    signal(&command, nix::sys::signal::Signal::SIGINT);
    server.wait_for("disabled");
    let begun = Instant::now();
    while command.try_wait().unwrap().is_none() {
        assert!(begun.elapsed() < Duration::from_secs(30), "it waits for its reader");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(server.json(&["faults"])["total"], 0);
}

#[test]
fn a_reader_that_pauses_for_too_long_disables_the_board() {
    let server = Server::ready();
    let mut command = start_unread(&server, &["enable"]);
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = command.try_wait().unwrap() {
            break status;
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "it waits for its reader");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(1));
    let (_, text) = said(&finish(command));
    assert!(text.contains("nobody read the output for too long; the board is disabled"), "{text}");
    assert_eq!(server.json(&["info"])["status"]["node"]["mode"], "Disabled");
    assert_eq!(server.json(&["faults"])["total"], 0);
}
