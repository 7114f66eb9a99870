//! Disturbance of a held box: weights are added one at a time and cumulatively, then it is pushed (Hand3,
//! section 6 and figures 12 and 13).

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki_description::grasp::PlacedGrasp;

use super::common::largest;
use super::grasping::{
    GraspLog, GraspRig, GraspTrial, GraspedObject, GripRatio, LIFT, component_targets, components,
    grip_ratio, internal_forces, table,
};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting, needs};
use crate::plant::{Load, Push};
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-weights",
    title: "Weights on a box in the three-finger hand",
    about: "weights of 50 to 300 g are put on a held box and taken off, then all are put on at once, then it \
            is pushed",
    robot: "hand3",
    kind: Kind::GraspingHand,
    files: needs::BOX,
    results: "docs/measurements.md#weights",
    duration: 35.0,
    shortest: None,
    laws: None,
    lead: &[
        "The hand locates and grasps a box of 23 g, probes its friction, and lifts it by 1 cm to the Hand3 paper's \
         position. Weights of 50, 100, 200 and 300 g are put on the middle of its top and removed, one at a \
         time, each within 0.3 s. Then all of them are added one after the other, 650 g in total, and \
         removed together. Finally the box is pushed from the side with 0.3 N. The hand only knows of this \
         through its force sensors.",
        "Motion is that of the true box since the start of each part. Sliding is the longest path of a \
         fingertip along the box while its contact force was at the friction limit. The grip ratio is taken \
         one second after each weight: the sum of the true normal forces, divided by that of the least \
         grip, the smallest forces that hold the true load with the true friction.",
    ],
    run,
};

/// The weights [kg].
pub(super) const WEIGHTS: [f64; 4] = [0.05, 0.1, 0.2, 0.3];
/// Point where the weights act: the middle of the top, in the box's frame [m].
pub(super) const TOP: [f64; 3] = [0.0, 0.0, 0.03];
/// Time in which a weight is added or removed [s].
const RAMP: f64 = 0.3;
/// Time from one weight to the next [s].
const STEP: f64 = 2.0;
/// Time from when a weight is on until the grip is evaluated [s].
const GRIP_AFTER: f64 = 1.0;
/// Force of the push from the side [N], and its duration [s].
pub(super) const PUSH: f64 = 0.3;
const PUSH_TIME: f64 = 1.5;
/// Limits of each part: motion [mm], sliding [mm] and grip ratio.
const MAX_MOTION: f64 = 0.5;
const MAX_SLIDING: f64 = 0.1;
const MAX_GRIP_RATIO: f64 = 1.5;
/// Rated torque of the joints [N·m].
const RATED_TORQUE: f64 = 0.6;

/// A part of the trial, with one kind of disturbance.
struct Part {
    name: &'static str,
    label: &'static str,
    span: Range<f64>,
}

/// A weight that was added.
struct AddedWeight {
    part: &'static str,
    /// Total mass on the box [kg].
    mass: f64,
    /// The grip one second later, if the box was still held.
    grip: Option<GripRatio>,
}

struct Record {
    parts: Vec<Part>,
    weights: Vec<AddedWeight>,
    empty: Option<GripRatio>,
    /// Times of the events [s], and their labels.
    events: Vec<(f64, String)>,
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = GraspRig::load(setting)?;
    let gravity = Vector3::from(rig.values.gravity);
    let model = rig.robot.model.clone();
    let limit = f64::from(rig.grasp("box")?.plan.force_limit);
    let grip = |log: &GraspLog| grip_ratio(&model, log.samples.last()?, limit);
    // The box stands lower by the lift, so that it has the paper's position after it.
    let down = gravity * (LIFT / gravity.norm());
    let change = |grasp: &mut PlacedGrasp| {
        grasp.position = (Vector3::from(grasp.position) + down).into();
        for contact in &mut grasp.plan.contacts {
            contact.position = (Vector3::from(contact.position) + down.map(|part| part as f32)).into();
        }
    };
    let held = GraspedObject { change: &change, ..GraspedObject::new("weights", "box") };
    let mut grasp_trial = GraspTrial::begin(setting, &mut rig, &held)?;
    grasp_trial.lift()?;
    let empty = grip(&grasp_trial.log);
    let mut record = Record { parts: Vec::new(), weights: Vec::new(), empty, events: Vec::new() };
    for (name, label, cumulative) in [("single", "One at a time", false), ("cumulative", "Cumulative", true)]
    {
        let begin = grasp_trial.log.now();
        add_weights(&mut grasp_trial, &mut record, name, cumulative, &grip)?;
        record.parts.push(Part { name, label, span: begin..grasp_trial.log.now() });
    }
    push(&mut grasp_trial, &mut record)?;
    let log = grasp_trial.end()?;

