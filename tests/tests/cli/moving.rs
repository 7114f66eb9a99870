//! Joints and fingertips moved to a target.

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::Value;
use tesaki::protocol::{FromBoard, Stream};
use tesaki_supervisor::{Board, LinkBoard};

use super::recording::{decode, encode};
use super::server::{Server, arm7, finish, hand3, said, signal};

#[test]
fn from_a_fresh_board_to_a_moved_recorded_and_replayed_joint() {
    let server = Server::start();
    server.fails(&["move", "finger1_swing=0.3"], 7, &["no robot model", "tesaki model push"]);
    server.fails(&["doctor"], 1, &["no robot model", "tesaki model push", "1 problem found"]);
    let pushed = server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    assert!(pushed.contains("9 joints"), "{pushed}");
    let reach = ["reach", "--relative", "finger1_tip=0.01,0,0.01"];
    for command in [&["move", "finger1_swing=0.3"][..], &reach, &["tare"]] {
        server.fails(command, 7, &["finger1_swing is not homed: its encoder is relative", "tesaki home"]);
    }
    server.fails(&["home", "finger1_swing=0"], 2, &["finger1_bend has no angle", "--others"]);
    server.home();
    let healthy = server.succeeds(&["doctor"]);
    // A busy machine repeats a request now and then, which `doctor` reports.
    let repeated = healthy.contains("works; 1 warning") && healthy.contains("no answer came in time");
    assert!(healthy.contains("no problems found") || repeated, "{healthy}");
    server.fails(&["model", "check", "/nowhere"], 1, &["/nowhere", "robot.urdf"]);
    let other = server.succeeds(&["doctor", "--robot", hand3().to_str().unwrap()]);
    assert!(
        other.contains("differs from the one in") && other.contains("push it again as before"),
        "{other}"
    );
    let words = ["the model of another robot", "tesaki model push"];
    server.fails(&["doctor", "--robot", arm7().to_str().unwrap()], 1, &words);
    // The board is checked also where the folder cannot be read.
    let words = ["cannot read /nowhere/robot.urdf", "the control loop runs", "the board is disabled"];
    server.fails(&["doctor", "--robot", "/nowhere"], 1, &words);
    server.fails(&["move", "thumb=0.3"], 2, &["no joint \"thumb\"", "finger3_curl"]);
    server.fails(
        &["move", "finger1_swing=9"],
        2,
        &["finger1_swing: 9 rad is outside its limits -1 to 1 rad"],
    );
    let limits = "finger1_swing: 90.0° is outside its limits -57.3° to 57.3°";
    server.fails(&["move", "--degrees", "finger1_swing=90"], 2, &[limits]);
    server.fails(&["move", "finger1_swing=90"], 2, &["rad (--degrees for degrees)"]);
    server.fails(
        &["move", "finger1_swing=30deg"],
        2,
        &["is not an angle in rad; in degrees: --degrees and a number"],
    );
    server.fails(&["move", "finger1_swing"], 2, &["JOINT=ANGLE"]);
    server.fails(&["move", "finger1_swing=0", "finger1_swing=1"], 2, &["finger1_swing is given twice"]);

    let name = server.folder.path().join("run");
    let mut recorder = server.start_command(&["record", name.to_str().unwrap()]);
    std::thread::sleep(Duration::from_millis(300));
    let moved = server.succeeds(&["move", "finger1_swing=20", "finger2_bend=30", "--degrees"]);
    assert!(moved.contains("arrived") && moved.contains("disabled"), "{moved}");
    signal(&recorder, Signal::SIGINT);
    assert!(recorder.wait().unwrap().success());
    let state = server.json(&["read"]);
    assert_eq!(state["joints"][0]["name"], "finger1_swing");
    let angle = state["joints"][0]["position"].as_f64().unwrap();
    assert!((angle - 0.349_066).abs() < 0.02, "{angle}");
    let log = name.with_extension("log");
    let replayed = server.succeeds(&["replay", log.to_str().unwrap()]);
    let ticks: u32 = replayed.split(' ').next().unwrap().parse().unwrap();
    assert!(ticks > 100 && replayed.contains("identical"), "{replayed}");
    assert!(std::fs::metadata(name.with_extension("mcap")).unwrap().len() > 10_000);

    // No file is overwritten unintentionally.
    let again = ["record", name.to_str().unwrap(), "--duration", "0.2"];
    server.fails(&again, 2, &["run.log exists", "--force"]);

    // A file with one wrong bit is rejected as a recording.
    let whole = std::fs::read(&log).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    std::fs::write(&log, flipped).unwrap();
    server.fails(&["replay", log.to_str().unwrap()], 1, &["damaged record", "after tick", "not be compared"]);
    // One in the model: the ticks differ, and the damage is told first.
    let mut flipped = whole.clone();
    flipped[200] ^= 1;
    std::fs::write(&log, flipped).unwrap();
    let told = ["1 damaged record, the first before the first tick; ", "torques; recorded"];
    server.fails(&["replay", log.to_str().unwrap()], 1, &told);
    std::fs::write(&log, whole).unwrap();

    // One flipped bit in a recorded torque is found and named, even with a valid checksum.
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
    server.succeeds(&[&again[..], &["--force"]].concat());
}

