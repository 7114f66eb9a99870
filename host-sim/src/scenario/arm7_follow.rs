//! A slave arm follows a person's hand over a link (Arm7, section 3.2): how far behind is it?

mod trace;

use std::ops::Range;

use rapier3d::na::{Isometry3, Translation3, UnitQuaternion, Vector3};
use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki::task::impedance::{ImpedanceSettings, Law};
use tesaki::teleop::{Follower, FollowerSettings, FollowerState, Instant, MasterSample};

use self::trace::{Trace, sides};
use super::arm::{ArmRig, ArmTrial, Machine, settings};
use super::common::capital;
use super::grasping::{T, require_duration};
use super::{Outcome, Scenario, ScenarioError, Setting};
use crate::operator::{
    ElbowMotion, ElbowSensor, ElbowSensorValues, ElbowSwing, Link, LinkValues, MasterArm, MasterArmValues,
    MasterPose, OperatorHandMotion, Packet, Stroke,
};
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-follow",
    title: "The arm follows an operator's hand",
    about: "an operator's hand moves ±0.1 m at 0.5 Hz, and the arm follows over a link, under the paper's \
            law and ours",
    robot: "arm7",
    duration: 88.0,
    lead: &[
        "A person moves the handle of a master arm, which is sampled at 240 Hz. A link delivers the samples \
         20 to 23 ms later and loses 2 % of them. The person's tremor is 0.05 mm (rms) along each axis, at 8 \
         to 12 Hz. A sensor at the person's elbow measures the tilt of the arm, and the shoulder yaw of the \
         robot follows it.",
        "The error is the true position of the tool minus the true position of the person's hand at the same \
         time. Both are taken relative to where the clutch closes: measurement errors of master and slave at \
         that place do not count, changes of these errors on the way do. The error at rest is the mean over \
         one second, from 1 s after the motion, because tremor is not an error of the arm.",
        "Further trials: minimum-jerk strokes with pauses, in which the hand also turns; twice the tremor; a \
         link with up to 20 ms of jitter that loses 20 % of the samples in bursts of six; and a clutch that \
         opens and closes during the motion.",
        "Our law estimates the hand's motion from the samples, predicts it to the present, and commands \
         position, velocity and acceleration; the paper's mass, damping and stiffness act on the error. The \
         paper's law takes the latest sample as the equilibrium position of the spring. All machines differ \
         from the model by up to 20 %; those under the paper's law have the friction that the paper's errors \
         imply.",
    ],
    run,
};

/// Since the session began [s]: the clutch closes; the hand moves; how long it is watched at rest.
const CLOSE: f64 = 1.0;
const BEGIN: f64 = 1.5;
const END: f64 = 11.5;
const REST: f64 = 2.0;
const AMPLITUDE: f64 = 0.1;
const FREQUENCY: f64 = 0.5;
/// Root mean square of a person's tremor along each axis [m]: Riviere, Rader and Khosla (1997) found 0.05 mm
/// in people who hold an instrument still, Growdon et al. (2000) twice to three times that with the arm
/// stretched out.
const TREMOR: f64 = 5e-5;
/// Of the impedance, with M 1.5 kg and K 300 N/m of the paper's section 3.1, whose larger damping it is: it
/// acts on the error, so it costs nothing, and the tool swings less when it is pushed.
const DAMPING: f32 = 30.0;
/// The paper does not say with which impedance its arm followed. Between its two dampings, 7.5 and 30 N·s/m,
/// this one comes nearest to its 7 mm at the reversals: the more damping, the farther the tool is behind.
const PAPER_DAMPING: f32 = 15.0;
const GOOD_LINK: LinkValues = LinkValues { delay: 0.02, jitter: 0.003, loss: 0.02, burst: 0.0 };
const BAD_LINK: LinkValues = LinkValues { delay: 0.02, jitter: 0.02, loss: 0.2, burst: 6.0 };

/// How the hand moves.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Course {
    /// The paper's.
    Sine,
    /// From end to end and back with minimum jerk, with pauses and turns.
    Strokes,
}

