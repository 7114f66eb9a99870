//! Laws of an arm: how a slave arm is controlled, and the experiments of Arm7.
//!
//! ```toml
//! title = "the paper's law"
//!
//! [control]             # as a file in `impedances/`
//! law = "direct"
//! # ...
//!
//! [release]             # section 3.1, figure 5
//! displacement = 0.03   # m, along one axis after the other
//! damping = [7.5, 30.0] # N·s/m, one release after the other
//!
//! [follow]              # section 3.2, figure 7
//! setpoint = "sample"   # the master's last sample (X₀ = X_M), or "predicted" from all of them
//! amplitude = 0.1       # m
//! frequency = 0.5       # Hz
//! damping = 15.0        # N·s/m
//! curve = [7.5, 15.0]   # N·s/m: the motion is repeated with each of them
//! link = { delay = 0.02, jitter = 0.003, loss = 0.02 } # s, s, fraction; the motion is repeated without
//! tremor = 5e-5         # m, root mean square along each axis
//!
//! [elbow]               # section 3.2: the hand is held, the elbow moves
//! angle = 0.52          # rad
//! time = 1.0            # s
//!
//! [bilateral]           # section 4; may be missing
//! coupling = "matched"  # this impedance at both ends, or "reflected": its spring's force under passivity control
//! mass = 3.5            # kg
//! damping = 60.0        # N·s/m
//! delays = [0.0, 0.02]  # s, each direction
//! ```
//!
//! The dampings of the experiments replace the one along x, y and z in `[control]`.

use std::path::Path;

use serde::Deserialize;
use tesaki::model::RobotModel;
use tesaki::task::impedance::ImpedanceSettings;
use tesaki::teleop::MatchedImpedance;

use super::{LawFileError, Wrong};
use crate::finding::Finding;
use crate::impedance::ImpedanceTable;

/// What to do about a key that cannot be used.
const ADVICE: &str = "correct it; robots/arm7/laws/paper.toml is an example";
/// Largest number of values in a list.
const MAX_VALUES: usize = 16;

/// A law of an arm and its experiments.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmLaw {
    /// What it is called in texts.
    pub title: String,
    /// Of impedance control.
    pub settings: ImpedanceSettings,
    /// The tool is displaced and released.
    pub release: ReleaseExperiment,
    /// The tool follows a hand.
    pub follow: FollowExperiment,
    /// The elbow moves.
    pub elbow: ElbowExperiment,
    /// The operator feels the forces on the tool.
    pub bilateral: Option<BilateralExperiment>,
}

/// Release of the tool (Arm7, section 3.1).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReleaseExperiment {
    /// Displacement along each axis [m].
    pub displacement: f64,
    /// Dampings of the releases along x, y and z [N·s/m].
    pub damping: Vec<f32>,
}

/// Unilateral teleoperation (Arm7, section 3.2).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FollowExperiment {
    /// The set-point of the slave.
    pub setpoint: Setpoint,
    /// Amplitude of the hand's sine along x [m].
    pub amplitude: f64,
    /// Its frequency [Hz].
    pub frequency: f64,
    /// Damping along x, y and z [N·s/m].
    pub damping: f32,
    /// Further dampings, for the curve of the error [N·s/m].
    pub curve: Vec<f32>,
    /// The link from master to slave.
    pub link: LinkTable,
    /// Tremor of the hand along each axis, root mean square [m].
    pub tremor: f64,
}

/// How the set-point of a slave comes from the samples of a master.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Setpoint {
    /// The last sample is the equilibrium of the spring, `X₀ = X_M`.
    Sample,
    /// Position, velocity and acceleration are predicted to the present.
    Predicted,
}

/// A link between master and slave.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkTable {
    /// Minimum time from sending to arrival [s].
    pub delay: f64,
    /// Largest additional delay [s].
    pub jitter: f64,
    /// Fraction of the messages that are lost.
    pub loss: f64,
}

/// Motion of the operator's elbow with the hand held.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElbowExperiment {
    /// Angle of the swing [rad].
    pub angle: f64,
    /// Its duration [s].
    pub time: f64,
}

/// Bilateral teleoperation (Arm7, section 4).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BilateralExperiment {
    /// How the operator feels the forces.
    pub coupling: ForceFeedback,
    /// Mass along x, y and z [kg], in place of that in `[control]`.
    pub mass: f32,
    /// Damping along x, y and z [N·s/m].
    pub damping: f32,
    /// Delays of the link in each direction [s], one trial after the other.
    pub delays: Vec<f64>,
}

/// How an operator feels the forces on a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ForceFeedback {
    /// Master and slave have the same impedance, and the measured wrenches act on both.
    Matched,
    /// The force of the slave's spring is reflected, under time-domain passivity control.
    Reflected,
}

/// The content of a file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    title: String,
    control: ImpedanceTable,
    release: ReleaseExperiment,
    follow: FollowExperiment,
    elbow: ElbowExperiment,
    bilateral: Option<BilateralExperiment>,
}

/// Whether the robot is an arm: one chain.
pub fn is_for(model: &RobotModel) -> bool {
    model.chains.len() == 1
}

