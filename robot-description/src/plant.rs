//! `plant.toml`: the simulated machine, as far as neither URDF nor controller know it.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use crate::file::{self, FileError, in_words};
use crate::finding::{Finding, Report};

/// The control period [s]: [`tesaki::TICK`] in double precision.
pub const CONTROL_PERIOD: f64 = 0.01;
/// The same [ns].
pub const CONTROL_PERIOD_NS: u64 = 10_000_000;

#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "rounding is meant")]
const _: () = {
    assert!((CONTROL_PERIOD as f32).to_bits() == tesaki::TICK.to_bits());
    assert!((CONTROL_PERIOD * 1e9).to_bits() == (CONTROL_PERIOD_NS as f64).to_bits());
};

const ADVICE: &str = "docs/bring-your-own-hand.md has a complete plant.toml; `tesaki model init` writes one";

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
    /// Stiffness between motor and link of each joint, by name [N·m/rad]; a joint that is not named is rigid.
    #[serde(default)]
    pub elasticity: BTreeMap<String, f64>,
    /// The linkages that move mimic joints.
    #[serde(default)]
    pub linkage: LinkageValues,
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

/// A linkage, as a spring with damping at the joint that follows.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkageValues {
    /// Stiffness [N·m/rad].
    pub stiffness: f64,
    /// Damping [N·m·s/rad].
    pub damping: f64,
}

impl Default for LinkageValues {
    /// For the fingers of a hand: 500 rad/s with 2e-5 kg·m², and a quarter of the critical damping. A finger
    /// of 40 g bends it by 3 mrad.
    fn default() -> Self {
        Self { stiffness: 5.0, damping: 5e-3 }
    }
}

/// The physics.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Integration {
    /// Sub-step [s]; divides the control period.
    pub step: f64,
}

/// A value that no plant can have.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantProblem {
    /// Table and key, as in the file.
    pub field: String,
    /// What was found.
    pub value: f64,
    /// The allowed values.
    pub expected: &'static str,
}

impl PlantValues {
    /// Reads `plant.toml` in a robot's folder.
    ///
    /// # Errors
    /// It cannot be read, or what is wrong in it.
    pub fn load(robot: &Path) -> Result<Self, FileError> {
        let advice = "a robot that is simulated has a plant.toml in its folder";
        file::load(&robot.join("plant.toml"), advice, Self::check)
    }

    /// Reads the text of a `plant.toml`.
    ///
    /// # Errors
    /// What is wrong, with line and key.
    pub fn from_toml(text: &str) -> Result<Self, FileError> {
        let (values, findings) = Self::check(Path::new("plant.toml"), text);
        values.ok_or(FileError::Wrong(findings))
    }

    /// Everything that is wrong with `text`, the content of `path`, and the values when nothing is.
    pub fn check(path: &Path, text: &str) -> (Option<Self>, Vec<Finding>) {
        let mut report = Report::of_toml(path, text);
        let Some(table) = file::parse::<Table>(text, ADVICE, &mut report) else {
            return (None, report.findings);
        };
        let values = Self::read(&table, &mut report);
        for PlantProblem { field, value, expected } in values.iter().flat_map(Self::problems) {
            let message = format!("{field} is {value}: it must be {expected}");
            report.dynamics(report.line_of(&field), message, "correct the value");
        }
        report.sort();
        let good = report.findings.is_empty();
        (values.filter(|_| good), report.findings)
    }

    /// Reads section by section, to find what is wrong in any of them.
    fn read(table: &Table, report: &mut Report) -> Option<Self> {
        let known = [
            "gravity",
            "mismatch",
            "friction",
            "inner_loop",
            "noise",
            "supply",
            "integration",
            "force_sensor",
            "elasticity",
            "linkage",
            "posture",
        ];
        // A file with more of them is no plant.
        for key in table.keys().filter(|key| !known.contains(&key.as_str())).take(20) {
            let message = format!("unknown key {key}, expected one of {}", known.join(", "));
            report.dynamics(report.line_of(key), message, "correct or remove it");
        }
        let mut reader = Reader { table, report };
        let (gravity, mismatch, friction) =
            (reader.needed("gravity"), reader.needed("mismatch"), reader.needed("friction"));
        let (inner_loop, noise, supply) =
            (reader.needed("inner_loop"), reader.needed("noise"), reader.needed("supply"));
        let (integration, force_sensor, posture) =
            (reader.needed("integration"), reader.section("force_sensor"), reader.section("posture"));
        let (elasticity, linkage) = (reader.section("elasticity"), reader.section("linkage"));
        Some(Self {
            gravity: gravity?,
            mismatch: mismatch?,
            friction: friction?,
            inner_loop: inner_loop?,
            noise: noise?,
            supply: supply?,
            integration: integration?,
            force_sensor: force_sensor.ok()?,
            elasticity: elasticity.ok()?.unwrap_or_default(),
            linkage: linkage.ok()?.unwrap_or_default(),
            posture: posture.ok()?.unwrap_or_default(),
        })
    }

