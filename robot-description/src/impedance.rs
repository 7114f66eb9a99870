//! Impedance files: the settings of an arm's Cartesian impedance control.
//!
//! ```toml
//! law = "model-following"               # or "direct"
//! redundancy = "arm-angle"              # or "none", or { driven = "shoulder_yaw" }
//! elbow_bandwidth = 12.0                # rad/s
//! force = "sensor"                      # or { observer = 30.0 }: from motor torques, bandwidth in rad/s
//! contact_force = 1.5                   # N
//! max_deviation = { translation = 0.3, rotation = 1.5 }         # m, rad
//!
//! axes = "base"                         # of the matrices below, or "tool"
//! # Along and about x, y, z: one number, or one for each axis; or a symmetric matrix.
//! mass = { translation = 1.5, rotation = 0.008 }                # kg, kg·m²
//! damping = { translation = [30.0, 30.0, 60.0], rotation = 0.5 } # N·s/m, N·m·s/rad
//! stiffness = { matrix = [                                      # N/m, N, N·m/rad
//!     [300.0, 100.0, 0.0, 0.0, 0.0, 0.0],
//!     [100.0, 300.0, 0.0, 0.0, 0.0, 0.0],
//!     [0.0, 0.0, 300.0, 0.0, 0.0, 0.0],
//!     [0.0, 0.0, 0.0, 16.0, 0.0, 0.0],
//!     [0.0, 0.0, 0.0, 0.0, 16.0, 0.0],
//!     [0.0, 0.0, 0.0, 0.0, 0.0, 16.0],
//! ] }
//! ```
//!
//! With `law = "direct"`, `direct` holds the [options](DirectLaw) of that law:
//!
//! ```toml
//! direct = { friction = 1.0, driven_term = false, null_space_damping = false }
//! ```

mod doubts;

use std::path::Path;

use serde::Deserialize;
use tesaki::control::{Impedance, ImpedanceAxes, ImpedanceCoupling, ImpedanceTerm, InvalidImpedance};
use tesaki::kinematics::Chain;
use tesaki::model::RobotModel;
use tesaki::task::impedance::{
    DirectLaw, ForceSource, ImpedanceRefusal, ImpedanceSettings, InvalidImpedanceSettings, Law, Redundancy,
    own_mass,
};

use crate::file::{self, FileError};
use crate::finding::{Finding, Report};
use crate::robot::{at_least, chain_length};

/// Name of the folder of such files in a robot folder.
pub const FOLDER: &str = "impedances";
/// What to do about a key that cannot be used.
const ADVICE: &str = "correct it; robots/arm7/impedances/soft.toml is an example";

/// The same for an arm of six joints.
const SIX_JOINTS: &str =
    "correct it; docs/examples/soft_six_joints.toml is an example for an arm of six joints";
const NO_REDUNDANCY: &str = "give redundancy = \"none\", as in docs/examples/soft_six_joints.toml";
const NO_SENSOR: &str = "give force = { observer = 30.0 }: the force is then estimated from the motor torques, and \
    contact_force must be above its error: about 6 N for a light arm, 40 N for a UR5e; docs/examples/soft_six_joints.toml is an example";

