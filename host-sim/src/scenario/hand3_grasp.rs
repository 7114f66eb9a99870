//! The whole grasp sequence: an object is located, grasped, lifted, moved and put down (Hand3, sections 5 to
//! 7).

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki::task::grasping::{GraspCommand, Phase};

use super::common::{capitalized, largest};
use super::grasping::{GraspLog, GraspRig, GraspSample, GraspTrial, GraspedObject, LIFT, MOVE, table, xyz};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::plant::ContactTruth;
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-grasp",
    title: "The three-finger hand takes a box, moves it and puts it down",
    about: "a box at an unknown place is grasped, lifted, turned, shifted and put down; a cylinder and a \
            wedge are turned",
    robot: "hand3",
    kind: Kind::GraspingHand,
    files: &[
        "grasps/box.toml",
        "grasps/cylinder.toml",
        "grasps/wedge.toml",
        "objects/box.toml",
        "objects/cylinder.toml",
        "objects/wedge.toml",
    ],
    results: "docs/measurements.md#the-whole-sequence",
    duration: 67.0,
    shortest: None,
    laws: None,
    lead: &[
        "A box stands on a support, up to 5 mm away from its nominal position. The hand homes, tares its \
         force sensors, approaches, touches the box, squeezes it, probes its friction with two fingers, \
         lifts it by 1 cm, turns it by 0.1 rad about the hand's y axis and back, moves it by 1 cm along x \
         and back, lowers it onto the support, and opens.",
        "The same is done with a cylinder and with a wedge whose faces are inclined towards each other by \
         11.5°. Their grasp files specify internal forces between each pair of contacts. Both are turned by \
         +0.1 and −0.1 rad.",
    ],
    run,
};

/// Angle of a rotation [rad], and displacement [m].
const ROTATION: f64 = 0.1;
const DISPLACEMENT: f64 = 0.01;
/// Rest after each motion [s]; errors are evaluated 0.1 s before its end.
const REST: f64 = 2.0;
/// Time limit for putting down and opening [s].
const MAX_PUT_DOWN_TIME: f64 = 15.0;
/// Limit of the penetration of a fingertip [mm].
const MAX_PENETRATION: f64 = 0.1;

struct Trial {
    object: &'static str,
    /// Rotations about y relative to the grasp [rad], and then displacements along x [m].
    rotations: &'static [f64],
    displacements: &'static [f64],
}

const TRIALS: [Trial; 3] = [
    Trial { object: "box", rotations: &[ROTATION, 0.0], displacements: &[DISPLACEMENT, 0.0] },
    Trial { object: "cylinder", rotations: &[ROTATION, 0.0, -ROTATION, 0.0], displacements: &[] },
    Trial { object: "wedge", rotations: &[ROTATION, 0.0, -ROTATION, 0.0], displacements: &[] },
];

/// The result of a trial.
struct Record {
    log: GraspLog,
    /// When each rotation began [s].
    rotations: Vec<f64>,
    /// When each commanded motion began [s], and its label.
    motions: Vec<(f64, String)>,
    /// From the end of the lift to the command to put down [s].
    carried: Range<f64>,
    force_limit: f64,
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = GraspRig::load(setting)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for trial in &TRIALS {
        let force_limit = f64::from(rig.grasp(trial.object)?.plan.force_limit);
        let held = GraspedObject::new(trial.object, trial.object);
        let mut grasp_trial = GraspTrial::begin(setting, &mut rig, &held)?;
        let mut motions = vec![(grasp_trial.log.now(), "lift".to_owned())];
        let up = grasp_trial.lift()?;
        let lifted = grasp_trial.log.now();
        let mut rotations = Vec::new();
        for &angle in trial.rotations {
            motions.push((grasp_trial.log.now(), format!("{} rad", signed(angle))));
            rotations.push(grasp_trial.move_object(up, [0.0, angle, 0.0])?);
            grasp_trial.wait(MOVE + REST)?;
        }
        for &displacement in trial.displacements {
            motions.push((grasp_trial.log.now(), format!("{} mm", signed(1e3 * displacement))));
            grasp_trial.move_object([up[0] + displacement, up[1], up[2]], [0.0; 3])?;
            grasp_trial.wait(MOVE + REST)?;
        }
        let carried = lifted..grasp_trial.log.now();
        grasp_trial.clear_target();
        grasp_trial.send("put down", GraspCommand::PutDown)?;
        grasp_trial.wait_for_phase(Phase::Ready, MAX_PUT_DOWN_TIME)?;
        let record = Record { log: grasp_trial.end()?, rotations, motions, carried, force_limit };
        add_metrics(&mut summary, trial, &record);
        figures.push(figure(trial, &record));
        tables.push((format!("{}.csv", trial.object), table(&record.log)));
    }
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

fn add_metrics(summary: &mut Summary, trial: &Trial, record: &Record) {
    let Record { log, rotations, carried, force_limit, .. } = record;
    let (name, label) = (trial.object, capitalized(trial.object));
    let mut insert = |key: &str, metric: Metric| summary.insert(format!("{name}_{key}"), metric);
    let lost = log.lost.as_ref().map(|lost| format!("the {name} was lost {lost}"));
    let lowest = log.least_rise(carried);
    let is_down = lowest < 0.5 * LIFT;
    let down = is_down.then(|| format!("the {name} was only {:.1} mm above its support", 1e3 * lowest));
    let dropped = f64::from(u8::from(log.lost.is_some() || is_down));
    let mut metric = Metric::at_most(format!("{label}: dropped"), dropped, 0.0, "");
    metric.note = lost.or(down);
    insert("dropped", metric);
    let friction = log.samples.last().map_or(f64::NAN, |sample| sample.object.friction);
    insert(
        "friction_estimate",
        Metric::reported(format!("{label}: friction, controller's estimate"), log.friction, ""),
    );
    insert("friction_true", Metric::reported(format!("{label}: friction, true value"), friction, ""));
    let whole: Range<f64> = 0.0..log.now();
    let of_contacts = |value: fn(&ContactTruth) -> f64| {
        log.largest(&whole, |sample| largest(sample.contacts.iter().map(value)))
    };
    let penetration = 1e3 * of_contacts(|contact| contact.depth);
    insert(
        "penetration_peak",
        Metric::at_most(
            format!("{label}: largest penetration of a fingertip"),
            penetration,
            MAX_PENETRATION,
            "mm",
        ),
    );
    let force = of_contacts(ContactTruth::normal_force);
    insert("force_peak", Metric::at_most(format!("{label}: largest normal force"), force, *force_limit, "N"));
    let pitch = |time: f64| log.at(time).map_or(f64::NAN, |sample| sample.angles()[1]);
    let start = rotations.first().map_or(f64::NAN, |&begin| pitch(begin));
    let errors = rotations.iter().zip(trial.rotations);
    let errors = errors.map(|(begin, angle)| 1e3 * (pitch(begin + MOVE + REST - 0.1) - start - angle).abs());
    insert("pitch_error", Metric::reported(format!("{label}: pitch error at rest"), largest(errors), "mrad"));
    let ends = log.samples.first().zip(log.samples.last());
    let distance = ends.map_or(f64::NAN, |(first, last)| 1e3 * (last.position() - first.position()).norm());
    let text = format!("{label}: distance from pick-up to put-down");
    insert("placement_distance", Metric::reported(text, distance, "mm"));
    insert("duration", Metric::reported(format!("{label}: total time"), log.now(), "s"));
}

/// A number with its sign: `+0.1`, `−0.1`, `0`.
fn signed(value: f64) -> String {
    let sign = if value > 0.0 { "+" } else { "" };
    format!("{sign}{value}").replace('-', "−")
}

const fn phase_name(phase: Phase) -> &'static str {
    match phase {
        Phase::Ready => "ready",
        Phase::Approach => "approach",
        Phase::Touch => "touch",
        Phase::Squeeze => "squeeze",
        Phase::ProbeFriction => "probe friction",
        Phase::Hold => "hold",
        // The event of the commanded motion already labels this phase.
        Phase::Move => "",
        Phase::Lower => "lower",
        Phase::Open => "open",
    }
}

