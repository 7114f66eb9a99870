//! Laws of an arm: how a slave arm is controlled, and the experiments of Arm7.
//!
//! ```toml
//! title = "the paper's law" # in figures and tables
//!
//! [control]             # as a file in `impedances/`
//! law = "direct"
//! # ...
//!
//! [release]             # section 3.1, figure 5
//! displacement = 0.03   # m, along one axis after the other
//! damping = [7.5, 30.0] # N·s/m, one release after the other
//! observed = 2.0        # s, after the release
//!
//! [follow]              # section 3.2, figure 7
//! setpoint = "sample"   # the master's last sample (X₀ = X_M), or "predicted" from all of them
//! amplitude = 0.1       # m
//! frequency = 0.5       # Hz
//! duration = 6.0        # s, of the hand's motion
//! rest = 2.0            # s, after it; the error at rest is the mean over the second half
//! damping = 15.0        # N·s/m
//! curve = [7.5, 15.0]   # N·s/m: the motion is repeated with each of them
//! link = { delay = 0.02, jitter = 0.003, loss = 0.02 } # s, s, fraction; the motion is repeated without
//! tremor = 5e-5         # m, root mean square along each axis
//!
//! [elbow]               # section 3.2: the hand is held, the elbow moves
//! angle = 0.52          # rad
//! time = 1.0            # s
//! rest = 1.5            # s, after each swing
//!
//! [push]                # equation (2): forces on the tool, one after the other
//! forces = [[6.0, 0.0, 0.0], [0.0, 6.0, 0.0]] # N, along the axes of the base
//! ramp = 0.3            # s, from one to the next
//! time = 1.7            # s, that each stays
//! evaluated = 0.3       # s, at its end
//!
//! [bilateral]           # section 4
//! coupling = "matched"  # this impedance at both ends, or "reflected": its spring's force under passivity control
//! mass = 3.5            # kg
//! damping = 60.0        # N·s/m
//! delays = [0.0, 0.02]  # s, each direction
//! stroke = { shift = 0.05, turn = 0.15, time = 0.8, stay = 4.0 } # m along x, rad about z, s, s
//! wall = { clearance = 0.02, stiffness = 2000.0, damping = 20.0 } # m, N/m, N·s/m
//! push = { force = [0.0, 2.0, 0.0], point = [0.1, 0.0, 0.0], ramp = 0.2, time = 2.0 } # N, m in the tool's frame, s, s
//! noise = { force = 0.1, torque = 0.005 } # N, N·m: of the sensor in the handle
//! ```
//!
//! The dampings of the experiments replace the one along x, y and z in `[control]`. An experiment that is
//! left out is none of this law; without `[push]` eight forces of 6 N in the plane of x and y act.
//! `observed`, `duration`, `rest` and the last four of `[bilateral]` may be left out, too; then they have the
//! values above.

use std::path::Path;

use serde::Deserialize;
use tesaki::control::{Impedance, ImpedanceAxes};
use tesaki::model::RobotModel;
use tesaki::task::impedance::ImpedanceSettings;
use tesaki::teleop::MatchedImpedance;

use super::Wrong;
use crate::file::{self, FileError};
use crate::finding::Finding;
use crate::impedance::ImpedanceTable;

/// What to do about a key that cannot be used.
const ADVICE: &str = "correct it; robots/arm7/laws/paper.toml is an example";
/// Largest number of values in a list.
const MAX_VALUES: usize = 16;
/// Longest time of a part of an experiment [s].
const MAX_TIME: f64 = 60.0;
/// Largest force on the tool along an axis [N].
const MAX_FORCE: f64 = 30.0;

/// A law of an arm and its experiments.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmLaw {
    /// What it is called in texts.
    pub title: String,
    /// Of impedance control.
    pub settings: ImpedanceSettings,
    /// The tool is displaced and released.
    pub release: Option<ReleaseExperiment>,
    /// The tool follows a hand.
    pub follow: Option<FollowExperiment>,
    /// The elbow moves.
    pub elbow: Option<ElbowExperiment>,
    /// Forces act on the tool.
    pub push: PushExperiment,
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
    /// Time after the release that is observed [s].
    #[serde(default = "two")]
    pub observed: f64,
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
    /// Time that it moves [s].
    #[serde(default = "six")]
    pub duration: f64,
    /// Time at rest after it [s].
    #[serde(default = "two")]
    pub rest: f64,
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
    /// Rest after each swing [s].
    #[serde(default = "one_and_a_half")]
    pub rest: f64,
}

/// Forces on the tool, one after the other.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PushExperiment {
    /// Along the axes of the base [N].
    pub forces: Vec<[f64; 3]>,
    /// Time from one to the next [s].
    pub ramp: f64,
    /// Time that each stays [s].
    pub time: f64,
    /// Time at its end that is evaluated [s].
    pub evaluated: f64,
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
    /// What the operator does.
    #[serde(default)]
    pub stroke: StrokeTable,
    /// What the tool meets.
    #[serde(default)]
    pub wall: WallTable,
    /// What acts on the tool after that.
    #[serde(default)]
    pub push: PushTable,
    /// Noise of the force sensor in the handle.
    #[serde(default)]
    pub noise: NoiseTable,
}

