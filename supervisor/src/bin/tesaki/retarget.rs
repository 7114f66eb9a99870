//! `retarget`: joint angles of a hand for an operator's fingertips, from a file or live.

mod live;
mod source;

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use serde_json::{Value, json};
use tesaki::kinematics::{Angles, Hand, MAX_FINGERS};
use tesaki::model::RobotModel;
use tesaki::robot::Robot;
use tesaki::task::telexistence::{FingertipPoint, MAX_EXTRAPOLATION};
use tesaki::teleop::{InvalidFingertip, RetargetReport, RetargetState, Retargeting};
use tesaki_description::retargeting::{self, RetargetingSettings};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::operator::{Fingertips, operator_fingertips};

use crate::args::{Options, Retarget};
use crate::eval::{Results, exact, finish};
use crate::failure::Failure;
use crate::output::{self, keep_input, keep_robot};
use source::Source;

pub fn run(options: &Options, args: &Retarget) -> Result<(), Failure> {
    match (&args.input, &args.robot) {
        (Some(input), Some(robot)) if !args.live => {
            keep_input(&args.output, "--out", input, "--in")?;
            keep_robot(&args.output, robot)?;
            let model = RobotFolder::load(robot)?.model;
            let settings = RetargetingSettings::load(robot, &model)?;
            tell_defaults(options, robot);
            let mut tracker = source::tracker(args, &settings)?;
            let (name, frames) = Source::new(args).file(input)?;
            let mut tips = Vec::with_capacity(frames.len());
            for (line, frame) in &frames {
                let found = tracker.add(frame.time, &frame.observation);
                let found = found.map_err(|error| Failure::Other(format!("{name}:{line}: {error}")))?;
                tips.push((frame.time, found));
            }
            offline(options, args, &model, &settings, &tips, tracker.gaps())
        }
        _ => live::run(options, args),
    }
}

/// Says where the settings come from if the robot has none.
fn tell_defaults(options: &Options, robot: &Path) {
    let file = robot.join(retargeting::FILE);
    if !file.exists() {
        output::notice(options, &format!("{}: there is none, so defaults are used", file.display()));
    }
}

/// A thumb that is farther from most targets does not fit the operator's [m].
const UNREACHED: f32 = 5e-3;

/// Retargets all frames, and says how well.
fn offline(
    options: &Options,
    args: &Retarget,
    model: &RobotModel,
    settings: &RetargetingSettings,
    frames: &[(f64, Fingertips)],
    gaps: u32,
) -> Result<(), Failure> {
    let mut robot = Box::new(Robot::NONE);
    let hand = robot.configure(model).ok().and_then(|()| robot.hand());
    // The settings are those of a hand.
    let hand = hand.ok_or_else(|| Failure::Usage(format!("{} is not a hand", model.name)))?;
    let mut task = settings.task;
    task.limit_speeds(model.joints.iter().map(|joint| joint.limits.velocity));
    let retargeting = Retargeting { hand, settings: &task.retargeting };
    let mut solver = Solver {
        retargeting,
        settings,
        start: settings.posture.unwrap_or_else(|| hand.center()),
        state: None,
        known: [None; MAX_FINGERS],
        time: None,
    };
    let mut accuracy = Accuracy::default();
    let header = std::iter::once("time".to_owned());
    let mut results = Results {
        header: header.chain(model.joints.iter().map(|joint| joint.name.to_string())).collect(),
        ..Results::default()
    };
    for (time, tips) in frames {
        let known = solver.bridge(*time, tips);
        if let Some((report, seconds)) =
            solver.solve(*time, &known).map_err(|error| Failure::Other(format!("at {time} s: {error}")))?
        {
            accuracy.add(&solver.retargeting, &known, &report, seconds);
        }
        let angles = solver.state.as_ref().map_or(solver.start, RetargetState::angles);
        let mut row = vec![time.to_string()];
        row.extend(angles.iter().take(model.joints.len()).map(|&angle| exact(angle)));
        results.rows.push(row);
    }
    if accuracy.seconds.is_empty() {
        return Err(Failure::Other(
            "no frame shows the thumb (thumb_x, thumb_y, thumb_z in a table), from which the other fingers are led: \
             nothing was computed"
                .to_owned(),
        ));
    }
    // Stamps in another unit make every frame a gap.
    if gaps > 10 && 2 * gaps as usize > frames.len() {
        let longest = settings.task.max_sample_age;
        results.notes.push(format!(
            "more than half of the frames come more than {longest} s after the one before: is `time` in seconds?"
        ));
    }
    if gaps > 0 {
        let gaps = output::counted(gaps as usize, "gap");
        results.notes.push(format!(
            "{gaps} of more than {} s between frames: the hand waited",
            settings.task.max_sample_age
        ));
    }
    let (text, mut value) = accuracy.told(model, hand, task.retargeting.tolerance);
    // The distances are sorted by now.
    let half = quantile(&accuracy.distances[0], 0.5).is_some_and(|distance| distance > UNREACHED);
    if half && 2 * accuracy.limited < accuracy.seconds.len() {
        results.notes.push(format!(
            "the thumb is more than {} mm from half of its targets: fit the robot's hand to the operator's by `scale` or \
             `[posture]` in retargeting.toml",
            1e3 * UNREACHED
        ));
    }
    value["gaps"] = gaps.into();
    finish(options, &args.output, &results, &text, &value)
}

/// The retargeting of one frame after the other.
struct Solver<'a> {
    retargeting: Retargeting<'a>,
    settings: &'a RetargetingSettings,
    /// Angles before the first frame with a thumb [rad].
    start: Angles,
    /// `None` until then.
    state: Option<RetargetState>,
    /// Where each fingertip was seen last, and when.
    known: [Option<(f64, FingertipPoint)>; MAX_FINGERS],
    time: Option<f64>,
}

