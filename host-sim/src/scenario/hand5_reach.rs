//! Fingertips of the five-finger hand: which ones it reproduces, and how well (Hand5, sections 2.2 and 3.2).

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki::kinematics::{Angles, FingertipTarget, FingertipTargets, Hand, HandOptions};
use tesaki::task::telexistence::TelexistenceSettings;
use tesaki::teleop::{HUMAN_FINGERS, HumanFinger};
use tesaki_supervisor::trajectory::minimum_jerk;

use super::common::{capitalized, largest};
use super::hand::{
    Fingertips, HandLog, HandRig, HandSample, HandTrial, exact_sample, human_fingertips, imitator,
    path_panel, robot_fingertips,
};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::operator::{FingersMotion, OperatorHand};
use crate::purpose::Purpose;
use crate::report::{Figure, Metric, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand5-reach",
    title: "Fingertips of the five-finger hand",
    about: "five fingertips follow those of an operator with the robot's own hand, of a person, and pinches",
    robot: "hand5",
    kind: Kind::FiveFingers,
    files: &[],
    results: "docs/measurements.md#fingertips-of-a-person-on-a-robot-hand",
    duration: 2.0 * MOTION + PINCHES,
    shortest: None,
    laws: None,
    lead: &[
        "The board gets an operator's fingertips every 10 ms, exactly and without delay. It puts the thumb's tip \
         where the operator has it, solves the other joints for the vectors from there to the other \
         fingertips, and servoes the sixteen joints on a machine that differs from its model. At first the \
         operator has the robot's hand, so that everything can be reproduced; then a person's, another one \
         for each seed, whose fingers spread one by one and have more joints; then the robot's again, and \
         pinches with one finger after another.",
        "The errors that the board states are those of its kinematics. True errors contain homing errors, up to \
         2 mrad per joint, and those of the servos: a joint that sticks comes to its reference within 2 s.",
    ],
    run,
};

/// Length of a trial with random postures, and of that with pinches [s].
const MOTION: f64 = 12.0;
const PINCHES: f64 = PINCH_PERIOD * 4.0 + 1.0;
/// Time of each movement to a pinch and back, for which it is held, and from one pinch to the next [s].
const PINCH_MOVEMENT: f64 = 1.0;
const PINCH_HOLD: f64 = 2.3;
const PINCH_PERIOD: f64 = 2.0 * PINCH_MOVEMENT + PINCH_HOLD + 0.3;
/// At rest: so long after the references stopped [s]. Joints that stick have come to their references by
/// then.
const AT_REST: f64 = 2.0;
/// Errors count from here on [s].
const BEGIN: f64 = 1.0;
/// Range of a joint in which random postures lie.
const INSIDE: [f64; 2] = [0.1, 0.9];

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = HandRig::load(setting)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    let window = BEGIN..MOTION;

    let log = follow(setting, &mut rig, "the robot's own hand", MOTION, &|hand, start, seed| {
        let motion = JointMotion::random(hand, start, seed);
        Box::new(move |time| robot_fingertips(hand, &motion.at(time)))
    })?;
    let held_back = |sample: &HandSample| sample.board.limited != 0;
    let unlimited = log.during(&window).iter().filter(|sample| !held_back(sample));
    let stated =
        largest(unlimited.flat_map(|sample| (0..HUMAN_FINGERS).map(|finger| sample.stated_error(finger))));
    let text = "Own hand: largest error that the board states while no speed limit acts";
    summary.insert("own_stated_error", Metric::at_most(text, stated, 0.05, "mm"));
    let text = "Own hand: time in which a speed limit acts";
    summary.insert("own_held_back", Metric::reported(text, log.share(&window, held_back), "%"));
    add_true_errors(&mut summary, "own", &log, &window);
    figures.push(paths("Own hand", &log));
    figures.push(errors("Own hand", &log));
    tables.push(("own.csv".to_owned(), log.table()));

    let log = follow(setting, &mut rig, "a person's hand", MOTION, &|robot, start, seed| {
        let hand = OperatorHand::random(seed);
        let motion = FingersMotion::random(&hand, seed, 3, 20, [0.6, 1.0], 0.3);
        let motion = imitator(&hand, &robot_fingertips(robot, start), motion);
        Box::new(move |time| human_fingertips(&hand, &motion, time))
    })?;
    for finger in 0..HUMAN_FINGERS {
        let name = HumanFinger::ALL[finger];
        let stated = log.rms(&window, |sample| sample.stated_error(finger));
        let text = format!("Person's hand: {name}, rms error that the board states");
        summary.insert(format!("human_{}_stated", name.name()), Metric::reported(text, stated, "mm"));
    }
    add_true_errors(&mut summary, "human", &log, &window);
    figures.push(paths("Person's hand", &log));
    figures.push(errors("Person's hand", &log));
    tables.push(("human.csv".to_owned(), log.table()));

    let log = follow(setting, &mut rig, "pinches", PINCHES, &|hand, start, _| {
        let pinches: Vec<Angles> = (1..HUMAN_FINGERS).map(|finger| pinch(hand, start, finger)).collect();
        let start = *start;
        Box::new(move |time| robot_fingertips(hand, &pinching(&start, &pinches, time)))
    })?;
    for finger in 1..HUMAN_FINGERS {
        let begin = PINCH_PERIOD * (finger - 1) as f64;
        let stop = begin + PINCH_MOVEMENT;
        // The servos have 0.3 s.
        let hold = stop + 0.3..stop + AT_REST;
        let name = HumanFinger::ALL[finger];
        let stated = log.largest(&hold, |sample| sample.stated_error(finger));
        let text = format!("Pinch with the {name}: gap by the board's account");
        summary.insert(format!("pinch_{}_stated", name.name()), Metric::at_most(text, stated, 0.5, "mm"));
        let gap = log.largest(&hold, |sample| sample.error(finger));
        let text = format!("Pinch with the {name}: true gap");
        summary.insert(format!("pinch_{}_gap", name.name()), Metric::reported(text, gap, "mm"));
        let rest = log.largest(&(stop + AT_REST..stop + PINCH_HOLD), |sample| sample.error(finger));
        let text = format!("Pinch with the {name}: true gap at rest");
        summary.insert(format!("pinch_{}_rest_gap", name.name()), Metric::at_most(text, rest, 0.5, "mm"));
    }
    figures.push(errors("Pinches", &log));
    tables.push(("pinches.csv".to_owned(), log.table()));

    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

