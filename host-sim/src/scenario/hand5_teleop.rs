//! Telexistence: a glove leads the five-finger hand over a link (Hand5, section 3).

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki::task::telexistence::{FingertipPoint, FingertipSample, TelexistenceSettings};
use tesaki::teleop::{Fingertip, GloveFilter, GloveFilterState, HUMAN_FINGERS, HumanFinger, HumanHand};

use super::common::{T, capitalized, largest};
use super::hand::{
    Fingertips, HandLog, HandRig, HandTrial, human_fingertips, imitator, in_robot_frame, path_panel,
    robot_fingertips, single,
};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::operator::calibration_trial::{CalibrationPlan, calibrate};
use crate::operator::{FingersMotion, Glove, GloveValues, Link, LinkValues, OperatorHand};
use crate::report::{Figure, Metric, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand5-teleop",
    title: "A glove leads the five-finger hand",
    about: "sixteen joints follow an operator's calibrated glove over a link with delay and loss",
    robot: "hand5",
    kind: Kind::FiveFingers,
    files: &[],
    results: "docs/measurements.md#fingertips-of-a-person-on-a-robot-hand",
    duration: MOTION * TRIALS.len() as f64,
    shortest: None,
    laws: None,
    lead: &[
        "A simulated operator, another one for each seed, has calibrated a glove and moves the fingers. The glove \
         gives sixteen orientations a hundred times a second, each 1.5° off; from them the PC computes positions \
         and velocities of the fingertips and sends them over a link of 20 to 30 ms that loses one message \
         in twenty, in bursts. The board extrapolates each sample to the present, solves the sixteen joints \
         and servoes them on a machine that differs from its model.",
        "Compared are the true fingertips of the robot with the operator's true ones at the same time. So \
         everything counts: calibration, sensors, filter, link, retargeting, servos, homing.",
    ],
    run,
};

/// Length of a trial [s].
const MOTION: f64 = 15.0;
/// Errors count from here on [s].
const BEGIN: f64 = 1.5;
/// No message arrives in this time of the last trial [s].
const SILENCE: Range<f64> = 6.0..7.0;
/// Time until the references have come to rest after the stream stopped [s]; joints that stick follow later.
const STOPPING: f64 = 0.5;

/// Of the glove: what it is late the board makes up for.
const FILTER: GloveFilter = GloveFilter::SMOOTH;

struct Trial {
    name: &'static str,
    label: &'static str,
    /// Fingers that the operator leads, from the thumb on.
    fingers: usize,
    silence: bool,
}

const TRIALS: [Trial; 3] = [
    Trial { name: "all", label: "five fingers", fingers: HUMAN_FINGERS, silence: false },
    Trial { name: "two", label: "thumb and index finger", fingers: 2, silence: false },
    Trial {
        name: "silence",
        label: "a link that is cut for a second",
        fingers: HUMAN_FINGERS,
        silence: true,
    },
];

/// The operator, with glove and link.
struct Operator {
    hand: OperatorHand,
    motion: FingersMotion,
    glove: Glove,
    rate: f64,
    fingers: usize,
    state: GloveFilterState,
    human: HumanHand,
    /// The sample that comes next.
    next: (f64, tesaki::teleop::GloveSample),
    link: Link<[Option<Fingertip>; HUMAN_FINGERS]>,
}

impl Operator {
    fn new(trial: &Trial, robot: &Fingertips, seed: u64) -> Result<Self, ScenarioError> {
        let hand = OperatorHand::random(seed);
        let values = GloveValues::default();
        let human = calibrate(&CalibrationPlan::FULL, values, seed)?.human;
        let motion = FingersMotion::random(&hand, seed, 4, 40, [0.6, 1.0], 0.3);
        let motion = imitator(&hand, robot, motion);
        let mut glove = Glove::new(values, seed.wrapping_add(3 << 32));
        let next = glove.sample(&hand, &motion);
        let link = LinkValues { delay: 0.02, jitter: 0.01, loss: 0.05, burst: 3.0 };
        Ok(Self {
            hand,
            motion,
            glove,
            rate: values.rate,
            fingers: trial.fingers,
            state: GloveFilterState::default(),
            human,
            next,
            link: Link::new(link, seed),
        })
    }

    fn at(&self, time: f64) -> Fingertips {
        human_fingertips(&self.hand, &self.motion, time)
    }

    /// The samples that arrive at the board by a time [s].
    fn receive(&mut self, time: f64) -> Vec<FingertipSample> {
        while self.next.0 <= time {
            // A sensor that gave no sample is bridged.
            let _ = FILTER.update(&mut self.state, (1.0 / self.rate) as f32, &self.next.1);
            self.link.send(self.next.0, self.human.fingertips(&self.state).map(Result::ok));
            self.next = self.glove.sample(&self.hand, &self.motion);
        }
        let delay = f64::from(FILTER.delay());
        let fingers = self.fingers;
        let packets = self.link.receive(time);
        packets
            .map(|packet| FingertipSample {
                number: packet.sequence as u16,
                age: (time - packet.time + delay) as f32,
                tips: std::array::from_fn(|finger| {
                    packet.message[finger].filter(|_| finger < fingers).map(|tip| point(&tip))
                }),
            })
            .collect()
    }
}

