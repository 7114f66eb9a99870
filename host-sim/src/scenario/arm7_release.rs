//! Free response of the impedance-controlled tool after it is displaced by 3 cm and released (Arm7, section
//! 3.1), compared with the exact solution.

use rapier3d::na::Vector3;
use tesaki::task::impedance::{DirectLaw, ImpedanceSettings, Law};

use super::arm::{ArmLog, ArmRig, ArmTrial, Machine, settings};
use super::common::{T, capitalized, largest};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::plant::Hold;
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-release",
    title: "The arm released under impedance control",
    about: "the tool is displaced by 3 cm along each axis and released, under the paper's law and under ours",
    robot: "arm7",
    kind: Kind::SevenJointArm,
    files: &[],
    results: "docs/measurements.md#an-arm-under-impedance-control",
    duration: 96.0,
    shortest: None,
    laws: None,
    lead: &[
        "The tool of the seven-joint arm, with the elbow at 90°, has the impedance M = 1.5 kg, K = 300 N/m, \
         and B = 7.5 or 30 N·s/m. A person displaces it by 3 cm along an axis, holds it there and releases \
         it just before the force sensor is read. The motion is compared with the exact one of a mass on a \
         spring and a damper. If it is released halfway between two readings, the controller notices half a \
         control period late.",
        "Three machines: one that matches the controller's model, except for sensor noise and a friction \
         equivalent to 0.1 N at the tool; one whose masses, inertias, friction and torque constants differ \
         by up to 20 %; and the same machine under the Arm7 paper's law with its misprints corrected, which uses the measured \
         state, holds its acceleration for a control period, and does not compensate friction. The paper \
         reports that it was difficult to come close to the theory.",
    ],
    run,
};

/// The tool is released before a reading of the force sensor by this many averaging windows, so that the
/// reading no longer contains the hold.
const RELEASE_LEAD: f64 = 1.05;
/// Displacement of the tool [m].
const DISPLACEMENT: f64 = 0.03;
/// Time to displace the tool, to hold it, and after the release [s].
const DISPLACE_TIME: f64 = 0.8;
const HOLD_TIME: f64 = 0.7;
const AFTER: f64 = 2.0;

struct Trial {
    name: &'static str,
    label: &'static str,
    machine: Machine,
    law: Law,
    /// Time from the release to the next reading of the force sensor [s]; `None`: just before the reading.
    before: Option<f64>,
    /// Limit of the deviation from the exact motion [mm].
    limit: Option<f64>,
}

const TRIALS: [Trial; 4] = [
    Trial {
        name: "matched",
        label: "matched model",
        machine: Machine::Matched,
        law: Law::ModelFollowing,
        before: None,
        limit: Some(0.3),
    },
    Trial {
        name: "half_period",
        label: "matched model, released between two readings",
        machine: Machine::Matched,
        law: Law::ModelFollowing,
        before: Some(0.5 * T),
        limit: None,
    },
    Trial {
        name: "mismatched",
        label: "mismatched model",
        machine: Machine::Mismatched,
        law: Law::ModelFollowing,
        before: None,
        limit: Some(1.5),
    },
    Trial {
        name: "paper",
        label: "the paper's law",
        machine: Machine::Mismatched,
        law: Law::Direct(DirectLaw::CORRECTED),
        before: None,
        limit: None,
    },
];
const DAMPINGS: [f32; 2] = [7.5, 30.0];
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];

/// How the tool is released.
pub(super) struct ReleaseTrial<'a> {
    pub label: &'a str,
    pub machine: Machine,
    pub settings: ImpedanceSettings,
    /// Displacement before the release [m].
    pub displacement: f64,
    /// Time from the release to the next reading of the force sensor [s]; `None`: just before the reading.
    pub before: Option<f64>,
    /// Time after the release that is observed [s].
    pub observed: f64,
}

/// One release.
pub(super) struct Release {
    pub axis: usize,
    pub damping: f64,
    mass: f64,
    stiffness: f64,
    pub log: ArmLog,
    /// Time of the first reading of the force sensor after the release, and time from the release to it [s].
    time: f64,
    before: f64,
    /// Time after the release that is observed [s].
    observed: f64,
}

impl Release {
    /// Time since the release [s], true displacement along the axis, and exact displacement [m].
    pub(super) fn curves(&self) -> [Vec<f64>; 3] {
        let samples = self.log.during(&(self.time - T..self.time + self.observed));
        let displacement =
            |index: usize| samples[index].position()[self.axis] - samples[index].target[self.axis];
        let time: Vec<f64> = samples.iter().map(|sample| sample.time - self.time + self.before).collect();
        let measured: Vec<f64> = (0..samples.len()).map(displacement).collect();
        let start = measured.first().copied().unwrap_or(f64::NAN);
        let exact = time.iter().map(|&time| self.free_response(start, time.max(0.0))).collect();
        [time, measured, exact]
    }

    /// The largest deviation from the exact motion [mm].
    pub(super) fn error(&self) -> f64 {
        let [_, measured, exact] = self.curves();
        1e3 * largest(measured.iter().zip(&exact).map(|(measured, exact)| (measured - exact).abs()))
    }

