//! From fits to the machine's calibration file.

use tesaki::model::{JointModel, RobotModel};
use tesaki_description::calibration::{Calibration, CalibrationFile, JointCalibration};

use super::regression::{Fit, FreeFit, NotIdentified};

/// The identified values of the joints of `model`, whose torque constants the drives used.
#[expect(clippy::cast_possible_truncation, reason = "the model is in single precision")]
pub fn identified(model: &RobotModel, fits: &[Fit]) -> Calibration {
    let joint = |(joint, fit): (&JointModel, &Fit)| {
        let gain = fit.gain.ok().map(|gain| gain.value);
        let friction = fit.friction.ok();
        let values = JointCalibration {
            torque_constant: gain.map(|gain| (gain * f64::from(joint.motor.torque_constant)) as f32),
            coulomb: friction.map(|[coulomb, _]| coulomb.value as f32),
            viscous: friction.map(|[_, viscous]| viscous.value as f32),
        };
        (joint.name.to_string(), values)
    };
    Calibration { joints: model.joints.iter().zip(fits).map(joint).collect() }
}

/// The friction of joints without load, as the board with `model` was told. A torque constant that is `known` otherwise
/// than in `model` makes another torque of the same current.
#[expect(clippy::cast_possible_truncation, reason = "the model is in single precision")]
pub fn identified_free(
    model: &RobotModel,
    fits: &[Result<FreeFit, NotIdentified>],
    known: &Calibration,
) -> Calibration {
    let joint = |(joint, fit): (&JointModel, &Result<FreeFit, NotIdentified>)| {
        let fit = fit.as_ref().ok()?;
        let torque_constant = known.joints.get(joint.name.as_str()).and_then(|known| known.torque_constant);
        let ratio = torque_constant.map_or(1.0, |constant| constant / joint.motor.torque_constant);
        let values = JointCalibration {
            torque_constant: None,
            coulomb: Some(fit.coulomb.value as f32 * ratio),
            viscous: Some(fit.viscous.value as f32 * ratio),
        };
        Some((joint.name.to_string(), values))
    };
    Calibration { joints: model.joints.iter().zip(fits).filter_map(joint).collect() }
}

/// Writes the friction of joints without load into a calibration file, with deviations. All other values remain.
pub fn update_free(
    file: &mut CalibrationFile,
    calibration: &Calibration,
    model: &RobotModel,
    fits: &[Result<FreeFit, NotIdentified>],
) {
    for (joint, fit) in model.joints.iter().zip(fits) {
        let name = joint.name.as_str();
        let (Some(values), Ok(fit)) = (calibration.joints.get(name), fit) else { continue };
        let (coulomb, viscous) = (fit.coulomb.deviation, fit.viscous.deviation);
        let value = |value: Option<f32>| value.map(|value| (value, 6));
        file.set(name, "coulomb", value(values.coulomb), &format!("N·m, ± {coulomb:.6}"));
        file.set(name, "viscous", value(values.viscous), &format!("N·m·s/rad, ± {viscous:.6}"));
    }
}

/// Writes what was identified into a calibration file, with deviations, and with reasons where a value is not
/// identified: such a joint has the value of its robot folder.
pub fn update(file: &mut CalibrationFile, calibration: &Calibration, model: &RobotModel, fits: &[Fit]) {
    for (joint, fit) in model.joints.iter().zip(fits) {
        let name = joint.name.as_str();
        let Some(values) = calibration.joints.get(name) else { continue };
        let deviation = fit.gain.map_or(0.0, |gain| gain.deviation * f64::from(joint.motor.torque_constant));
        let constant = values.torque_constant.map(|value| (value, 5));
        file.set(name, "torque_constant", constant, &format!("N·m/A, ± {deviation:.5}"));
        let [coulomb, viscous] =
            fit.friction.map_or([0.0; 2], |friction| friction.map(|part| part.deviation));
        let value = |value: Option<f32>| value.map(|value| (value, 6));
        file.set(name, "coulomb", value(values.coulomb), &format!("N·m, ± {coulomb:.6}"));
        file.set(name, "viscous", value(values.viscous), &format!("N·m·s/rad, ± {viscous:.6}"));
        let doubts = [("torque_constant", fit.gain.err()), ("friction", fit.friction.err())];
        let doubts = doubts.into_iter().filter_map(|(what, doubt)| Some((what, doubt?)));
        let doubts = doubts.map(|(what, doubt)| format!("{what} is not identified, because {doubt}"));
        file.remark(name, &doubts.collect::<Vec<_>>().join("; "));
    }
}

/// The text of a file with a first line that names the machine, replacing an earlier one.
pub fn with_head(text: &str, robot: &str, board: &str) -> String {
    let start = format!("# {robot}, board ");
    let head = format!("{start}{board}: what `tesaki identify` found of its joints, ± standard deviations.");
    match text.lines().find(|line| line.starts_with(&start)) {
        Some(earlier) => text.replacen(earlier, &head, 1),
        None => {
            let text = text.trim_start();
            format!("{head}\n# To use it: tesaki model push ROBOT --calibration THIS_FILE\n\n{text}")
        }
    }
}
