//! `model push`, `model show`.

use std::path::Path;

use serde_json::json;
use tesaki::model::RobotModel;
use tesaki_description::calibration::Calibration;
use tesaki_description::finding::{Finding, Matter, Severity};
use tesaki_description::read_text;
use tesaki_description::robot::{RobotFolder, chain_model};
use tesaki_supervisor::{Board as _, BoardError};

use crate::args::Options;
use crate::board_session::{BoardSession, notice_unhomed, notice_untared};
use crate::check;
use crate::doctor::{mismatch, sensor_frame};
use crate::failure::Failure;
use crate::output;
use crate::parameter;

/// The text of the folder's URDF.
pub fn urdf_text(folder: &RobotFolder) -> Result<String, Failure> {
    let path = folder.path.join("robot.urdf");
    read_text(&path).map_err(Failure::file(path))
}

pub fn push(
    options: &Options,
    robot: &Path,
    chain: Option<&str>,
    calibration: Option<&Path>,
) -> Result<(), Failure> {
    let (folder, mut warnings) = RobotFolder::load_plausible(robot, None)?;
    let mut model = folder.model;
    let calibration = calibration.map(|path| calibrated(&mut model, path, &mut warnings)).transpose()?;
    if let Some(tip) = chain {
        let index = model.chains.iter().position(|chain| chain.name == tip);
        model = index.and_then(|index| chain_model(&model, index)).ok_or_else(|| {
            let names: Vec<&str> = model.chains.iter().map(|chain| chain.name.as_str()).collect();
            Failure::Usage(format!("{} has no tip {tip:?}; its tips are {}", model.name, names.join(", ")))
        })?;
    }
    let mut session = BoardSession::command(options)?;
    let old = session.board.model_if_there()?;
    let replaced = old.as_ref().filter(|old| old.name != model.name).map(|old| old.name.to_string());
    if let Some(replaced) = &replaced {
        let name = &model.name;
        output::notice(
            options,
            &format!("the board has the model of {replaced}: that of {name} replaces it"),
        );
    }
    let mut tared = match old {
        Some(old) => session.tared(&old)?,
        None => Vec::new(),
    };
    let has_sensor = |name: &String| {
        model.chains.iter().any(|chain| chain.name == name.as_str() && chain.force_sensor.is_some())
    };
    tared.retain(has_sensor);
    let was_homed = session.board.status()?.node.homed != 0;
    let node = session.board.push_model_and_sense(&model)?;
    let checksum = checksum(&model)?;
    if node.model_checksum != checksum {
        return Err(Failure::Other(format!(
            "the board has model {:08x} instead of {checksum:08x}: push it again",
            node.model_checksum
        )));
    }
    // What the board gets from its machine is no reason not to push.
    let sensors = sensor_frame(&mut session.board).ok().flatten();
    let mismatch = sensors.and_then(|sensors| mismatch(&sensors, &model));
    let (name, joints) = (&model.name, model.joints.len());
    let uncalibrated = calibration.map(|calibration| calibration.missing(&model));
    let checksum = format!("{checksum:08x}");
    let unhomed = (0..)
        .zip(&model.joints)
        .filter(|(index, joint)| was_homed && joint.encoder.relative && node.homed >> index & 1 == 0);
    let unhomed: Vec<String> = unhomed.map(|(_, joint)| joint.name.to_string()).collect();
    let mut value = json!({
        "robot": name, "joints": joints, "checksum": checksum, "no_longer_tared": tared,
        "no_longer_homed": unhomed, "warnings": warnings.iter().map(check::object).collect::<Vec<_>>(),
        "replaced": replaced, "mismatch": mismatch,
    });
    if let Some(uncalibrated) = &uncalibrated {
        value["uncalibrated"] = json!(uncalibrated);
    }
    output::result(options, &value, || {
        let calibrated = match uncalibrated.as_deref() {
            None => String::new(),
            Some([]) => ", all in the calibration".to_owned(),
            Some(missing) => {
                let missing = missing.join(", ");
                format!(", with the values of the robot's folder where the calibration has none: {missing}")
            }
        };
        let joints = output::counted(joints, "joint");
        format!("{name}: {joints}{calibrated}; model {checksum} is in use until the next reset")
    })?;
    for warning in &warnings {
        output::notice(options, &format!("warning: {warning}"));
    }
    if let Some(mismatch) = mismatch {
        output::notice(options, &format!("warning: {mismatch}: push the model of this machine"));
    }
    notice_unhomed(options, &unhomed);
    notice_untared(options, "this pushed the model", &tared);
    Ok(())
}

/// Puts the values of a calibration file into the model, and what is not likely about them into the
/// warnings.
fn calibrated(
    model: &mut RobotModel,
    path: &Path,
    warnings: &mut Vec<Finding>,
) -> Result<Calibration, Failure> {
    let calibration = Calibration::load(path)?;
    let folder = model.clone();
    let applied = calibration.apply(model);
    applied.map_err(|source| Failure::Calibration { path: path.to_owned(), source })?;
    let mut doubts = parameter::doubtful(&folder, model, None, &[]);
    for (old, new) in folder.joints.iter().zip(&model.joints) {
        let (old, constant) = (old.motor.torque_constant, new.motor.torque_constant);
        if !(0.5..=2.0).contains(&(constant / old)) {
            doubts.push(format!(
                "{}: torque_constant = {constant} N·m/A is far from the folder's {old}: is it that of the joint, \
                 with the gear, and of this robot?",
                new.name
            ));
        }
    }
    warnings.extend(doubts.into_iter().map(|message| Finding {
        severity: Severity::Warning,
        matter: Matter::Dynamics,
        path: path.to_owned(),
        line: None,
        message,
        advice: String::new(),
    }));
    Ok(calibration)
}

/// The checksum that identifies a model.
pub fn checksum(model: &RobotModel) -> Result<u32, Failure> {
    let bytes = postcard::to_stdvec(model).map_err(BoardError::Encoding)?;
    Ok(tesaki::protocol::codec::checksum(&bytes))
}

pub fn show(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::open(options)?;
    let model = session.model()?;
    let text = toml::to_string_pretty(&model).map_err(|error| Failure::Other(error.to_string()))?;
    output::result(options, &model, || text)
}
