//! What the tests that cross the crates of tesaki share; they live in `tests/`.
#![allow(clippy::unwrap_used, reason = "tests")]

mod rig;

use std::path::{Path, PathBuf};
use std::process::Command;

use tesaki::model::RobotModel;
use tesaki::protocol::codec::checksum;
use tesaki::protocol::{MODEL_CHUNK, Request, SCHEMA_KEY, SensorFlags, SensorFrame};
use tesaki_description::robot::RobotFolder;

pub use rig::Rig;

/// The folder of a robot that comes with tesaki.
pub fn robot_folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(name)
}

/// A robot that comes with tesaki.
pub fn robot(name: &str) -> RobotFolder {
    RobotFolder::load(&robot_folder(name)).unwrap()
}

/// What a client asks until it commands a node that has this model.
pub fn set_up(model: &RobotModel) -> Vec<Request> {
    let bytes = postcard::to_stdvec(model).unwrap();
    let length = u32::try_from(bytes.len()).unwrap();
    let mut requests = vec![
        Request::Hello { schema: SCHEMA_KEY },
        Request::TakeCommand { by_force: false },
        Request::ModelBegin { length, checksum: checksum(&bytes) },
    ];
    for (offset, data) in (0..).step_by(MODEL_CHUNK).zip(bytes.chunks(MODEL_CHUNK)) {
        requests.push(Request::ModelChunk { offset, data: heapless::Vec::from_slice(data).unwrap() });
    }
    requests.push(Request::ModelCommit);
    requests
}

/// Sensors that read zero in tick 0; `supply` [mV].
pub fn zero_sensors(model: &RobotModel, supply: u16) -> SensorFrame {
    SensorFrame {
        sequence: 0,
        flags: SensorFlags(0),
        supply,
        encoders: model.joints.iter().map(|_| 0).collect(),
        currents: model.joints.iter().map(|_| 0).collect(),
        forces: model.chains.iter().filter_map(|chain| chain.force_sensor).map(|_| [0; 6]).collect(),
    }
}

/// The program `tesaki`, see [`program`].
pub fn tesaki() -> Command {
    program("tesaki")
}

/// A program of the workspace, as cargo built it with the running test: cargo tells its path only to tests
/// of its own package.
///
/// # Panics
/// The program is not there: it is built by `cargo test`, not by `cargo test -p tesaki-tests`.
pub fn program(name: &str) -> Command {
    let test = std::env::current_exe().unwrap_or_default();
    // The test is in the folder `deps` beside the program.
    let folder = test.parent().and_then(Path::parent).unwrap_or(&test);
    let program = folder.join(name).with_extension(std::env::consts::EXE_EXTENSION);
    assert!(
        program.is_file(),
        "{} is missing: run `cargo build` with the same profile first",
        program.display()
    );
    Command::new(program)
}
