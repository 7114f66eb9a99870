//! Rotation of a held box by ±0.1 rad (Hand3, section 7 and figure 14).

use rapier3d::na::UnitQuaternion;

use super::common::{capitalized, largest};
use super::grasping::{GraspLog, GraspRig, GraspSample, GraspTrial, GraspedObject, MOVE, table};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting, needs};
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-turn",
    title: "A box turned by the three-finger hand",
    about: "a held box is turned by +0.1, −0.1, −0.1 and +0.1 rad about the hand's y axis",
    robot: "hand3",
    kind: Kind::GraspingHand,
    files: needs::BOX,
    results: "docs/measurements.md#turned-and-shifted",
    duration: 20.0,
    shortest: None,
    laws: None,
    lead: &[
        "The hand locates and grasps a box that stands up to 5 mm away from its nominal position, probes its \
         friction, lifts it by 1 cm, and turns it by +0.1, −0.1, −0.1 and +0.1 rad about the hand's y axis. \
         Each turn takes one second and is followed by two and a half seconds of rest. In the Hand3 paper the \
         pitch of the box went from 0.769 rad to 0.868, back, to 0.673, and back.",
        "The error is that of the true box, two seconds after the end of each turn: its pitch relative to \
         that before the first turn, minus the commanded turn.",
    ],
    run,
};

/// Angle of a turn [rad].
const TURN: f64 = 0.1;
/// Target pitch after each turn, relative to the pitch before the first [rad].
const TARGETS: [f64; 4] = [TURN, 0.0, -TURN, 0.0];
/// Rest after each turn [s].
const REST: f64 = 2.5;
/// Time from the end of a turn until its error is evaluated [s].
const AFTER: f64 = 2.0;

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = GraspRig::load(setting)?;
    let held = GraspedObject::new("turn", "box");
    let mut grasp_trial = GraspTrial::begin(setting, &mut rig, &held)?;
    let up = grasp_trial.lift()?;
    let mut begins = [f64::NAN; 4];
    for (begin, turn) in begins.iter_mut().zip(TARGETS) {
        *begin = grasp_trial.move_object(up, [0.0, turn, 0.0])?;
        grasp_trial.wait(MOVE + REST)?;
    }
    let log = grasp_trial.end()?;
    let mut summary = Summary::default();
    add_metrics(&mut summary, &log, &begins);
    let figures = vec![figure(&log, begins[0])];
    Ok(Outcome { summary, figures, tables: vec![("turn.csv".to_owned(), table(&log))], motion: rig.motion })
}

fn pitch(sample: Option<&GraspSample>) -> f64 {
    sample.map_or(f64::NAN, |sample| sample.angles()[1])
}

fn add_metrics(summary: &mut Summary, log: &GraspLog, begins: &[f64; 4]) {
    let lost = log.lost.as_ref().map(|lost| format!("the box was lost {lost}"));
    let start = pitch(log.at(begins[0]));
    let rests = begins.map(|begin| pitch(log.at(begin + MOVE + AFTER)));
    let errors = [0, 1, 2, 3].map(|index| 1e3 * (rests[index] - start - TARGETS[index]).abs());
    let mut metric =
        Metric::at_most("Pitch error at rest, worst of four", largest(errors), 2.0, "mrad").paper("1–4 mrad");
    metric.note = lost;
    summary.insert("pitch_error", metric);
    for (number, (error, turn)) in (1..).zip(errors.into_iter().zip(["+0.1", "−0.1", "−0.1", "+0.1"])) {
        let text = format!("Pitch error after turn {number} ({turn} rad)");
        summary.insert(format!("pitch_error_turn{number}"), Metric::reported(text, error, "mrad"));
    }
    let span = begins[0]..begins[3] + MOVE + AFTER;
    let text = "Largest sliding of a fingertip on the box";
    summary.insert("sliding", Metric::reported(text, 1e3 * log.sliding(&span), "mm"));
    let drift = [0, 2].map(|axis| {
        let angle = |sample: Option<&GraspSample>| sample.map_or(f64::NAN, |sample| sample.angles()[axis]);
        let start = angle(log.at(begins[0]));
        largest(begins.iter().map(|begin| 1e3 * (angle(log.at(begin + MOVE + AFTER)) - start).abs()))
    });
    let text = "Largest change of roll and yaw at rest";
    summary.insert("roll_yaw_drift", Metric::reported(text, largest(drift), "mrad"));
}

fn figure(log: &GraspLog, begin: f64) -> Figure {
    let caption = "True roll, pitch and yaw of the box, and their references (dashed), which begin at the \
                   true values before the first turn. As in the paper's figure 14.";
    let mut figure = Figure::stacked("Roll, pitch and yaw of the box", caption, "time", "s");
    for (number, name) in ["+0.1 rad", "−0.1 rad", "−0.1 rad", "+0.1 rad"].into_iter().enumerate() {
        let begin = number as f64 * (MOVE + REST);
        figure = figure.phase(begin, begin + MOVE, name).phase(begin + MOVE, begin + MOVE + REST, "at rest");
    }
    let samples: Vec<&GraspSample> = log.samples.iter().filter(|sample| sample.time >= begin - 0.5).collect();
    let time: Vec<f64> = samples.iter().map(|sample| sample.time - begin).collect();
    let start = log.at(begin);
    for (axis, name) in ["roll", "pitch", "yaw"].into_iter().enumerate() {
        let reference = |sample: &&GraspSample| {
            let Some(start) = start else { return f64::NAN };
            let target =
                UnitQuaternion::from_scaled_axis(sample.target[1] - start.target[1]) * start.orientation();
            let (roll, pitch, yaw) = target.euler_angles();
            [roll, pitch, yaw][axis]
        };
        let reference: Vec<f64> = samples.iter().map(reference).collect();
        let measured: Vec<f64> = samples.iter().map(|sample| sample.angles()[axis]).collect();
        figure = figure.panel(
            Panel::new(capitalized(name), name, "rad")
                .line(Line::solid("true", axis, time.clone(), measured))
                .line(Line::dashed("reference", Line::INK, time.clone(), reference)),
        );
    }
    figure
}
