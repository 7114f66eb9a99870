//! Calibration of an operator's hand: a glove, and markers on the fingertips (Hand5, sections 2.1 and 3.1).

use rapier3d::na::Vector3;
use tesaki::teleop::{GloveFilter, HUMAN_FINGERS, HumanFinger};

use super::common::capitalized;
use super::hand::{in_robot_frame, path_panel, vector_errors};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::motion::Motion;
use crate::operator::GloveValues;
use crate::operator::calibration_trial::{self, CalibrationPlan, CalibrationTrial, MIN_DISTANCE};
use crate::report::{Column, Figure, Line, Metric, Panel, Summary, csv};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand5-calibrate",
    title: "An operator's hand, calibrated",
    about: "an operator's fingertips from a glove, calibrated with markers on five or on three fingers",
    robot: "hand5",
    kind: Kind::None,
    files: &[],
    results: "docs/measurements.md#an-operators-hand",
    duration: 60.0,
    shortest: Some(60.0),
    laws: None,
    lead: &[
        "Sixteen orientation sensors give the fingertips once the links between them are known. Here a simulated \
         operator calibrates a glove, with a marker on each fingertip for two minutes, or with three markers \
         and touches of the thumb; then moves the fingers fast for a minute. Each seed is another hand. Each \
         sensor is 1.5° off (root mean square, bandwidth 10 Hz), each marker 0.3 mm along each axis, and a \
         sixth of the markers is hidden.",
        "Compared are the estimated vectors from the thumb's tip to the others with the true ones, at instants in \
         which they are at least 25 mm long. The filter of the glove delays its output by 32 ms; the truth is \
         delayed as much. No board takes part.",
    ],
    run,
};

/// What is to be reached.
struct Limits {
    /// Time that the calibration takes [s].
    time: Option<f64>,
    /// Mean error of the vectors' length [mm].
    length: Option<f64>,
    /// Standard deviation of the vectors' length [mm].
    deviation: f64,
    /// Mean and standard deviation of their direction [°].
    direction: [Option<f64>; 2],
}

struct Trial {
    name: &'static str,
    label: &'static str,
    plan: CalibrationPlan,
    limits: Limits,
}

const TRIALS: [Trial; 2] = [
    Trial {
        name: "full",
        label: "five markers",
        plan: CalibrationPlan::FULL,
        limits: Limits { time: None, length: Some(0.9), deviation: 2.0, direction: [Some(1.4), Some(1.0)] },
    },
    Trial {
        name: "quick",
        label: "three markers",
        plan: CalibrationPlan::QUICK,
        limits: Limits { time: Some(120.0), length: None, deviation: 3.0, direction: [None; 2] },
    },
];

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for (trial, number) in TRIALS.iter().zip(1..) {
        let (values, filter) = (GloveValues::default(), GloveFilter::SMOOTH);
        let found = calibration_trial::run(&trial.plan, values, filter, setting.seed, setting.duration)?;
        add_metrics(&mut summary, trial, &found);
        figures.push(paths(trial, &found));
        figures.push(vector(trial, &found));
        tables.push((format!("{}.csv", trial.name), table(&found)));
        (setting.progress)(f64::from(number) / TRIALS.len() as f64);
    }
    Ok(Outcome { summary, figures, tables, motion: Motion::new(Vec::<String>::new()) })
}

