//! Figures 12 and 13: weights are put on the held box.

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki_description::law::hand::WeightsExperiment;

use super::{Law, Metrics, ScenarioError, Setting, Summary, compare, hold_box, mean};
use crate::plant::Load;
use crate::report::{Figure, Line, Panel};
use crate::scenario::grasping::{
    GraspLog, GraspRig, GraspSample, component_targets, components, internal_forces, table,
};

/// Point where the weights act: the middle of the top, in the box's frame [m].
const TOP: [f64; 3] = [0.0, 0.0, 0.03];
/// Time at the end of each step in which the load is evaluated [s].
const EVALUATED: f64 = 0.5;
/// Rest before the first weight [s].
const REST: f64 = 1.0;

/// What happened under a law.
struct Record {
    log: GraspLog,
    /// When each weight began to be put on [s].
    begins: Vec<f64>,
    /// Unit vector of gravity.
    down: Vector3<f64>,
}

impl Record {
    fn span(&self) -> Range<f64> {
        self.begins.first().map_or(f64::NAN, |begin| begin - REST)..self.log.now()
    }

    /// Load on the fingers, against gravity, by the force sensors [N].
    fn sensed(&self, sample: &GraspSample) -> f64 {
        -self.down.dot(&sample.estimates.sensed_forces.iter().sum::<Vector3<f64>>())
    }

    /// Largest difference of a step's sensed load from the true one, apart from that of the empty box [N].
    fn error(&self, experiment: &WeightsExperiment) -> f64 {
        let Some(&first) = self.begins.first() else { return f64::NAN };
        let empty = mean(&self.log, &(first - EVALUATED..first), |sample| self.sensed(sample));
        let errors = self.begins.iter().map(|begin| {
            let end = begin + experiment.interval;
            let sensed = mean(&self.log, &(end - EVALUATED..end), |sample| self.sensed(sample));
            let added = mean(&self.log, &(end - EVALUATED..end), |sample| 9.81 * sample.object.load);
            (sensed - empty - added).abs()
        });
        errors.fold(0.0, |a: f64, b| if b.is_nan() || a.is_nan() { f64::NAN } else { a.max(b) })
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
    let coulomb = rig.values.friction.paper;
    let down = Vector3::from(rig.values.gravity).normalize();
    let mut records = Vec::new();
    for law in laws {
        let experiment = &law.law.weights;
        let label = format!("weights, {}", law.name);
        let mut trial = hold_box(setting, rig, &label, (law, &experiment.law), coulomb)?;
        trial.wait(REST)?;
        let mut begins = Vec::new();
        let mut before = 0.0;
        for &mass in &experiment.masses {
            begins.push(trial.log.now());
            trial.note(&format!("{:.0} g", 1e3 * mass));
            // One in place of the other: what is added is the difference.
            let added = if experiment.cumulative { mass } else { mass - before };
            before = mass;
            if added > 0.0 {
                trial.plant.load(Load { mass: added, point: TOP, ramp: experiment.ramp })?;
            } else {
                trial.plant.unload(experiment.ramp);
                trial.plant.load(Load { mass, point: TOP, ramp: experiment.ramp })?;
            }
            trial.wait(experiment.interval)?;
        }
        let record = Record { log: trial.end()?, begins, down };
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
        let panel = Panel::new(law.name.as_str(), "force", "N")
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
        let panel = Panel::new(law.name.as_str(), "force", "N");
        let panel = components(panel, &record.log, &span, |sample| sample.estimates.sensed_forces[0]);
        let panel = component_targets(panel, &record.log, &span, |sample| sample.estimates.target_forces[0]);
        figure = figure.panel(panel);
    }
    figure
}
