//! Laws: the shipped ones are read; what is wrong with one is said in words, with the place.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::{Path, PathBuf};

use tesaki::model::RobotModel;
use tesaki::task::impedance::{DirectLaw, Law, Redundancy};
use tesaki_description::law::arm::{Setpoint, load};
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
        assert_eq!((law.release.displacement, &law.release.damping[..]), (0.03, &[7.5, 30.0][..]));
    }
    assert_eq!((paper.follow.setpoint, ours.follow.setpoint), (Setpoint::Sample, Setpoint::Predicted));
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