#[test]
fn other_programs_leave_the_rate_that_one_needs() {
    let server = Server::ready();
    let [mut watcher, mut other] = [(); 2].map(|()| {
        let port = tesaki_supervisor::port::open(&server.address, None).unwrap();
        let mut board = LinkBoard::new(port, Duration::from_secs(2));
        board.hello().unwrap();
        board
    });
    watcher.set_rate(Stream::Telemetry, 1).unwrap();
    watcher.set_rate(Stream::Tips, 1).unwrap();
    other.set_rate(Stream::Telemetry, 0).unwrap();
    other.set_rate(Stream::Tips, 50).unwrap();
    server.succeeds(&["move", "finger1_swing=0.05"]);
    server.succeeds(&["read"]);
    server.succeeds(&["doctor"]);
    while watcher.next_event(Instant::now()).unwrap().is_some() {}
    let mut ticks = [Vec::new(), Vec::new()];
    while ticks.iter().any(|ticks| ticks.len() < 5) {
        match watcher.next_event(Instant::now() + Duration::from_secs(1)).unwrap().unwrap() {
            FromBoard::Telemetry(telemetry) => ticks[0].push(telemetry.tick),
            FromBoard::Tips(tips) => ticks[1].push(tips.tick),
            _ => {}
        }
    }
    for ticks in ticks {
        assert!(ticks.windows(2).all(|pair| pair[1] == pair[0] + 1), "{ticks:?}");
    }
}

#[test]
fn a_fingertip_moves_along_a_line_and_an_impossible_path_is_refused_before_anything_moves() {
    let server = Server::ready();
    // All fingers bent, away from the singular straight posture.
    server.succeeds(&[
        "move",
        "finger1_bend=0.1",
        "finger1_curl=1.3",
        "finger2_curl=1.3",
        "finger3_curl=1.3",
    ]);
    let arrived = server.succeeds(&["reach", "--relative", "finger1_tip=0.01,-0.005,0.008"]);
    assert!(arrived.contains("arrived") && arrived.contains("disabled"), "{arrived}");
    // Back along the same path to the initial angles.
    server.succeeds(&["reach", "--relative", "finger1_tip=-0.01,0.005,-0.008", "finger2_tip=0,0.005,0"]);
    let state = server.json(&["read"]);
    for (joint, angle) in [(0, 0.0), (1, 0.1), (2, 1.3)] {
        let position = state["joints"][joint]["position"].as_f64().unwrap();
        assert!((position - angle).abs() < 0.03, "joint {joint} at {position}");
    }
    server.fails(&["reach", "thumb=0,0,0"], 2, &["no tip \"thumb\"", "finger3_tip"]);
    let millimetres =
        ["finger1_tip: the target: ", " m away, more than ten times the length of hand3", "in metres?"];
    server.fails(&["reach", "finger1_tip=60,40,140"], 2, &millimetres);
    server.fails(&["reach", "finger1_tip=0,0"], 2, &["is not a position"]);
    server.fails(
        &["reach", "finger1_tip=0.5,0.04,0.1"],
        2,
        &["finger1_tip: the target 0.5000, 0.0400, 0.1000 m is out of reach", " m"],
    );
    server.fails(
        &["reach", "--relative", "finger1_tip=-0.045,0.05,0"],
        2,
        &["finger1_swing", "outside its limits"],
    );
    server.fails(
        &["reach", "--speed", "2", "--relative", "finger1_tip=0,0,-0.1"],
        2,
        &["would turn at", "lower --speed"],
    );
    server.fails(&["reach", "--speed", "0", "finger1_tip=0,0,0.1"], 2, &["above 0"]);
    server.fails(&["reach", "--speed", "1e-9", "--relative", "finger1_tip=0,0,0.01"], 2, &["600 s"]);
}

/// After the pause, the set-points continue along the path; a jump would cause fault 2, 4 or 5.
#[test]
fn a_fingertip_moves_on_after_its_supervisor_paused() {
    use nix::sys::signal::Signal::{SIGCONT, SIGSTOP};
    let server = Server::ready();
    server.succeeds(&["move", "finger1_curl=1.3"]);
    let reach = server.start_command(&["reach", "--relative", "finger1_tip=0.01,0,0.01"]);
    server.wait_for("enabled");
    for _ in 0..3 {
        signal(&reach, SIGSTOP);
        std::thread::sleep(Duration::from_millis(250));
        signal(&reach, SIGCONT);
        std::thread::sleep(Duration::from_millis(50));
    }
    let (code, text) = said(&finish(reach));
    assert!(code == 0 && text.contains("arrived"), "{text}");
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

/// A program that reads JSON learns at once that the joint is late, and not only when the hold ends.
#[test]
fn a_late_move_that_holds_is_told_in_json() {
    let server = Server::ready();
    let mut command = server.command(&["--json", "move", "--hold", "--within", "0.1", "finger1_bend=0.5"]);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let output = BufReader::new(child.stdout.take().unwrap());
    let values = output.lines().map(|line| serde_json::from_str::<Value>(&line.unwrap()).unwrap());
    let late = values.into_iter().find(|value| value["arrived"] == false).unwrap();
    assert!(late["joint"] == "finger1_bend" && late["largest_error"].as_f64().unwrap() > 0.1, "{late}");
    signal(&child, Signal::SIGINT);
    assert_eq!(child.wait().unwrap().code(), Some(6));
}

#[test]
fn a_motion_that_ctrl_c_breaks_off_fails() {
    let server = Server::ready();
    server.succeeds(&["move", "finger1_curl=1.3"]);
    for command in [
        // This tolerance is never reached.
        &["move", "--within", "60", "--tolerance", "1e-12", "finger2_bend=0.2"][..],
        &["reach", "--relative", "--speed", "1e-4", "finger1_tip=0.01,0,0.01"],
    ] {
        let child = server.wait_with(server.start_command(command), "enabled");
        signal(&child, Signal::SIGINT);
        let (code, text) = said(&finish(child));
        assert!(code == 130 && text.contains("interrupted: disabled"), "{command:?}: {code}: {text}");
        server.wait_for("disabled");
    }
}
