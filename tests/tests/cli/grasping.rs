//! A hand that grasps a box, is interrupted, or finds no object. That one command lifts, turns and puts down
//! a box is shown in `pages`.

use std::time::Duration;

use super::server::{Server, finish, hand3, said, signal, unread};

/// Returns the grasp file of the box.
fn box_grasp() -> String {
    hand3().join("grasps/box.toml").to_str().unwrap().to_owned()
}

#[test]
fn steps_that_are_none_are_refused_before_anything_moves() {
    let server = Server::ready_to_grasp(false);
    let file = box_grasp();
    server.fails(&["grasp", "run", &file], 7, &["finger1_tip was not tared", "tesaki tare"]);
    let out = server.folder.path().join("calibration.toml");
    let words = ["finger1_tip was not tared", "tesaki tare"];
    server.fails(&["identify", &file, "--out", out.to_str().unwrap()], 7, &words);
    server.succeeds(&["tare"]);
    server.fails(&["grasp", "run", &file, "lift=high"], 2, &["lift", "not a number"]);
    server.fails(&["grasp", "run", &file, "turn=0,1"], 2, &["turn", "three numbers"]);
    server.fails(&["grasp", "run", &file, "juggle"], 2, &["juggle", "lift=M"]);
    server.fails(&["grasp", "run", &file, "hold", "lift=0.01"], 2, &["hold without a time", "hold=5"]);
    server.fails(&["grasp", "run", &file, "--speed", "0"], 2, &["--speed", "above 0"]);
    server.fails(&["grasp", "run", &file, "--speed", "1e-9", "lift=0.01"], 2, &["--speed", "600 s"]);
    server.fails(&["grasp", "status"], 7, &["no task was enabled", "troubleshooting.md"]);

    // The joint is named whose limits are in the way of a contact, or of the path to it.
    let text = std::fs::read_to_string(&file).unwrap();
    let millimetres = server.folder.path().join("millimetres.toml");
    std::fs::write(&millimetres, text.replace("[0.090, 0.0, 0.085]", "[90, 0.0, 85]")).unwrap();
    let words = ["millimetres.toml: contact 1", "is it in metres?"];
    server.fails(&["grasp", "run", millimetres.to_str().unwrap()], 2, &words);
    let strong = server.folder.path().join("strong.toml");
    std::fs::write(&strong, text.replace("force_limit = 9.0", "force_limit = 90.0")).unwrap();
    let words =
        ["strong.toml: force_limit = 90 N", "more than 10 N at finger1_tip is a fault", "at most 10 N"];
    let strong = strong.to_str().unwrap();
    server.fails(&["grasp", "run", strong], 2, &words);
    server.fails(&["identify", strong, "--out", out.to_str().unwrap()], 2, &words);
    for (position, code, words) in [
        (
            "[0.0, 0.0, 0.085]",
            2,
            ["finger1_tip cannot stand at contact 1: ", "finger1_bend would need ", "limits -1.2 to 1.7 rad"],
        ),
        (
            "[0.090, 0.0, 0.045]",
            7,
            [
                "a fingertip cannot be led to its position: ",
                "finger3_swing: ",
                "beyond its limit of 4.8 rad/s",
            ],
        ),
    ] {
        let elsewhere = server.folder.path().join("elsewhere.toml");
        std::fs::write(&elsewhere, text.replace("[0.090, 0.0, 0.085]", position)).unwrap();
        server.fails(&["grasp", "run", elsewhere.to_str().unwrap()], code, &words);
    }
}

#[test]
fn a_grasp_that_ctrl_c_breaks_off_fails() {
    let server = Server::ready_to_grasp(false);
    server.succeeds(&["tare"]);
    let run = server.wait_with(server.start_command(&["grasp", "run", &box_grasp()]), "enabled");
    signal(&run, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(run));
    assert!(code == 130 && text.contains("interrupted: the steps were not completed"), "{code}: {text}");
    assert!(text.contains("interrupted: disabled"), "{text}");
}

#[test]
fn ctrl_c_puts_the_box_down_and_a_fault_says_what_became_of_it() {
    let server = Server::ready_to_grasp(true);
    server.succeeds(&["tare"]);
    let file = box_grasp();
    let wait_until_held = || {
        while server.status("grasp").is_none_or(|status| status["phase"] != "Hold") {
            std::thread::sleep(Duration::from_millis(50));
        }
        std::thread::sleep(Duration::from_millis(200));
    };
    let run = server.start_command(&["grasp", "run", &file]);
    wait_until_held();
    signal(&run, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(run));
    assert_eq!(code, 0, "{text}");
    assert!(text.contains("lowers an object") && text.contains("interrupted: disabled"), "{text}");

    // The box is put down although nobody reads the output.
    let run = server.start_command(&["--json", "grasp", "run", &file]);
    wait_until_held();
    let (code, text) = unread(run);
    assert_eq!(code, 141, "{text}");
    let status = server.json(&["grasp", "status"]);
    assert!(status["phase"] == "Ready" && status["mode"] == "Disabled", "{status}");

    // A step that is refused is named, and the box is put down.
    let words = [
        "lift=0.2: the board refused to move the object: finger ",
        "lowers an object",
        "the nearest in reach",
    ];
    server.fails(&["grasp", "run", &file, "lift=0.2"], 7, &words);

    let run = server.start_command(&["--json", "grasp", "run", &file, "hold"]);
    wait_until_held();
    server.make_trouble("estop on");
    let (code, text) = said(&finish(run));
    assert_eq!(code, 5, "{text}");
    assert!(text.contains("emergency stop") && text.contains("`tesaki disable` releases"), "{text}");
    for line in text.lines() {
        assert!(serde_json::from_str::<serde_json::Value>(line).is_ok(), "{line}");
    }
    assert!(text.contains("\"phase\":\"Hold\""), "{text}");
    let status = server.succeeds(&["grasp", "status"]);
    assert!(
        status.contains("the grasp ended: the board is in fault") && status.contains("before that"),
        "{status}"
    );
}

#[test]
fn a_second_ctrl_c_lets_the_box_fall_and_says_so() {
    let server = Server::ready_to_grasp(true);
    server.succeeds(&["tare"]);
    let wait_for = |phase: &str| {
        while server.status("grasp").is_none_or(|status| status["phase"] != phase) {
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let run = server.start_command(&["grasp", "run", &box_grasp(), "lift=0.02", "hold"]);
    wait_for("Move");
    wait_for("Hold");
    signal(&run, nix::sys::signal::Signal::SIGINT);
    wait_for("Lower");
    signal(&run, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(run));
    assert!(code == 130 && text.contains("an object that the hand still held falls"), "{code}: {text}");
    assert!(!text.contains("done"), "{text}");
}

#[test]
fn a_hand_that_finds_nothing_says_so_and_opens() {
    let server = Server::ready_to_grasp(false);
    server.succeeds(&["tare"]);
    let file = box_grasp();
    server.fails(
        &["grasp", "run", &file, "lift=0.01"],
        8,
        &[
            "found no surface within 0.02 m: the hand opened",
            "[object] in",
            "clearance",
            "is ready",
            "disabled",
        ],
    );
    server.fails(&["grasp", "run", "/nowhere"], 1, &["/nowhere"]);
    let status = server.json(&["grasp", "status"]);
    assert!(!status["failure"]["NoObject"].is_null(), "{status}");
}
