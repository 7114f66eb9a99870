//! The robot model on the board, and its parameters.

use super::server::{Server, hand3};

#[test]
fn a_board_of_one_finger_gets_its_own_model() {
    let server = Server::start();
    let robot = hand3();
    let robot = robot.to_str().unwrap();
    server.fails(&["model", "push", robot, "--chain", "thumb"], 2, &["no tip \"thumb\"", "finger3_tip"]);
    let pushed = server.succeeds(&["model", "push", robot, "--chain", "finger2_tip"]);
    assert!(pushed.contains("hand3.finger2_tip: 3 joints"), "{pushed}");
    let model = server.json(&["model", "show"]);
    assert_eq!(model["joints"][0]["name"], "finger2_swing");
    assert_eq!(model["chains"].as_array().unwrap().len(), 1);
}

#[test]
fn parameters_are_read_changed_and_refused_by_name() {
    let server = Server::ready();
    assert!(server.succeeds(&["read", "safety.command_timeout"]).contains("safety.command_timeout = 1"));
    server.succeeds(&["set", "safety.reaction", "off"]);
    assert!(server.succeeds(&["read", "safety"]).contains("safety.reaction = \"Off\""));
    server.succeeds(&["set", "joints.*.limits.velocity", "4.5"]);
    assert!(server.succeeds(&["read", "joints.finger3_curl.limits"]).contains("limits.velocity = 4.5"));
    server.fails(&["set", "safety.damping", "-1"], 2, &["safety.damping", "-1"]);
    server.fails(&["set", "safety.reaction", "sleep"], 2, &["sleep", "Hold"]);
    server.fails(&["set", "safety.colour", "red"], 2, &["colour", "command_timeout"]);
    server.fails(&["set", "safety", "1"], 2, &["is a group"]);
    // Homed joints stay homed: their encoders are the same.
    server.succeeds(&["move", "finger1_swing=0.02"]);
    assert_eq!(server.json(&["model", "show"])["safety"]["reaction"], "Off");
}
