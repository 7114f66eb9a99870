//! Laws: the shipped ones are read; what is wrong with one is said in words, with the place.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::{Path, PathBuf};

use tesaki::model::RobotModel;
use tesaki::task::impedance::{DirectLaw, Law, Redundancy};
use tesaki_description::law::arm::{ArmLaw, PushExperiment, Setpoint, check, load};
use tesaki_description::robot::RobotFolder;

const PAPER: &str = include_str!("../../robots/arm7/laws/paper.toml");

fn arm7() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7")
}

fn model() -> RobotModel {
    RobotFolder::load(&arm7()).unwrap().model
}

/// What is said of the paper's law with `from` replaced by `to`, after the name of the file.
#[track_caller]
fn complaint(from: &str, to: &str) -> String {
    assert!(PAPER.contains(from), "{from}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("paper.toml");
    std::fs::write(&path, PAPER.replacen(from, to, 1)).unwrap();
    let said = load(&path, &model()).unwrap_err().to_string();
    said.strip_prefix(&format!("{}:", path.display())).unwrap_or_else(|| panic!("{said}")).to_owned()
}

/// The line of the paper's law that begins with `key`, in a section.
fn line(section: &str, key: &str) -> usize {
    let lines = || (1..).zip(PAPER.lines());
    let (start, _) = lines().find(|(_, line)| line.starts_with(section)).unwrap();
    lines().find(|(number, line)| *number > start && line.starts_with(key)).unwrap().0
}

#[test]
fn the_shipped_laws_are_read() {
    let model = model();
    let law = |name: &str| load(&arm7().join(format!("laws/{name}.toml")), &model).unwrap();
    let (paper, ours) = (law("paper"), law("tesaki"));
    let driven = Redundancy::DrivenJoint { joint: 2 };
    assert_eq!((paper.settings.law, paper.settings.redundancy), (Law::Direct(DirectLaw::PRINTED), driven));
    assert_eq!((ours.settings.law, ours.settings.redundancy), (Law::ModelFollowing, driven));
    // The paper's numbers, in both.
    for law in [&paper, &ours] {
        let impedance = law.with_damping(7.5).impedance;
        assert_eq!((impedance.mass[0], impedance.damping[1], impedance.stiffness[2]), (1.5, 7.5, 300.0));
        let release = law.release.as_ref().unwrap();
        assert_eq!((release.displacement, &release.damping[..]), (0.03, &[7.5, 30.0][..]));
    }
    let setpoint = |law: &ArmLaw| law.follow.as_ref().unwrap().setpoint;
    assert_eq!((setpoint(&paper), setpoint(&ours)), (Setpoint::Sample, Setpoint::Predicted));
    // The other laws differ from the paper's in what their names say.
    let options = |name| match law(name).settings.law {
        Law::Direct(options) => options,
        Law::ModelFollowing => panic!("{name}"),
    };
    assert_eq!(options("paper-without-friction"), DirectLaw { friction: 0.0, ..DirectLaw::PRINTED });
    assert_eq!(options("corrected"), DirectLaw { driven_term: true, ..DirectLaw::PRINTED });
    let pseudo_inverse = law("pseudo-inverse").settings;
    assert_eq!(pseudo_inverse.redundancy, Redundancy::None);
    assert_eq!(options("pseudo-inverse"), DirectLaw::PRINTED);
}

#[test]
fn what_is_wrong_is_said_with_line_and_key() {
    let said = complaint("stiffness = { translation = 300.0", "stiffness = { translation = -300.0");
    let expected = format!("{}: the stiffness along x is -300 N/m", line("[control]", "stiffness"));
    assert!(said.contains(&expected), "{said}");
    let said = complaint("curve = [3.75,", "curve = [3.75, 200.0,");
    let expected = format!("{}: follow.curve: the damping along x is 200 N·s/m", line("[follow]", "curve"));
    assert!(said.starts_with(&expected), "{said}");
    let said = complaint("damping = [7.5, 30.0]", "damping = []");
    let expected =
        format!("{}: release.damping has 0 values; possible are 1 to 16", line("[release]", "damping"));
    assert!(said.starts_with(&expected), "{said}");
    let said = complaint("amplitude = 0.1 ", "amplitude = 0.2 ");
    let expected =
        format!("{}: follow.amplitude is 0.2 m; the range is 0.001 to 0.12 m", line("[follow]", "amplitude"));
    assert!(said.starts_with(&expected), "{said}");
    let said = complaint("loss = 0.02", "loss = 0.9");
    let expected = format!("{}: follow.link.loss is 0.9; the range is 0 to 0.5", line("[follow]", "link"));
    assert!(said.starts_with(&expected), "{said}");
    let said = complaint("driven = \"shoulder_yaw\"", "driven = \"yaw\"");
    assert!(said.contains("arm7 has no joint \"yaw\""), "{said}");
    let said = complaint("[elbow]", "[elbows]");
    assert!(said.contains("elbows"), "{said}");
    let said = complaint("setpoint = \"sample\"", "setpoint = \"last\"");
    assert!(
        said.starts_with(&format!("{}: ", line("[follow]", "setpoint"))) && said.contains("sample"),
        "{said}"
    );
}

#[test]
fn experiments_have_the_values_that_the_paper_does_not_state_unless_the_law_does() {
    let law = |text: &str| check(Path::new("own.toml"), text, &model()).0.unwrap();
    let paper = law(PAPER);
    // The paper's law states them all, this one none.
    let short = load(&arm7().join("laws/corrected.toml"), &model()).unwrap();
    assert_eq!(short.follow, paper.follow);
    assert_eq!((short.release, short.elbow), (paper.release, paper.elbow));
    let matched = load(&arm7().join("laws/matched.toml"), &model()).unwrap();
    assert_eq!(matched.bilateral, paper.bilateral);
    // 6 N in eight directions.
    assert_eq!(short.push, PushExperiment::default());
    assert_eq!(short.push.forces.len(), 8);
    assert!(short.push.forces.iter().all(|[x, y, z]| (x.hypot(*y) - 6.0).abs() < 1e-12 && z.abs() < 1e-12));
    let own = PAPER
        .replacen("delays = [0.0, 0.02, 0.05]", "delays = [0.1]", 1)
        .replacen("stiffness = 2000.0, damping = 20.0", "stiffness = 500.0", 1)
        .replacen("[-6.0, 0.0, 0.0]", "[0.0, 0.0, 3.0]", 1)
        .replacen("duration = 6.0", "duration = 4.0", 1);
    let own = law(&own);
    let (follow, bilateral) = (own.follow.unwrap(), own.bilateral.unwrap());
    assert_eq!((follow.duration, follow.rest), (4.0, 2.0));
    assert_eq!(
        (bilateral.delays, bilateral.wall.stiffness, bilateral.wall.damping),
        (vec![0.1], 500.0, 20.0)
    );
    assert_eq!(own.push.forces.get(2), Some(&[0.0, 0.0, 3.0]));
}

#[test]
fn what_is_wrong_with_an_experiment_is_said_with_line_and_key() {
    for (from, to, section, key, said) in [
        (
            "stiffness = 2000.0",
            "stiffness = 1.0",
            "[bilateral]",
            "wall",
            "bilateral.wall.stiffness is 1 N/m; the range is 10 to 100000 N/m",
        ),
        (
            "force = [0.0, 2.0,",
            "force = [0.0, nan,",
            "[bilateral]",
            "push",
            "bilateral.push.force is NaN N; the range is -30 to 30 N",
        ),
        (
            "point = [0.1,",
            "point = [inf,",
            "[bilateral]",
            "push",
            "bilateral.push.point is inf m; the range is -0.5 to 0.5 m",
        ),
        ("rest = 2.0", "rest = -1.0", "[follow]", "rest", "follow.rest is -1 s; the range is 0.1 to 60 s"),
        (
            "forces = [[6.0,",
            "forces = [[nan,",
            "[push]",
            "forces",
            "push.forces is NaN N; the range is -30 to 30 N",
        ),
        (
            "evaluated = 0.3",
            "evaluated = 3.0",
            "[push]",
            "evaluated",
            "push.evaluated is 3 s; the range is 0.01 to 1.7 s",
        ),
    ] {
        assert!(PAPER.contains(from), "{from}");
        let text = PAPER.replacen(from, to, 1);
        let (law, findings) = check(Path::new("own.toml"), &text, &model());
        let lines = || (1..).zip(text.lines());
        let (start, _) = lines().find(|(_, line)| line.starts_with(section)).unwrap();
        let line = lines().find(|(number, line)| *number > start && line.starts_with(key)).unwrap().0;
        let told: Vec<String> = findings.iter().map(ToString::to_string).collect();
        assert!(law.is_none() && told.len() == 1, "{to}: {told:?}");
        assert!(told[0].starts_with(&format!("own.toml:{line}: {said}")), "{to}: {told:?}");
    }
}

#[test]
fn matrices_that_are_not_symmetric_or_not_positive_definite_are_named() {
    let text = std::fs::read_to_string(arm7().join("laws/coupled.toml")).unwrap();
    for (from, to, key, said) in [
        ("[2.5, -0.5,", "[2.5, 0.5,", "mass", "the mass matrix is not symmetric: row 2, column 1 is -0.5"),
        (
            "-300.0",
            "-600.0",
            "stiffness",
            "the stiffness matrix is not positive semi-definite: its pivot along y",
        ),
    ] {
        let changed = if key == "mass" { text.replacen(from, to, 1) } else { text.replace(from, to) };
        assert_ne!(text, changed);
        let (law, findings) = check(Path::new("own.toml"), &changed, &model());
        let line = 1 + changed.lines().position(|line| line.starts_with(key)).unwrap();
        let told: Vec<String> = findings.iter().map(ToString::to_string).collect();
        assert!(law.is_none() && told[0].starts_with(&format!("own.toml:{line}: {said}")), "{to}: {told:?}");
    }
    let released = format!("{text}\n[release]\ndisplacement = 0.03\ndamping = [50.0]\n");
    let (law, findings) = check(Path::new("own.toml"), &released, &model());
    let line = 1 + released.lines().position(|line| line == "[release]").unwrap();
    let told: Vec<String> = findings.iter().map(ToString::to_string).collect();
    let expected = format!("own.toml:{line}: release: its theory is that of a single axis");
    assert!(law.is_none() && told[0].starts_with(&expected), "{told:?}");
    // It has none of the experiments of the figures.
    let law = check(Path::new("own.toml"), &text, &model()).0.unwrap();
    assert!(law.release.is_none() && law.follow.is_none() && law.elbow.is_none() && law.bilateral.is_none());
}

#[test]
fn a_law_of_an_arm_is_none_of_a_hand() {
    let hand = RobotFolder::load(&arm7().join("../hand3")).unwrap().model;
    let said = load(&arm7().join("laws/paper.toml"), &hand).unwrap_err().to_string();
    assert!(
        said.ends_with(
            "laws/paper.toml: a law of an arm; the robot has 3 chain(s): run it with a robot that it is for"
        ),
        "{said}"
    );
}
