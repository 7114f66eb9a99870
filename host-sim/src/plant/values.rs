use std::collections::BTreeMap;

use serde::Deserialize;
use tesaki::model::{Encoder, JointModel, Motor};

use super::error::PlantError;
use super::object::ObjectValues;

/// The control period [s].
pub const CONTROL_PERIOD: f64 = 0.01;

/// The simulated machine as data, a robot's `plant.toml`: what neither its URDF nor its controller knows.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantValues {
    /// Acceleration of gravity in the frame of the URDF's root link [m/s²].
    pub gravity: [f64; 3],
    /// How far a plant is from the controller's model.
    pub mismatch: Mismatch,
    /// Coulomb friction of special runs.
    pub friction: FrictionSizes,
    /// The current loops.
    pub inner_loop: InnerLoop,
    /// Noise of the sensors.
    pub noise: Noise,
    /// The power supply.
    pub supply: Supply,
    /// The physics.
    pub integration: Integration,
    /// The force sensors of the fingertips, if there are any.
    #[serde(default)]
    pub force_sensor: Option<ForceSensorValues>,
    /// Where joints stand at the start, by name [rad]; 0 for a joint that is not named.
    #[serde(default)]
    pub posture: BTreeMap<String, f64>,
}

/// How far a plant is from the controller's model.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mismatch {
    /// The factors are uniform in 1 ± `spread`.
    pub spread: f64,
    /// Largest error of a joint's homing [rad].
    pub homing_error: f64,
}

/// Coulomb friction of special runs; the usual one is in the URDF.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrictionSizes {
    /// The size that the paper's results imply [N·m].
    pub paper: f64,
}

/// The current loop of a drive: first order, with a delay.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InnerLoop {
    /// Bandwidth [Hz].
    pub bandwidth: f64,
    /// From the sensors' sampling to the moment when a torque computed from them begins to act [s].
    pub delay: f64,
}

/// Standard deviations of the sensors' noise.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Noise {
    /// Motor currents [A].
    pub current: f64,
    /// Supply voltage [V].
    pub supply: f64,
}

/// The power supply.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Supply {
    /// Mean voltage [V].
    pub voltage: f64,
}

/// The physics.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Integration {
    /// Sub-step [s]; divides the control period.
    pub step: f64,
}

impl PlantValues {
    /// Reads `plant.toml` in a robot's folder.
    ///
    /// # Errors
    /// When it cannot be read, or what is wrong in it.
    pub fn load(robot: &std::path::Path) -> Result<Self, PlantError> {
        let path = robot.join("plant.toml");
        let text = std::fs::read_to_string(&path)
            .map_err(|error| PlantError::Read { path, reason: error.to_string() })?;
        Self::from_toml(&text)
    }

    /// Reads the text of a `plant.toml` and checks it.
    ///
    /// # Errors
    /// What is wrong, with line or key.
    pub fn from_toml(text: &str) -> Result<Self, PlantError> {
        let values: Self = toml::from_str(text).map_err(|error| PlantError::Syntax(error.to_string()))?;
        values.validate()?;
        Ok(values)
    }

    pub(super) fn validate(&self) -> Result<(), PlantError> {
        let error = |field: &str, value, expected| {
            Err(PlantError::Value { field: field.to_owned(), value, expected })
        };
        for value in self.gravity {
            if !value.is_finite() {
                return error("gravity", value, "finite [m/s²]");
            }
        }
        let spread = self.mismatch.spread;
        if !(0.0..1.0).contains(&spread) {
            return error("mismatch.spread", spread, "from 0 to below 1");
        }
        for (field, value) in [
            ("mismatch.homing_error", self.mismatch.homing_error),
            ("friction.paper", self.friction.paper),
            ("noise.current", self.noise.current),
            ("noise.supply", self.noise.supply),
            ("supply.voltage", self.supply.voltage),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return error(field, value, "at least 0");
            }
        }
        if let Some(sensor) = &self.force_sensor {
            sensor.validate()?;
        }
        let bandwidth = self.inner_loop.bandwidth;
        if !(bandwidth.is_finite() && bandwidth > 0.0) {
            return error("inner_loop.bandwidth", bandwidth, "above 0 [Hz]");
        }
        let step = self.integration.step;
        let steps = CONTROL_PERIOD / step;
        if !((1e-5..=CONTROL_PERIOD).contains(&step) && (steps - libm::round(steps)).abs() < 1e-6) {
            return error(
                "integration.step",
                step,
                "a whole part of the control period of 0.01 s, at least 1e-5 s",
            );
        }
        let delay = self.inner_loop.delay;
        if !(0.0..=CONTROL_PERIOD - step).contains(&delay) {
            return error("inner_loop.delay", delay, "from 0 to the control period less a sub-step [s]");
        }
        Ok(())
    }

    /// Sub-steps in a control period.
    pub(super) fn steps(&self) -> usize {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to 1000, see validate"
        )]
        let steps = libm::round(CONTROL_PERIOD / self.integration.step) as usize;
        steps
    }
}