fn add_metrics(summary: &mut Summary, trial: &Trial, found: &CalibrationTrial) {
    let label = capitalized(trial.label);
    let mut insert = |key: String, metric: Metric| summary.insert(format!("{}_{key}", trial.name), metric);
    let limited = |metric: Metric, limit: Option<f64>| Metric { limit, ..metric };
    let time = Metric::reported(format!("{label}: time that the calibration takes"), found.time, "s");
    insert("time".into(), limited(time, trial.limits.time));
    for finger in 1..HUMAN_FINGERS {
        let name = HumanFinger::ALL[finger];
        let [[mean, deviation], [angle, angle_deviation]] =
            vector_errors(found.vectors[finger - 1].iter().copied());
        let Limits { length, deviation: length_deviation, direction, .. } = trial.limits;
        let rows = [
            ("length_mean", "mean error of the length", mean.abs(), "mm", length, "0.9 mm"),
            (
                "length_deviation",
                "standard deviation of the length",
                deviation,
                "mm",
                Some(length_deviation),
                "3.8 mm",
            ),
            ("direction_mean", "mean error of the direction", angle, "°", direction[0], "2.4°"),
            (
                "direction_deviation",
                "standard deviation of the direction",
                angle_deviation,
                "°",
                direction[1],
                "1.6°",
            ),
        ];
        for (key, what, value, unit, limit, paper) in rows {
            let metric = limited(Metric::reported(format!("{label}: {name}, {what}"), value, unit), limit);
            // The paper measured thumb and index finger.
            let metric = if finger == 1 { metric.paper(paper) } else { metric };
            insert(format!("{}_{key}", name.name()), metric);
        }
    }
}

/// As the paper's figure 3.
fn paths(trial: &Trial, found: &CalibrationTrial) -> Figure {
    let caption = "The first 10 s of the index finger's and the little finger's tip as seen from the thumb's tip, in \
                   the plane in which fingers bend: z along the fingers, x out of the palm (compare the paper's \
                   figure 3).";
    let figure = Figure::paths(format!("{}: paths", capitalized(trial.label)), caption, "x", "mm");
    [1, 4].into_iter().fold(figure, |figure, finger| {
        let vectors = &found.vectors[finger - 1];
        let shown = vectors.len().min(1000);
        let points = |which: usize| vectors[..shown].iter().map(move |pair| in_robot_frame(pair[which]));
        let title = HumanFinger::ALL[finger].to_string();
        figure.panel(path_panel(&title, ["estimated", "true"], points(0), points(1)))
    })
}

/// As the paper's figure 4.
fn vector(trial: &Trial, found: &CalibrationTrial) -> Figure {
    let caption = "The first 20 s of the vector from the thumb's tip to that of the index finger: its length, \
                   estimated minus true length, and the angle between both where they are at least 25 mm long \
                   (compare the paper's figure 4).";
    let shown: Vec<_> =
        found.times.iter().zip(&found.vectors[0]).take_while(|(time, _)| **time < 20.0).collect();
    let time: Vec<f64> = shown.iter().map(|(time, _)| **time).collect();
    let values =
        |value: &dyn Fn([Vector3<f64>; 2]) -> f64| shown.iter().map(|(_, pair)| value(**pair)).collect();
    let estimated: Vec<f64> = values(&|[found, _]| 1e3 * found.norm());
    let truth: Vec<f64> = values(&|[_, truth]| 1e3 * truth.norm());
    let length: Vec<f64> = values(&|[found, truth]| 1e3 * (found.norm() - truth.norm()));
    let direction: Vec<f64> = values(&|[found, truth]| {
        if truth.norm() >= MIN_DISTANCE { found.angle(&truth).to_degrees() } else { f64::NAN }
    });
    Figure::stacked(format!("{}: vector to the index finger", capitalized(trial.label)), caption, "time", "s")
        .panel(
            Panel::new("Length", "length", "mm")
                .line(Line::solid("estimated", 0, time.clone(), estimated))
                .line(Line::dashed("true", Line::INK, time.clone(), truth)),
        )
        .panel(Panel::new("Error of the length", "error", "mm").line(Line::solid(
            "error",
            0,
            time.clone(),
            length,
        )))
        .panel(
            Panel::new("Error of the direction", "error", "°").line(Line::solid("error", 0, time, direction)),
        )
}

fn table(found: &CalibrationTrial) -> String {
    let vectors = &found.vectors[0];
    let series = |which: usize, axis: usize| -> Vec<f64> {
        vectors.iter().map(|pair: &[Vector3<f64>; 2]| in_robot_frame(pair[which])[axis]).collect()
    };
    let mut columns = vec![Column::new("time", "s", &found.times)];
    for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
        columns.push(Column::new(format!("estimated {letter}"), "m", series(0, axis)));
        columns.push(Column::new(format!("true {letter}"), "m", series(1, axis)));
    }
    csv(&columns)
}
