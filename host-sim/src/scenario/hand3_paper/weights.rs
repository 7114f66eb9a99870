//! Figures 12 and 13: weights are put on the held box.

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki_description::law::hand::WeightsExperiment;

use super::{Law, Metrics, ScenarioError, Setting, Summary, compare, hold_box, mean};
use crate::plant::Load;
use crate::report::{Figure, Line, Panel};
use crate::scenario::common::largest;
use crate::scenario::grasping::{
    GraspLog, GraspRig, GraspSample, component_targets, components, internal_forces, table,
};

/// What happened under a law.
struct Record {
    log: GraspLog,
    /// When each weight began to be put on [s].
    begins: Vec<f64>,
    /// Rest before the first [s].
    rest: f64,
    /// Unit vector of gravity.
    down: Vector3<f64>,
}

impl Record {
    fn span(&self) -> Range<f64> {
        self.begins.first().map_or(f64::NAN, |begin| begin - self.rest)..self.log.now()
    }

    /// Load on the fingers, against gravity, by the force sensors [N].
    fn sensed(&self, sample: &GraspSample) -> f64 {
        -self.down.dot(&sample.estimates.sensed_forces.iter().sum::<Vector3<f64>>())
    }

    /// Largest difference of a step's sensed load from the true one, apart from that of the empty box [N].
    fn error(&self, experiment: &WeightsExperiment) -> f64 {
        let Some(&first) = self.begins.first() else { return f64::NAN };
        let evaluated = experiment.evaluated;
        let empty = mean(&self.log, &(first - evaluated..first), |sample| self.sensed(sample));
        let errors = self.begins.iter().map(|begin| {
            let end = begin + experiment.interval;
            let sensed = mean(&self.log, &(end - evaluated..end), |sample| self.sensed(sample));
            let added = mean(&self.log, &(end - evaluated..end), |sample| 9.81 * sample.object.load);
            (sensed - empty - added).abs()
        });
        largest(errors)
    }
}

pub(super) fn run(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    laws: &[Law],
    summary: &mut Summary,
    figures: &mut Vec<Figure>,
    tables: &mut Vec<(String, String)>,
) -> Result<(), ScenarioError> {
    let mut records = Vec::new();
    for law in laws {
        let record = hold_and_load(setting, rig, law)?;
        tables.push((format!("weights-{}.csv", law.key), table(&record.log)));
        records.push(record);
    }
    let mut motions = Vec::new();
    for (law, record) in laws.iter().zip(&records) {
        let mut metrics = Metrics::new(summary, law, "weights", &record.log);
        let text = "largest error of the sensed weight";
        metrics.add("sensed_weight_error", text, record.error(&law.law.weights), "N", "");
        let motion = 1e3 * record.log.motion(&record.span());
        metrics.add("weights_motion", "largest motion of the box under weights", motion, "mm", "held");
        let sliding = 1e3 * record.log.sliding(&record.span());
        metrics.add("weights_sliding", "largest sliding of a fingertip under weights", sliding, "mm", "");
        motions.push(motion);
    }
    compare(summary, laws, "weights_motion", "Motion of the box under weights", &motions);
    figures.push(loads(laws, &records));
    figures.push(forces(laws, &records));
    Ok(())
}

/// Holds the box and puts the weights of a law on it.
fn hold_and_load(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    law: &Law,
) -> Result<Record, ScenarioError> {
    let (coulomb, down) = (rig.values.friction.paper, Vector3::from(rig.values.gravity).normalize());
    let experiment = &law.law.weights;
    let WeightsExperiment { ramp, rest, point, .. } = *experiment;
    let label = format!("weights, {}", law.name);
    let mut trial = hold_box(setting, rig, &label, (law, &experiment.law), coulomb)?;
    trial.wait(rest)?;
    let mut begins = Vec::new();
    let mut before = 0.0;
    for &mass in &experiment.masses {
        begins.push(trial.log.now());
        trial.note(&format!("{:.0} g", 1e3 * mass));
        // One in place of the other: what is added is the difference.
        let added = if experiment.cumulative { mass } else { mass - before };
        before = mass;
        if added > 0.0 {
            trial.plant.load(Load { mass: added, point, ramp })?;
        } else {
            trial.plant.unload(ramp);
            trial.plant.load(Load { mass, point, ramp })?;
        }
        trial.wait(experiment.interval)?;
    }
    Ok(Record { log: trial.end()?, begins, rest, down })
}

fn mark(mut figure: Figure, laws: &[Law], records: &[Record]) -> Figure {
    let (Some(law), Some(record)) = (laws.first(), records.first()) else { return figure };
    let mut total = 0.0;
    for (begin, mass) in record.begins.iter().zip(&law.law.weights.masses) {
        total = if law.law.weights.cumulative { total + mass } else { *mass };
        figure = figure.event(begin - record.span().start, format!("{:.0} g", 1e3 * total));
    }
    figure
}