/// Motor and encoder of a joint, as the controller knows them.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// Name of the joint in the URDF.
    pub joint: String,
    /// The motor. Bandwidth and delay are the plant's own, see [`InnerLoop`].
    pub motor: Motor,
    /// The angle sensor.
    pub encoder: Encoder,
}

impl From<&JointModel> for Drive {
    fn from(joint: &JointModel) -> Self {
        Self { joint: joint.name.as_str().to_owned(), motor: joint.motor, encoder: joint.encoder }
    }
}

/// What differs between runs on one machine.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantOptions {
    /// Decides factors, homing errors, power-on counts and noise.
    pub seed: u64,
    /// Whether masses, inertias, friction and torque constants differ from the model by seeded factors.
    pub mismatch: bool,
    /// Sensors without noise and homing without error. Counts stay whole numbers.
    pub ideal_sensors: bool,
    /// Coulomb friction of every joint instead of the URDF's [N·m].
    pub coulomb: Option<f64>,
    /// Angles at the start instead of the file's, a joint each [rad].
    pub posture: Option<Vec<f64>>,
    /// Whether something holds the joints where they are until the power stages are first switched on.
    pub held_at_start: bool,
    /// Something for the hand to grasp.
    pub object: Option<ObjectValues>,
}

impl PlantOptions {
    /// A mismatched plant with all sensor errors, held until the drives are on: what acceptance runs use.
    pub const fn mismatched(seed: u64) -> Self {
        Self {
            seed,
            mismatch: true,
            ideal_sensors: false,
            coulomb: None,
            posture: None,
            held_at_start: true,
            object: None,
        }
    }

    /// A plant as the model says, with ideal sensors, held until the drives are on.
    pub const fn exact() -> Self {
        let mut options = Self::mismatched(0);
        options.mismatch = false;
        options.ideal_sensors = true;
        options
    }
}

/// The force sensors, all alike. They are read once in a control period.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceSensorValues {
    /// Size of a count, forces [N].
    pub force_count: f64,
    /// Size of a count, torques [N·m].
    pub torque_count: f64,
    /// Where the reading saturates [N].
    pub force_range: f64,
    /// Where the reading saturates [N·m].
    pub torque_range: f64,
    /// Each axis multiplies by 1 ± at most this.
    pub gain_error: f64,
    /// Largest reading without load [N].
    pub force_offset: f64,
    /// Largest reading without load [N·m].
    pub torque_offset: f64,
    /// Standard deviation [N].
    pub force_noise: f64,
    /// Standard deviation [N·m].
    pub torque_noise: f64,
    /// They read the mean over so much time before the reading [s]; over the whole control period if it is
    /// not given.
    #[serde(default)]
    pub window: Option<f64>,
}

impl ForceSensorValues {
    pub(super) fn validate(&self) -> Result<(), PlantError> {
        let positive = [
            ("force_count", self.force_count),
            ("torque_count", self.torque_count),
            ("force_range", self.force_range),
            ("torque_range", self.torque_range),
        ];
        let others = [
            ("gain_error", self.gain_error),
            ("force_offset", self.force_offset),
            ("torque_offset", self.torque_offset),
            ("force_noise", self.force_noise),
            ("torque_noise", self.torque_noise),
        ];
        if let Some(window) = self.window
            && !(window > 0.0 && window <= CONTROL_PERIOD)
        {
            let (field, expected) = ("force_sensor.window".to_owned(), "above 0 s, at most a control period");
            return Err(PlantError::Value { field, value: window, expected });
        }
        let bad = |(_, value): &(&str, f64)| !(value.is_finite() && *value >= 0.0);
        let zero = |(_, value): &(&str, f64)| *value <= 0.0;
        match positive.into_iter().find(|item| bad(item) || zero(item)).or(others.into_iter().find(bad)) {
            None => Ok(()),
            Some((field, value)) => Err(PlantError::Value {
                field: format!("force_sensor.{field}"),
                value,
                expected: "at least 0; counts and ranges above 0",
            }),
        }
    }

    /// The value for forces on axes 0 to 2, that for torques on the others.
    pub(super) const fn of_axis(axis: usize, force: f64, torque: f64) -> f64 {
        if axis < 3 { force } else { torque }
    }

    /// What a board multiplies counts by, of each axis [N], [N·m].
    pub fn scales(&self) -> [f64; 6] {
        core::array::from_fn(|axis| Self::of_axis(axis, self.force_count, self.torque_count))
    }
}