    /// Free response of the impedance, released at rest from the displacement `start` [m].
    fn free_response(&self, start: f64, time: f64) -> f64 {
        let decay = self.damping / (2.0 * self.mass);
        let square = self.stiffness / self.mass - decay * decay;
        if square <= 0.0 {
            // Overdamped.
            let rate = (-square).sqrt().max(1e-6);
            let (up, down) = (((rate - decay) * time).exp(), ((-rate - decay) * time).exp());
            return 0.5 * start * (up + down + decay / rate * (up - down));
        }
        let frequency = square.sqrt();
        let (sine, cosine) = (frequency * time).sin_cos();
        (-decay * time).exp() * start * (cosine + decay / frequency * sine)
    }

    /// The largest lateral deviation of the tool from the axis [mm].
    fn lateral_deviation(&self) -> f64 {
        let samples = self.log.during(&(self.time..self.time + self.observed));
        let lateral = |sample: &super::arm::ArmSample| {
            let mut deviation = sample.position() - sample.target;
            deviation[self.axis] = 0.0;
            deviation.norm()
        };
        1e3 * largest(samples.iter().map(lateral))
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for trial in &TRIALS {
        let mut releases = Vec::new();
        for damping in DAMPINGS {
            let how = ReleaseTrial {
                label: trial.label,
                machine: trial.machine,
                settings: ImpedanceSettings { law: trial.law, ..settings(damping) },
                displacement: DISPLACEMENT,
                before: trial.before,
                observed: AFTER,
            };
            for (axis, name) in AXES.into_iter().enumerate() {
                let release = release(setting, &mut rig, &how, axis)?;
                tables.push((format!("{}_{}_{damping}.csv", trial.name, name), release.log.table()));
                releases.push(release);
            }
        }
        add_metrics(&mut summary, trial, &releases);
        figures.push(figure(trial, &releases));
    }
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

/// Displaces the tool along an axis and releases it.
pub(super) fn release(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    trial: &ReleaseTrial<'_>,
    axis: usize,
) -> Result<Release, ScenarioError> {
    let impedance = trial.settings.impedance;
    let [mass, damping, stiffness] =
        [impedance.mass, impedance.damping, impedance.stiffness].map(|values| f64::from(values[axis]));
    let label = format!("{}, B {damping} N·s/m, {}", trial.label, AXES[axis]);
    let mut arm_trial = ArmTrial::begin(setting, rig, &label, trial.machine, trial.settings)?;
    arm_trial.wait(0.5)?;
    let (target, _) = arm_trial.start();
    let mut position = Vector3::from(target.position).map(f64::from);
    position[axis] += trial.displacement;
    arm_trial
        .plant
        .hold_tip(0, Hold::firm(position.into(), target.rotation.map(f64::from), DISPLACE_TIME))?;
    arm_trial.wait(DISPLACE_TIME + HOLD_TIME)?;
    let before = trial.before.unwrap_or(RELEASE_LEAD * arm_trial.plant.force_window());
    arm_trial.plant.release_tip(0, T - before)?;
    arm_trial.tick()?;
    let time = arm_trial.log.now();
    arm_trial.wait(trial.observed)?;
    let observed = trial.observed;
    Ok(Release { axis, damping, mass, stiffness, log: arm_trial.end()?, time, before, observed })
}

fn add_metrics(summary: &mut Summary, trial: &Trial, releases: &[Release]) {
    let label = capitalized(trial.label);
    for damping in DAMPINGS {
        let of_damping =
            || releases.iter().filter(move |release| release.damping.total_cmp(&f64::from(damping)).is_eq());
        let worst = largest(of_damping().map(Release::error));
        let text = format!("{label}, B {damping}: largest deviation from the exact motion");
        let metric = match trial.limit {
            Some(limit) => Metric::at_most(text, worst, limit, "mm"),
            None => Metric::reported(text, worst, "mm"),
        };
        summary.insert(format!("{}_b{}_error_peak", trial.name, damping.round()), metric);
        let worst = largest(of_damping().map(Release::lateral_deviation));
        let text = format!("{label}, B {damping}: largest distance from the axis");
        summary.insert(
            format!("{}_b{}_lateral_deviation", trial.name, damping.round()),
            Metric::reported(text, worst, "mm"),
        );
    }
}

fn figure(trial: &Trial, releases: &[Release]) -> Figure {
    let caption = "Displacement of the tool along the axis of each release, and the exact motion (dashed).";
    let mut figure = Figure::stacked(capitalized(trial.label), caption, "time", "s").event(0.0, "released");
    for damping in DAMPINGS {
        let mut panel = Panel::new(format!("B {damping} N·s/m"), "displacement", "mm");
        for release in
            releases.iter().filter(|release| release.damping.total_cmp(&f64::from(damping)).is_eq())
        {
            let [time, measured, exact] = release.curves();
            let millimetres = |values: Vec<f64>| values.into_iter().map(|value| 1e3 * value).collect();
            panel = panel
                .line(Line::solid(AXES[release.axis], release.axis, time.clone(), millimetres(measured)))
                .line(Line::dashed("exact", Line::INK, time, millimetres(exact)));
        }
        figure = figure.panel(panel);
    }
    figure
}
