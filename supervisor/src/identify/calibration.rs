//! From fits to the machine's calibration file.

use std::fmt::Write as _;

use tesaki::model::RobotModel;
use tesaki_description::calibration::{Calibration, JointCalibration};

use super::regression::Fit;

/// The values that were identified, of the joints of `model`, whose torque constants the drives had.
#[expect(clippy::cast_possible_truncation, reason = "the model is in single precision")]
pub fn identified(model: &RobotModel, fits: &[Fit]) -> Calibration {
    let joint = |(joint, fit): (&tesaki::model::JointModel, &Fit)| {
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

/// The file's text, with the deviations and what is not identified as comments.
pub fn calibration_text(calibration: &Calibration, head: &str, model: &RobotModel, fits: &[Fit]) -> String {
    let mut text = String::new();
    for line in head.lines() {
        let _ = writeln!(text, "# {line}");
    }
    for (joint, fit) in model.joints.iter().zip(fits) {
        let Some(values) = calibration.joints.get(joint.name.as_str()) else { continue };
        let _ = writeln!(text, "\n[joints.{}]", joint.name);
        let constant = f64::from(joint.motor.torque_constant);
        match (values.torque_constant, &fit.gain) {
            (Some(value), Ok(gain)) => {
                let deviation = gain.deviation * constant;
                let _ = writeln!(text, "torque_constant = {value:.5}  # N·m/A, ± {deviation:.5}");
            }
            (_, Err(doubt)) => {
                let _ = writeln!(text, "# torque_constant is not identified, because {doubt}");
            }
            _ => {}
        }
        match (values.coulomb, values.viscous, &fit.friction) {
            (Some(coulomb), Some(viscous), Ok([c, v])) => {
                let _ = writeln!(text, "coulomb = {coulomb:.6}  # N·m, ± {:.6}", c.deviation);
                let _ = writeln!(text, "viscous = {viscous:.6}  # N·m·s/rad, ± {:.6}", v.deviation);
            }
            (_, _, Err(doubt)) => {
                let _ = writeln!(text, "# friction is not identified, because {doubt}");
            }
            _ => {}
        }
    }
    text
}
