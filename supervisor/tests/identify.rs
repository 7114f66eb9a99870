//! Calibrations: files that are written are read again; what is wrong with one is said in words.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;
use std::process::Command;

use tesaki_supervisor::identify::{Calibration, Doubt, Estimate, Fit};
use tesaki_supervisor::robot::RobotFolder;

const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3");

fn fits() -> Vec<Fit> {
    let estimate = |value| Estimate { value, deviation: 0.001 };
    let known = Fit {
        gain: Ok(estimate(1.1)),
        friction: Ok([estimate(0.018), estimate(0.0025)]),
        load_range: 0.2,
        residual: 0.001,
        readings: 1000,
    };
    let unloaded = Doubt::Unloaded { load_range: 0.04, deviation: 0.03 };
    let mut fits = vec![known; 9];
    fits[0].gain = Err(unloaded);
    fits[8].friction = Err(Doubt::Implausible { what: "N·m of Coulomb friction", value: -0.1 });
    fits
}

#[test]
fn what_is_written_is_read_and_changes_the_model() {
    let mut model = RobotFolder::load(Path::new(ROBOT)).unwrap().model;
    let calibration = Calibration::identified(&model, &fits());
    let text = calibration.text("two\nlines", &model, &fits());
    assert!(
        text.starts_with("# two\n# lines\n\n[joints.finger1_swing]\n# torque_constant is not identified")
    );
    assert!(
        text.contains("[joints.finger1_bend]\ntorque_constant = 0.55000  # N·m/A, ± 0.00050\n"),
        "{text}"
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("calibration.toml");
    std::fs::write(&path, text).unwrap();
    let read = Calibration::load(&path).unwrap();
    read.apply(&mut model).unwrap();
    let [swing, bend, .., last] = model.joints.as_slice() else { panic!() };
    let near = |value: f32, wanted: f32| (value - wanted).abs() < 1e-6;
    assert!(near(swing.motor.torque_constant, 0.5) && near(swing.friction.coulomb, 0.018));
    assert!(near(bend.motor.torque_constant, 0.55) && near(bend.friction.viscous, 0.0025));
    assert!(near(last.motor.torque_constant, 0.55) && near(last.friction.coulomb, 0.02));
}

#[test]
fn a_calibration_that_does_not_fit_changes_nothing() {
    let mut model = RobotFolder::load(Path::new(ROBOT)).unwrap().model;
    let before = model.clone();
    let mut complain = |text: &str| {
        let calibration: Calibration = toml::from_str(text).unwrap();
        calibration.apply(&mut model).unwrap_err().to_string()
    };
    let said = complain("[joints.finger4_bend]\ncoulomb = 0.02");
    assert!(said.contains("[joints.finger4_bend]") && said.contains("finger1_swing, finger1_bend"), "{said}");
    let said = complain("[joints.finger1_bend]\ncoulomb = 0.03\ntorque_constant = -0.5");
    assert!(said.contains("finger1_bend: motor.torque_constant = -0.5 must be above 0"), "{said}");
    assert_eq!(model, before);
}

/// Exit code and complaint of `tesaki`.
fn complaint(arguments: &[&str]) -> (i32, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_tesaki")).args(arguments).output().unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn the_command_line_says_what_is_wrong_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("calibration.toml");
    std::fs::write(&path, "[joints.finger1_bend]\ncolumb = 0.02\n").unwrap();
    let file = path.to_str().unwrap();
    let (code, said) = complaint(&["model", "push", ROBOT, "--calibration", file]);
    assert_eq!(code, 1, "{said}");
    assert!(said.contains(file) && said.contains("line 2") && said.contains("columb"), "{said}");
    let grasp = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3/grasps/box.toml");
    let (code, said) = complaint(&["identify", grasp, "--grips", "3"]);
    assert!(code == 2 && said.contains("two or more forces above 0 N and up to the 9 N"), "{said}");
    let (code, said) = complaint(&["identify", grasp, "--grips", "3,12"]);
    assert!(code == 2 && said.contains("two or more"), "{said}");
    let (code, said) = complaint(&["identify", grasp, "--amplitude", "2"]);
    assert!(code == 2 && said.contains("0.03 to 0.5 rad"), "{said}");
}