/// A fingertip in the frame of the robot's hand.
fn point(tip: &Fingertip) -> FingertipPoint {
    let turned = |vector: [f32; 3]| single(in_robot_frame(Vector3::from(vector.map(f64::from))));
    FingertipPoint {
        position: turned(tip.position),
        velocity: turned(tip.velocity),
        direction: Some(turned(tip.direction)),
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = HandRig::load(setting)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for trial in &TRIALS {
        let log = lead(setting, &mut rig, trial)?;
        add_metrics(&mut summary, trial, &log);
        if !trial.silence {
            figures.push(paths(trial, &log));
        }
        figures.push(errors(trial, &log));
        tables.push((format!("{}.csv", trial.name), log.table()));
    }
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

fn lead(setting: &mut Setting<'_, '_>, rig: &mut HandRig, trial: &Trial) -> Result<HandLog, ScenarioError> {
    let (robot, seed) = (rig.hand.clone(), setting.seed);
    let mut hand = HandTrial::begin(setting, rig, trial.label, &TelexistenceSettings::DEFAULT)?;
    let mut operator = Operator::new(trial, &robot_fingertips(&robot, &hand.start()), seed)?;
    while hand.now() < MOTION {
        let time = hand.now();
        let mut samples = operator.receive(time);
        if trial.silence && SILENCE.contains(&time) {
            samples.clear();
        }
        hand.tick(samples, operator.at(time))?;
    }
    hand.end()
}

fn add_metrics(summary: &mut Summary, trial: &Trial, log: &HandLog) {
    let label = capitalized(trial.label);
    let mut insert = |key: String, metric: Metric| summary.insert(format!("{}_{key}", trial.name), metric);
    let speed = 100.0 * log.largest(&(0.0..MOTION), |sample| sample.speed);
    let text = format!("{label}: largest speed of a joint, of its limit");
    insert("speed".into(), Metric::at_most(text, speed, 100.0, "%"));
    if trial.silence {
        let rest = SILENCE.start + STOPPING..SILENCE.end;
        let text = format!("{label}: motion of a fingertip from 0.5 s after the cut on");
        insert("rest_motion".into(), Metric::reported(text, motion(log, &rest), "mm"));
        let after = SILENCE.end + 0.5..MOTION;
        let before = BEGIN..SILENCE.start;
        for (key, text, window) in
            [("before", "before the cut", before), ("after", "from 0.5 s after the link returned on", after)]
        {
            let rms = log.rms(&window, |sample| sample.error(1));
            let text = format!("{label}: vector from thumb to index finger, rms error {text}");
            insert(format!("index_rms_{key}"), Metric::reported(text, rms, "mm"));
        }
        return;
    }
    let window = BEGIN..MOTION;
    let delay = 1e3 * delay(log, &window);
    insert("delay".into(), Metric::reported(format!("{label}: delay of the robot's vectors"), delay, "ms"));
    let thumb = log.thumb_error(&window);
    let text = format!("{label}: motion of the thumb's tip, rms error");
    insert("thumb_rms".into(), Metric::reported(text, thumb, "mm"));
    for finger in 1..trial.fingers {
        let name = HumanFinger::ALL[finger];
        let [[mean, deviation], [angle, angle_deviation]] = log.vector_errors(&window, finger);
        let mut report = |key: &str, what: &str, value: f64, unit: &'static str| {
            let text = format!("{label}: {name}, {what}");
            insert(format!("{}_{key}", name.name()), Metric::reported(text, value, unit));
        };
        report("length_mean", "mean error of the length", mean, "mm");
        report("length_deviation", "standard deviation of the length", deviation, "mm");
        report("direction_mean", "mean error of the direction", angle, "°");
        report("direction_deviation", "standard deviation of the direction", angle_deviation, "°");
    }
}

/// Largest distance of a fingertip from where it is at the start of a time span [mm].
fn motion(log: &HandLog, span: &Range<f64>) -> f64 {
    let Some(first) = log.during(span).first() else { return f64::NAN };
    log.largest(span, |sample| {
        let moved = sample.robot.iter().zip(&first.robot).map(|(tip, before)| 1e3 * (tip - before).norm());
        largest(moved)
    })
}

/// By how much the operator's vector from thumb to index finger must be delayed to fit the robot's best [s],
/// in ticks.
fn delay(log: &HandLog, span: &Range<f64>) -> f64 {
    let cost = |ticks: usize| -> f64 {
        let late = log.during(&(span.start + ticks as f64 * T..span.end));
        let pairs = late.iter().zip(log.during(span));
        pairs.map(|(late, then)| (late.vectors(1)[0] - then.vectors(1)[1]).norm_squared()).sum::<f64>()
            / late.len() as f64
    };
    let best = (0..20).min_by(|one, other| cost(*one).total_cmp(&cost(*other)));
    best.map_or(f64::NAN, |ticks: usize| ticks as f64 * T)
}

/// As the paper's figures 3 and 5 in one.
fn paths(trial: &Trial, log: &HandLog) -> Figure {
    let caption = "From the thumb's tip to those of index and little finger, in the plane in which fingers bend: z \
                   along the fingers, x out of the palm.";
    let samples = log.during(&(BEGIN..MOTION));
    let figure = Figure::paths(format!("{}: paths", capitalized(trial.label)), caption, "x", "mm");
    [1, trial.fingers - 1].into_iter().take(trial.fingers - 1).fold(figure, |figure, finger| {
        let points = |which: usize| samples.iter().map(move |sample| sample.vectors(finger)[which]);
        figure.panel(path_panel(
            &HumanFinger::ALL[finger].to_string(),
            ["robot", "operator"],
            points(0),
            points(1),
        ))
    })
}

fn errors(trial: &Trial, log: &HandLog) -> Figure {
    let caption = "How far the robot's vectors from the thumb's tip to the other fingertips are from the operator's at \
                   the same time.";
    let figure = Figure::stacked(format!("{}: errors", capitalized(trial.label)), caption, "time", "s")
        .panel(log.error_panel());
    if trial.silence { figure.phase(SILENCE.start, SILENCE.end, "link cut") } else { figure }
}
