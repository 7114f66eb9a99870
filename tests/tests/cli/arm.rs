//! An arm under impedance control.

use std::time::Duration;

use super::server::{Server, arm7, finish, said, signal, unread};

#[test]
fn an_arm_is_compliant_until_ctrl_c() {
    let server = Server::ready_arm();
    let soft = arm7().join("impedances/soft.toml").to_str().unwrap().to_owned();
    server.fails(&["impedance", "hold", &soft], 7, &["hand was not tared", "tesaki tare"]);
    server.succeeds(&["tare"]);
    server.fails(&["impedance", "hold", "nowhere.toml"], 1, &["nowhere.toml"]);
    let spoilt = server.folder.path().join("spoilt.toml");
    let text =
        std::fs::read_to_string(&soft).unwrap().replace("translation = 300.0", "translation = 30000.0");
    std::fs::write(&spoilt, text).unwrap();
    let spoilt = spoilt.to_str().unwrap();
    server.fails(&["impedance", "hold", spoilt], 1, &["spoilt.toml", "stiffness along x", "0 to 3750 N/m"]);
    server.fails(&["impedance", "status"], 7, &["no task was enabled", "troubleshooting.md"]);

    let run = server.start_command(&["impedance", "hold", &soft]);
    let held = (0..100).find_map(|_| {
        std::thread::sleep(Duration::from_millis(50));
        server.status("impedance").filter(|status| status["sigma_min"].as_f64().unwrap() > 0.1)
    });
    let held = held.expect("never enabled");
    assert!((held["position"][0].as_f64().unwrap() - 0.36).abs() < 0.01, "{held}");
    std::thread::sleep(Duration::from_millis(1200));
    let words = server.succeeds(&["impedance", "status"]);
    assert!(words.contains("deviation") && words.contains("contact        no"), "{words}");
    signal(&run, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(run));
    assert_eq!(code, 0, "{text}");
    for word in ["enabled", "deviation", "N, free", "elbow", "interrupted: disabled", "done: compliant for"] {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }
    let words = server.succeeds(&["impedance", "status"]);
    assert!(words.starts_with("no impedance control now: the board is disabled"), "{words}");

    // A second arm, because this one falls.
    let server = Server::ready_arm();
    server.succeeds(&["tare"]);
    // With --json every line is JSON, and a recording that starts in mid-motion can be replayed.
    let run = server.start_command(&["--json", "impedance", "hold", &soft, "--duration", "4"]);
    server.wait_for("enabled");
    let recording = server.folder.path().join("arm").to_str().unwrap().to_owned();
    server.succeeds(&["record", &recording, "--duration", "1"]);
    server.succeeds(&["replay", &format!("{recording}.log")]);
    let (code, text) = said(&finish(run));
    assert_eq!(code, 0, "{text}");
    assert!(text.lines().count() > 3 && text.contains("\"contact\":false"), "{text}");
    assert!(text.contains("largest_force"), "{text}");
}

/// At any instant: a set-point may be refused before the first telemetry shows that the board was enabled.
#[test]
fn a_board_that_another_program_disables_is_named_as_such() {
    let soft = arm7().join("impedances/soft.toml").to_str().unwrap().to_owned();
    for _ in 0..4 {
        let server = Server::ready_arm();
        server.succeeds(&["tare"]);
        let mut run = server.start_command(&["impedance", "hold", &soft, "--duration", "20"]);
        while run.try_wait().unwrap().is_none() {
            server.succeeds(&["disable"]);
        }
        let (code, text) = said(&finish(run));
        assert!(code == 1 && text.contains("another program disabled the board"), "{code}: {text}");
    }
}

#[test]
fn motors_that_cannot_hold_the_arm_are_not_switched_on() {
    let server = Server::ready_arm();
    server.succeeds(&["set", "joints.*.limits.torque", "10%"]);
    for command in [&["enable"][..], &["move", "--relative", "wrist_roll=0.02"]] {
        let told = [
            "nothing was enabled: elbow cannot be held there: gravity 4.01 N·m, its motor at most 3.00 N·m",
            "raise limits.torque of elbow if its motor allows it",
        ];
        server.fails(command, 7, &told);
    }
    assert_eq!(server.json(&["info"])["status"]["node"]["mode"], "Disabled");
}

#[test]
fn an_arm_is_held_until_ctrl_c_and_disabled_when_nobody_reads_on() {
    let server = Server::ready_arm();
    assert!(server.home.is_empty(), "{:?}", server.home);
    assert!(server.succeeds(&["home"]).contains("all encoders of arm7 are absolute"));
    let joint = server.json(&["model", "show"])["joints"][3]["name"].as_str().unwrap().to_owned();
    let target = format!("{joint}=0.02");
    let moved = server.start_command(&["move", "--relative", &target]);
    server.wait_for("enabled");
    std::thread::sleep(Duration::from_secs(2));
    server.wait_for("enabled");
    signal(&moved, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(moved));
    assert_eq!(code, 0, "{text}");
    for word in ["arrived", "holding, because without power arm7 falls", "disabled; without power arm7 falls"]
    {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }
    server.wait_for_rest();
    let moved = server.succeeds(&["move", "--no-hold", "--relative", &format!("{joint}=0")]);
    assert!(moved.contains("arrived") && !moved.contains("holding"), "{moved}");

    // A second arm, because this one falls.
    let server = Server::ready_arm();
    server.succeeds(&["tare"]);
    let soft = arm7().join("impedances/soft.toml").to_str().unwrap().to_owned();
    let run = server.start_command(&["--json", "impedance", "hold", &soft]);
    server.wait_for("enabled");
    let (code, text) = unread(run);
    assert_eq!((code, &*text), (141, ""));
    assert_eq!(server.json(&["info"])["status"]["node"]["mode"], "Disabled");
    assert_eq!(server.json(&["faults"])["total"], 0);
}

#[test]
fn a_hand_is_not_an_arm() {
    let server = Server::ready();
    server.fails(&["impedance", "status"], 7, &["no task was enabled"]);
    let soft = arm7().join("impedances/soft.toml").to_str().unwrap().to_owned();
    server.fails(&["impedance", "hold", &soft], 1, &["hand3: the robot is not an arm"]);
}