fn loads(laws: &[Law], records: &[Record]) -> Figure {
    let caption = "For each law: the load on the fingers against gravity as the tared force sensors give it, that of the \
                   simulated contacts (dashed), and the internal part of the true force of finger 1. As in figure 12 \
                   of the Hand3 paper, which shows that the sensors see the weights. Under the paper's law the \
                   internal force is commanded once and for all; under ours it follows the load.";
    let figure = Figure::stacked("Hand3 figure 12: load on the box and internal force", caption, "time", "s");
    let mut figure = mark(figure, laws, records);
    for (law, record) in laws.iter().zip(records) {
        let samples = record.log.during(&record.span());
        let time: Vec<f64> = samples.iter().map(|sample| sample.time - record.span().start).collect();
        let sensed = samples.iter().map(|sample| record.sensed(sample)).collect();
        let truth = |sample: &GraspSample| -record.down.dot(&(0..3).map(|finger| sample.force(finger)).sum());
        let truth = samples.iter().map(truth).collect();
        let internal = samples.iter().map(|sample| internal_forces(sample)[0].norm()).collect();
        let panel = Panel::new(law.law.title.as_str(), "force", "N")
            .line(Line::solid("load, sensed", 0, time.clone(), sensed))
            .line(Line::solid("internal force of finger 1", 1, time.clone(), internal))
            .line(Line::dashed("load, true", Line::INK, time, truth));
        figure = figure.panel(panel);
    }
    figure
}

fn forces(laws: &[Law], records: &[Record]) -> Figure {
    let caption = "Force of finger 1 on the box by its tared sensor, in the hand's frame, and the controller's target \
                   (dashed), while weights are put on the box. As in figure 13 of the Hand3 paper.";
    let figure = Figure::stacked("Hand3 figure 13: force of finger 1 under weights", caption, "time", "s");
    let mut figure = mark(figure, laws, records);
    for (law, record) in laws.iter().zip(records) {
        let span = record.span();
        let panel = Panel::new(law.law.title.as_str(), "force", "N");
        let panel = components(panel, &record.log, &span, |sample| sample.estimates.sensed_forces[0]);
        let panel = component_targets(panel, &record.log, &span, |sample| sample.estimates.target_forces[0]);
        figure = figure.panel(panel);
    }
    figure
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::super::laws;
    use super::super::tests::log;
    use super::*;
    use crate::scenario::common::tests::with_setting;

    fn experiment(masses: &[f64]) -> (Law, WeightsExperiment) {
        with_setting("hand3", 1, &["paper"], |setting| {
            let rig = GraspRig::load(setting).unwrap();
            let law = laws(setting, &rig.robot.model).unwrap().swap_remove(0);
            let weights = WeightsExperiment { masses: masses.to_vec(), ..law.law.weights.clone() };
            (law, weights)
        })
    }

    /// Sensors that read 0.2 N of the empty box, 13 mN too much of 50 g and 31 mN too little of 300 g are 31
    /// mN off.
    #[test]
    fn the_error_of_the_sensed_weight_is_that_of_what_was_added() {
        let down = Vector3::new(-0.6, 0.0, -0.8);
        let log = log(6.0, |sample| {
            let (mass, error) = match sample.time {
                time if time > 3.5 => (0.3, -0.031),
                time if time > 1.5 => (0.05, 0.013),
                _ => (0.0, 0.0),
            };
            sample.object.load = mass;
            let sensed = -down * (0.2 + 9.81 * mass + error);
            sample.estimates.sensed_forces = [sensed * 0.5, sensed * 0.2, sensed * 0.3];
        });
        let record = Record { log, begins: vec![1.0, 3.0], rest: 1.0, down };
        let (_, experiment) = experiment(&[0.05, 0.3]);
        let error = record.error(&experiment);
        assert!((error - 0.031).abs() < 1e-9, "{error}");
    }

    /// The law of section 6.2: the internal force stays at the 4 N of paper.toml, and the load is what the
    /// sensors say. The least grip of our law would be below 1 N for the empty box.
    #[test]
    fn under_the_papers_law_the_grip_is_fixed_and_the_sensors_see_the_weight() {
        let (_, weights) = experiment(&[0.2]);
        with_setting("hand3", 1, &["paper"], |setting| {
            let mut rig = GraspRig::load(setting).unwrap();
            let mut laws = laws(setting, &rig.robot.model).unwrap();
            laws[0].law.weights = weights.clone();
            let record = hold_and_load(setting, &mut rig, &laws[0]).unwrap();
            assert_eq!(record.log.lost, None);
            let grip = |sample: &GraspSample| {
                let forces = sample.estimates.target_forces;
                let x = sample.estimates.orientation * Vector3::x();
                let [first, second, third] = forces.map(|force| force.dot(&x));
                // Each finger carries a third of the load.
                0.5 * (first + second - third) - (first + second + third) / 6.0
            };
            let last = record.log.samples.last().unwrap();
            for sample in [record.log.at(record.begins[0]).unwrap(), last] {
                assert!((grip(sample) - 4.0).abs() < 0.05, "{} N at {} s", grip(sample), sample.time);
            }
            // 200 g are 1.962 N. What the sensors read of it decides what the fingers push up with.
            let load = |sample: &GraspSample| -record.down.dot(&sample.estimates.load);
            let added = load(last) - load(record.log.at(record.begins[0]).unwrap());
            assert!((added.abs() - 1.962).abs() < 0.08, "{added} N");
            assert!(record.error(&weights) < 0.06, "{}", record.error(&weights));
        });
    }
}
