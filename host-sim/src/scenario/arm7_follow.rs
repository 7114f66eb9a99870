//! Unilateral teleoperation: a slave arm follows an operator's hand over a link (Arm7, section 3.2). Measures
//! the tracking error.

use std::ops::Range;

use rapier3d::na::{Isometry3, Vector3};
use tesaki::task::impedance::{DirectLaw, ImpedanceSettings, Law};

use super::arm::{ArmRig, ArmTrial, Machine, settings};
use super::common::capitalized;
use super::unilateral::{Operator, Slave, Trace, displacements, lead, tool_pose};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::operator::{ElbowMotion, ElbowSwing, LinkValues, OperatorHandMotion, Stroke};
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-follow",
    title: "The arm follows an operator's hand",
    about: "an operator's hand moves ±0.1 m at 0.5 Hz, and the arm follows over a link, under the paper's \
            law and ours",
    robot: "arm7",
    kind: Kind::SevenJointArm,
    files: &[],
    results: "docs/measurements.md#an-arm-that-follows-a-hand",
    duration: 88.0,
    shortest: None,
    laws: None,
    lead: &[
        "An operator moves the handle of a master arm, which is sampled at 240 Hz. A link delivers the \
         samples 20 to 23 ms later and loses 2 % of them. The operator's tremor is 0.05 mm (rms) along \
         each axis, at 8 to 12 Hz. A sensor at the operator's elbow measures the tilt of the arm, and the \
         shoulder yaw of the robot follows it.",
        "The error is the true position of the tool minus the true position of the operator's hand at the \
         same time. Both are taken relative to where the clutch closes: measurement errors of master and \
         slave at that place do not count; changes of these errors during the motion do. The error at rest \
         is the mean over one second, from 1 s after the motion, because tremor is not an error of the \
         arm.",
        "Further trials: minimum-jerk strokes with pauses, in which the hand also turns; twice the tremor; a \
         link with up to 20 ms of jitter that loses 20 % of the samples in bursts of six; and a clutch that \
         opens and closes during the motion.",
        "Our law estimates the hand's motion from the samples, predicts it to the present, and commands \
         position, velocity and acceleration; the Arm7 paper's mass, damping and stiffness act on the error. The \
         paper's law takes the latest sample as the equilibrium position of the spring. All machines differ \
         from the model by up to 20 %; those under the paper's law have the friction that the paper's errors \
         imply.",
    ],
    run,
};

/// Times since the trial began: the clutch closes, the hand begins and ends its motion [s].
const CLOSE: f64 = 1.0;
const BEGIN: f64 = 1.5;
const END: f64 = 11.5;
/// Rest after the motion [s].
const REST: f64 = 2.0;
/// Amplitude [m] and frequency [Hz] of the sine.
const AMPLITUDE: f64 = 0.1;
const FREQUENCY: f64 = 0.5;
/// Root mean square of an operator's tremor along each axis [m]: Riviere, Rader and Khosla (1997) measured
/// 0.05 mm with an instrument held still, Growdon et al. (2000) two to three times that with the arm
/// extended.
const TREMOR: f64 = 5e-5;
/// Damping of the impedance [N·s/m], the larger of the paper's two (section 3.1, with M 1.5 kg and K 300
/// N/m). Under our law it acts on the tracking error and adds no lag.
const DAMPING: f32 = 30.0;
/// Damping under the paper's law [N·s/m]. The paper does not state the impedance of this experiment. Between
/// its two values, 7.5 and 30 N·s/m, this one reproduces best its error of 7 mm at the reversals: under this
/// law, lag grows with damping.
const PAPER_DAMPING: f32 = 15.0;
const GOOD_LINK: LinkValues = LinkValues { delay: 0.02, jitter: 0.003, loss: 0.02, burst: 0.0 };
const BAD_LINK: LinkValues = LinkValues { delay: 0.02, jitter: 0.02, loss: 0.2, burst: 6.0 };

/// Reference trajectory of the hand.
#[derive(Clone, Copy, PartialEq, Eq)]
enum HandTrajectory {
    /// The paper's sine.
    Sine,
    /// Minimum-jerk strokes from end to end, with pauses and rotations.
    Strokes,
}

struct Trial {
    name: &'static str,
    label: &'static str,
    law: Law,
    trajectory: HandTrajectory,
    link: LinkValues,
    /// Root mean square along each axis [m].
    tremor: f64,
    /// When the clutch opens and closes again [s].
    clutch: Option<[f64; 2]>,
    /// Limits of the peak error and of the error at rest [mm].
    limits: Option<[f64; 2]>,
}

const OURS: Trial = Trial {
    name: "ours",
    label: "ours",
    law: Law::ModelFollowing,
    trajectory: HandTrajectory::Sine,
    link: GOOD_LINK,
    tremor: TREMOR,
    clutch: None,
    limits: Some([1.0, 0.2]),
};

