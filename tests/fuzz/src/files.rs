//! The other files that users write: grasps, impedances, calibrations.

use std::io::Write;

use tempfile::NamedTempFile;
use tesaki::protocol::Request;
use tesaki::task::grasping::GraspCommand;
use tesaki::task::impedance::ImpedanceCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_description::calibration::{Calibration, CalibrationFile};
use tesaki_description::{grasp, impedance};
use tesaki_tests::robot_folder;

use crate::node::machine::{follow, machines};
use crate::node::rig::Rig;

/// Runs an input, whose first byte says what the text after it is.
pub fn run(data: &[u8]) {
    let Some((kind, text)) = data.split_first() else { return };
    let file = write(text);
    match kind % 3 {
        0 => match grasp::load_placed(file.path()) {
            Err(error) => assert!(!error.to_string().is_empty()),
            Ok(placed) => {
                placed.plan.validate().expect("an accepted grasp is valid");
                let command = TaskCommand::Grasping(GraspCommand::Grasp(placed.plan));
                try_on(&mut machines()[0].rig(false), TaskConfig::Grasping(()), command);
            }
        },
        1 => match impedance::load(file.path(), &machines()[1].model) {
            Err(error) => assert!(!error.to_string().is_empty()),
            Ok(settings) => {
                settings.validate(machines()[1].model.joints.len()).expect("accepted settings are valid");
                let command = TaskCommand::Impedance(ImpedanceCommand::Configure(settings));
                try_on(&mut machines()[1].rig(false), TaskConfig::Impedance(settings), command);
            }
        },
        _ => match Calibration::load(file.path()) {
            Err(error) => {
                assert!(!error.to_string().is_empty());
                assert!(CalibrationFile::open(file.path()).is_err(), "not a calibration, and yet opened");
            }
            Ok(calibration) => {
                let mut model = machines()[0].model.clone();
                match calibration.apply(&mut model) {
                    Err(error) => assert!(!error.to_string().is_empty()),
                    Ok(()) => model.validate().expect("a calibrated robot is valid"),
                }
                change(
                    &mut CalibrationFile::open(file.path()).expect("a calibration can be opened"),
                    &calibration,
                );
            }
        },
    }
}

/// Changes values of a calibration; the result must be a valid calibration.
fn change(file: &mut CalibrationFile, calibration: &Calibration) {
    let names = calibration.joints.keys().map(String::as_str).chain(["a new one"]);
    for name in names {
        file.set(name, "coulomb", Some((0.25, 5)), "identified");
        file.set(name, "viscous", None, "");
        file.remark(name, "on this day");
    }
    let written = write(file.to_string().as_bytes());
    let again = Calibration::load(written.path()).unwrap_or_else(|error| panic!("{error}\n{file}"));
    for joint in again.joints.values() {
        assert_eq!((joint.coulomb, joint.viscous), (Some(0.25), None), "{file}");
    }
}

/// Gives accepted values to a node, which must take or refuse them and keep its limits.
fn try_on(rig: &mut Rig, task: TaskConfig, command: TaskCommand) {
    rig.tick();
    rig.tick();
    let positions = rig.sensors.encoders.iter().map(|_| 0.3).collect();
    rig.ask(Request::Home { positions });
    rig.tare();
    rig.ask(Request::Enable(task));
    rig.ask(Request::Task(command));
    for _ in 0..20 {
        follow(rig);
        rig.ask(Request::Keep);
        rig.tick();
    }
}

/// Writes a file with this content, which is deleted when dropped.
fn write(content: &[u8]) -> NamedTempFile {
    let file = tempfile::Builder::new().prefix("tesaki-fuzz-").suffix(".toml").tempfile();
    let mut file = file.expect("there is room for temporary files");
    file.write_all(content).expect("there is room for temporary files");
    file
}

/// Returns the files that come with the robots.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = vec![
        b"\x02".to_vec(),
        b"\x02[joints.finger1_swing]  # one\ntorque_constant = 0.55000\ncoulomb = 0.02\nviscous = 0.002\n"
            .to_vec(),
        b"\x02joints = { finger1_swing = { coulomb = 0.02 }, x = {} }\n".to_vec(),
        b"\x02joints.finger1_bend.viscous = 1\njoints.\"a b\".coulomb = nan\n".to_vec(),
    ];
    for (kind, folder) in [(0, "hand3/grasps"), (1, "arm7/impedances")] {
        let files = std::fs::read_dir(robot_folder(folder)).into_iter().flatten().flatten();
        let mut paths: Vec<_> = files.map(|file| file.path()).collect();
        paths.sort();
        let texts = paths.iter().filter_map(|path| std::fs::read(path).ok());
        seeds.extend(texts.map(|text| [&[kind], &*text].concat()));
    }
    let control = "control = { wrench = { position = [1, 1], orientation = [1, 1], damping = 0.1, compensated = true } }";
    if let Some(grasp) = seeds.get(4).cloned() {
        seeds.push(
            [&grasp[..1], control.as_bytes(), b"\nfriction = 0.5\nfeedback = false\n", &grasp[1..]].concat(),
        );
    }
    let bombs = crate::large::tomls(2000);
    seeds.extend(bombs.iter().flat_map(|bomb| [0, 1, 2].map(|kind| [&[kind], bomb.as_bytes()].concat())));
    seeds
}