fn figure(trial: &Trial, record: &Record) -> Figure {
    let log = &record.log;
    let caption = "Displacement and pitch of the true object with their references (dashed), and the contact \
                   force of each finger with the controller's target (dashed), from enabling the hand until \
                   it is open again.";
    let mut figure = Figure::stacked(capitalized(trial.object), caption, "time", "s");
    // The hand holds before the lift and between two motions: only the first of these phases gets a label.
    let mut is_labelled = false;
    let ends = log.phases.iter().skip(1).map(|(time, _)| *time).chain([log.now()]);
    for (&(begin, phase), end) in log.phases.iter().zip(ends) {
        let again = phase == Phase::Hold && std::mem::replace(&mut is_labelled, true);
        figure = figure.phase(begin, end, if again { "" } else { phase_name(phase) });
    }
    for (time, label) in &record.motions {
        figure = figure.event(*time, label.as_str());
    }
    figure.panel(displacement(log)).panel(pitch(log)).panel(forces(log))
}

/// The sample when the hand began to hold the object: references are relative to it.
fn when_held(log: &GraspLog) -> Option<&GraspSample> {
    log.at(log.held)
}

fn displacement(log: &GraspLog) -> Panel {
    let start = log.samples.first().map_or(Vector3::zeros(), GraspSample::position);
    let held = when_held(log).map_or(Vector3::repeat(f64::NAN), GraspSample::position);
    let mut panel = Panel::new("Displacement of the object", "displacement", "mm");
    for (axis, name) in xyz() {
        let values = log.series(|sample| 1e3 * (sample.position() - start)[axis]);
        panel = panel.line(Line::solid(name, axis, log.times(), values));
    }
    for (axis, name) in xyz() {
        let reference = |sample: &GraspSample| 1e3 * (held + sample.target[0] - start)[axis];
        let values = log.series(|sample| if sample.time < log.held { f64::NAN } else { reference(sample) });
        panel = panel.line(Line::dashed(format!("{name} reference"), axis, log.times(), values));
    }
    panel
}

fn pitch(log: &GraspLog) -> Panel {
    let held = when_held(log).map_or(f64::NAN, |sample| sample.angles()[1]);
    let reference =
        log.series(|sample| if sample.time < log.held { f64::NAN } else { held + sample.target[1][1] });
    Panel::new("Pitch of the object", "angle", "rad")
        .line(Line::solid("pitch", 3, log.times(), log.series(|sample| sample.angles()[1])))
        .line(Line::dashed("pitch reference", 3, log.times(), reference))
}

fn forces(log: &GraspLog) -> Panel {
    let mut panel = Panel::new("Contact force of each finger", "force", "N");
    for finger in 0..3 {
        let name = format!("finger {}", finger + 1);
        let magnitude = log.series(|sample| sample.force(finger).norm());
        panel = panel.line(Line::solid(name, finger, log.times(), magnitude));
    }
    for finger in 0..3 {
        let name = format!("finger {} target", finger + 1);
        let target = log.series(|sample| sample.estimates.target_forces[finger].norm());
        panel = panel.line(Line::dashed(name, finger, log.times(), target));
    }
    panel
}