struct Trial {
    name: &'static str,
    label: &'static str,
    law: Law,
    course: Course,
    link: LinkValues,
    /// [m]
    tremor: f64,
    /// When the clutch opens and closes again [s].
    clutch: Option<[f64; 2]>,
    /// The largest error, and that at rest [mm].
    limits: Option<[f64; 2]>,
}

const OURS: Trial = Trial {
    name: "ours",
    label: "ours",
    law: Law::ModelFollowing,
    course: Course::Sine,
    link: GOOD_LINK,
    tremor: TREMOR,
    clutch: None,
    limits: Some([1.0, 0.2]),
};

const TRIALS: [Trial; 6] = [
    OURS,
    Trial { name: "strokes", label: "ours, strokes", course: Course::Strokes, ..OURS },
    Trial { name: "paper", label: "the paper's law", law: Law::Direct, limits: None, ..OURS },
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

impl Course {
    fn motion(self, start: Isometry3<f64>) -> OperatorHandMotion {
        let along = Vector3::new(AMPLITUDE, 0.0, 0.0);
        match self {
            Self::Sine => OperatorHandMotion::sine(start, along, FREQUENCY, [BEGIN, END]),
            Self::Strokes => {
                // Out, then end to end, twice after a pause.
                let turn = Vector3::new(0.0, 0.1, 0.1);
                let strokes = [(0.0, 1.0, 1.0), (1.0, 1.5, -2.0), (3.0, 1.5, 2.0), (4.5, 1.5, -2.0)]
                    .into_iter()
                    .chain([(6.4, 1.5, 2.0), (7.9, 1.2, -1.0)])
                    .map(|(begin, duration, way)| Stroke {
                        begin: BEGIN + begin,
                        duration,
                        shift: along * way,
                        turn: turn * way,
                    });
                OperatorHandMotion::strokes(start, strokes.collect())
            }
        }
    }
}

/// The person, with the devices and the links.
struct Operator {
    motion: OperatorHandMotion,
    elbow: ElbowMotion,
    master: MasterArm,
    sensor: ElbowSensor,
    links: (Link<MasterPose>, Link<f64>),
}

impl Operator {
    fn new(trial: &Trial, seed: u64, start: &Isometry3<f64>, elbow: f64) -> Self {
        let elbow_swing = |begin, angle| ElbowSwing { begin: BEGIN + begin, duration: 1.5, angle };
        Self {
            motion: trial.course.motion(*start).with_tremor(trial.tremor, seed),
            elbow: ElbowMotion { start: elbow, swings: vec![elbow_swing(2.2, 0.3), elbow_swing(6.1, -0.3)] },
            master: MasterArm::new(MasterArmValues::default(), start, seed),
            sensor: ElbowSensor::new(ElbowSensorValues::default(), seed),
            links: (Link::new(trial.link, 2 * seed), Link::new(trial.link, 2 * seed + 1)),
        }
    }

    /// What has arrived by a time [s] since the last call.
    fn tell(&mut self, time: f64) -> (Vec<Packet<MasterPose>>, Vec<Packet<f64>>) {
        let (hand, elbow) = &mut self.links;
        for (sampled, pose) in self.master.run(&self.motion, time) {
            hand.send(sampled, pose);
        }
        for (sampled, tilt) in self.sensor.run(&self.elbow, time) {
            elbow.send(sampled, tilt);
        }
        (hand.receive(time).collect(), elbow.receive(time).collect())
    }
}

/// What makes set-points of samples.
enum Slave {
    Ours(Follower, Box<FollowerState>),
    /// The last sample is where the spring is at rest.
    Paper(PosePoint, ElbowSetpoint),
}

impl Slave {
    fn new(law: Law, (target, elbow): (PosePoint, ElbowSetpoint)) -> Self {
        match law {
            Law::Direct => Self::Paper(target, elbow),
            Law::ModelFollowing => {
                let follower =
                    Follower::try_new(FollowerSettings::HUMAN).expect("its own settings are valid");
                Self::Ours(
                    follower,
                    Box::new(FollowerState::at(target.position, target.rotation, elbow.angle)),
                )
            }
        }
    }

    fn take(&mut self, time: f64, pose: &Packet<MasterPose>) {
        let MasterPose { position, orientation } = pose.message;
        let (position, rotation) = (position.map(|x| x as f32), orientation.map(|x| x as f32));
        match self {
            Self::Ours(follower, state) => {
                let sample = MasterSample { time: instant(pose.time), position, rotation };
                // Overtaken ones are of no use, and nothing else is refused here.
                let _ = follower.add_sample(state, instant(time), &sample);
            }
            Self::Paper(target, _) => (target.position, target.rotation) = (position, rotation),
        }
    }

    fn take_elbow(&mut self, time: f64, tilt: &Packet<f64>) {
        let angle = tilt.message as f32;
        match self {
            Self::Ours(follower, state) => {
                let _ = follower.add_elbow_sample(state, instant(time), instant(tilt.time), angle);
            }
            Self::Paper(_, elbow) => elbow.angle = angle,
        }
    }

    fn clutch(&mut self, time: f64, closed: bool) {
        if let Self::Ours(follower, state) = self {
            if closed {
                follower.close_clutch(state, instant(time)).expect("samples come all the time");
            } else {
                follower.open_clutch(state);
            }
        }
    }

    fn tick(&mut self, time: f64) -> (PosePoint, ElbowSetpoint) {
        match self {
            Self::Ours(follower, state) => follower.tick(state, instant(time)),
            Self::Paper(target, elbow) => (*target, *elbow),
        }
    }
}

#[expect(clippy::cast_sign_loss, reason = "no time is negative")]
fn instant(time: f64) -> Instant {
    Instant((1e6 * time).round() as u32)
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    require_duration(&SCENARIO, setting)?;
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::new(SCENARIO.name, "", setting.seed);
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for trial in &TRIALS {
        let trace = follow(setting, &mut rig, trial)?;
        add_metrics(&mut summary, trial, &trace);
        figures.push(figure(trial, &trace));
        tables.push((format!("{}.csv", trial.name), trace.table()));
    }
    let summary = summary.ticks(u64::from(rig.motion.ticks()));
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

fn follow(setting: &mut Setting<'_, '_>, rig: &mut ArmRig, trial: &Trial) -> Result<Trace, ScenarioError> {
    let seed = setting.seed;
    let machine = if trial.law == Law::Direct { Machine::Paper } else { Machine::Mismatched };
    let damping = if trial.law == Law::Direct { PAPER_DAMPING } else { DAMPING };
    let settings = ImpedanceSettings { law: trial.law, ..settings(damping) };
    let mut arm_trial = ArmTrial::begin(setting, rig, trial.label, machine, settings)?;
    arm_trial.wait(0.5)?;
    let now = arm_trial.plant.tips().swap_remove(0);
    let [x, y, z, w] = now.orientation;
    let turn = UnitQuaternion::from_quaternion(rapier3d::na::Quaternion::new(w, x, y, z));
    let start = Isometry3::from_parts(Translation3::from(Vector3::from(now.position)), turn);
    let target = arm_trial.start();
    let mut operator = Operator::new(trial, seed, &start, target.1.angle.into());
    let mut slave = Slave::new(trial.law, target);
    let mut trace = Trace::new(arm_trial.log.now());
    let tick = |time: f64| (time / T).round() as usize;
    for number in 0..tick(END + REST) {
        let time = number as f64 * T;
        let (poses, tilts) = operator.tell(time);
        poses.iter().for_each(|pose| slave.take(time, pose));
        tilts.iter().for_each(|tilt| slave.take_elbow(time, tilt));
        if number == tick(CLOSE) {
            slave.clutch(time, true);
        }
        for (at, closed) in trial.clutch.into_iter().flat_map(|[open, close]| [(open, false), (close, true)])
        {
            if number == tick(at) {
                slave.clutch(time, closed);
            }
        }
        let (point, elbow) = slave.tick(time);
        trace.hand(&operator.motion.at(time), &operator.elbow.at(time), &point);
        arm_trial.follow(point, elbow)?;
    }
    trace.end(arm_trial.end()?);
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
        let text_open = self.text("motion of the tool while the clutch is open, from 0.3 s on");
        self.insert("open", Metric::at_most(text_open, trace.wander(&(open + 0.3..close)), 0.2, "mm"));
        let largest = trace.largest_beside(&(close + 0.5..END + 1.0), rest);
        let note = "relative to the mean difference at rest, which the clutch is meant to create";
        let text_closed = self.text("largest error later than 0.5 s after the clutch closed");
        self.insert("closed", Metric::at_most(text_closed, largest, 1.0, "mm").note(note));
    }

    fn following(&mut self, trace: &Trace, moving: &Range<f64>, rest: &Range<f64>) {
        let largest = trace.largest(moving, |moment| moment.error().norm());
        let largest = self.reported("largest position error in motion", largest, "mm");
        let reversals = trace.reversals(moving);
        let reversals = self.reported("largest error along x at the reversals", reversals, "mm");
        let at_rest = self.reported("error at rest", trace.mean_error(rest).norm(), "mm");
        match (self.trial.law, self.trial.limits) {
            (Law::Direct, _) => {
                self.insert("largest", largest);
                self.insert("reversals", reversals.paper("7 mm"));
                let along = trace.mean_error(rest).x.abs();
                let along = self.reported("error at rest along x", along, "mm");
                self.insert("rest_x", along.paper("3 mm"));
                self.insert("rest", at_rest);
            }
            (_, Some([limit, limit_at_rest])) => {
                self.insert("largest", Metric { limit: Some(limit), ..largest });
                self.insert("reversals", reversals.paper("7 mm"));
                self.insert("rest", Metric { limit: Some(limit_at_rest), ..at_rest }.paper("3 mm"));
            }
            _ => {
                self.insert("largest", largest);
                self.insert("rest", at_rest);
            }
        }
    }

    fn prediction(&mut self, trace: &Trace, moving: &Range<f64>) {
        let predicted = trace.largest(moving, |moment| moment.predicted().norm());
        let own = trace.largest(moving, |moment| moment.own().norm());
        if self.trial.clutch.is_none() {
            let text = "largest error of the set-point, without the arm";
            self.insert("prediction", self.reported(text, predicted, "mm"));
        }
        self.insert("arm", self.reported("largest distance of the tool from the set-point", own, "mm"));
    }
}

fn add_metrics(summary: &mut Summary, trial: &Trial, trace: &Trace) {
    let mut metrics = Metrics { summary, trial, label: capital(trial.label) };
    let (moving, rest) = (BEGIN..END + 1.0, END + 1.0..END + REST);
    match trial.clutch {
        Some(times) => metrics.clutch(trace, times, &rest),
        None => metrics.following(trace, &moving, &rest),
    }
    let predicts = trial.law == Law::ModelFollowing;
    if predicts {
        metrics.prediction(trace, &moving);
    }
    if trial.clutch.is_none() {
        let elbow = trace.largest(&(BEGIN..END), |moment| moment.elbow().abs());
        metrics.insert("elbow", metrics.reported("largest error of the shoulder yaw", elbow, "mrad"));
    }
    let all = CLOSE..END + REST;
    // To the digits of single precision.
    let acceleration = trace.largest(&all, |moment| (moment.acceleration * 1e4).round() / 1e4);
    let limit = f64::from(FollowerSettings::HUMAN.position_limits.acceleration);
    let acceleration = Metric {
        limit: predicts.then_some(limit),
        ..metrics.reported("largest acceleration of the set-point", acceleration, "m/s²")
    };
    metrics.insert("acceleration", acceleration);
    let rate = trace.torque_rate(&all);
    metrics.insert("rate", metrics.reported("largest rate of a torque", rate, "N·m/s"));
}

fn figure(trial: &Trial, trace: &Trace) -> Figure {
    let caption = "Top: positions of hand and tool along x from their common start (as in the paper's figure \
                   7). Bottom: position of the true tool minus that of the true hand at the same time.";
    let mut figure = Figure::stacked(capital(trial.label), caption, "time", "s");
    let time = trace.times();
    let [hand, tool] = sides(trace, 0);
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