const TRIALS: [Trial; 6] = [
    OURS,
    Trial { name: "strokes", label: "ours, strokes", trajectory: HandTrajectory::Strokes, ..OURS },
    Trial {
        name: "paper",
        label: "the paper's law",
        law: Law::Direct(DirectLaw::CORRECTED),
        limits: None,
        ..OURS
    },
    Trial { name: "tremor", label: "ours, twice the tremor", tremor: 2.0 * TREMOR, limits: None, ..OURS },
    Trial { name: "loss", label: "ours, a bad link", link: BAD_LINK, limits: None, ..OURS },
    Trial {
        name: "clutch",
        label: "ours, with the clutch",
        clutch: Some([4.25, 6.25]),
        limits: None,
        ..OURS
    },
];

impl HandTrajectory {
    fn motion(self, start: Isometry3<f64>) -> OperatorHandMotion {
        let along = Vector3::new(AMPLITUDE, 0.0, 0.0);
        match self {
            Self::Sine => OperatorHandMotion::sine(start, along, FREQUENCY, [BEGIN, END]),
            Self::Strokes => {
                // From the middle to one end, then from end to end, with two pauses.
                let rotation = Vector3::new(0.0, 0.1, 0.1);
                let strokes = [(0.0, 1.0, 1.0), (1.0, 1.5, -2.0), (3.0, 1.5, 2.0), (4.5, 1.5, -2.0)]
                    .into_iter()
                    .chain([(6.4, 1.5, 2.0), (7.9, 1.2, -1.0)])
                    .map(|(begin, duration, factor)| Stroke {
                        begin: BEGIN + begin,
                        duration,
                        shift: along * factor,
                        turn: rotation * factor,
                    });
                OperatorHandMotion::strokes(start, strokes.collect())
            }
        }
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for trial in &TRIALS {
        let trace = follow(setting, &mut rig, trial)?;
        add_metrics(&mut summary, trial, &trace);
        figures.push(figure(trial, &trace));
        tables.push((format!("{}.csv", trial.name), trace.table()));
    }
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

fn follow(setting: &mut Setting<'_, '_>, rig: &mut ArmRig, trial: &Trial) -> Result<Trace, ScenarioError> {
    let seed = setting.seed;
    let machine = if trial.law != Law::ModelFollowing { Machine::PaperFriction } else { Machine::Mismatched };
    let damping = if trial.law != Law::ModelFollowing { PAPER_DAMPING } else { DAMPING };
    let settings = ImpedanceSettings { law: trial.law, ..settings(damping) };
    let mut arm_trial = ArmTrial::begin(setting, rig, trial.label, machine, settings)?;
    arm_trial.wait(0.5)?;
    let start = tool_pose(&arm_trial);
    let target = arm_trial.start();
    let elbow_swing = |begin, angle| ElbowSwing { begin: BEGIN + begin, duration: 1.5, angle };
    let elbow = ElbowMotion {
        start: target.1.angle.into(),
        swings: vec![elbow_swing(2.2, 0.3), elbow_swing(6.1, -0.3)],
    };
    let motion = trial.trajectory.motion(start).with_tremor(trial.tremor, seed);
    let mut operator = Operator::new(motion, elbow, trial.link, seed, &start);
    let mut slave =
        if trial.law == Law::ModelFollowing { Slave::predicted(target) } else { Slave::sample(target) };
    let mut trace = Trace::new(arm_trial.log.now());
    let mut clutch = vec![(CLOSE, true)];
    clutch.extend(trial.clutch.into_iter().flat_map(|[open, close]| [(open, false), (close, true)]));
    lead(&mut arm_trial, &mut slave, &mut operator, END + REST, &clutch, |operator, time, point| {
        trace.push(&operator.motion.at(time), &operator.elbow.at(time), point);
    })?;
    trace.add_arm_log(arm_trial.end()?);
    Ok(trace)
}

/// Adds metrics under the trial's name.
struct Metrics<'a> {
    summary: &'a mut Summary,
    trial: &'a Trial,
    label: String,
}

impl Metrics<'_> {
    fn insert(&mut self, key: &str, metric: Metric) {
        self.summary.insert(format!("{}_{key}", self.trial.name), metric);
    }

    fn text(&self, text: &str) -> String {
        format!("{}: {text}", self.label)
    }

    fn reported(&self, text: &str, value: f64, unit: &'static str) -> Metric {
        Metric::reported(self.text(text), value, unit)
    }

