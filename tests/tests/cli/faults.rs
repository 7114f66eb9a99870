//! Faults of the robot in the command line's output.

use std::time::Duration;

use nix::sys::signal::Signal;

use super::server::{Server, arm7, finish, hand3, said, signal};

#[test]
fn faults_of_the_machine_are_named_by_joint_value_and_limit() {
    let server = Server::ready();
    let enabled = server.start_command(&["enable"]);
    server.wait_for("enabled");
    server.make_trouble("encoder finger2_curl 9000");
    let (code, text) = said(&finish(enabled));
    assert_eq!(code, 5, "{text}");
    assert!(text.contains("finger2_curl: the encoder jumped") && text.contains("limit 0.12"), "{text}");
    let faults = server.json(&["faults"]);
    assert_eq!(faults["faults"][0]["number"], 4);
    assert_eq!(faults["faults"][0]["fault"]["joint"], 5);
    // The encoder counts relative to its power-on position: after the jump its zero is lost.
    server.fails(&["doctor"], 5, &["the encoder jumped", "not homed: finger2_curl"]);
    let stopped = "the board is stopped until this fault is cleared (`tesaki faults --clear`):\n  fault ";
    assert!(server.succeeds(&["faults"]).starts_with(stopped));
    assert_eq!(server.json(&["faults"])["faults"][0]["joint"], "finger2_curl");
    assert!(server.succeeds(&["read"]).contains("The board is in fault; these are the values of tick "));
    let info = server.succeeds(&["info"]);
    for words in ["clock          crystal, 168 MHz", "last reset     power-on or reset button"] {
        assert!(info.contains(words), "{info}");
    }
    server.make_trouble("estop on");
    server.succeeds(&["faults", "--clear"]);
    server.succeeds(&["home", "finger2_curl=0", "--others", "0"]);
    let past = server.succeeds(&["faults"]);
    for word in ["past faults; none stops the board now", "a fault before its push may be of another robot"] {
        assert!(past.contains(word), "no {word:?} in: {past}");
    }
    server.fails(&["enable"], 7, &["emergency stop", "#fault-9-emergencystop"]);
    server.fails(&["doctor"], 1, &["the emergency stop is pressed"]);
    server.make_trouble("estop off");
    assert!(!server.succeeds(&["doctor"]).contains("emergency stop"));
    server.make_trouble("supply 15");
    server.fails(&["doctor"], 1, &["supply 15.0 V, outside 20 to 28 V"]);
    server.make_trouble("reset");
    server.make_trouble("nonsense");
    // The faults survive a reset, the model does not.
    server.fails(&["read"], 7, &["no robot model"]);
    assert_eq!(server.json(&["faults"])["total"], 1);
}

#[test]
fn the_doctor_sees_the_model_of_another_machine() {
    let server = Server::start();
    server.succeeds(&["model", "push", arm7().to_str().unwrap()]);
    let words = [
        "the machine has 9 joints and 3 force sensors",
        "its model arm7 has 7 joints",
        "push the model of this",
    ];
    server.fails(&["doctor"], 1, &words);
}

/// Not the first problem that it finds.
#[test]
fn the_doctors_exit_code_is_that_of_the_worst_problem() {
    let server = Server::start();
    server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    server.fails(&["doctor"], 1, &["not homed"]);
    server.succeeds(&["stop"]);
    server.fails(&["doctor"], 5, &["not homed", "the board is in fault"]);
}

/// Of several faults since power-on only the last one is said to stop the board.
#[test]
fn a_cleared_fault_does_not_stop_the_board() {
    let server = Server::ready();
    for supply in ["15", "14"] {
        let enabled = server.start_command(&["enable"]);
        server.wait_for("enabled");
        server.make_trouble(&format!("supply {supply}"));
        assert_eq!(said(&finish(enabled)).0, 5);
        if supply == "15" {
            server.make_trouble("supply 24");
            server.succeeds(&["faults", "--clear"]);
        }
    }
    let text = server.succeeds(&["faults"]);
    let (past, stops) = text.split_once("the board is stopped until this fault is cleared").unwrap();
    assert!(past.starts_with("all faults since power-on, cleared ones too:\n  fault "), "{text}");
    assert!(past.contains("value 15 V") && !past.contains("value 14 V"), "{text}");
    assert!(stops.contains("value 14 V") && !stops.contains("value 15 V"), "{text}");
}

#[test]
fn a_stop_hides_no_fault_before_it() {
    let server = Server::ready();
    let name = server.folder.path().join("run");
    let recorder = server.start_command(&["record", name.to_str().unwrap()]);
    let log = name.with_extension("log");
    while !std::fs::metadata(&log).is_ok_and(|log| log.len() > 0) {
        std::thread::sleep(Duration::from_millis(20));
    }
    let enabled = server.wait_with(server.start_command(&["enable"]), "enabled");
    // The recorder learns of both faults at once.
    signal(&recorder, Signal::SIGSTOP);
    server.make_trouble("encoder finger2_curl 9000");
    let (code, text) = said(&finish(enabled));
    assert!(code == 5 && text.contains("finger2_curl: the encoder jumped"), "{text}");
    server.succeeds(&["stop"]);
    signal(&recorder, Signal::SIGCONT);
    let words = ["fault 17 in tick ", "; before it: fault 4 in tick ", "#fault-17-stop and ", "#fault-4-"];
    server.fails(&["enable"], 5, &words);
    server.fails(&["doctor"], 5, &words);
    std::thread::sleep(Duration::from_millis(500));
    signal(&recorder, Signal::SIGINT);
    let (code, text) = said(&finish(recorder));
    assert_eq!(code, 0, "{text}");
    let told: Vec<&str> = text.lines().filter(|line| line.starts_with("fault ")).collect();
    assert!(
        matches!(told[..], [jump, stop] if jump.starts_with("fault 4 ") && stop.starts_with("fault 17 ")),
        "{told:?}"
    );
}
