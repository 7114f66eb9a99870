//! Boards that are shared over TCP, and keys.

use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::PermissionsExt as _;
use std::process::Child;

use super::server::{Server, finish, said, signal};

/// A running `tesaki share`.
struct Share {
    child: Option<Child>,
    /// Its first output.
    said: String,
    /// Address for programs on this machine.
    port: String,
}

impl Share {
    fn start(server: &Server, arguments: &[&str]) -> Self {
        let mut child = server.start_command(arguments);
        let mut said = String::new();
        let mut reader = BufReader::new(child.stderr.take().unwrap());
        reader.read_line(&mut said).unwrap();
        child.stderr = Some(reader.into_inner());
        let number = said.split("--port tcp://").nth(1).unwrap_or_else(|| panic!("{said}"));
        let number = number.split(|letter: char| "` ".contains(letter)).next().unwrap();
        let number = number.rsplit_once(':').unwrap().1;
        Self { child: Some(child), port: format!("tcp://localhost:{number}"), said }
    }

    /// Runs a program that uses the shared board.
    fn client(&self, arguments: &[&str]) -> (i32, String) {
        said(&tesaki_tests::tesaki().args(["--port", &self.port]).args(arguments).output().unwrap())
    }

    /// Stops it; returns its output since then.
    fn stop(mut self) -> String {
        let child = self.child.take().unwrap();
        signal(&child, nix::sys::signal::Signal::SIGINT);
        let (code, text) = said(&finish(child));
        assert_eq!(code, 0, "{text}");
        text
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            let _ = child.kill();
        }
    }
}

#[test]
fn a_key_is_not_read_where_there_is_no_tcp() {
    let server = Server::start();
    let (key, socket) = (server.folder.path().join("none.key"), server.folder.path().join("socket"));
    let socket = format!("unix://{}", socket.display());
    let command = ["--key", key.to_str().unwrap(), "share", &socket];
    let mut child = server.start_command(&command);
    let mut said = String::new();
    BufReader::new(child.stderr.take().unwrap()).read_line(&mut said).unwrap();
    assert!(said.contains(&socket) && said.contains("may command the board"), "{said}");
    signal(&child, nix::sys::signal::Signal::SIGINT);
    assert!(finish(child).status.success());
    server.fails(&["--key", key.to_str().unwrap(), "share", "tcp://localhost:0"], 1, &["none.key"]);
}

#[test]
fn a_board_is_shared_with_other_machines_by_a_key_only() {
    let server = Server::start();
    for open in ["tcp://0.0.0.0:0", "tcp://[::]:0"] {
        server.fails(
            &["share", open],
            2,
            &[open, "without a key", "tesaki key FILE", "--key FILE", "TESAKI_KEY", "tcp://localhost"],
        );
    }
    let path = |name: &str| server.folder.path().join(name).to_str().unwrap().to_owned();
    let (key, wrong) = (path("lab.key"), path("wrong.key"));
    assert!(server.succeeds(&["key", &key]).contains(&format!("--key {key}")));
    server.succeeds(&["key", &wrong]);
    server.fails(&["key", &key], 2, &[&key, "exists already"]);

    let share = Share::start(&server, &["share", "tcp://0.0.0.0:0", "--key", &key]);
    assert!(share.said.contains("every program with this key may command the board"), "{}", share.said);
    assert!(share.said.contains("tcp://0.0.0.0:") && share.said.contains(&key), "{}", share.said);
    assert!(!share.said.contains(std::fs::read_to_string(&key).unwrap().trim()));
    let port = &share.port;
    server.succeeds(&["--port", port, "--key", &key, "info"]);
    server.succeeds(&["--key", &wrong, "info"]); // a socket of this machine needs none
    let output = server.command(&["--port", port, "info"]).env("TESAKI_KEY", &key).output().unwrap();
    assert_eq!(said(&output).0, 0, "{output:?}");
    server.fails(&["--port", port, "--key", &wrong, "info"], 3, &["refused the key", "the same key file"]);
    server.fails(&["--port", port, "info"], 3, &["is encrypted", "--key FILE", "TESAKI_KEY"]);
    server.fails(&["--port", port, "doctor"], 3, &["is encrypted"]);
    server.fails(&["--port", port, "share", "tcp://127.0.0.1:0"], 3, &["is encrypted"]);

    std::fs::set_permissions(&key, std::fs::Permissions::from_mode(0o644)).unwrap();
    server.fails(&["--port", port, "--key", &key, "info"], 1, &[&key, "chmod 600"]);
    std::fs::write(&wrong, "secret").unwrap();
    server.fails(&["--port", port, "--key", &wrong, "info"], 1, &[&wrong, "is too short", "64"]);
    server.fails(
        &["--key", "/nowhere", "--port", "tcp://localhost:1", "info"],
        1,
        &["/nowhere", "no such key file"],
    );
    server.fails(&["--key", "/tmp", "--port", "tcp://localhost:1", "info"], 1, &["/tmp", "is not a file"]);

    let heard = share.stop();
    assert!(heard.contains("127.0.0.1:") || heard.contains("[::1]:"), "{heard}");
    assert!(heard.contains("has another key") && heard.contains("has no key"), "{heard}");
}

