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

use crate::file::{self, FileError, read_text};
use crate::finding::{Finding, Report};
use crate::impedance::ImpedanceTable;
use crate::line::line_of;
use crate::urdf;

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

/// Why a law cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ArmLawError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// What is wrong in it.
    #[error("{}", urdf::list(.0))]
    Wrong(Vec<Finding>),
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

/// A key with its section, and what is wrong there.
type Wrong = (String, String);

/// The law in a file, checked for the robot of `model`.
///
/// # Errors
/// The file cannot be read, or what is wrong in it, by line and key.
pub fn load(path: &Path, model: &RobotModel) -> Result<ArmLaw, ArmLawError> {
    let text = read_text(path).map_err(|source| FileError::Read { path: path.to_path_buf(), source })?;
    let (law, findings) = check(path, &text, model);
    law.ok_or(ArmLawError::Wrong(findings))
}

/// What is wrong with `text`, the content of `path`, for the robot of `model`; the law when nothing is.
pub fn check(path: &Path, text: &str, model: &RobotModel) -> (Option<ArmLaw>, Vec<Finding>) {
    let mut report = Report::new(path);
    let Some(file) = file::parse::<File>(text, ADVICE, &mut report) else {
        return (None, report.findings);
    };
    match file.law(model) {
        Ok(law) => (Some(law), report.findings),
        Err((key, message)) => {
            report.dynamics(line_of(text, &key), message, ADVICE);
            (None, report.findings)
        }
    }
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
    fn law(self, model: &RobotModel) -> Result<ArmLaw, Wrong> {
        let Self { title, control, release, follow, elbow, bilateral } = self;
        let settings =
            control.settings(model).map_err(|(key, message)| (format!("control.{key}"), message))?;
        let law = ArmLaw { title, settings, release, follow, elbow, bilateral };
        law.check_ranges()?;
        law.check_dampings("release.damping", &law.release.damping, model)?;
        law.check_dampings("follow.damping", &[law.follow.damping], model)?;
        law.check_dampings("follow.curve", &law.follow.curve, model)?;
        law.check_bilateral(model)?;
        Ok(law)
    }
}

impl ArmLaw {
    /// Checks the numbers of the experiments.
    fn check_ranges(&self) -> Result<(), Wrong> {
        let Self { release, follow, elbow, .. } = self;
        let max_displacement = 0.5 * f64::from(self.settings.max_deviation[0]);
        for (key, value, [min, max], unit) in [
            ("release.displacement", release.displacement, [1e-3, max_displacement], "m"),
            ("follow.amplitude", follow.amplitude, [1e-3, 0.12], "m"),
            ("follow.frequency", follow.frequency, [0.1, 2.0], "Hz"),
            ("follow.link", follow.link.delay, [0.0, 0.1], "s (delay)"),
            ("follow.link", follow.link.jitter, [0.0, 0.1], "s (jitter)"),
            ("follow.link", follow.link.loss, [0.0, 0.5], "(loss)"),
            ("follow.tremor", follow.tremor, [0.0, 1e-3], "m"),
            ("elbow.angle", elbow.angle, [0.05, 0.8], "rad"),
            ("elbow.time", elbow.time, [0.3, 3.0], "s"),
        ] {
            if !(min..=max).contains(&value) {
                let message = format!("{key} is {value} {unit}; possible is {min} to {max}");
                return Err((key.to_owned(), message));
            }
        }
        Ok(())
    }

    /// Checks the bilateral experiment, if there is one.
    fn check_bilateral(&self, model: &RobotModel) -> Result<(), Wrong> {
        let (Some(experiment), Some(settings)) = (&self.bilateral, self.bilateral_settings()) else {
            return Ok(());
        };
        settings
            .validate(model.joints.len())
            .map_err(|problem| ("bilateral".to_owned(), format!("bilateral: {problem}")))?;
        if experiment.coupling == ForceFeedback::Matched
            && MatchedImpedance::new(&settings.impedance).is_none()
        {
            let message = "bilateral.coupling: \"matched\" needs an impedance in the axes of the base, without coupling, \
                           and a stiffness along and about each of them";
            return Err(("bilateral.coupling".to_owned(), message.to_owned()));
        }
        let delays = &experiment.delays;
        if delays.is_empty()
            || delays.len() > MAX_VALUES
            || delays.iter().any(|delay| !(0.0..=0.1).contains(delay))
        {
            let message = format!(
                "bilateral.delays is {delays:?}; possible are 1 to {MAX_VALUES} values from 0 to 0.1 s"
            );
            return Err(("bilateral.delays".to_owned(), message));
        }
        Ok(())
    }

    /// Checks a list of dampings along x, y and z.
    fn check_dampings(&self, key: &str, values: &[f32], model: &RobotModel) -> Result<(), Wrong> {
        if values.is_empty() || values.len() > MAX_VALUES {
            let message = format!("{key} has {} values; possible are 1 to {MAX_VALUES}", values.len());
            return Err((key.to_owned(), message));
        }
        for &value in values {
            let settings = self.with_damping(value);
            settings
                .validate(model.joints.len())
                .map_err(|problem| (key.to_owned(), format!("{key}: {problem}")))?;
        }
        Ok(())
    }
}
