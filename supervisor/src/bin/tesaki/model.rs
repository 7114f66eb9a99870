//! `model push`, `model show`, `model check`.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::json;
use tesaki::model::RobotModel;
use tesaki_supervisor::BoardError;
use tesaki_supervisor::robot::RobotFolder;

use crate::args::Options;
use crate::failure::Failure;
use crate::output;
use crate::session::Session;

pub fn push(options: &Options, robot: &Path) -> Result<(), Failure> {
    let model = RobotFolder::load(robot)?.model;
    let mut session = Session::command(options)?;
    let node = session.push(&model)?;
    let checksum = checksum(&model)?;
    if node.model_checksum != checksum {
        return Err(Failure::Other(format!(
            "the board has model {:08x} now, sent was {checksum:08x}: push it again",
            node.model_checksum
        )));
    }
    let value =
        json!({ "robot": model.name, "joints": model.joints.len(), "checksum": format!("{checksum:08x}") });
    output::result(options, &value, || {
        format!(
            "{}: {} joints, model {checksum:08x} is in use until the next reset",
            model.name,
            model.joints.len()
        )
    })
}

/// The checksum by which board and PC know a model.
pub fn checksum(model: &RobotModel) -> Result<u32, Failure> {
    let bytes = postcard::to_stdvec(model).map_err(BoardError::Encoding)?;
    Ok(tesaki::protocol::codec::checksum(&bytes))
}

pub fn show(options: &Options) -> Result<(), Failure> {
    let mut session = Session::open(options)?;
    let model = session.model()?;
    let text = toml::to_string_pretty(&model).map_err(|error| Failure::Other(error.to_string()))?;
    output::result(options, &model, || text)
}

pub fn check(options: &Options, robot: &Path) -> Result<(), Failure> {
    let model = RobotFolder::load(robot)?.model;
    let value = json!({ "robot": model.name, "joints": model.joints.len(), "chains": model.chains.len() });
    output::result(options, &value, || {
        let mut text = String::new();
        for (number, range) in model.chain_ranges().enumerate() {
            let _ = writeln!(text, "chain {}", number + 1);
            for joint in model.joints.get(range).unwrap_or_default() {
                let _ = writeln!(
                    text,
                    "  {:<20} {:>7.3} to {:>6.3} rad, {:>6.2} rad/s, {:>6.3} N·m, link {:.1} g",
                    joint.name,
                    joint.limits.lower,
                    joint.limits.upper,
                    joint.limits.velocity,
                    joint.limits.torque,
                    joint.link.mass * 1000.0
                );
            }
        }
        let _ = write!(
            text,
            "{}: {} joints in {} chains; nothing is wrong",
            model.name,
            model.joints.len(),
            model.chains.len()
        );
        text
    })
}
