//! The experiments of Arm7, sections 3.1 and 3.2 (figures 5 and 7), under laws side by side on the same
//! machines.

mod follow;
mod release;

use std::cell::Cell;

use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki_description::law::arm::{self, ArmLaw, FollowExperiment, LinkTable, Setpoint};

use super::arm::{ArmRig, ArmTrial, Machine};
use super::common::{capitalized, clear_faults};
use super::unilateral::{Operator, Slave, lead};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::law::tell_apart;
use crate::operator::LinkValues;
use crate::report::{Figure, Line, Metric, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-paper",
    title: "Arm7: release and master-slave, the paper's law and ours",
    about: "figures 5 and 7 of the Arm7 paper under its law, with and without its friction term, and under ours",
    robot: "arm7",
    kind: Kind::Arm,
    files: &[],
    results: "docs/papers/arm7.md",
    duration: 703.3,
    shortest: None,
    laws: Some(&["paper", "paper-without-friction", "tesaki"]),
    lead: &[
        "The experiments of the paper on the slave arm of TELESAR II, under each law in robots/arm7/laws, on the \
         same machines. The paper's law is the one that it prints: steps 1 to 6 on the measured state, held for \
         the control period of 10 ms, with a friction term. Paper's numbers: M 1.5 kg, K 300 N/m, B 7.5 and \
         30 N·s/m, 3 cm; 7 mm at the reversals and 3 mm at rest. Not in the paper, and ours: lengths, masses, \
         friction, control period, link, tremor, the hand's motion, and the damping of the master-slave \
         experiment, which is a fit; the curves show what depends on it.",
        "Figure 5, the release: on a machine that matches the model, with a friction equivalent to 0.1 N at the \
         tool; and on a machine whose masses, inertias, friction and torque constants differ by up to 20 % from \
         the model and whose friction, 0.3 N·m a joint, is what the paper's 3 mm at rest imply.",
        "Figure 7, the master-slave experiment: that second machine. The hand moves along x; the error is the \
         true position of the tool minus that of the hand at the same time. Directly: the master's samples \
         arrive at once. Over the link: 20 to 23 ms later, 2 % of them are lost.",
    ],
    run,
};

/// The machines: key, name in texts.
pub(super) const MACHINES: [(&str, &str, Machine); 2] = [
    ("matched", "the matched machine", Machine::Matched),
    ("mismatched", "the mismatched machine", Machine::KnownPaperFriction),
];
/// When the operator closes the clutch [s].
const CLOSE: f64 = 0.5;

/// A law with the name of its file.
pub(super) struct NamedLaw {
    /// Name of its file, and as a part of the names of metrics.
    pub name: String,
    pub key: String,
    /// Its colour in figures.
    pub colour: usize,
    pub law: ArmLaw,
    /// Trials that a fault ended.
    faults: Cell<u32>,
}

impl NamedLaw {
    /// The laws that a run compares, checked for the robot.
    pub fn load_all(setting: &Setting<'_, '_>, rig: &ArmRig) -> Result<Vec<Self>, ScenarioError> {
        let laws = setting.laws.iter().enumerate().map(|(colour, file)| {
            let law = arm::load(&file.path, &rig.robot.model)?;
            let (name, key, colour) = (file.name.clone(), file.key(), colour % Line::INK);
            Ok(Self { name, key, colour, law, faults: Cell::new(0) })
        });
        let mut laws = laws.collect::<Result<Vec<Self>, ScenarioError>>()?;
        let titles = laws.iter_mut().map(|law| &mut law.law.title);
        tell_apart(setting.laws.iter().map(|file| file.name.as_str()).zip(titles));
        Ok(laws)
    }

    /// A section of the law, which this scenario runs.
    pub fn need<'a, S>(&self, section: &'a Option<S>, name: &'static str) -> Result<&'a S, ScenarioError> {
        section.as_ref().ok_or_else(|| ScenarioError::LawWithout { law: self.name.clone(), section: name })
    }

    /// The motion of the operator, and how its set-points are made.
    pub fn follow(&self) -> Result<&FollowExperiment, ScenarioError> {
        self.need(&self.law.follow, "[follow]")
    }

