//! Grasp files: what is wrong with them is said in words, with the place.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use tesaki::control::ServoMode;
use tesaki::task::grasping::{InternalForce, ObjectControl};
use tesaki_description::grasp::{load, load_placed};
use tesaki_description::object::ObjectValues;

const BOX: &str = include_str!("../../robots/hand3/grasps/box.toml");

/// What is said of the box's grasp with `from` replaced by `to`.
#[track_caller]
fn complaint(from: &str, to: &str) -> String {
    assert!(BOX.contains(from), "{from}");
    complaint_about(&BOX.replacen(from, to, 1))
}

fn complaint_about(text: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("box.toml");
    std::fs::write(&path, text).unwrap();
    let said = load(&path).unwrap_err().to_string();
    assert!(said.starts_with(path.to_str().unwrap()), "{said}");
    said
}

#[test]
fn the_shipped_grasp_is_read_with_its_place() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3/grasps/box.toml");
    let grasp = load_placed(&path).unwrap();
    assert_eq!(load(&path).unwrap(), grasp.plan);
    assert!((grasp.position[2] - 0.085).abs() < 1e-12);
    // 0.769 rad about y.
    assert!((grasp.orientation[1] - (0.5 * 0.769_f64).sin()).abs() < 1e-12, "{:?}", grasp.orientation);
    assert_eq!(grasp.plan.friction, None);
    assert_eq!(grasp.plan.control, ObjectControl::Differential(ServoMode::Observer));
    assert!(matches!(grasp.plan.internal, InternalForce::LeastGrip { .. }));
    // 49 mm from the middle, along the turned x.
    let [x, _, z] = grasp.plan.contacts[2].position;
    assert!((x - 0.1252).abs() < 1e-4 && (z - 0.0509).abs() < 1e-4, "{x} {z}");
}

#[test]
fn numbers_that_make_no_sense_are_named_with_what_is_possible() {
    let said = complaint("clearance", "friction = 0.0\nclearance");
    assert!(said.contains("the coefficient of friction is 0") && said.contains("0.05 to 3"), "{said}");
    let said = complaint("force_limit = 9.0", "force_limit = 900.0");
    assert!(said.contains("the force limit is 900 N") && said.contains("0.1 to 100 N"), "{said}");
    let said = complaint("clearance = 0.010", "clearance = 0.5");
    assert!(said.contains("the clearance is 0.5 m"), "{said}");
    let said = complaint("rpy = [0.0, 0.769, 0.0]", "rpy = [0.0, 44.0, 0.0]");
    assert!(said.contains("box.toml:13: an angle of 44 rad, beyond ±4π: degrees?"), "{said}");
}

#[test]
fn an_object_is_no_grasp() {
    let said = complaint_about(include_str!("../../robots/hand3/objects/box.toml"));
    assert!(said.contains("this is an object file, not a grasp file") && said.lines().count() == 1, "{said}");
}

#[test]
fn contacts_that_cannot_grip_are_told_from_a_wrong_number_of_them() {
    // All three push the same way.
    let said = complaint("normal = [-1.0, 0.0, 0.0]", "normal = [1.0, 0.0, 0.0]");
    assert!(
        said.contains("no contact forces of this form inside the friction cones balance each other"),
        "{said}"
    );
    let said = complaint("normal = [-1.0, 0.0, 0.0]", "normal = [0.0, 0.0, 0.0]");
    assert!(said.contains("finger 3") && said.contains("its normal is 0"), "{said}");
    // The line is that of the third contact, not of the first.
    let (line, _) =
        (1..).zip(BOX.lines()).filter(|(_, line)| line.starts_with("[[contact]]")).nth(2).unwrap();
    assert!(said.contains(&format!("box.toml:{line}: ")), "{said}");
    let said = complaint("[-0.049, -0.04, 0.0]", "[-0.049, 0.04, 0.0]");
    assert!(said.contains("coincide"), "{said}");
    let two = BOX.rsplit_once("[[contact]]").unwrap().0;
    let said = complaint_about(two);
    assert!(said.contains("2 contacts") && said.contains("3 fingers"), "{said}");
}

#[test]
fn unknown_and_missing_keys_are_named_with_their_line() {
    let said = complaint("clearance = 0.010", "clearence = 0.010");
    assert!(said.contains("clearence") && said.contains("box.toml:2: "), "{said}");
    let said = complaint("touch_force = 0.1", "");
    assert!(said.contains("touch_force"), "{said}");
    let said = complaint("least_grip = {", "most_grip = {");
    assert!(said.contains("most_grip") && said.contains("pairwise"), "{said}");
    let folder = tempfile::tempdir().unwrap();
    let binary = folder.path().join("box.toml");
    std::fs::write(&binary, b"\xff\xfe").unwrap();
    for (path, advice) in
        [(binary.as_path(), "; save it as UTF-8"), (folder.path(), "; it is a folder: name a file")]
    {
        let said = load(path).unwrap_err().to_string();
        assert!(said.contains(advice), "{said}");
    }
    let said = load(Path::new("/nowhere/box.toml")).unwrap_err().to_string();
    assert!(said.starts_with("cannot read /nowhere/box.toml: "), "{said}");
}

#[test]
fn an_object_in_grams_is_denser_than_lead() {
    let text = include_str!("../../robots/hand3/objects/box.toml");
    let check = |text: &str| ObjectValues::check(Path::new("box.toml"), text);
    assert_eq!(check(text).1, []);
    let (object, findings) = check(&text.replacen("mass = 0.023", "mass = 23.0", 1));
    let [found] = &findings[..] else { panic!("{findings:?}") };
    assert!(object.is_some() && !found.is_error(), "{found}");
    let words = "mass = 23 kg in 0.098 × 0.208 × 0.06 m is denser than lead: grams?; masses are in kg: 23 g are 0.023";
    assert!(found.to_string().contains(words), "{found}");
}
