//! Impedance files: what is wrong with them is said in words, with the place.
#![allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests")]

use core::f32::consts::FRAC_PI_2;
use std::path::{Path, PathBuf};

use tesaki::control::ImpedanceAxes;
use tesaki::model::{MimicJoint, RobotModel};
use tesaki::task::impedance::{DirectLaw, ImpedanceSettings, Law, Redundancy};
use tesaki_description::impedance::{check, load, own_mass_at};
use tesaki_description::init::{InitOptions, robot_texts};
use tesaki_description::robot::RobotFolder;

const SOFT: &str = include_str!("../../robots/arm7/impedances/soft.toml");

fn robots() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots")
}

fn model(robot: &str) -> RobotModel {
    RobotFolder::load(&robots().join(robot)).unwrap().model
}

/// What is said of the soft impedance with `from` replaced by `to`.
#[track_caller]
fn complaint(from: &str, to: &str) -> String {
    assert!(SOFT.contains(from), "{from}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("soft.toml");
    std::fs::write(&path, SOFT.replacen(from, to, 1)).unwrap();
    let said = load(&path, &model("arm7")).unwrap_err().to_string();
    assert!(said.starts_with(path.to_str().unwrap()), "{said}");
    said
}

#[test]
fn the_shipped_impedances_are_read() {
    let model = model("arm7");
    let [soft, firm] = ["soft", "firm"]
        .map(|name| load(&robots().join(format!("arm7/impedances/{name}.toml")), &model).unwrap());
    assert_eq!((soft.law, soft.redundancy), (Law::ModelFollowing, Redundancy::ArmAngle));
    assert_eq!(soft.impedance.stiffness[..], [300.0, 300.0, 300.0, 16.0, 16.0, 16.0]);
    assert_eq!(soft.max_deviation[..], [0.3, 1.0]);
    assert!(firm.impedance.stiffness[2] > soft.impedance.stiffness[2]);
}

#[test]
fn axes_may_differ_and_a_joint_is_driven_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("own.toml");
    let text = SOFT
        .replace("redundancy = \"arm-angle\"", "redundancy = { driven = \"shoulder_yaw\" }")
        .replace("stiffness = { translation = 300.0", "stiffness = { translation = [100.0, 200, 300.0]");
    std::fs::write(&path, text).unwrap();
    let settings = load(&path, &model("arm7")).unwrap();
    assert_eq!(settings.redundancy, Redundancy::DrivenJoint { joint: 2 });
    assert_eq!(settings.impedance.stiffness[..4], [100.0, 200.0, 300.0, 16.0]);
    let said = complaint("\"arm-angle\"", "{ driven = \"finger1_swing\" }");
    assert!(said.contains("arm7 has no joint \"finger1_swing\"") && said.contains("shoulder_yaw"), "{said}");
}

#[test]
fn a_hand_has_no_impedance_whatever_the_file_says() {
    let path = robots().join("arm7/impedances/soft.toml");
    let said = load(&path, &model("hand3")).unwrap_err().to_string();
    assert!(
        said.contains("soft.toml: hand3: the robot is not an arm: a single chain of six or seven joints"),
        "{said}"
    );
    assert!(!said.contains("is an example"), "{said}");
    // Nor has an arm one of whose joints has no motor.
    let mut coupled = model("arm7");
    let wrist = coupled.joints.pop().unwrap();
    let follower = MimicJoint {
        chain: 0,
        place: 6,
        joint: 5,
        multiplier: 1.0,
        offset: 0.0,
        origin: wrist.origin,
        axis: wrist.axis,
        link: wrist.link,
    };
    coupled.mimics.push(follower).unwrap();
    coupled.chains[0].joints = 6;
    let said = load(&path, &coupled).unwrap_err().to_string();
    assert!(said.contains("six or seven joints, each with a motor"), "{said}");
}

/// An arm of six joints without a force sensor, as `tesaki model init` makes it of its URDF.
fn ur5e() -> RobotModel {
    let path = robots().join("../tests/robots/ur5e.urdf");
    let urdf = std::fs::read_to_string(&path).unwrap();
    let texts = robot_texts(&path, &urdf, &InitOptions::default()).unwrap();
    RobotFolder::parse(&path, &urdf, &texts.controller).unwrap().model
}