    let mut summary = Summary::default();
    add_metrics(&mut summary, &log, &record);
    let begin = record.parts.first().map_or(0.0, |part| part.span.start);
    let figures = vec![loads(&log, &record, begin), forces(&log, &record, begin)];
    let tables = vec![("weights.csv".to_owned(), table(&log))];
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

/// Adds the weights, one at a time or cumulatively, and removes them.
fn add_weights(
    grasp_trial: &mut GraspTrial<'_, '_>,
    record: &mut Record,
    part: &'static str,
    cumulative: bool,
    grip: &impl Fn(&GraspLog) -> Option<GripRatio>,
) -> Result<(), ScenarioError> {
    let mut total = 0.0;
    for mass in WEIGHTS {
        total = if cumulative { total + mass } else { mass };
        grasp_trial.note(&format!("{:.0} g on", 1e3 * total));
        record.events.push((grasp_trial.log.now(), format!("{:.0} g", 1e3 * total)));
        grasp_trial.plant.load(Load { mass, point: TOP, ramp: RAMP })?;
        grasp_trial.wait(RAMP + GRIP_AFTER)?;
        let evaluated = if grasp_trial.log.lost.is_none() { grip(&grasp_trial.log) } else { None };
        record.weights.push(AddedWeight { part, mass: total, grip: evaluated });
        grasp_trial.wait(STEP - RAMP - GRIP_AFTER)?;
        if !cumulative {
            record.events.push((grasp_trial.log.now(), "off".to_owned()));
            remove_weights(grasp_trial)?;
        }
    }
    if cumulative {
        record.events.push((grasp_trial.log.now(), "off".to_owned()));
        remove_weights(grasp_trial)?;
    }
    Ok(())
}

/// Pushes the box from the side.
fn push(grasp_trial: &mut GraspTrial<'_, '_>, record: &mut Record) -> Result<(), ScenarioError> {
    let begin = grasp_trial.log.now();
    grasp_trial.note("push");
    record.events.push((begin, "push".to_owned()));
    let force = [0.0, PUSH, 0.0];
    grasp_trial.plant.push(Push { force, point: [0.0; 3], ramp: 0.1, hold: PUSH_TIME })?;
    grasp_trial.wait(PUSH_TIME + 1.0)?;
    let span = begin..grasp_trial.log.now();
    record.parts.push(Part { name: "push", label: "Push from the side", span });
    Ok(())
}

fn remove_weights(grasp_trial: &mut GraspTrial<'_, '_>) -> Result<(), ScenarioError> {
    grasp_trial.note("off");
    grasp_trial.plant.unload(RAMP);
    grasp_trial.wait(STEP)
}

fn add_metrics(summary: &mut Summary, log: &GraspLog, record: &Record) {
    let lost = log.lost.as_ref().map(|lost| format!("the box was lost {lost}"));
    let metric = |text: String, value: f64, max: f64, unit: &str| {
        let mut metric = Metric::at_most(text, value, max, unit);
        metric.note.clone_from(&lost);
        metric
    };
    for Part { name, label, span, .. } in &record.parts {
        let text = format!("{label}: largest motion of the box");
        summary.insert(format!("{name}_motion"), metric(text, 1e3 * log.motion(span), MAX_MOTION, "mm"));
        let text = format!("{label}: largest sliding of a fingertip");
        summary.insert(format!("{name}_sliding"), metric(text, 1e3 * log.sliding(span), MAX_SLIDING, "mm"));
    }
    for part in record.parts.iter().filter(|part| part.name != "push") {
        let weights = || record.weights.iter().filter(|weight| weight.part == part.name);
        let all = |value: fn(&GripRatio) -> f64| {
            largest(weights().map(|weight| weight.grip.as_ref().map_or(f64::NAN, value)))
        };
        let text = format!("{}: largest grip ratio", part.label);
        let key = format!("{}_grip_ratio", part.name);
        summary.insert(key, metric(text, all(|grip| grip.ratio), MAX_GRIP_RATIO, ""));
        for weight in weights() {
            let text = format!("{}: grip ratio with {:.0} g", part.label, 1e3 * weight.mass);
            let ratio = weight.grip.map_or(f64::NAN, |grip| grip.ratio);
            let key = format!("{}_grip_ratio_{:.0}g", part.name, 1e3 * weight.mass);
            summary.insert(key, Metric::reported(text, ratio, ""));
        }
        let text = format!("{}: largest joint torque of the least grip", part.label);
        let note = format!("without the fingers' own weight; the joints are rated at {RATED_TORQUE} N·m");
        let torque = Metric::reported(text, all(|grip| grip.torque), "N·m").note(note);
        summary.insert(format!("{}_least_grip_torque", part.name), torque);
    }
    let empty = record.empty.map_or(f64::NAN, |grip| grip.ratio);
    let text = "Empty box: grip ratio";
    summary.insert("empty_grip_ratio", Metric::reported(text, empty, ""));
    let friction = log.samples.last().map_or(f64::NAN, |sample| sample.object.friction);
    summary.insert(
        "friction_estimate",
        Metric::reported("Coefficient of friction, controller's estimate", log.friction, ""),
    );
    summary.insert("friction_true", Metric::reported("Coefficient of friction, true", friction, ""));
    let whole = log.held..log.now();
    let max = log.largest(&whole, |sample| {
        largest(sample.contacts.iter().map(crate::plant::ContactTruth::normal_force))
    });
    summary.insert("force_peak", Metric::reported("Largest normal force", max, "N"));
}

fn loads(log: &GraspLog, record: &Record, begin: f64) -> Figure {
    let span = begin..log.now();
    let samples = log.during(&span);
    let time: Vec<f64> = samples.iter().map(|sample| sample.time - begin).collect();
    let load = samples.iter().map(|sample| 9.81 * sample.object.load).collect();
    let loads =
        Panel::new("Weight on the box", "weight", "N").line(Line::solid("weight", 3, time.clone(), load));
    let forces: Vec<_> = samples.iter().map(internal_forces).collect();
    let mut internal = Panel::new("True internal force of each finger", "force", "N");
    for finger in 0..3 {
        let magnitudes = forces.iter().map(|forces| forces[finger].norm()).collect();
        internal =
            internal.line(Line::solid(format!("finger {}", finger + 1), finger, time.clone(), magnitudes));
    }
    let start = log.at(begin).map_or(Vector3::repeat(f64::NAN), |sample| sample.position());
    let distance = samples.iter().map(|sample| 1e3 * (sample.position() - start).norm()).collect();
    let motion = Panel::new("Distance of the box from where it was held empty", "distance", "mm")
        .rule(MAX_MOTION, format!("limit {MAX_MOTION} mm"))
        .line(Line::solid("distance", 6, time, distance));
    let caption = "Weight on the box, the internal part of the true fingertip forces (as in the paper's \
                   figure 12), and how far the box moved. First one weight at a time (shaded), then \
                   cumulative, then the push.";
    let figure = Figure::stacked("Load and internal force", caption, "time", "s");
    mark_parts(figure, record, begin).panel(loads).panel(internal).panel(motion)
}

fn forces(log: &GraspLog, record: &Record, begin: f64) -> Figure {
    let caption = "True contact force of finger 1 on the box in the hand's frame (as in the paper's figure \
                   13), and the controller's target (dashed).";
    let span = begin..log.now();
    let panel =
        components(Panel::new("Force of finger 1", "force", "N"), log, &span, |sample| sample.force(0));
    let panel = component_targets(panel, log, &span, |sample| sample.estimates.target_forces[0]);
    let figure = Figure::stacked("Force of finger 1 on the box", caption, "time", "s");
    mark_parts(figure, record, begin).panel(panel)
}

/// Marks parts as phases, and weights as events.
fn mark_parts(mut figure: Figure, record: &Record, begin: f64) -> Figure {
    for part in &record.parts {
        figure = figure.phase(part.span.start - begin, part.span.end - begin, "");
    }
    let events = record.events.iter();
    events.fold(figure, |figure, (time, label)| figure.event(time - begin, label.as_str()))
}