impl Solver<'_> {
    /// Bridges what is not seen as the board does: a fingertip goes on with its velocity for a moment, then
    /// it waits, then it is unknown.
    #[expect(clippy::cast_possible_truncation, reason = "a short time")]
    fn bridge(&mut self, time: f64, tips: &Fingertips) -> Fingertips {
        let mut bridged = *tips;
        for (tip, known) in bridged.iter_mut().zip(&mut self.known) {
            match (&*tip, &*known) {
                (Some(seen), _) => *known = Some((time, *seen)),
                (None, Some((last, seen))) if time - last <= self.settings.task.max_sample_age.into() => {
                    let ahead = ((time - last) as f32).min(MAX_EXTRAPOLATION);
                    let mut ahead_of = *seen;
                    for (position, velocity) in ahead_of.position.iter_mut().zip(seen.velocity) {
                        *position += velocity * ahead;
                    }
                    *tip = Some(ahead_of);
                }
                (None, _) => *known = None,
            }
        }
        bridged
    }

    /// Report and computing time [s] of a frame.
    #[expect(clippy::cast_possible_truncation, reason = "a short time")]
    fn solve(
        &mut self,
        time: f64,
        tips: &Fingertips,
    ) -> Result<Option<(RetargetReport, f64)>, InvalidFingertip> {
        let operator = operator_fingertips(tips);
        // During a gap the hand waited.
        let longest = f64::from(self.settings.task.max_sample_age);
        // The hand begins where the first frame needs it.
        let period = self.time.map_or(f32::INFINITY, |before| (time - before).min(longest) as f32);
        if self.state.is_none()
            && let Some(thumb) = &operator.positions[0]
        {
            let posture = &self.settings.posture;
            let offset = posture.as_ref().map(|posture| self.retargeting.initial_offset(posture, thumb));
            self.state = Some(self.retargeting.begin(&self.start, &offset.unwrap_or_default()));
        }
        let Some(state) = &mut self.state else { return Ok(None) };
        self.time = Some(time);
        let start = Instant::now();
        let report = self.retargeting.update(state, &operator, period);
        let seconds = start.elapsed().as_secs_f64();
        Ok(Some((report?, seconds)))
    }
}

/// What was reproduced, and in what time.
#[derive(Default)]
struct Accuracy {
    /// Distances from the targets, finger by finger of the robot [m].
    distances: [Vec<f32>; MAX_FINGERS],
    /// Computing times [s].
    seconds: Vec<f64>,
    /// Frames in which the speed limits hold back a joint.
    limited: usize,
}

impl Accuracy {
    fn add(
        &mut self,
        retargeting: &Retargeting<'_>,
        tips: &Fingertips,
        report: &RetargetReport,
        seconds: f64,
    ) {
        self.seconds.push(seconds);
        self.limited += usize::from(report.limited != 0);
        let fingers = self.distances.iter_mut().zip(retargeting.settings.follows).enumerate();
        for (finger, (distances, follows)) in fingers.take(retargeting.hand.len()) {
            if tips.get(usize::from(follows)).is_some_and(Option::is_some) {
                distances.push(report.distance(finger));
            }
        }
    }

    /// As text and as JSON.
    fn told(&mut self, model: &RobotModel, hand: &Hand, tolerance: f32) -> (String, Value) {
        let mut text = format!("{}\n", output::counted(self.seconds.len(), "frame"));
        let _ =
            writeln!(text, "finger            median      95 %   largest  within {:.1} mm", 1e3 * tolerance);
        let mut fingers = serde_json::Map::new();
        for (chain, distances) in model.chains.iter().zip(&mut self.distances).take(hand.len()) {
            distances.sort_by(f32::total_cmp);
            let within = distances.partition_point(|distance| *distance <= tolerance);
            #[expect(clippy::cast_precision_loss, reason = "a share")]
            let share = within as f64 / distances.len().max(1) as f64;
            let [median, most, largest] = [0.5, 0.95, 1.0].map(|part| quantile(distances, part));
            let name = chain.name.as_str();
            match (median, most, largest) {
                (Some(median), Some(most), Some(largest)) => {
                    let [a, b, c] = [median, most, largest].map(|distance| 1e3 * distance);
                    let _ = writeln!(
                        text,
                        "{name:<15} {a:>5.2} mm  {b:>5.2} mm  {c:>5.2} mm  {:>5.1} %",
                        1e2 * share
                    );
                }
                _ => drop(writeln!(text, "{name:<15} never seen")),
            }
            let value = json!({
                "frames": distances.len(), "median": output::exact(&median), "percentile_95": output::exact(&most),
                "largest": output::exact(&largest), "within_tolerance": share,
            });
            fingers.insert(name.to_owned(), value);
        }
        self.seconds.sort_by(f64::total_cmp);
        let [median, most] = [0.5, 0.99].map(|part| quantile(&self.seconds, part).unwrap_or(0.0));
        let _ = writeln!(text, "held back by limits of speed: {}", output::counted(self.limited, "frame"));
        let _ = writeln!(
            text,
            "computing time of a frame: median {:.3} ms, 99 % {:.3} ms",
            1e3 * median,
            1e3 * most
        );
        text += &output::counted(self.seconds.len(), "frame");
        let value = json!({
            "frames": self.seconds.len(), "tolerance": output::exact(&tolerance), "fingers": fingers,
            "speed_limited": self.limited, "computing_time": { "median": median, "percentile_99": most },
        });
        (text, value)
    }
}

/// The smallest of sorted values that is not below this part of them.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "a number of values"
)]
fn quantile<T: Copy>(sorted: &[T], part: f64) -> Option<T> {
    let rank = (part * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied()
}
