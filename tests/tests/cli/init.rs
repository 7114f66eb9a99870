//! A robot folder that `tesaki model init` has written is right as it is: it passes the check, and a
//! simulated board moves every joint with it.

use std::path::{Path, PathBuf};

use super::machine::move_every_joint;
use super::server::{arm7, hand3};

/// A finger with what published URDFs often have wrong.
const DEFECTS: &str = include_str!("defects.urdf");

/// Exit code and all that was printed.
fn run(arguments: &[&str]) -> (i32, String) {
    let output = tesaki_tests::tesaki().args(arguments).output().unwrap();
    (output.status.code().unwrap(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
}

/// Writes the folder of a robot; what was said.
fn init(urdf: &Path, folder: &Path, options: &[&str]) -> String {
    let paths = [urdf.to_str().unwrap(), "--out", folder.to_str().unwrap()];
    let (code, text) = run(&[&["model", "init"], &paths[..], options].concat());
    assert_eq!(code, 0, "{text}");
    text
}

fn check(folder: &Path) -> String {
    let (code, text) = run(&["model", "check", folder.to_str().unwrap()]);
    assert_eq!(code, 0, "{text}");
    text
}

#[test]
fn a_hand_from_its_urdf_alone_moves_every_joint() {
    let folder = tempfile::tempdir().unwrap();
    let said = init(&hand3().join("robot.urdf"), folder.path(), &[]);
    assert!(
        said.contains("finger1_swing        maxon-16mm     0.600 N·m, for the URDF's effort of 0.6"),
        "{said}"
    );
    assert!(check(folder.path()).contains("no problems found"));
    move_every_joint(folder.path(), 2);
}

#[test]
fn an_arm_from_its_urdf_alone_moves_every_joint() {
    let folder = tempfile::tempdir().unwrap();
    let said = init(&arm7().join("robot.urdf"), folder.path(), &["--motor", "wrist_roll=xm430-w350"]);
    assert!(said.contains("shoulder_pitch       ak80-64       60.000 N·m"), "{said}");
    assert!(said.contains("wrist_roll           xm430-w350     4.101 N·m, as chosen"), "{said}");
    check(folder.path());
    move_every_joint(folder.path(), 3);
}

/// The URDF with defects, and the folder to write.
fn defects(folder: &tempfile::TempDir) -> (PathBuf, PathBuf) {
    let urdf = folder.path().join("defects.urdf");
    std::fs::write(&urdf, DEFECTS).unwrap();
    (urdf, folder.path().join("robot"))
}

#[test]
fn a_urdf_with_the_usual_defects_is_refused_by_line_or_accepted_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (urdf, out) = defects(&folder);
    let (code, text) = run(&["model", "init", urdf.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert_eq!(code, 1, "{text}");
    for words in ["defects.urdf:18: link link_0.0: physically impossible", "--accept-inertia"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert!(!out.exists(), "nothing is written");
    let said = init(&urdf, &out, &["--accept-inertia", "all"]);
    for words in [
        "inertia replaced by the nearest that a body can have: link_0.0, link_2.0",
        "the URDF's friction would take most of the torque, the motor's is used: joint_0.0",
        "the URDF has no effort limit, the motor's torque is used: joint_1.0",
        "link link_1.0: an inertia of 1.0e-3 kg·m² for 0.03 kg is a radius of gyration of 0.183 m",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let checked = check(&out);
    assert!(checked.contains("works; 3 warnings"), "{checked}");
    let plant = std::fs::read_to_string(out.join("plant.toml")).unwrap();
    assert!(plant.contains("\"joint_0.0\" = 0.3763"), "a tenth of the range above 0.263: {plant}");
    move_every_joint(&out, 1);
}

#[test]
fn wrong_names_and_folders_that_exist_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (urdf, out) = defects(&folder);
    let urdf = urdf.to_str().unwrap();
    for (options, words) in [
        (["--motor", "mg996r"], "there is no motor \"mg996r\"; the motors are xl330-m288"),
        (["--motor", "thumb=sts3215"], "no moving joint \"thumb\"; its joints are joint_0.0"),
        (["--accept-inertia", "link_9"], "--accept-inertia link_9: the URDF has no such link"),
    ] {
        let accept = ["--accept-inertia", "all"];
        let (code, text) = run(&[&["model", "init", urdf], &options[..], &accept[..]].concat());
        assert!(code == 2 && text.contains(words), "{code} {text}");
    }
    init(Path::new(urdf), &out, &["--accept-inertia", "all"]);
    let again = ["model", "init", urdf, "--accept-inertia", "all", "--out", out.to_str().unwrap()];
    let (code, text) = run(&again);
    assert!(code == 1 && text.contains("robot.urdf exists") && text.contains("--force"), "{text}");
    let (code, text) = run(&[&again[..], &["--force"]].concat());
    assert_eq!(code, 0, "{text}");
}