#[test]
fn the_example_for_six_joints_is_read_and_named_where_that_for_seven_is_wrong() {
    let example = robots().join("../docs/examples/soft_six_joints.toml");
    let settings = load(&example, &ur5e()).unwrap();
    assert_eq!((settings.redundancy, settings.impedance.stiffness[0]), (Redundancy::None, 300.0));
    let said = load(&robots().join("arm7/impedances/soft.toml"), &ur5e()).unwrap_err().to_string();
    assert!(
        said.contains("soft.toml:5: force = \"sensor\": ") && said.contains("has no force sensor"),
        "{said}"
    );
    assert!(said.contains("observer = 30.0") && said.contains("soft_six_joints.toml"), "{said}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("own.toml");
    std::fs::write(&path, SOFT.replace("force = \"sensor\"", "force = { observer = 30.0 }")).unwrap();
    let said = load(&path, &ur5e()).unwrap_err().to_string();
    assert!(
        said.contains("own.toml:3: only an arm of seven joints") && said.contains("redundancy = \"none\""),
        "{said}"
    );
}

#[test]
fn numbers_that_make_no_sense_are_named_with_what_is_possible() {
    let said = complaint("mass = { translation = 1.5", "mass = { translation = [1.5, 0.0, 1.5]");
    assert!(said.contains("the mass along y is 0 kg; possible is 0.001 to 10000 kg"), "{said}");
    let said = complaint("rotation = 16.0", "rotation = 160.0");
    assert!(
        said.contains("the stiffness about x is 160 N·m/rad") && said.contains("0 to 20 N·m/rad"),
        "{said}"
    );
    let said = complaint("damping = { translation = 30.0", "damping = { translation = -30.0");
    assert!(said.contains("the damping along x is -30 N·s/m") && said.contains("0 to 150 N·s/m"), "{said}");
    let said = complaint("elbow_bandwidth = 12.0", "elbow_bandwidth = 200.0");
    assert!(said.contains("the elbow bandwidth is 200 rad/s") && said.contains("at most 50 rad/s"), "{said}");
    let said = complaint("force = \"sensor\"", "force = { observer = 90.0 }");
    assert!(
        said.contains("the bandwidth of the force observer is 90 rad/s; it must be between 10 and 50 rad/s"),
        "{said}"
    );
    let said = complaint("contact_force = 1.5", "contact_force = nan");
    assert!(said.contains("the contact force is NaN N"), "{said}");
    let said = complaint("translation = 0.3", "translation = -0.3");
    assert!(said.contains("the maximum deviation is -0.3"), "{said}");
}

/// What is doubtful in `text` for a robot, each with its line.
fn doubts(text: &str, model: &RobotModel) -> Vec<String> {
    let (settings, findings) = check(Path::new("own.toml"), text, model);
    assert!(settings.is_some(), "{findings:?}");
    findings.iter().map(ToString::to_string).collect()
}

#[test]
fn thresholds_that_nothing_reaches_are_refused() {
    let said = complaint("contact_force = 1.5", "contact_force = 4000.0");
    assert!(
        said.contains("soft.toml:6: the contact force is 4000 N") && said.contains("controller.toml, 150 N"),
        "{said}"
    );
    // 300 mm.
    let said = complaint("translation = 0.3", "translation = 300.0");
    assert!(
        said.contains("soft.toml:7: the maximum deviation is 300; ") && said.contains("at most 1 m"),
        "{said}"
    );
    // An arm of a third of the size.
    let mut model = model("arm7");
    for joint in &mut model.joints {
        joint.origin.translation = joint.origin.translation.map(|length| length / 3.0);
    }
    model.chains[0].tip.translation = model.chains[0].tip.translation.map(|length| length / 3.0);
    let text = SOFT.replace("translation = 0.3", "translation = 0.6");
    let (settings, findings) = check(Path::new("own.toml"), &text, &model);
    let said = findings.iter().map(ToString::to_string).collect::<String>();
    assert!(settings.is_none() && said.contains("own.toml:7: max_deviation: translation is 0.6 m"), "{said}");
    assert!(said.contains("of arm7, 0.22"), "{said}");
}

#[test]
fn settings_in_other_units_and_without_damping_are_doubtful() {
    let model = model("arm7");
    assert_eq!(doubts(SOFT, &model), [""; 0]);
    let cases = [
        (
            "damping = { translation = 30.0",
            "damping = { translation = 0.0",
            "own.toml:11: the damping along x is 0",
        ),
        (
            "rotation = 0.5 }        # N·s/m",
            "rotation = 0 }        # N·s/m",
            "own.toml:11: the damping about x is 0",
        ),
        // 0.3 N/mm.
        ("stiffness = { translation = 300.0", "stiffness = { translation = 0.3", "time constant of 100 s"),
        // 1500 g.
        (
            "mass = { translation = 1.5",
            "mass = { translation = 1500.0",
            "own.toml:10: the mass along x is 1500 kg",
        ),
        // 8000 kg·mm².
        ("rotation = 0.008", "rotation = 8000.0", "own.toml:10: the mass about x is 8000 kg·m²"),
    ];
    for (from, to, expected) in cases {
        assert!(SOFT.contains(from), "{from}");
        let said = doubts(&SOFT.replacen(from, to, 1), &model);
        assert!(said.iter().any(|text| text.contains(expected)), "{to}: {said:?}");
    }
    let drifting = SOFT
        .replace("damping = { translation = 30.0", "damping = { translation = 0.0")
        .replace("stiffness = { translation = 300.0", "stiffness = { translation = 0.0");
    let said = doubts(&drifting, &model);
    assert!(matches!(&said[..], [text] if text.contains("the tool drifts after a push")), "{said:?}");
    let six = include_str!("../../docs/examples/soft_six_joints.toml");
    assert_eq!(doubts(six, &ur5e()), [""; 0]);
    let said = doubts(&six.replace("contact_force = 40.0", "contact_force = 4000.0"), &ur5e());
    assert!(matches!(&said[..], [text] if text.contains("a contact is never detected")), "{said:?}");
}

/// What is said of the soft impedance with this stiffness matrix: `change` of 300 and 16 on its diagonal.
fn said_of_matrix(change: impl Fn(&mut [[f32; 6]; 6])) -> Result<ImpedanceSettings, String> {
    let mut matrix = [[0.0; 6]; 6];
    (0..6).for_each(|axis| matrix[axis][axis] = if axis < 3 { 300.0 } else { 16.0 });
    change(&mut matrix);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("soft.toml");
    let text =
        SOFT.replace("{ translation = 300.0, rotation = 16.0 }", &format!("{{ matrix = {matrix:?} }}"));
    std::fs::write(&path, text).unwrap();
    load(&path, &model("arm7")).map_err(|error| error.to_string())
}

#[test]
fn a_matrix_may_couple_the_axes() {
    let settings = said_of_matrix(|_| {}).unwrap();
    assert_eq!(settings.impedance.coupling, None, "a diagonal matrix is the cheap form");
    // As NumPy prints some zeros.
    assert_eq!(said_of_matrix(|k| k[3][1] = -0.0).unwrap().impedance.coupling, None);
    let settings =
        said_of_matrix(|k| (k[0][1], k[1][0], k[5][2], k[2][5]) = (100.0, 100.0, -7.0, -7.0)).unwrap();
    let coupling = settings.impedance.coupling.unwrap();
    // The last row begins at 10.
    assert_eq!((coupling.stiffness[0], coupling.stiffness[12], coupling.mass), (100.0, -7.0, [0.0; 15]));
    let said = said_of_matrix(|k| k[3][1] = 1.0).unwrap_err();
    assert!(
        said.contains(
            "soft.toml:12: the stiffness matrix is not symmetric: row 4, column 2 is 1, row 2, column 4 is 0"
        ),
        "{said}"
    );
    let said = said_of_matrix(|k| (k[0][1], k[1][0]) = (400.0, 400.0)).unwrap_err();
    assert!(
        said.contains(
            "soft.toml:12: the stiffness matrix is not positive semi-definite: its pivot along y is -233"
        ),
        "{said}"
    );
    let said = complaint("damping = { translation = 30.0, ", "damping = { ");
    assert!(said.contains("soft.toml:11: damping: expected translation and rotation, or matrix"), "{said}");
}

#[test]
fn the_direct_law_has_options() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("soft.toml");
    let text = SOFT.replace(
        "law = \"model-following\"",
        "law = \"direct\"\naxes = \"tool\"\ndirect = { friction = 0.5, driven_term = false }",
    );
    std::fs::write(&path, &text).unwrap();
    let settings = load(&path, &model("arm7")).unwrap();
    let options = DirectLaw { friction: 0.5, driven_term: false, null_space_damping: true };
    assert_eq!((settings.law, settings.impedance.axes), (Law::Direct(options), ImpedanceAxes::Tool));
    std::fs::write(&path, text.replace("0.5, driven", "1.5, driven")).unwrap();
    let said = load(&path, &model("arm7")).unwrap_err().to_string();
    let expected = "soft.toml:4: the compensated fraction of the friction is 1.5; it must be from 0 to 1";
    assert!(said.contains(expected), "{said}");
    let said = complaint("force = \"sensor\"", "direct = { friction = 0.5 }\nforce = \"sensor\"");
    assert!(said.contains("soft.toml:5: direct: only `law = \"direct\"` has these options"), "{said}");
}

