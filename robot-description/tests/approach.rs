//! `approach.toml`: that of the arm that comes with tesaki, and what is wrong with others.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use tesaki_description::robot::RobotFolder;
use tesaki_description::{approach, hand_eye};

fn folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/knob-arm")
}

/// What is said about the file with a text in place of another.
fn said(from: &str, to: &str) -> String {
    let text = std::fs::read_to_string(folder().join(approach::FILE)).unwrap();
    assert!(text.contains(from), "{from}");
    let model = RobotFolder::load(&folder()).unwrap().model;
    let table = hand_eye::load(&folder()).unwrap();
    let (settings, findings) =
        approach::check(Path::new("approach.toml"), &text.replacen(from, to, 1), &model, &table);
    assert!(settings.is_none(), "{to} is accepted");
    findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

#[test]
fn the_file_of_the_arm_is_read() {
    let model = RobotFolder::load(&folder()).unwrap().model;
    let file = approach::load(&folder(), &model).unwrap();
    assert_eq!(file.task.gripper.joint, 6);
    assert!((file.behavior.expectation.radius - 0.025).abs() < 1e-9);
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    for (from, to, line, word) in [
        ("joint = \"gripper\"", "joint = \"grippr\"", 11, "grippr"),
        ("speed = 0.15 ", "speed = 1.5 ", 5, "speed of the hand"),
        ("open = -0.98", "open = -1.8", 12, "gripper: -1.8 rad is outside"),
        ("open = -0.98", "open = -56.0", 12, "rad (angles are in rad: -56° are -0.9774)"),
        ("open = -0.98", "open = -98", 12, "rad (angles are in rad: -98° are -1.7104)"),
        (
            "opening = [-0.1, 0.16]",
            "opening = [-10, 9]",
            32,
            "outside the limits of gripper, -1 to 0.4 rad: a held knob could not be told from an empty grip (angles are \
             in rad: -10° are -0.1745)",
        ),
        ("torque = 0.8", "torque = 8.0", 15, "torque of the gripper"),
        ("reach = 0.5", "reach = 0.2", 22, "distance is 0.28"),
        ("guard_distance = 0.075", "guard_distance = 0.05", 28, "guard_distance is 0.05"),
        ("near_speed = 0.04", "near_speed = 0.4", 31, "near_speed is 0.4"),
        ("retries = 3", "retries = 200", 34, "retries is 200"),
    ] {
        let said = said(from, to);
        assert!(said.contains(&format!(":{line}")) && said.contains(word), "{to}: {said}");
    }
    assert!(said("pull = 0.02", "pul = 0.02").contains("pul"));
}
