//! Robot folders: `robot.urdf`, `controller.toml` and `plant.toml` as users write them.

use std::path::Path;

use tesaki::control::ServoMode;
use tesaki::node::Node;
use tesaki::protocol::{Reply, Request};
use tesaki::task::TaskConfig;
use tesaki_description::init::{InitOptions, robot_texts};
use tesaki_description::robot::{RobotFolder, chain_model};
use tesaki_description::urdf::Urdf;
use tesaki_tests::{robot_folder, set_up, zero_sensors};

use crate::large;
use crate::node::machine::{follow, minimal};
use crate::node::rig::Rig;

/// Separates the texts of a folder.
const SEPARATOR: char = '\u{1e}';

/// Texts longer than this [bytes] are not read in every way, because that is slow.
const SHORT: usize = 2000;

/// Runs an input, whose first byte says what the text after it is: a URDF, settings, a plant, a URDF for
/// which a folder is written, or all three files. The other files are those of the one-joint robot.
pub fn run(data: &[u8]) {
    let Some((kind, text)) = data.split_first() else { return };
    let text = String::from_utf8_lossy(text);
    let base = minimal();
    match kind % 5 {
        0 => urdf(&text),
        1 => folder(&base.urdf, &text, Some(&base.plant)),
        2 => folder(&base.urdf, &base.controller, Some(&text)),
        3 => init(&text),
        _ => {
            let mut texts = text.splitn(3, SEPARATOR);
            let (urdf, settings) = (texts.next().unwrap_or_default(), texts.next().unwrap_or_default());
            folder(urdf, settings, texts.next());
        }
    }
}

/// Reads a URDF, with every path in it.
fn urdf(text: &str) {
    let path = Path::new("robot.urdf");
    let (urdf, findings) = Urdf::check(path, text);
    findings.iter().for_each(|finding| drop(finding.to_string()));
    assert!(urdf.is_some() || !findings.is_empty(), "no robot, and no reason");
    Urdf::impossible_inertias(path, text);
    let Some(urdf) = urdf else { return };
    for tip in urdf.tips(None) {
        match urdf.path(None, tip) {
            Err(error) => drop(error.to_string()),
            Ok(path) => {
                let angles = path.angles(&vec![0.1; path.drives.len()]);
                let chain = path.chain();
                let _ = (chain.posture(&angles).tip(), chain.mass_matrix(&angles));
            }
        }
    }
    // Settings of another robot: every difference is reported.
    if text.len() < SHORT {
        folder(text, &minimal().controller, None);
    }
}

/// Writes the settings of a URDF, and checks that they can be read.
fn init(text: &str) {
    let options = InitOptions { accept_inertia: vec!["all".to_owned()], ..InitOptions::default() };
    for options in [InitOptions::default(), options] {
        match robot_texts(Path::new("robot.urdf"), text, &options) {
            Ok(texts) => return folder(&texts.urdf, &texts.controller, Some(&texts.plant)),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
}

/// Checks that a folder is either a robot, which a node takes and ticks, or gives an error.
fn folder(urdf: &str, settings: &str, plant: Option<&str>) {
    let (folder, findings) = RobotFolder::check_all(Path::new("robot"), urdf, settings, plant);
    findings.iter().for_each(|finding| drop(finding.to_string()));
    let Some(folder) = folder else {
        return assert!(findings.iter().any(|finding| finding.is_error()), "no robot, and no error");
    };
    if urdf.len() < SHORT {
        let parsed = RobotFolder::parse(Path::new("robot"), urdf, settings).expect("it has no error");
        let encoded = |folder: &RobotFolder| postcard::to_stdvec(&folder.model).expect("it has an encoding");
        assert_eq!(encoded(&folder), encoded(&parsed), "read twice, it is another robot");
    }
    let model = folder.model;
    model.validate().expect("an accepted robot is valid");
    let chains = (0..model.chains.len()).filter_map(|index| chain_model(&model, index));
    chains.for_each(|chain| chain.validate().expect("a chain of a valid robot is valid"));
    let mut rig = Rig::new(&Node::new(), 0, zero_sensors(&model, 0), false);
    for request in set_up(&model) {
        let reply = rig.ask(request);
        assert!(!matches!(reply, Reply::Refused(_)), "a node refuses an accepted robot: {reply:?}");
    }
    let middle = (model.safety.supply_min + model.safety.supply_max) * 500.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    let supply = middle as u16;
    rig.sensors.supply = supply;
    rig.tick();
    rig.tick();
    let positions =
        model.joints.iter().map(|joint| joint.limits.lower.midpoint(joint.limits.upper)).collect();
    rig.ask(Request::Home { positions });
    rig.ask(Request::Enable(TaskConfig::JointServo(ServoMode::Observer)));
    for _ in 0..20 {
        follow(&mut rig);
        rig.ask(Request::Keep);
        rig.tick();
    }
    rig.finish();
}

/// Returns the files of all robots, and those of the one-joint robot damaged in the known ways.
pub fn seeds() -> Vec<Vec<u8>> {
    let base = minimal();
    let mut seeds = vec![
        text(0, &base.urdf),
        text(1, &base.controller),
        text(2, &base.plant),
        text(3, &base.urdf),
        all(&base.urdf, &base.controller, &base.plant),
    ];
    for name in ["hand3", "arm7"] {
        let read = |file: &str| std::fs::read_to_string(robot_folder(name).join(file)).unwrap_or_default();
        let (urdf, settings, plant) = (read("robot.urdf"), read("controller.toml"), read("plant.toml"));
        seeds.extend([text(0, &urdf), text(1, &settings), text(2, &plant), text(3, &urdf)]);
        seeds.push(all(&urdf, &settings, &plant));
    }
    let tree = robot_folder("../tests/robots");
    for name in ["robotiq_2f85", "abb_irb140", "kinova_j2s6s200"] {
        let urdf = std::fs::read_to_string(tree.join(name).with_extension("urdf")).unwrap_or_default();
        if urdf.len() < crate::MAX_TEXT {
            seeds.extend([text(0, &urdf), text(3, &urdf)]);
        }
    }
    seeds.extend(large::urdfs(crate::MAX_TEXT / 2).iter().map(|bomb| text(0, bomb)));
    seeds.extend(large::tomls(crate::MAX_TEXT / 2).iter().flat_map(|bomb| [text(1, bomb), text(2, bomb)]));
    seeds
}

fn text(kind: u8, text: &str) -> Vec<u8> {
    [&[kind], text.as_bytes()].concat()
}

fn all(urdf: &str, settings: &str, plant: &str) -> Vec<u8> {
    text(4, &[urdf, settings, plant].join(&SEPARATOR.to_string()))
}
