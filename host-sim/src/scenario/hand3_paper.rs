//! The experiments of the Hand3 paper as printed, under several laws side by side on one machine.

mod curve;
mod curves;
mod force;
mod motion;
mod step;
mod weights;

use std::ops::Range;

use tesaki::model::RobotModel;
use tesaki_description::law::hand::{self, HandLaw, ObjectLaw};

use super::grasping::{GraspLog, GraspRig, GraspSample, GraspTrial, GraspedObject};
use super::{Scenario, ScenarioError, Setting};
use crate::law::tell_apart;
use crate::report::{Metric, Summary};

pub(super) const FORCE: Scenario = force::SCENARIO;
pub(super) const MOTION: Scenario = motion::SCENARIO;
pub(super) const CURVES: Scenario = curves::SCENARIO;

/// The laws that are compared when nothing else is asked for.
const LAWS: &[&str] = &["paper", "tesaki"];

/// A law of the run.
#[derive(Clone)]
struct Law {
    /// For people.
    name: String,
    /// For the names of metrics and files.
    key: String,
    law: HandLaw,
    /// The robot with the gains of the law.
    model: RobotModel,
}

/// The laws of the run.
fn laws(setting: &Setting<'_, '_>, model: &RobotModel) -> Result<Vec<Law>, ScenarioError> {
    let read = |file: &crate::law::LawFile| {
        let law = hand::load(&file.path, model)?;
        let mut model = model.clone();
        law.servo.apply(&mut model);
        Ok(Law { name: file.name.clone(), key: file.key(), law, model })
    };
    let mut laws = setting.laws.iter().map(read).collect::<Result<Vec<Law>, ScenarioError>>()?;
    tell_apart(laws.iter_mut().map(|law| (law.name.as_str(), &mut law.law.title)));
    Ok(laws)
}

impl Law {
    /// What the controller is told of a machine whose joints have the nominal Coulomb friction `coulomb`
    /// [N·m].
    fn model(&self, coulomb: f64) -> RobotModel {
        let mut model = self.model.clone();
        if self.law.servo.knows_friction {
            model.joints.iter_mut().for_each(|joint| joint.friction.coulomb = coulomb as f32);
        }
        model
    }
}

/// Grasps the box as a law says of this experiment, on joints with the Coulomb friction `coulomb` [N·m], and
/// removes the support.
fn hold_box<'a, 'b>(
    setting: &'a mut Setting<'_, 'b>,
    rig: &'a mut GraspRig,
    label: &str,
    (law, object): (&Law, &ObjectLaw),
    coulomb: f64,
) -> Result<GraspTrial<'a, 'b>, ScenarioError> {
    rig.robot.model = law.model(coulomb);
    let held = GraspedObject {
        change: &|grasp| object.apply(&mut grasp.plan),
        coulomb: Some(coulomb),
        records_forces: true,
        ..GraspedObject::new(label, "box")
    };
    GraspTrial::without_support(setting, rig, &held)
}

/// Adds the metrics of a law; those that a lost box leaves unknown are left out.
struct Metrics<'a> {
    summary: &'a mut Summary,
    law: &'a Law,
    lost: Option<String>,
}

impl<'a> Metrics<'a> {
    /// Those of a part of the experiments, with whether the box was lost in it.
    fn new(summary: &'a mut Summary, law: &'a Law, part: &str, log: &GraspLog) -> Self {
        let lost = log.lost.as_ref().map(|lost| format!("the box was lost {lost}"));
        let mut metrics = Self { summary, law, lost };
        let value = f64::from(u8::from(log.lost.is_some()));
        metrics.add(&format!("{part}_lost"), &format!("{part}: the box was lost"), value, "", "");
        metrics
    }

    fn add(&mut self, key: &str, text: &str, value: f64, unit: &str, paper: &str) {
        if !value.is_finite() {
            return;
        }
        let mut metric = Metric::reported(format!("{}: {text}", self.law.name), value, unit);
        metric.paper = (!paper.is_empty()).then(|| paper.to_owned());
        metric.note.clone_from(&self.lost);
        self.summary.insert(format!("{}_{key}", self.law.key), metric);
    }
}

/// Compares the errors of the first law with those of the others: how many times as large they are.
fn compare(summary: &mut Summary, laws: &[Law], key: &str, text: &str, errors: &[f64]) {
    let mut laws = laws.iter().zip(errors);
    let Some((first, first_error)) = laws.next() else { return };
    for (other, error) in laws {
        let factor = first_error / error;
        if factor.is_finite() {
            let text = format!("{text}: {} over {}", first.name, other.name);
            summary.insert(
                format!("{}_over_{}_{key}", first.key, other.key),
                Metric::reported(text, factor, ""),
            );
        }
    }
}

/// Mean of a value over a time span; NaN if it was not recorded to its end.
fn mean(log: &GraspLog, span: &Range<f64>, value: impl Fn(&GraspSample) -> f64) -> f64 {
    let samples = log.during(span);
    samples.iter().map(value).sum::<f64>() / samples.len() as f64
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
pub(super) mod tests {
    use rapier3d::na::Vector3;

    use crate::plant::ObjectTruth;
    use crate::scenario::common::T;
    use crate::scenario::grasping::{GraspEstimates, GraspLog, GraspSample};

    /// A log of a time [s] with an object at rest in the origin, changed by `record` in each sample.
    pub fn log(time: f64, record: impl Fn(&mut GraspSample)) -> GraspLog {
        let object = ObjectTruth {
            position: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity: [0.0; 3],
            angular_velocity: [0.0; 3],
            load: 0.0,
            friction: 0.5,
            support_force: [0.0; 3],
        };
        let samples = (0..(time / T).round() as u32).map(|tick| {
            let mut sample = GraspSample {
                time: f64::from(tick) * T,
                object: object.clone(),
                contacts: Vec::new(),
                joints: Vec::new(),
                estimates: GraspEstimates::UNKNOWN,
                target: [Vector3::zeros(); 2],
            };
            record(&mut sample);
            sample
        });
        GraspLog { samples: samples.collect(), held: 0.0, ..GraspLog::default() }
    }
}