/// The operator's fingertips at a time [s].
type Operator<'a> = Box<dyn Fn(f64) -> Fingertips + 'a>;

/// A trial in which the board gets the fingertips of `operator`, made of the hand, its first angles and the
/// seed.
fn follow(
    setting: &mut Setting<'_, '_>,
    rig: &mut HandRig,
    label: &str,
    duration: f64,
    operator: &dyn for<'a> Fn(&'a Hand, &Angles, u64) -> Operator<'a>,
) -> Result<HandLog, ScenarioError> {
    let (hand, seed) = (rig.hand.clone(), setting.seed);
    let mut trial = HandTrial::begin(setting, rig, label, &TelexistenceSettings::DEFAULT)?;
    let operator = operator(&hand, &trial.start(), seed);
    let mut number = 0_u16;
    while trial.now() < duration {
        let time = trial.now();
        let sample = exact_sample(number, time, &operator);
        trial.tick([sample], operator(time))?;
        number = number.wrapping_add(1);
    }
    trial.end()
}

/// A motion of the robot's joints: minimum-jerk movements between postures, with pauses.
struct JointMotion {
    /// When each posture is reached and left [s].
    stops: Vec<([f64; 2], Angles)>,
}

impl JointMotion {
    fn random(hand: &Hand, start: &Angles, seed: u64) -> Self {
        let mut rng = Purpose::HandPostures.rng(seed);
        let mut stops = vec![([0.0, 0.3], *start)];
        let mut time = 0.3;
        while time < MOTION {
            time += 1.0 + 0.4 * rng.uniform();
            let mut angles = Angles::zeros();
            for (angle, &(lower, upper)) in angles.iter_mut().zip(hand.limits()) {
                let [low, high] = INSIDE;
                let fraction = low + (high - low) * rng.uniform();
                *angle = lower + fraction as f32 * (upper - lower);
            }
            stops.push(([time, time + 0.3], angles));
            time += 0.3;
        }
        Self { stops }
    }

