//! `tesaki identify --joints` on a simulated board.

use std::fs::File;
use std::process::Stdio;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use tesaki_description::robot::RobotFolder;

use crate::server::{Server, finish, said, signal};

/// The identified friction matches the machine's true friction in commanded torque; then the causes that end
/// the test early.
#[test]
fn a_hand_tells_its_friction_without_an_object() {
    let server = Server::ready();
    let out = server.folder.path().join("calibration.toml");
    let arguments = ["identify", "--joints", "--out", out.to_str().unwrap()];
    let interrupted = server.wait_with(server.start_command(&arguments), "enabled");
    signal(&interrupted, Signal::SIGINT);
    let (code, text) = said(&finish(interrupted));
    assert!(code == 130 && text.contains("interrupted: the board is disabled"), "{code}: {text}");
    server.wait_for("disabled");
    let disturbed = server.wait_with(server.start_command(&arguments), "enabled");
    server.fails(&["--take-over", "tare"], 7, &["which is enabled", "`tesaki stop` or `tesaki disable`"]);
    server.wait_for("enabled");
    server.succeeds(&["disable"]);
    let (code, text) = said(&finish(disturbed));
    assert!(code == 1 && text.contains("another program disabled the board"), "{code}: {text}");
    // Something pulls at a fingertip.
    let touched = server.wait_with(server.start_command(&arguments), "enabled");
    server.make_trouble("pull 0.01 0 0");
    let (code, text) = said(&finish(touched));
    assert!(code == 1 && text.contains("the force on finger1_tip changed by"), "{code}: {text}");
    server.wait_for("disabled");
    server.make_trouble("pull off");
    server.wait_for_rest();
    assert!(!out.exists());

    let found = identified(&server, &arguments);
    let hand = crate::server::hand3();
    server.succeeds(&["model", "push", hand.to_str().unwrap(), "--calibration", out.to_str().unwrap()]);
    let plant = server.stop();
    let model = RobotFolder::load(&hand).unwrap().model;
    for (joint, factors) in model.joints.iter().zip(plant.factors()) {
        // The folder has 20 mN·m.
        let told = 0.02 * factors.coulomb / factors.torque_constant;
        let [coulomb, deviation] = ["value", "deviation"]
            .map(|what| found["joints"][joint.name.as_str()]["coulomb"][what].as_f64().unwrap());
        // A busy machine loses frames and delays commands: then the fit's own deviation is the tolerance.
        let tolerance = (0.02 * told).max(4.0 * deviation);
        assert!((coulomb - told).abs() < tolerance, "{}: {coulomb} ± {deviation}, {told}", joint.name);
        assert!(deviation < 0.1 * told, "{}: {coulomb} ± {deviation}", joint.name);
    }
}

/// Runs the self-test again if the computer was too busy for it: then its message says so, or the readings
/// that are left do not identify every joint.
fn identified(server: &Server, arguments: &[&str]) -> serde_json::Value {
    let arguments = [&["--json"], arguments].concat();
    let mut said = String::new();
    for _ in 0..5 {
        let (code, text) = server.run(&arguments);
        assert!(code == 0 || code == 6 && text.contains("set-points came late"), "{code}: {text}");
        let found = serde_json::from_str::<serde_json::Value>(&text).unwrap_or_default();
        let is_complete = |joint: &serde_json::Value| joint["coulomb"].is_object();
        if found["joints"].as_object().is_some_and(|joints| joints.values().all(is_complete)) {
            return found;
        }
        said = text;
        server.wait_for_rest();
    }
    panic!("not identified in five tries: {said}");
}

/// The board of an arm holds it after a fault, as its model says; so it does when the self-test ends by that.
#[test]
fn an_arm_is_held_when_a_fault_ends_the_test() {
    let server = Server::ready_arm();
    let out = server.folder.path().join("calibration.toml");
    let child = server.start_command(&["identify", "--joints", "--out", out.to_str().unwrap()]);
    let child = server.wait_with(child, "enabled");
    server.make_trouble("supply 15");
    let (code, text) = said(&finish(child));
    assert!(code == 5 && text.contains("supply"), "{code}: {text}");
    let stopped = server.json(&["stop"]);
    assert!(stopped["mode"] == "Fault" && stopped["outputs"] == true, "{stopped}");
}

/// An arm that would fall does not fall onto an obstacle.
#[test]
fn an_arm_that_presses_holds_until_it_is_interrupted() {
    let server = Server::ready_arm();
    let (out, told) = (server.folder.path().join("calibration.toml"), server.folder.path().join("told"));
    let mut command = server.command(&["identify", "--joints", "--out", out.to_str().unwrap()]);
    let child = command.stdout(Stdio::null()).stderr(File::create(&told).unwrap()).spawn().unwrap();
    let child = server.wait_with(child, "enabled");
    server.make_trouble("pull 0.05 0 0");
    let start = Instant::now();
    let told = || std::fs::read_to_string(&told).unwrap();
    while !told().contains("holding, because without power it would fall") {
        assert!(start.elapsed() < Duration::from_secs(60), "{}", told());
        std::thread::sleep(Duration::from_millis(20));
    }
    server.make_trouble("pull off");
    server.wait_for("enabled");
    signal(&child, Signal::SIGINT);
    let (code, _) = said(&finish(child));
    let told = told();
    // Stopped either by the torque of a joint or by the force on the hand, whichever is detected first.
    let is_named =
        told.contains("N·m beyond the weight of its links") || told.contains("the force on hand changed by");
    assert!(code == 1 && is_named && !out.exists(), "{code}: {told}");
    server.wait_for("disabled");
    assert_eq!(server.json(&["faults"])["total"], 0);
}