    /// What came of a trial; `None` when a fault ended it, which is a result, too: it is counted and cleared.
    pub fn survives<T>(
        &self,
        setting: &mut Setting<'_, '_>,
        trial: Result<T, ScenarioError>,
    ) -> Result<Option<T>, ScenarioError> {
        if let Err(ScenarioError::Fault { .. }) = trial {
            clear_faults(setting.controller)?;
            self.faults.set(self.faults.get() + 1);
            return Ok(None);
        }
        trial.map(Some)
    }

    /// The operator leads the slave of `trial` from `target` on for a time, with the set-points of the law.
    /// `observe` sees the time and each set-point.
    pub fn lead(
        &self,
        trial: &mut ArmTrial<'_, '_>,
        target: (PosePoint, ElbowSetpoint),
        operator: &mut Operator,
        duration: f64,
        observe: impl FnMut(&Operator, f64, &PosePoint),
    ) -> Result<(), ScenarioError> {
        let mut slave = match self.follow()?.setpoint {
            Setpoint::Sample => Slave::sample(target),
            Setpoint::Predicted => Slave::predicted(target),
        };
        lead(trial, &mut slave, operator, duration, &[(CLOSE, true)], observe)
    }

    /// Adds the number of trials that a fault ended.
    pub fn add_faults(&self, summary: &mut Summary) {
        let text = format!("{}: trials that a fault ended", capitalized(&self.law.title));
        summary.insert(format!("{}_faults", self.key), Metric::reported(text, self.faults.get().into(), ""));
    }
}

/// Runs `trial` under every law on every machine; `figures` draws those on one machine.
pub(super) fn compare<'a, T>(
    setting: &mut Setting<'_, '_>,
    mut rig: ArmRig,
    laws: &'a [NamedLaw],
    trial: impl Fn(
        &mut Setting<'_, '_>,
        &mut ArmRig,
        &'a NamedLaw,
        Machine,
        &str,
    ) -> Result<Recorded<T>, ScenarioError>,
    add_metrics: impl Fn(&mut Summary, &T, &str, &str),
    draw: impl Fn(&[T], &str) -> Vec<Figure>,
) -> Result<Outcome, ScenarioError> {
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for (key, name, machine) in MACHINES {
        let mut traces = Vec::new();
        for law in laws {
            let trial = trial(setting, &mut rig, law, machine, name);
            let Some((trace, table)) = law.survives(setting, trial)? else { continue };
            add_metrics(&mut summary, &trace, key, name);
            tables.push((format!("{key}_{}.csv", law.key), table));
            traces.push(trace);
        }
        figures.extend(draw(&traces, name));
    }
    laws.iter().for_each(|law| law.add_faults(&mut summary));
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

/// What a trial leaves, and its table as CSV.
pub(super) type Recorded<T> = (T, String);

/// A link as a law says.
pub(super) const fn link(table: &LinkTable) -> LinkValues {
    let LinkTable { delay, jitter, loss } = *table;
    LinkValues { delay, jitter, loss, burst: 0.0 }
}

/// The name of a damping in those of metrics: `b7_5`.
fn damping_key(damping: f32) -> String {
    format!("b{damping}").replace('.', "_")
}

/// B [N·s/m], overshoot [mm], error at the reversals [mm], from `tests/oracles/printed_arm.py`: a mass with
/// the acceleration of step 3, held for a period, released, and after the samples of a master.
#[cfg(test)]
const PRINTED: &[[f64; 3]] = include!("../../../tests/oracles/data/printed_arm.in");

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let laws = NamedLaw::load_all(setting, &rig)?;
    for law in &laws {
        law.need(&law.law.release, "[release]")?;
        law.follow()?;
    }
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    release::run(setting, &mut rig, &laws, &mut summary, &mut figures, &mut tables)?;
    follow::run(setting, &mut rig, &laws, &mut summary, &mut figures, &mut tables)?;
    laws.iter().for_each(|law| law.add_faults(&mut summary));
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}