/// The law in a file, checked for the robot of `model`.
///
/// # Errors
/// The file cannot be read, or what is wrong in it, by line and key.
pub fn load(path: &Path, model: &RobotModel) -> Result<ArmLaw, LawFileError> {
    super::check_robot(path, model, is_for(model), "an arm")?;
    super::load(path, |text| check(path, text, model))
}

/// What is wrong with `text`, the content of `path`, for the robot of `model`; the law when nothing is.
pub fn check(path: &Path, text: &str, model: &RobotModel) -> (Option<ArmLaw>, Vec<Finding>) {
    super::read(path, text, ADVICE, |file: File| file.law(model))
}

impl ArmLaw {
    /// The settings with another damping along x, y and z [N·s/m].
    pub const fn with_damping(&self, damping: f32) -> ImpedanceSettings {
        let mut settings = self.settings;
        let [x, y, z, ..] = &mut settings.impedance.damping;
        (*x, *y, *z) = (damping, damping, damping);
        settings
    }

    /// The settings of the bilateral experiment, if there is one.
    pub fn bilateral_settings(&self) -> Option<ImpedanceSettings> {
        let BilateralExperiment { mass, damping, .. } = *self.bilateral.as_ref()?;
        let mut settings = self.with_damping(damping);
        let [x, y, z, ..] = &mut settings.impedance.mass;
        (*x, *y, *z) = (mass, mass, mass);
        Some(settings)
    }
}

impl File {
    fn law(self, model: &RobotModel) -> Result<ArmLaw, Vec<Wrong>> {
        let Self { title, control, release, follow, elbow, bilateral } = self;
        let settings = control
            .settings(model)
            .map_err(|(key, message)| vec![Wrong::new(format!("control.{key}"), message)])?;
        let law = ArmLaw { title, settings, release, follow, elbow, bilateral };
        let wrong = law.problems(model);
        if wrong.is_empty() { Ok(law) } else { Err(wrong) }
    }
}

impl ArmLaw {
    fn problems(&self, model: &RobotModel) -> Vec<Wrong> {
        let Self { release, follow, elbow, .. } = self;
        let max_displacement = 0.5 * f64::from(self.settings.max_deviation[0]);
        let ranges = [
            ("release.displacement", release.displacement, [1e-3, max_displacement], "m"),
            ("follow.amplitude", follow.amplitude, [1e-3, 0.12], "m"),
            ("follow.frequency", follow.frequency, [0.1, 2.0], "Hz"),
            ("follow.link.delay", follow.link.delay, [0.0, 0.1], "s"),
            ("follow.link.jitter", follow.link.jitter, [0.0, 0.1], "s"),
            ("follow.link.loss", follow.link.loss, [0.0, 0.5], ""),
            ("follow.tremor", follow.tremor, [0.0, 1e-3], "m"),
            ("elbow.angle", elbow.angle, [0.05, 0.8], "rad"),
            ("elbow.time", elbow.time, [0.3, 3.0], "s"),
        ];
        let ranges = ranges
            .into_iter()
            .filter_map(|(key, value, range, unit)| Wrong::outside(key, value, range, unit));
        let dampings = [
            ("release.damping", &release.damping[..]),
            ("follow.damping", &[follow.damping]),
            ("follow.curve", &follow.curve),
        ];
        let dampings =
            dampings.into_iter().filter_map(|(key, values)| self.wrong_damping(key, values, model));
        ranges.chain(dampings).chain(self.wrong_bilateral(model)).collect()
    }

    /// What is wrong with the bilateral experiment, if there is one.
    fn wrong_bilateral(&self, model: &RobotModel) -> Option<Wrong> {
        let (experiment, settings) = self.bilateral.as_ref().zip(self.bilateral_settings())?;
        if let Err(problem) = settings.validate(model.joints.len()) {
            return Some(Wrong::new("bilateral", format!("bilateral: {problem}")));
        }
        if experiment.coupling == ForceFeedback::Matched
            && MatchedImpedance::new(&settings.impedance).is_none()
        {
            let message = "bilateral.coupling: \"matched\" needs an impedance in the axes of the base, without coupling, \
                           and a stiffness along and about each of them";
            return Some(Wrong::new("bilateral.coupling", message));
        }
        let delays = &experiment.delays;
        let is_possible = (1..=MAX_VALUES).contains(&delays.len())
            && delays.iter().all(|delay| (0.0..=0.1).contains(delay));
        (!is_possible).then(|| {
            let message = format!(
                "bilateral.delays is {delays:?}; possible are 1 to {MAX_VALUES} values from 0 to 0.1 s"
            );
            Wrong::new("bilateral.delays", message)
        })
    }

    /// What is wrong with a list of dampings along x, y and z.
    fn wrong_damping(&self, key: &str, values: &[f32], model: &RobotModel) -> Option<Wrong> {
        if values.is_empty() || values.len() > MAX_VALUES {
            let message = format!("{key} has {} values; possible are 1 to {MAX_VALUES}", values.len());
            return Some(Wrong::new(key, message));
        }
        let mut problems =
            values.iter().filter_map(|&value| self.with_damping(value).validate(model.joints.len()).err());
        problems.next().map(|problem| Wrong::new(key, format!("{key}: {problem}")))
    }
}