    /// Every value that no plant can have.
    pub fn problems(&self) -> Vec<PlantProblem> {
        let mut problems = Vec::new();
        let mut check = |good: bool, field: &str, value: f64, expected: &'static str| {
            if !good {
                problems.push(PlantProblem { field: field.to_owned(), value, expected });
            }
        };
        for value in self.gravity {
            check(value.is_finite(), "gravity", value, "finite [m/s²]");
        }
        let Mismatch { spread, homing_error } = self.mismatch;
        check(
            (0.0..=0.5).contains(&homing_error),
            "mismatch.homing_error",
            homing_error,
            "from 0 to 0.5 rad",
        );
        check((0.0..1.0).contains(&spread), "mismatch.spread", spread, "from 0 to below 1");
        for (field, value) in [
            ("friction.paper", self.friction.paper),
            ("noise.current", self.noise.current),
            ("noise.supply", self.noise.supply),
            ("supply.voltage", self.supply.voltage),
        ] {
            check(value.is_finite() && value >= 0.0, field, value, "at least 0");
        }
        let (noise, voltage) = (self.noise.supply, self.supply.voltage);
        let told = !noise.is_finite() || voltage.is_nan() || voltage <= 0.0;
        check(told || noise <= 0.1 * voltage, "noise.supply", noise, "at most a tenth of supply.voltage");
        let bandwidth = self.inner_loop.bandwidth;
        check(bandwidth.is_finite() && bandwidth > 0.0, "inner_loop.bandwidth", bandwidth, "above 0 [Hz]");
        let step = self.integration.step;
        let steps = CONTROL_PERIOD / step;
        let divides = (1e-5..=CONTROL_PERIOD).contains(&step) && (steps - libm::round(steps)).abs() < 1e-6;
        let expected = "a whole part of the control period of 0.01 s, at least 1e-5 s";
        check(divides, "integration.step", step, expected);
        let delay = self.inner_loop.delay;
        let expected = "from 0 to the control period less a sub-step [s]";
        let short = !divides || (0.0..=CONTROL_PERIOD - step).contains(&delay);
        check(short, "inner_loop.delay", delay, expected);
        for (joint, &angle) in &self.posture {
            check(angle.is_finite(), &format!("posture.{joint}"), angle, "a finite angle [rad]");
        }
        for (joint, &stiffness) in &self.elasticity {
            let good = stiffness.is_finite() && stiffness > 0.0;
            check(good, &format!("elasticity.{joint}"), stiffness, "above 0 [N·m/rad]");
        }
        let LinkageValues { stiffness, damping } = self.linkage;
        check(stiffness.is_finite() && stiffness > 0.0, "linkage.stiffness", stiffness, "above 0 [N·m/rad]");
        check(damping.is_finite() && damping >= 0.0, "linkage.damping", damping, "at least 0");
        if let Some(sensor) = &self.force_sensor {
            sensor.problems(&mut check);
        }
        problems
    }
}

/// Reads the sections of a table.
struct Reader<'a> {
    table: &'a Table,
    report: &'a mut Report,
}

impl Reader<'_> {
    /// A section that may be missing; `Err` when it is wrong, which has been reported.
    fn section<T: DeserializeOwned>(&mut self, name: &str) -> Result<Option<T>, ()> {
        let Some(value) = self.table.get(name) else { return Ok(None) };
        Value::clone(value).try_into().map(Some).map_err(|error: toml::de::Error| {
            let message = in_words(error.message());
            let line = message
                .split('`')
                .nth(1)
                .and_then(|key| self.report.line_of(&format!("{name}.{key}")))
                .or_else(|| self.report.line_of(name));
            let advice =
                if name == "force_sensor" { "robots/hand3/plant.toml has such a section" } else { ADVICE };
            self.report.dynamics(line, format!("{name}: {message}"), advice);
        })
    }

    fn needed<T: DeserializeOwned>(&mut self, name: &str) -> Option<T> {
        let section = self.section(name).ok()?;
        if section.is_none() {
            self.report.dynamics(None, format!("{name} is missing"), ADVICE);
        }
        section
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
    fn problems(&self, check: &mut impl FnMut(bool, &str, f64, &'static str)) {
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
        if let Some(window) = self.window {
            let good = window > 0.0 && window <= CONTROL_PERIOD;
            check(good, "force_sensor.window", window, "above 0 s, at most a control period");
        }
        let expected = "at least 0; counts and ranges above 0";
        for (field, value) in positive {
            check(value.is_finite() && value > 0.0, &format!("force_sensor.{field}"), value, expected);
        }
        for (field, value) in others {
            check(value.is_finite() && value >= 0.0, &format!("force_sensor.{field}"), value, expected);
        }
        // Of what is not finite it has been told.
        let gain = self.gain_error;
        check(gain < 1.0 || !gain.is_finite(), "force_sensor.gain_error", gain, "from 0 to below 1, a share");
        for (field, offset, range, expected) in [
            ("force_sensor.force_offset", self.force_offset, self.force_range, "below force_range"),
            ("force_sensor.torque_offset", self.torque_offset, self.torque_range, "below torque_range"),
        ] {
            let told = !offset.is_finite() || !range.is_finite() || range <= 0.0;
            check(told || offset < range, field, offset, expected);
        }
    }

    /// The value for forces on axes 0 to 2, that for torques on the others.
    pub const fn of_axis(axis: usize, force: f64, torque: f64) -> f64 {
        if axis < 3 { force } else { torque }
    }

    /// What a board multiplies counts by, of each axis [N], [N·m].
    pub fn scales(&self) -> [f64; 6] {
        core::array::from_fn(|axis| Self::of_axis(axis, self.force_count, self.torque_count))
    }
}