#[test]
fn other_mistakes_are_told_with_line_and_key() {
    let said = complaint("contact_force =", "contact_froce =");
    assert!(said.contains("contact_froce") && said.contains("soft.toml:6: "), "{said}");
    let said = complaint("\"arm-angle\"", "\"elbow\"");
    assert!(said.contains("elbow") && said.contains("arm-angle") && said.contains("soft.toml:3: "), "{said}");
    let said = complaint("translation = 300.0", "translation = [300.0, 300.0]");
    assert!(said.contains("expected a number, or three: for x, y and z"), "{said}");
    let said = complaint("elbow_bandwidth = 12.0 ", "");
    assert!(said.contains("elbow_bandwidth") || said.contains("expected"), "{said}");
    let missing = load(Path::new("nowhere/soft.toml"), &model("arm7")).unwrap_err().to_string();
    assert!(missing.starts_with("cannot read nowhere/soft.toml: "), "{missing}");
}

#[test]
fn the_arms_own_mass_is_that_of_pinocchio() {
    const MASSES: &[([f64; 7], [f64; 3])] = include!("../../tests/oracles/data/own_mass.in");
    let model = model("arm7");
    for (angles, expected) in MASSES {
        let own = own_mass_at(&model, &angles.map(|angle| angle as f32), ImpedanceAxes::Base);
        for (own, expected) in own.iter().zip(expected) {
            assert!((f64::from(*own) / expected - 1.0).abs() < 1e-3, "{angles:?}: {own} {expected}");
        }
    }
    // With the elbow at 90° the tool's z points along the base's −x.
    let tool = own_mass_at(&model, &[0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0, 0.0], ImpedanceAxes::Tool);
    assert!((f64::from(tool[2]) / MASSES[0].1[0] - 1.0).abs() < 1e-3, "{tool:?}");
    // A stretched arm has no bound along itself: five times the mean counts.
    let straight = own_mass_at(&model, &[0.0; 7], ImpedanceAxes::Base);
    assert!(straight[2] > 3.5 && straight[2] < 5.0, "{straight:?}");
}

#[test]
fn a_mass_far_below_the_arms_own_is_refused() {
    let (mass, damping) =
        ("translation = 1.5, rotation = 0.008 }          # kg, kg·m²\n", "damping = { translation = 30.0");
    let said = complaint(
        &format!("{mass}{damping}"),
        &format!("{}{}", mass.replace("1.5", "0.2"), damping.replace("30.0", "10.0")),
    );
    assert!(said.contains("the mass along x is 0.2 kg and the arm's own there 0.93"), "{said}");
    let least = said.split("take at least ").nth(1).and_then(|rest| rest.split(" kg").next()).unwrap();
    assert!(least.trim_start_matches("0.").len() <= 4, "three digits: {said}");
    assert!(said.contains("take at least") && said.contains("soft.toml:"), "{said}");
}
