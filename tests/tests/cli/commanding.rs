//! Command of a board, and what happens when the commander leaves.

use std::io::{Read as _, Write as _};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::Child;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tesaki::protocol::codec::Decoder;
use tesaki::protocol::{Request, RequestFrame};
use tesaki_supervisor::port::Address;

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
    assert!(text.contains("standard output was not read for too long, so the board was disabled"), "{text}");
    assert_eq!(server.json(&["info"])["status"]["node"]["mode"], "Disabled");
    assert_eq!(server.json(&["faults"])["total"], 0);
}

/// A socket in front of the board's, for one program. After the first request to enable the board, what the
/// board says is lost for so long.
fn losing_answers(server: &Server, time: Duration) -> Address {
    let path = server.folder.path().join("lossy");
    let listener = UnixListener::bind(&path).unwrap();
    let Address::Unix(board) = server.address.clone() else { panic!("no socket") };
    std::thread::spawn(move || {
        let (mut from_program, _) = listener.accept().unwrap();
        let mut to_program = from_program.try_clone().unwrap();
        let mut to_board = UnixStream::connect(board).unwrap();
        let mut from_board = to_board.try_clone().unwrap();
        let hears_from = Arc::new(Mutex::new(Instant::now()));
        let hears = Arc::clone(&hears_from);
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(length @ 1..) = from_board.read(&mut buffer) {
                if Instant::now() >= *hears.lock().unwrap()
                    && to_program.write_all(&buffer[..length]).is_err()
                {
                    break;
                }
            }
        });
        let (mut decoder, mut was_enabled) = (Decoder::new(), false);
        let mut buffer = [0; 4096];
        while let Ok(length @ 1..) = from_program.read(&mut buffer) {
            let bytes = &buffer[..length];
            let mut frames = bytes.iter().filter_map(|&byte| decoder.push::<RequestFrame>(byte));
            let enables = frames.any(|frame| {
                frame.is_ok_and(|RequestFrame { request, .. }| matches!(request, Request::Enable(_)))
            });
            if enables && !std::mem::replace(&mut was_enabled, true) {
                *hears_from.lock().unwrap() = Instant::now() + time;
            }
            to_board.write_all(bytes).unwrap();
        }
        to_board.shutdown(Shutdown::Both).unwrap();
    });
    Address::Unix(path)
}

#[test]
fn a_board_whose_answer_to_enable_is_lost_is_disabled() {
    let server = Server::ready();
    let lossy = losing_answers(&server, Duration::from_millis(700)).to_string();
    server.fails(
        &["--port", &lossy, "--timeout", "0.5", "enable"],
        6,
        &["no answer from the board within 0.5 s"],
    );
    let info = server.succeeds(&["info"]);
    assert!(info.contains("mode           disabled"), "{info}");
    assert_eq!(server.json(&["faults"])["total"], 0);
}