    fn at(&self, time: f64) -> Angles {
        let next = self.stops.partition_point(|([reached, _], _)| *reached <= time);
        let ([_, left], from) = self.stops[next.saturating_sub(1)];
        match self.stops.get(next) {
            Some(([reached, _], to)) => between(&from, to, (time - left) / (reached - left)),
            None => from,
        }
    }
}

fn between(from: &Angles, to: &Angles, fraction: f64) -> Angles {
    let [fraction, ..] = minimum_jerk(fraction);
    from + (to - from) * fraction as f32
}

/// A posture in which the tip of the thumb is that of a finger: of several postures of the finger, the one
/// that the thumb reaches best.
fn pinch(hand: &Hand, start: &Angles, finger: usize) -> Angles {
    let candidates = (1..20).map(|step| {
        let mut angles = *start;
        for &joint in hand.actuated(finger).iter().filter(|&&joint| Some(joint) != hand.shared()) {
            let (lower, upper) = hand.limits()[usize::from(joint)];
            angles[usize::from(joint)] = lower + 0.05 * step as f32 * (upper - lower);
        }
        let tip = hand.tip(finger, &angles).map_or(Vector3::zeros(), |(tip, _)| tip);
        let mut targets = FingertipTargets::default();
        let position: [f32; 3] = tip.into();
        targets[0] = Some(FingertipTarget { position: position.into(), weight: 1.0, direction: None });
        let report = hand.search(&targets, &HandOptions::default(), &mut angles);
        (report.distance(0), angles)
    });
    let best = candidates.min_by(|(one, _), (other, _)| one.total_cmp(other));
    best.map_or(*start, |(_, angles)| angles)
}

/// From the first posture to each pinch and back.
fn pinching(start: &Angles, pinches: &[Angles], time: f64) -> Angles {
    let number = (time / PINCH_PERIOD).floor();
    let Some(pinch) = pinches.get(number as usize) else { return *start };
    let time = time - number * PINCH_PERIOD;
    let opening = PINCH_MOVEMENT + PINCH_HOLD;
    if time < opening {
        between(start, pinch, time / PINCH_MOVEMENT)
    } else {
        between(pinch, start, (time - opening) / PINCH_MOVEMENT)
    }
}

fn add_true_errors(summary: &mut Summary, name: &str, log: &HandLog, window: &Range<f64>) {
    let label = if name == "own" { "Own hand" } else { "Person's hand" };
    let text = format!("{label}: true motion of the thumb's tip, rms error");
    summary.insert(format!("{name}_thumb_rms"), Metric::reported(text, log.thumb_error(window), "mm"));
    for finger in 1..HUMAN_FINGERS {
        let rms = log.rms(window, |sample| sample.error(finger));
        let text = format!("{label}: true vector from thumb to {}, rms error", HumanFinger::ALL[finger]);
        summary.insert(
            format!("{name}_{}_rms", HumanFinger::ALL[finger].name()),
            Metric::reported(text, rms, "mm"),
        );
    }
}

/// As the paper's figure 5.
fn paths(label: &str, log: &HandLog) -> Figure {
    let caption = "Thumb and index finger in the plane in which fingers bend: z along the fingers, x out of the palm \
                   (compare the paper's figure 5). The thumb is shifted to where the robot's was at first; the \
                   index finger is seen from the thumb's tip.";
    let samples = log.during(&(BEGIN..MOTION));
    let offset = log.0.first().map_or(Vector3::zeros(), |first| first.robot[0] - first.operator[0]);
    let names = ["robot", "operator"];
    let thumb = path_panel(
        "thumb",
        names,
        samples.iter().map(|sample| sample.robot[0]),
        samples.iter().map(|sample| sample.operator[0] + offset),
    );
    let index = path_panel(
        "index finger from the thumb",
        names,
        samples.iter().map(|sample| sample.vectors(1)[0]),
        samples.iter().map(|sample| sample.vectors(1)[1]),
    );
    Figure::paths(format!("{label}: paths"), caption, "x", "mm").panel(thumb).panel(index)
}

fn errors(label: &str, log: &HandLog) -> Figure {
    let caption = "How far the true vectors from the thumb's tip to the other fingertips are from the operator's at \
                   the same time.";
    Figure::stacked(format!("{label}: errors"), capitalized(caption), "time", "s").panel(log.error_panel())
}