    fn clutch(&mut self, trace: &Trace, [open, close]: [f64; 2], rest: &Range<f64>) {
        let text_open = self.text("displacement of the tool while the clutch is open, from 0.3 s on");
        let displacement = trace.tool_displacement(&(open + 0.3..close));
        self.insert("open_displacement", Metric::at_most(text_open, displacement, 0.2, "mm"));
        let largest = trace.largest_relative_to_mean(&(close + 0.5..END + 1.0), rest);
        let note = "relative to the mean difference at rest, which opening the clutch creates on purpose";
        let text_closed = self.text("largest error later than 0.5 s after the clutch closed");
        self.insert("error_after_closing", Metric::at_most(text_closed, largest, 1.0, "mm").note(note));
    }

    fn following(&mut self, trace: &Trace, moving: &Range<f64>, rest: &Range<f64>) {
        let largest = trace.largest(moving, |moment| moment.error().norm());
        let largest = self.reported("largest position error in motion", largest, "mm");
        let reversals = trace.reversals(moving);
        let reversals = self.reported("largest error along x at the reversals", reversals, "mm");
        let at_rest = self.reported("error at rest", trace.mean_error(rest).norm(), "mm");
        match (self.trial.law, self.trial.limits) {
            (Law::Direct(_), _) => {
                self.insert("error_peak", largest);
                self.insert("error_at_reversals", reversals.paper("7 mm"));
                let along = trace.mean_error(rest).x.abs();
                let along = self.reported("error at rest along x", along, "mm");
                self.insert("error_at_rest_x", along.paper("3 mm"));
                self.insert("error_at_rest", at_rest);
            }
            (_, Some([limit, limit_at_rest])) => {
                self.insert("error_peak", Metric { limit: Some(limit), ..largest });
                self.insert("error_at_reversals", reversals.paper("7 mm"));
                self.insert("error_at_rest", Metric { limit: Some(limit_at_rest), ..at_rest }.paper("3 mm"));
            }
            _ => {
                self.insert("error_peak", largest);
                self.insert("error_at_rest", at_rest);
            }
        }
    }

    fn prediction(&mut self, trace: &Trace, moving: &Range<f64>) {
        let predicted = trace.largest(moving, |moment| moment.prediction_error().norm());
        let tracking = trace.largest(moving, |moment| moment.tracking_error().norm());
        if self.trial.clutch.is_none() {
            let text = "largest prediction error, set-point minus hand";
            self.insert("prediction_error_peak", self.reported(text, predicted, "mm"));
        }
        let text = "largest distance of the tool from the set-point";
        self.insert("tracking_error_peak", self.reported(text, tracking, "mm"));
    }
}

fn add_metrics(summary: &mut Summary, trial: &Trial, trace: &Trace) {
    let mut metrics = Metrics { summary, trial, label: capitalized(trial.label) };
    let (moving, rest) = (BEGIN..END + 1.0, END + 1.0..END + REST);
    match trial.clutch {
        Some(times) => metrics.clutch(trace, times, &rest),
        None => metrics.following(trace, &moving, &rest),
    }
    if trial.law == Law::ModelFollowing {
        metrics.prediction(trace, &moving);
    }
    if trial.clutch.is_none() {
        let elbow = trace.largest(&(BEGIN..END), |moment| moment.elbow_error().abs());
        metrics
            .insert("elbow_error_peak", metrics.reported("largest error of the shoulder yaw", elbow, "mrad"));
    }
    let all = CLOSE..END + REST;
    let acceleration = trace.largest(&all, |moment| moment.acceleration);
    metrics.insert(
        "acceleration_peak",
        metrics.reported("largest acceleration of the set-point", acceleration, "m/s²"),
    );
    let rate = trace.torque_rate(&all);
    metrics.insert("torque_rate_peak", metrics.reported("largest rate of a torque", rate, "N·m/s"));
}

fn figure(trial: &Trial, trace: &Trace) -> Figure {
    let caption = "Top: positions of hand and tool along x from their common start (as in the paper's figure \
                   7). Bottom: true position of the tool minus true position of the hand at the same time.";
    let mut figure = Figure::stacked(capitalized(trial.label), caption, "time", "s");
    let time = trace.times();
    let [hand, tool] = displacements(trace, 0);
    let position = Panel::new("Position along x", "position", "mm")
        .line(Line::solid("tool", 0, time.clone(), tool))
        .line(Line::dashed("hand", Line::INK, time.clone(), hand));
    let mut error = Panel::new("Error", "tool minus hand", "mm");
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        error = error.line(Line::solid(name, axis, time.clone(), trace.errors(axis)));
    }
    if let Some([limit, _]) = trial.limits {
        error = error.band(limit, format!("limit ±{limit} mm"));
    }
    figure = figure.event(CLOSE, "clutch closes").phase(BEGIN, END, "hand moves").phase(
        END,
        END + REST,
        "at rest",
    );
    if let Some([open, close]) = trial.clutch {
        figure = figure.event(open, "clutch opens").event(close, "clutch closes");
    }
    figure.panel(position).panel(error)
}
