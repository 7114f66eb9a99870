//! `tesaki identify --joints` on a simulated board.

use nix::sys::signal::Signal;
use tesaki_description::robot::RobotFolder;

use crate::server::{Server, finish, said, signal};

/// The friction of the machine, as the drives are told it, by its truth; and what ends the test early.
#[test]
fn a_hand_tells_its_friction_without_an_object() {
    let server = Server::ready();
    let out = server.folder.path().join("calibration.toml");
    let arguments = ["identify", "--joints", "--out", out.to_str().unwrap()];
    let interrupted = server.wait_with(server.start_command(&arguments), "enabled");
    signal(&interrupted, Signal::SIGINT);
    let (code, text) = said(&finish(interrupted));
    assert!(code == 1 && text.contains("interrupted: the board is disabled"), "{code}: {text}");
    server.wait_for("disabled");
    let disturbed = server.wait_with(server.start_command(&arguments), "enabled");
    server.succeeds(&["disable"]);
    let (code, text) = said(&finish(disturbed));
    assert!(code == 1 && text.contains("another program disabled the board"), "{code}: {text}");
    assert!(!out.exists());

    let found = server.json(&arguments);
    let hand = crate::server::hand3();
    server.succeeds(&["model", "push", hand.to_str().unwrap(), "--calibration", out.to_str().unwrap()]);
    let plant = server.stop();
    let model = RobotFolder::load(&hand).unwrap().model;
    for (joint, factors) in model.joints.iter().zip(plant.factors()) {
        // 20 mN·m by the folder.
        let told = 0.02 * factors.coulomb / factors.torque_constant;
        let coulomb = found["joints"][joint.name.as_str()]["coulomb"]["value"].as_f64().unwrap();
        assert!((coulomb / told - 1.0).abs() < 0.02, "{}: {coulomb} {told}", joint.name);
    }
}