/// Motion of the operator's hand.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StrokeTable {
    /// Along x [m].
    pub shift: f64,
    /// About z [rad]; not where forces alone are reflected.
    pub turn: f64,
    /// Its duration [s].
    pub time: f64,
    /// Time that the hand stays [s].
    pub stay: f64,
}

/// A wall across x.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WallTable {
    /// Distance from the tool at the start [m].
    pub clearance: f64,
    /// Stiffness [N/m].
    pub stiffness: f64,
    /// Damping [N·s/m].
    pub damping: f64,
}

/// A force on the tool, under matched impedances.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PushTable {
    /// Along the axes of the base [N].
    pub force: [f64; 3],
    /// Where it acts, in the tool's frame [m].
    pub point: [f64; 3],
    /// Time to rise [s].
    pub ramp: f64,
    /// Time that is observed, from its start [s].
    pub time: f64,
}

/// Standard deviations of a force sensor.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseTable {
    /// [N]
    pub force: f64,
    /// [N·m]
    pub torque: f64,
}

impl Default for PushExperiment {
    /// 6 N, eight directions in the plane of x and y.
    fn default() -> Self {
        let (straight, oblique) = (6.0, 6.0 * std::f64::consts::FRAC_1_SQRT_2);
        let directions: [[f64; 2]; 8] = [
            [straight, 0.0],
            [oblique, oblique],
            [0.0, straight],
            [-oblique, oblique],
            [-straight, 0.0],
            [-oblique, -oblique],
            [0.0, -straight],
            [oblique, -oblique],
        ];
        let forces = directions.into_iter().map(|[x, y]| [x, y, 0.0]).collect();
        Self { forces, ramp: 0.3, time: 1.7, evaluated: 0.3 }
    }
}

impl Default for StrokeTable {
    fn default() -> Self {
        Self { shift: 0.05, turn: 0.15, time: 0.8, stay: 4.0 }
    }
}

impl Default for WallTable {
    fn default() -> Self {
        Self { clearance: 0.02, stiffness: 2000.0, damping: 20.0 }
    }
}

impl Default for PushTable {
    fn default() -> Self {
        Self { force: [0.0, 2.0, 0.0], point: [0.1, 0.0, 0.0], ramp: 0.2, time: 2.0 }
    }
}

impl Default for NoiseTable {
    fn default() -> Self {
        Self { force: 0.1, torque: 0.005 }
    }
}

const fn one_and_a_half() -> f64 {
    1.5
}

const fn two() -> f64 {
    2.0
}