/// A key, and what is wrong there.
pub(crate) type Wrong = (&'static str, String);

/// The content of a file, or of a part of one.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ImpedanceTable {
    #[serde(default)]
    axes: FileAxes,
    mass: Axes,
    damping: Axes,
    stiffness: Axes,
    #[serde(default)]
    law: FileLaw,
    direct: Option<Direct>,
    redundancy: FileRedundancy,
    elbow_bandwidth: f32,
    #[serde(default)]
    force: FileForce,
    contact_force: f32,
    max_deviation: MaxDeviation,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table with `translation` and `rotation`, or with `matrix`")]
struct Axes {
    translation: Option<Three>,
    rotation: Option<Three>,
    matrix: Option<[[f32; 6]; 6]>,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum FileAxes {
    #[default]
    Base,
    Tool,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Direct {
    friction: f32,
    driven_term: bool,
    null_space_damping: bool,
}

impl Default for Direct {
    fn default() -> Self {
        let DirectLaw { friction, driven_term, null_space_damping } = DirectLaw::CORRECTED;
        Self { friction, driven_term, null_space_damping }
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a number, or three: for x, y and z; a matrix of all axes is `{ matrix = [[…], …] }`"
)]
enum Three {
    All(f32),
    Each([f32; 3]),
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum FileLaw {
    Direct,
    #[default]
    ModelFollowing,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum FileForce {
    #[default]
    Sensor,
    Observer(f32),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum FileRedundancy {
    None,
    ArmAngle,
    Driven(String),
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MaxDeviation {
    translation: f32,
    rotation: f32,
}

impl Axes {
    /// Diagonal of the matrix `key`, and the elements below it if one is not 0.
    fn elements(self, key: &'static str) -> Result<([f32; 6], Option<[f32; 15]>), Wrong> {
        match self {
            Self { translation: Some(translation), rotation: Some(rotation), matrix: None } => {
                let [[x, y, z], [a, b, c]] = [translation, rotation].map(|three| match three {
                    Three::All(value) => [value; 3],
                    Three::Each(values) => values,
                });
                Ok(([x, y, z, a, b, c], None))
            }
            Self { translation: None, rotation: None, matrix: Some(matrix) } => split(&matrix, key),
            _ => Err((key, format!("{key}: expected translation and rotation, or matrix"))),
        }
    }
}

/// Diagonal of a symmetric matrix, and the elements below it if one is not 0.
fn split(matrix: &[[f32; 6]; 6], key: &'static str) -> Result<([f32; 6], Option<[f32; 15]>), Wrong> {
    let (mut diagonal, mut below) = ([0.0; 6], Vec::new());
    for (row, values) in matrix.iter().enumerate() {
        diagonal[row] = values[row];
        for (column, &value) in values.iter().enumerate().take(row) {
            let mirrored = matrix[column][row];
            // Adding 0 turns -0 into 0.
            if (value + 0.0).to_bits() != (mirrored + 0.0).to_bits() {
                let message = format!(
                    "the {key} matrix is not symmetric: row {}, column {} is {value}, row {}, column {} is {mirrored}",
                    row + 1,
                    column + 1,
                    column + 1,
                    row + 1
                );
                return Err((key, message));
            }
            below.push(value);
        }
    }
    let below = <[f32; 15]>::try_from(below).ok();
    Ok((diagonal, below.filter(|below| below.iter().any(|value| *value != 0.0))))
}

/// The settings in an impedance file, checked for the robot of `model`.
///
/// # Errors
/// The file cannot be read, or what is wrong in it, by line and key.
pub fn load(path: &Path, model: &RobotModel) -> Result<ImpedanceSettings, FileError> {
    file::load(path, "", |path, text| check(path, text, model))
}

/// Why the robot of `model` has no impedance, if it has none.
pub fn not_an_arm(model: &RobotModel) -> Option<String> {
    let is_arm = model.chains.len() == 1 && model.joints.len() >= 6 && model.mimics.is_empty();
    (!is_arm).then(|| format!("{}: {}", model.name, ImpedanceRefusal::NotAnArm))
}

/// What is wrong with `text`, the content of `path`, for the robot of `model`; the settings when nothing is.
pub fn check(path: &Path, text: &str, model: &RobotModel) -> (Option<ImpedanceSettings>, Vec<Finding>) {
    let mut report = Report::of_toml(path, text);
    let Some(table) = file::parse::<ImpedanceTable>(text, ADVICE, &mut report) else {
        return (None, report.findings);
    };
    if let Some(message) = not_an_arm(model) {
        report.dynamics(None, message, "only an arm has an impedance");
        return (None, report.findings);
    }
    match table.settings(model) {
        Ok(settings) => {
            for (key, message, advice) in doubts::of(&settings, model) {
                report.warning(report.line_of(key), message, advice);
            }
            report.sort();
            (Some(settings), report.findings)
        }
        Err((key, message)) => {
            report.dynamics(report.line_of(key), message, advice(key, model));
            (None, report.findings)
        }
    }
}

/// What to do about the key `key` for the robot of `model`.
fn advice(key: &str, model: &RobotModel) -> &'static str {
    match (key, model.joints.len()) {
        ("redundancy", 6) => NO_REDUNDANCY,
        ("force", _) if !has_force_sensor(model) => NO_SENSOR,
        (_, 6) => SIX_JOINTS,
        _ => ADVICE,
    }
}

fn has_force_sensor(model: &RobotModel) -> bool {
    model.chains.iter().any(|chain| chain.force_sensor.is_some())
}

impl ImpedanceTable {
    /// The settings, checked for the robot of `model`.
    pub(crate) fn settings(&self, model: &RobotModel) -> Result<ImpedanceSettings, Wrong> {
        let settings = ImpedanceSettings {
            impedance: self.impedance()?,
            law: match (self.law, self.direct) {
                (FileLaw::Direct, direct) => {
                    let Direct { friction, driven_term, null_space_damping } = direct.unwrap_or_default();
                    Law::Direct(DirectLaw { friction, driven_term, null_space_damping })
                }
                (FileLaw::ModelFollowing, None) => Law::ModelFollowing,
                (FileLaw::ModelFollowing, Some(_)) => {
                    let message = "direct: only `law = \"direct\"` has these options";
                    return Err(("direct", message.to_owned()));
                }
            },
            redundancy: self.redundancy(model)?,
            elbow_bandwidth: self.elbow_bandwidth,
            force: match self.force {
                FileForce::Sensor if !has_force_sensor(model) => {
                    return Err(("force", format!("force = \"sensor\": {} has no force sensor", model.name)));
                }
                FileForce::Sensor => ForceSource::Sensor,
                FileForce::Observer(bandwidth) => ForceSource::Observer { bandwidth },
            },
            contact_force: self.contact_force,
            max_deviation: [self.max_deviation.translation, self.max_deviation.rotation],
        };
        settings
            .validate(model.joints.len())
            .and_then(|()| settings.check_mass(&typical_mass(model, settings.impedance.axes)))
            .map_err(|problem| (key(&problem), rounded(problem).to_string()))?;
        within_reach(&settings, model)?;
        Ok(settings)
    }

    fn impedance(&self) -> Result<Impedance, Wrong> {
        let (mass, of_mass) = self.mass.elements("mass")?;
        let (damping, of_damping) = self.damping.elements("damping")?;
        let (stiffness, of_stiffness) = self.stiffness.elements("stiffness")?;
        let is_coupled = of_mass.or(of_damping).or(of_stiffness).is_some();
        let [of_mass, of_damping, of_stiffness] =
            [of_mass, of_damping, of_stiffness].map(|below| below.unwrap_or([0.0; 15]));
        let coupling = ImpedanceCoupling { mass: of_mass, damping: of_damping, stiffness: of_stiffness };
        Ok(Impedance {
            axes: match self.axes {
                FileAxes::Base => ImpedanceAxes::Base,
                FileAxes::Tool => ImpedanceAxes::Tool,
            },
            coupling: is_coupled.then_some(coupling),
            ..Impedance::diagonal(mass, damping, stiffness)
        })
    }

    fn redundancy(&self, model: &RobotModel) -> Result<Redundancy, Wrong> {
        let name = match &self.redundancy {
            FileRedundancy::None => return Ok(Redundancy::None),
            FileRedundancy::ArmAngle => return Ok(Redundancy::ArmAngle),
            FileRedundancy::Driven(name) => name,
        };
        let found = (0..).zip(&model.joints).find(|(_, joint)| joint.name == name.as_str());
        let (joint, _) = found.ok_or_else(|| {
            let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
            let message =
                format!("{} has no joint {name:?}; its joints are {}", model.name, names.join(", "));
            ("redundancy", message)
        })?;
        Ok(Redundancy::DrivenJoint { joint })
    }
}

/// Refuses thresholds that nothing reaches.
fn within_reach(settings: &ImpedanceSettings, model: &RobotModel) -> Result<(), Wrong> {
    let ([deviation, _], reach) = (settings.max_deviation, chain_length(model, 0));
    if deviation > 2.0 * reach {
        let message = format!(
            "max_deviation: translation is {deviation} m, more than twice the length of {}, {reach:.3} m: no set-point in \
             reach is so far from the tool; 1 mm is 0.001 m",
            model.name
        );
        return Err(("max_deviation", message));
    }
    let sensor = model.chains.iter().find_map(|chain| chain.force_sensor.as_ref());
    match (settings.force, sensor) {
        (ForceSource::Sensor, Some(sensor)) if settings.contact_force >= sensor.force_limit => {
            let message = format!(
                "the contact force is {} N; above force_sensor.force_limit of controller.toml, {} N, there is a fault and no \
                 contact",
                settings.contact_force, sensor.force_limit
            );
            Err(("contact_force", message))
        }
        _ => Ok(()),
    }
}

/// The arm's own mass along `axes` [kg], with its joints in the middle of their ranges. The controller
/// checks an impedance in the posture in which it is enabled.
fn typical_mass(model: &RobotModel, axes: ImpedanceAxes) -> [f32; 3] {
    let angles: Vec<f32> =
        model.joints.iter().map(|joint| 0.5 * (joint.limits.lower + joint.limits.upper)).collect();
    own_mass_at(model, &angles, axes)
}

/// The arm's own mass along `axes` [kg] at joint angles [rad]; 0 without a chain.
pub fn own_mass_at(model: &RobotModel, angles: &[f32], axes: ImpedanceAxes) -> [f32; 3] {
    if model.chains.is_empty() {
        return [0.0; 3];
    }
    own_mass(&Chain::of_model(model, 0), &model.joints, angles, axes)
}

/// A bound in three digits, on the side that is accepted.
fn rounded(problem: InvalidImpedanceSettings) -> InvalidImpedanceSettings {
    match problem {
        InvalidImpedanceSettings::MassInContact { axis, value, own, limit } => {
            let limit = at_least(limit).parse().unwrap_or(limit);
            InvalidImpedanceSettings::MassInContact { axis, value, own, limit }
        }
        other => other,
    }
}

/// The key of an invalid setting.
const fn key(problem: &InvalidImpedanceSettings) -> &'static str {
    match problem {
        InvalidImpedanceSettings::Impedance(InvalidImpedance { term, .. }) => match term {
            ImpedanceTerm::Mass | ImpedanceTerm::MassMatrix => "mass",
            ImpedanceTerm::Damping | ImpedanceTerm::DampingMatrix | ImpedanceTerm::DampingToMass => "damping",
            ImpedanceTerm::Stiffness | ImpedanceTerm::StiffnessMatrix | ImpedanceTerm::StiffnessToMass => {
                "stiffness"
            }
        },
        InvalidImpedanceSettings::MassInContact { .. } => "mass",
        InvalidImpedanceSettings::Joint { .. }
        | InvalidImpedanceSettings::NoArmAngle
        | InvalidImpedanceSettings::NoRedundantJoint => "redundancy",
        InvalidImpedanceSettings::ElbowBandwidth { .. } => "elbow_bandwidth",
        InvalidImpedanceSettings::ForceBandwidth { .. } => "force",
        InvalidImpedanceSettings::ContactForce { .. } => "contact_force",
        InvalidImpedanceSettings::MaxDeviation { .. } => "max_deviation",
        InvalidImpedanceSettings::Friction { .. } => "direct",
    }
}