#[test]
fn a_program_is_told_the_port_that_the_system_chose() {
    let server = Server::start();
    let mut child = server.start_command(&["--json", "share", "tcp://localhost:0"]);
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let shared: serde_json::Value = serde_json::from_str(&line).unwrap();
    let address = shared["address"].as_str().unwrap();
    let info = tesaki_tests::tesaki().args(["--port", address, "info"]).output().unwrap();
    signal(&child, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(child));
    assert_eq!((said(&info).0, code), (0, 0), "{address}: {text}");
}

#[test]
fn this_machine_needs_no_key() {
    let server = Server::start();
    let share = Share::start(&server, &["share", "tcp://localhost:0"]);
    assert!(share.said.contains("every program on this machine"), "{}", share.said);
    server.succeeds(&["--port", &share.port, "info"]);
    let key = server.folder.path().join("key");
    let key = key.to_str().unwrap();
    server.succeeds(&["key", key]);
    server.fails(&["--port", &share.port, "--key", key, "info"], 3, &["is not encrypted", "leave --key out"]);
    share.stop();
}

#[test]
fn a_robot_folder_is_for_foxglove_only() {
    let server = Server::start();
    let command = ["share", "tcp://localhost:0", "--robot", "robots/hand3"];
    server.fails(&command, 2, &["--robot", "foxglove://", "tesaki view --robot"]);
    // Where it is set for all commands, it does no harm.
    let mut child = server.command(&["share", "tcp://localhost:0"]);
    let mut child =
        child.env("TESAKI_ROBOT", "robots/hand3").stderr(std::process::Stdio::piped()).spawn().unwrap();
    let mut said = String::new();
    BufReader::new(child.stderr.take().unwrap()).read_line(&mut said).unwrap();
    assert!(said.contains("may command the board"), "{said}");
    signal(&child, nix::sys::signal::Signal::SIGINT);
    assert!(finish(child).status.success());
}

#[test]
fn a_shared_board_that_is_away_is_told_once() {
    let server = Server::start();
    let share = Share::start(&server, &["share", "tcp://localhost:0"]);
    server.stop();
    std::thread::sleep(std::time::Duration::from_secs(1));
    let away =
        ["no answer from the board", &*share.port, "its terminal says whether the board is away, and why"];
    let (code, text) = share.client(&["--timeout", "0.3", "info"]);
    assert!(code == 6 && away.iter().all(|words| text.contains(words)), "{code}: {text}");
    let (code, text) = share.client(&["--timeout", "0.3", "doctor"]);
    assert!(code == 6 && text.contains("says in its terminal whether the board is away"), "{code}: {text}");
    let heard = share.stop();
    assert_eq!(heard.matches("the board is away: ").count(), 1, "{heard}");
}
