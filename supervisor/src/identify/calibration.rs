//! Conversion of fits to the machine's calibration file.

use tesaki::model::{JointModel, RobotModel};
use tesaki_description::calibration::{Calibration, CalibrationFile, JointCalibration};

use super::regression::{Estimate, Fit, FreeFit, NotIdentified, Reading, fit_free, fit_gain};

/// Returns the identified values of the joints of `model`, whose torque constants the drives used.
#[expect(clippy::cast_possible_truncation, reason = "the model is in single precision")]
pub fn identified(model: &RobotModel, fits: &[Fit]) -> Calibration {
    let joint = |(joint, fit): (&JointModel, &Fit)| {
        let gain = fit.gain.ok().map(|gain| gain.value);
        let values = JointCalibration {
            torque_constant: gain.map(|gain| (gain * f64::from(joint.motor.torque_constant)) as f32),
            coulomb: fit.coulomb().ok().map(|coulomb| coulomb.value as f32),
            viscous: fit.viscous().ok().map(|viscous| viscous.value as f32),
        };
        (joint.name.to_string(), values)
    };
    Calibration { joints: model.joints.iter().zip(fits).map(joint).collect() }
}

/// Values of a joint found by the self-test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeJoint {
    /// Torque constant [N·m/A], if it was requested; or why it was not identified.
    pub torque_constant: Option<Result<Estimate, NotIdentified>>,
    /// Its friction, in the torque of that constant; or why it was not identified.
    pub friction: Result<FreeFit, NotIdentified>,
}

impl FreeJoint {
    /// Identifies a joint from its readings, during which the drive used the torque constant of the model.
    /// With `weighed` the model has the true masses of the links, and the torque constant is identified, too.
    /// Otherwise the machine's constant is `known` [N·m/A], if given.
    pub fn identify(joint: &JointModel, readings: &[Reading], weighed: bool, known: Option<f32>) -> Self {
        let told = f64::from(joint.motor.torque_constant);
        let scaled =
            |Estimate { value, deviation }| Estimate { value: told * value, deviation: told * deviation };
        let torque_constant = weighed.then(|| fit_gain(readings).map(scaled));
        let found = torque_constant.and_then(Result::ok).map(|found| found.value);
        let gain = found.or(known.map(f64::from)).map_or(1.0, |constant| constant / told);
        let true_torque = |r: &Reading| Reading { torque: gain * r.torque, ..*r };
        let friction = fit_free(&readings.iter().map(true_torque).collect::<Vec<_>>());
        Self { torque_constant, friction }
    }

    /// Coulomb friction [N·m], or why it was not identified.
    ///
    /// # Errors
    /// The friction is not identified, or this part is not larger than its standard deviation.
    pub fn coulomb(&self) -> Result<Estimate, NotIdentified> {
        self.friction?.coulomb.known("mN·m")
    }

    /// Viscous friction [N·m·s/rad], or why it was not identified.
    ///
    /// # Errors
    /// As [`coulomb`](Self::coulomb).
    pub fn viscous(&self) -> Result<Estimate, NotIdentified> {
        self.friction?.viscous.known("mN·m·s/rad")
    }
}

/// Returns the identified values of the joints of `model` after the self-test.
#[expect(clippy::cast_possible_truncation, reason = "the model is in single precision")]
pub fn identified_free(model: &RobotModel, found: &[FreeJoint]) -> Calibration {
    let joint = |(joint, found): (&JointModel, &FreeJoint)| {
        let constant = found.torque_constant.and_then(Result::ok);
        let values = JointCalibration {
            torque_constant: constant.map(|constant| constant.value as f32),
            coulomb: found.coulomb().ok().map(|coulomb| coulomb.value as f32),
            viscous: found.viscous().ok().map(|viscous| viscous.value as f32),
        };
        (joint.name.to_string(), values)
    };
    Calibration { joints: model.joints.iter().zip(found).map(joint).collect() }
}

/// Writes the values found by the self-test into a calibration file, with deviations. All other values
/// remain.
#[expect(clippy::cast_possible_truncation, reason = "the model is in single precision")]
pub fn update_free(file: &mut CalibrationFile, model: &RobotModel, found: &[FreeJoint]) {
    for (joint, found) in model.joints.iter().zip(found) {
        let mut set = |key: &str, Estimate { value, deviation }: Estimate, decimals: usize, unit: &str| {
            let comment = format!("{unit}, ± {deviation:.decimals$}");
            file.set(joint.name.as_str(), key, Some((value as f32, decimals)), &comment);
        };
        if let Some(Ok(constant)) = found.torque_constant {
            set("torque_constant", constant, 5, "N·m/A");
        }
        if let Ok(coulomb) = found.coulomb() {
            set("coulomb", coulomb, 6, "N·m");
        }
        if let Ok(viscous) = found.viscous() {
            set("viscous", viscous, 6, "N·m·s/rad");
        }
    }
}

/// Writes the identified values into a calibration file, with deviations, and with the reason if a value was
/// not identified: such a joint has the value of its robot folder.
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
        let doubts = fit.doubts().map(|(what, doubt)| format!("{what} is not identified, because {doubt}"));
        file.remark(name, &doubts.collect::<Vec<_>>().join("; "));
    }
}

/// Returns the board that such a first line names.
pub fn board_in_head<'a>(text: &'a str, robot: &str) -> Option<&'a str> {
    let start = format!("# {robot}, board ");
    text.lines().find_map(|line| line.strip_prefix(&start))?.split_once(':').map(|(board, _)| board)
}

/// Returns the text of a file with a first line that names the machine, replacing an earlier one.
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