const fn six() -> f64 {
    6.0
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
    release: Option<ReleaseExperiment>,
    follow: Option<FollowExperiment>,
    elbow: Option<ElbowExperiment>,
    #[serde(default)]
    push: PushExperiment,
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
pub fn load(path: &Path, model: &RobotModel) -> Result<ArmLaw, FileError> {
    super::check_robot(path, model, is_for(model), "an arm")?;
    file::load(path, "", |path, text| check(path, text, model))
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

    /// The settings of a bilateral experiment.
    pub const fn with_bilateral(&self, experiment: &BilateralExperiment) -> ImpedanceSettings {
        let BilateralExperiment { mass, damping, .. } = *experiment;
        let mut settings = self.with_damping(damping);
        let [x, y, z, ..] = &mut settings.impedance.mass;
        (*x, *y, *z) = (mass, mass, mass);
        settings
    }
}

impl PushExperiment {
    /// What is wrong with the forces.
    fn wrong_forces(&self) -> Option<Wrong> {
        let count = self.forces.len();
        if !(1..=MAX_VALUES).contains(&count) {
            let message = format!("push.forces has {count} values; possible are 1 to {MAX_VALUES}");
            return Some(Wrong::new("push.forces", message));
        }
        Wrong::any_outside("push.forces", self.forces.iter().flatten(), [-MAX_FORCE, MAX_FORCE], "N")
    }
}

impl File {
    fn law(self, model: &RobotModel) -> Result<ArmLaw, Vec<Wrong>> {
        let Self { title, control, release, follow, elbow, push, bilateral } = self;
        let settings = control
            .settings(model)
            .map_err(|(key, message)| vec![Wrong::new(format!("control.{key}"), message)])?;
        let law = ArmLaw { title, settings, release, follow, elbow, push, bilateral };
        let wrong = law.problems(model);
        if wrong.is_empty() { Ok(law) } else { Err(wrong) }
    }
}

impl ArmLaw {
    fn problems(&self, model: &RobotModel) -> Vec<Wrong> {
        let Self { release, follow, elbow, push, .. } = self;
        // To the millimetre: what is printed of it is no single-precision number.
        let max_displacement = (500.0 * f64::from(self.settings.max_deviation[0])).round() / 1e3;
        let mut ranges = vec![
            ("push.ramp", push.ramp, [0.0, MAX_TIME], "s"),
            ("push.time", push.time, [0.1, MAX_TIME], "s"),
            ("push.evaluated", push.evaluated, [0.01, push.time], "s"),
        ];
        let mut dampings = Vec::new();
        if let Some(release) = release {
            ranges.extend([
                ("release.displacement", release.displacement, [1e-3, max_displacement], "m"),
                ("release.observed", release.observed, [0.1, MAX_TIME], "s"),
            ]);
            dampings.push(("release.damping", &release.damping[..]));
        }
        if let Some(follow) = follow {
            ranges.extend([
                ("follow.amplitude", follow.amplitude, [1e-3, 0.12], "m"),
                ("follow.frequency", follow.frequency, [0.1, 2.0], "Hz"),
                ("follow.duration", follow.duration, [1.0, MAX_TIME], "s"),
                ("follow.rest", follow.rest, [0.1, MAX_TIME], "s"),
                ("follow.link.delay", follow.link.delay, [0.0, 0.1], "s"),
                ("follow.link.jitter", follow.link.jitter, [0.0, 0.1], "s"),
                ("follow.link.loss", follow.link.loss, [0.0, 0.5], ""),
                ("follow.tremor", follow.tremor, [0.0, 1e-3], "m"),
            ]);
            dampings.push(("follow.damping", std::slice::from_ref(&follow.damping)));
            dampings.push(("follow.curve", &follow.curve));
        }
        if let Some(elbow) = elbow {
            ranges.extend([
                ("elbow.angle", elbow.angle, [0.05, 0.8], "rad"),
                ("elbow.time", elbow.time, [0.3, 3.0], "s"),
                ("elbow.rest", elbow.rest, [0.5, MAX_TIME], "s"),
            ]);
        }
        let ranges = ranges
            .into_iter()
            .filter_map(|(key, value, range, unit)| Wrong::outside(key, value, range, unit));
        let dampings =
            dampings.into_iter().filter_map(|(key, values)| self.wrong_damping(key, values, model));
        ranges
            .chain(dampings)
            .chain(self.wrong_release())
            .chain(push.wrong_forces())
            .chain(Wrong::title(&self.title))
            .chain(self.wrong_bilateral(model))
            .collect()
    }

    /// That the theory of the release does not hold for this impedance, if it does not.
    fn wrong_release(&self) -> Option<Wrong> {
        let Impedance { axes, coupling, .. } = self.settings.impedance;
        let is_simple = axes == ImpedanceAxes::Base && coupling.is_none();
        (self.release.is_some() && !is_simple).then(|| {
            let message = "release: its theory is that of a single axis: leave it out, or give matrices in the axes of the \
                           base without coupling";
            Wrong::new("release", message)
        })
    }

    /// What is wrong with the bilateral experiment, if there is one.
    fn wrong_bilateral(&self, model: &RobotModel) -> Option<Wrong> {
        let experiment = self.bilateral.as_ref()?;
        let settings = self.with_bilateral(experiment);
        if let Err(problem) = settings.validate(model.joints.len()) {
            return Some(Wrong::new("bilateral", format!("bilateral: {problem}")));
        }
        if experiment.coupling == ForceFeedback::Matched
            && MatchedImpedance::try_new(&settings.impedance).is_err()
        {
            let message = "bilateral.coupling: \"matched\" needs an impedance in the axes of the base, without coupling, \
                           and a stiffness along and about each of them";
            return Some(Wrong::new("bilateral.coupling", message));
        }
        let BilateralExperiment { delays, stroke, wall, push, noise, .. } = experiment;
        let ranges = [
            ("bilateral.stroke.shift", stroke.shift, [1e-3, 0.12], "m"),
            ("bilateral.stroke.turn", stroke.turn.abs(), [0.0, 0.5], "rad"),
            ("bilateral.stroke.time", stroke.time, [0.1, MAX_TIME], "s"),
            ("bilateral.stroke.stay", stroke.stay, [0.5, MAX_TIME], "s"),
            ("bilateral.wall.clearance", wall.clearance, [0.0, 0.2], "m"),
            ("bilateral.wall.stiffness", wall.stiffness, [10.0, 1e5], "N/m"),
            ("bilateral.wall.damping", wall.damping, [0.0, 1e3], "N·s/m"),
            ("bilateral.push.ramp", push.ramp, [0.0, MAX_TIME], "s"),
            ("bilateral.push.time", push.time, [0.5, MAX_TIME], "s"),
            ("bilateral.noise.force", noise.force, [0.0, 10.0], "N"),
            ("bilateral.noise.torque", noise.torque, [0.0, 1.0], "N·m"),
        ];
        let outside =
            ranges.into_iter().find_map(|(key, value, range, unit)| Wrong::outside(key, value, range, unit));
        let force = || Wrong::any_outside("bilateral.push.force", &push.force, [-MAX_FORCE, MAX_FORCE], "N");
        let point = || Wrong::any_outside("bilateral.push.point", &push.point, [-0.5, 0.5], "m");
        if let Some(wrong) = outside.or_else(force).or_else(point) {
            return Some(wrong);
        }
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
