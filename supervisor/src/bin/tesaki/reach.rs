//! `reach`: fingertips along straight lines.

use std::cell::{Cell, RefCell};
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde_json::json;
use tesaki::TICK;
use tesaki::control::JointPoint;
use tesaki::kinematics::{Chain, Finger, FingerError, TipPoint};
use tesaki::model::{JointModel, RobotModel};
use tesaki::protocol::{Request, Telemetry};
use tesaki::signal::MINIMUM_JERK_PEAK;
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_supervisor::arrival::Arrival;
use tesaki_supervisor::trajectory::minimum_jerk;
use tesaki_supervisor::words::unreachable;

use crate::args::{Options, Reach};
use crate::failure::Failure;
use crate::joints::{each_once, goal_request};
use crate::motion::{End, KEEP_ALIVE, MAX_DURATION, Motion, PERIOD, check_distance};
use crate::output;

/// Longest step along the path from a set-point to the next: a late one must not let the joints jump.
const MAX_STEP: Duration = Duration::from_millis(20);
/// How far the path may be ahead of the board's ticks, as its telemetry tells them: set-points that arrive
/// together, after a pause of the link, must not let the joints jump either.
const MAX_LEAD: Duration = Duration::from_millis(30);
/// Shortest duration of a path [s].
const MIN_DURATION: f32 = 0.5;
/// No joint is meant to turn so far in a tick [rad], 15 rad/s: the path passes a singularity.
const LEAP: f32 = 0.15;
/// Longest wait for arrival after the end of the path.
const ARRIVAL_TIMEOUT: Duration = Duration::from_secs(3);

/// The path of one fingertip: a straight line with a minimum-jerk profile.
struct TipPath {
    tip: String,
    finger: Finger,
    chain: Chain,
    joints: std::ops::Range<usize>,
    from: Vector3<f32>,
    to: Vector3<f32>,
}

/// The time on the path: that of this machine, but never far ahead of the board's.
#[derive(Clone, Copy)]
struct PathClock {
    /// When it was last advanced.
    last: Instant,
    on_path: Duration,
    /// The first tick of the board that was heard of, and the latest.
    board: Option<(u32, u32)>,
}

impl PathClock {
    const fn start(now: Instant) -> Self {
        Self { last: now, on_path: Duration::ZERO, board: None }
    }

    /// With telemetry from `tick`.
    fn heard(self, tick: u32) -> Self {
        Self { board: Some((self.board.map_or(tick, |(first, _)| first), tick)), ..self }
    }

    /// At `now`, for the next set-point. After a pause it goes on from where it was.
    fn advanced(self, now: Instant) -> Self {
        let step = now.saturating_duration_since(self.last).min(MAX_STEP);
        // Of a board that was reset, the ticks seem to be before the first one.
        let ticks =
            self.board.map(|(first, latest)| latest.wrapping_sub(first)).filter(|ticks| *ticks < 1 << 31);
        let board = ticks.map_or(Duration::ZERO, |ticks| PERIOD * ticks);
        let on_path = (self.on_path + step).min(board + MAX_LEAD).max(self.on_path);
        Self { last: now, on_path, ..self }
    }
}

pub fn run(options: &Options, args: &Reach) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    let (_, duration) = plan(&mut motion, args)?;
    output::confirm(
        options,
        &format!(
            "{} of {} will move for {duration:.1} s. Continue?",
            output::counted(args.tips.len(), "tip"),
            motion.model.name
        ),
    )?;
    // The joints may have moved during the question.
    let (paths, duration) = plan(&mut motion, args)?;
    motion.enable(TaskConfig::JointServo(args.servo.into()))?;
    motion.announce_ctrl_c(motion.load().as_ref());
    let clock = Cell::new(PathClock::start(Instant::now()));
    let is_hand = paths.len() == motion.model.chains.len();
    let points: Vec<JointPoint> = motion.angles_within_limits().into_iter().map(at_rest).collect();
    let points = RefCell::new(points);
    let set_point = |now: Instant| {
        clock.set(clock.get().advanced(now));
        let fraction = clock.get().on_path.as_secs_f32() / duration;
        Request::Task(TaskCommand::JointServo(if is_hand {
            let tips = paths.iter().map(|path| path.point(fraction, duration)).collect();
            JointCommand::StreamTips { tips }
        } else {
            // The board computes no joints of a tip where not every chain is a finger.
            let mut points = points.borrow_mut();
            for path in &paths {
                path.follow(fraction, duration, &mut points);
            }
            JointCommand::Stream { points: points.iter().copied().collect() }
        }))
    };
    let end_of_path = Duration::from_secs_f32(duration);
    let (mut arrival, mut farthest) = (Arrival::default(), (String::new(), 0.0_f32));
    let end = motion.drive(PERIOD, set_point, |news, _| {
        if let Some(telemetry) = &news.telemetry {
            clock.set(clock.get().heard(telemetry.tick));
            farthest = distance(&paths, telemetry);
            arrival.update(farthest.1, args.tolerance);
        }
        let on_path = clock.get().on_path;
        (arrival.has_come() && on_path >= end_of_path) || on_path >= end_of_path + ARRIVAL_TIMEOUT
    })?;
    if end == End::Interrupted {
        return motion.break_off();
    }
    let (tip, distance) = farthest;
    if !arrival.has_come() {
        if (args.stay.hold || motion.load().is_some()) && !args.stay.no_hold {
            if options.json {
                let value =
                    json!({ "arrived": false, "tip": tip, "largest_error": output::exact(&distance) });
                output::line(&value.to_string())?;
            }
            output::notice(
                options,
                &format!("{tip} has not arrived; the robot holds where it is until Ctrl-C"),
            );
            // Not at the target, where something may be in the way.
            let here = goal_request(&motion.angles_within_limits())?;
            motion.drive(KEEP_ALIVE, |_| here.clone(), |_, _| false)?;
        }
        motion.end(false)?;
        return Err(Failure::Late(format!(
            "{tip} is still {:.2} mm from its target (tolerance {:.2} mm); the board is disabled. Is a joint blocked?",
            1e3 * distance,
            1e3 * args.tolerance
        )));
    }
    output::result(
        options,
        &json!({ "arrived": true, "tip": tip, "largest_error": output::exact(&distance) }),
        || format!("arrived: the largest error is {:.2} mm", 1e3 * distance),
    )?;
    let load = motion.load();
    motion.stay(args.stay.hold, args.stay.no_hold, load.as_ref(), PERIOD, set_point)?;
    motion.end(false)
}

/// The paths from where the joints are, and their duration [s].
fn plan(motion: &mut Motion, args: &Reach) -> Result<(Vec<TipPath>, f32), Failure> {
    // A robot of another kind need not be homed to be told so.
    let fingers = fingers(&motion.model, &args.tips)?;
    let start = motion.positions()?;
    let paths = paths(&motion.model, fingers, &start, args);
    for path in &paths {
        check_distance(&format!("{}: the target", path.tip), (path.to - path.from).norm(), &motion.model)?;
    }
    let duration = duration(&paths, args.speed)?;
    check(&motion.model, &paths, &start, duration)?;
    Ok((paths, duration))
}

/// Duration of the longest path at the maximum speed [s].
fn duration(paths: &[TipPath], speed: f32) -> Result<f32, Failure> {
    let longest = paths.iter().map(|path| (path.to - path.from).norm()).fold(0.0, f32::max);
    let duration = (MINIMUM_JERK_PEAK * longest / speed).max(MIN_DURATION);
    if duration > MAX_DURATION {
        return Err(Failure::Usage(format!(
            "--speed {}: the path would take {duration:.0} s, more than {MAX_DURATION} s",
            speed
        )));
    }
    Ok(duration)
}

/// The fingers of a hand, with the places of their chains: all, or only those of the tips that are named
/// where another chain is no finger, which then holds its angles.
fn fingers(model: &RobotModel, tips: &[(String, [f32; 3])]) -> Result<Vec<(usize, Finger, Chain)>, Failure> {
    each_once(tips, "tip")?;
    let named = |name: &str| model.chains.iter().any(|chain| chain.name == name);
    if let Some((unknown, _)) = tips.iter().find(|(name, _)| !named(name)) {
        let names: Vec<&str> = model.chains.iter().map(|chain| chain.name.as_str()).collect();
        return Err(Failure::Usage(format!(
            "{} has no tip {unknown:?}; its tips are {}",
            model.name,
            names.join(", ")
        )));
    }
    let chains = model.chains.iter().zip(model.chain_ranges()).enumerate();
    let found = chains.map(|(index, (tip, joints))| {
        let joints = &model.joints[joints];
        let chain = Chain::new(joints, &tip.tip);
        let not_a_finger = |why: String| {
            Failure::Usage(format!(
                "`tesaki reach` needs fingers of three joints; {}{why}. Use `tesaki eval ik` to find joint angles for \
                 `tesaki move`",
                tip.name
            ))
        };
        if model.mimics_of(index).next().is_some() {
            return Err(not_a_finger(" has a mimic joint".to_owned()));
        }
        let limits: Vec<(f32, f32)> =
            joints.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
        let limits = <[(f32, f32); 3]>::try_from(limits)
            .map_err(|_| not_a_finger(format!(" has {}", joints.len())))?;
        let finger = Finger::try_new(&chain, limits).map_err(|error| not_a_finger(format!(": {error}")))?;
        Ok((index, finger, chain))
    });
    let found: Vec<_> = found.collect();
    let all = found.iter().all(Result::is_ok);
    let is_named = |tip: &str| tips.iter().any(|(name, _)| name == tip);
    let chains = model.chains.iter().zip(found);
    chains.filter(|(chain, _)| all || is_named(&chain.name)).map(|(_, finger)| finger).collect()
}

/// A path for each finger; tips that are not named hold their positions.
fn paths(
    model: &RobotModel,
    fingers: Vec<(usize, Finger, Chain)>,
    start: &[f32],
    args: &Reach,
) -> Vec<TipPath> {
    let path = fingers.into_iter().filter_map(|(index, finger, chain)| {
        let (tip, joints) = (model.chains.get(index)?, model.chain_ranges().nth(index)?);
        let from = chain.posture(&start[joints.clone()]).tip().translation.vector;
        let target = args.tips.iter().find(|(name, _)| *name == tip.name.as_str()).map(|(_, target)| *target);
        let to = match target {
            None => from,
            Some(target) if args.relative => from + Vector3::from(target),
            Some(target) => Vector3::from(target),
        };
        Some(TipPath { tip: tip.name.to_string(), finger, chain, joints, from, to })
    });
    path.collect()
}

/// Checks all points of the paths, so that no set-point is refused during the motion.
fn check(model: &RobotModel, paths: &[TipPath], start: &[f32], duration: f32) -> Result<(), Failure> {
    for path in paths {
        let mut last = [0.0; 3];
        last.copy_from_slice(&start[path.joints.clone()]);
        let joints = &model.joints[path.joints.clone()];
        let failure = |place: &str, error: &FingerError| {
            let why = unreachable(error, joints);
            let role = if path.from == path.to { " (to be held where it is)" } else { "" };
            Failure::Usage(format!("{}{role}: {place} {why}", path.tip))
        };
        let [x, y, z]: [f32; 3] = path.to.into();
        let target = format!("the target {x:.4}, {y:.4}, {z:.4} m");
        path.finger.nearest(&path.to, &last).map_err(|error| failure(&target, &error))?;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of ticks")]
        let steps = (duration / TICK) as u16;
        // Of the fastest turn: share of the limit, joint, turn in a tick [rad], distance on the path [mm].
        let mut fastest: Option<(f32, &JointModel, f32, f32)> = None;
        for step in 0..=steps {
            let fraction = f32::from(step) / f32::from(steps);
            let position = Vector3::from(path.point(fraction, duration).position);
            let distance = 1e3 * (position - path.from).norm();
            let angles = path
                .finger
                .nearest(&position, &last)
                .map_err(|error| failure(&format!("a position {distance:.1} mm along the path"), &error))?;
            for (joint, (angle, last)) in joints.iter().zip(angles.iter().zip(&last)) {
                let turn = (angle - last).abs();
                let share = turn / (TICK * joint.limits.velocity);
                if step > 0 && share > fastest.map_or(1.0, |(share, ..)| share) {
                    fastest = Some((share, joint, turn, distance));
                }
            }
            last = angles;
        }
        if let Some((_, joint, turn, distance)) = fastest {
            let (tip, name) = (&path.tip, &joint.name);
            return Err(Failure::Usage(if turn > LEAP {
                format!(
                    "{tip}: {distance:.1} mm along the path {name} would have to turn by {turn:.2} rad at once, since the path \
                     passes the axis of the first joint, or stretches the finger. A lower --speed hardly helps: choose a \
                     path around that, in several steps"
                )
            } else {
                format!(
                    "{tip}: {distance:.1} mm along the path {name} would turn at {:.1} rad/s, above its limit of {} rad/s. \
                     Choose a lower --speed, or a path away from the singularities (straight finger; tip on the axis of \
                     the first joint)",
                    turn / TICK,
                    joint.limits.velocity
                )
            }));
        }
    }
    Ok(())
}

/// The tip that is farthest from its target, and its distance [m].
fn distance(paths: &[TipPath], telemetry: &Telemetry) -> (String, f32) {
    let mut farthest = (String::new(), 0.0);
    for path in paths {
        let joints = telemetry.joints.iter().skip(path.joints.start).take(path.joints.len());
        let angles: Vec<f32> = joints.map(|joint| joint.position).collect();
        let distance = (path.chain.posture(&angles).tip().translation.vector - path.to).norm();
        if distance >= farthest.1 {
            farthest = (path.tip.clone(), distance);
        }
    }
    farthest
}

/// A joint that holds an angle.
const fn at_rest(position: f32) -> JointPoint {
    JointPoint { position, velocity: 0.0, acceleration: 0.0 }
}

impl TipPath {
    /// Puts the points of its joints at `fraction` of the duration, near their last ones, into those of all
    /// joints. Where there is none, which [`check`] has ruled out but for rounding, they hold the last ones.
    fn follow(&self, fraction: f32, duration: f32, points: &mut [JointPoint]) {
        let tip = self.point(fraction, duration);
        let Some(own) = points.get_mut(self.joints.clone()) else { return };
        let mut near = [0.0; 3];
        near.iter_mut().zip(&*own).for_each(|(near, point)| *near = point.position);
        let Ok(angles) = self.finger.nearest(&tip.position.into(), &near) else {
            own.iter_mut().for_each(|point| *point = at_rest(point.position));
            return;
        };
        let motion = self.chain.posture(&angles).joint_motion(&tip);
        let (velocities, accelerations) = motion.unwrap_or_default();
        let motion = angles.into_iter().zip(velocities).zip(accelerations);
        for (point, ((position, velocity), acceleration)) in own.iter_mut().zip(motion) {
            *point = JointPoint { position, velocity, acceleration };
        }
    }

    /// The set-point at `fraction` of the duration, 0 to 1.
    fn point(&self, fraction: f32, duration: f32) -> TipPoint {
        let line = self.to - self.from;
        #[expect(clippy::cast_possible_truncation, reason = "the board computes in single precision")]
        let [value, rate, change] = minimum_jerk(fraction.into()).map(|value| value as f32);
        TipPoint {
            position: (self.from + line * value).into(),
            velocity: (line * (rate / duration)).into(),
            acceleration: (line * (change / (duration * duration))).into(),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// A finger of hand3, whose first axis is z at x = 0, y = 0.04 m, from 69 mm beside it.
    #[test]
    fn no_lower_speed_is_advised_where_the_path_crosses_the_first_axis() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
        let model = tesaki_description::robot::RobotFolder::load(&folder).unwrap().model;
        let (start, joints) = ([0.002, 0.332, 1.3, 0.0, 0.332, 0.681, 0.0, 0.332, 0.681], 0..3);
        let limits = [0, 1, 2]
            .map(|joint: usize| (model.joints[joint].limits.lower, model.joints[joint].limits.upper));
        let chain = Chain::of_model(&model, 0);
        let from = chain.posture(&start[..3]).tip().translation.vector;
        let said = |to: [f32; 3], speed: f32| {
            let finger = Finger::try_new(&chain, limits).unwrap();
            let tip = "finger1_tip".to_owned();
            let path =
                TipPath { tip, finger, chain: chain.clone(), joints: joints.clone(), from, to: to.into() };
            let duration = duration(std::slice::from_ref(&path), speed).unwrap();
            check(&model, &[path], &start, duration)
                .err()
                .map(|failure| failure.to_string())
                .unwrap_or_default()
        };
        for speed in [0.05, 0.1, 0.2] {
            let said = said([-0.02, 0.0401, 0.14], speed);
            assert!(said.contains("finger1_swing would have to turn by "), "{speed}: {said}");
            assert!(said.contains(" rad at once") && said.contains("A lower --speed hardly helps"), "{said}");
        }
        assert_eq!(said([from.x + 0.01, from.y, from.z + 0.01], 0.05), "");
    }

    #[test]
    fn a_chain_that_is_no_finger_holds_its_angles_and_does_not_stop_the_others() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
        let mut model = tesaki_description::robot::RobotFolder::load(&folder).unwrap().model;
        let target = |tip: &str| [(tip.to_owned(), [0.0; 3])];
        let chains = |model: &RobotModel, tip: &str| {
            let found = fingers(model, &target(tip)).map_err(|failure| failure.to_string());
            found.map(|found| found.into_iter().map(|(index, ..)| index).collect::<Vec<_>>())
        };
        assert_eq!(chains(&model, "finger2_tip"), Ok(vec![0, 1, 2]));
        model.chains[2].joints = 2;
        model.joints.pop();
        assert_eq!(chains(&model, "finger2_tip"), Ok(vec![1]));
        let why = chains(&model, "finger3_tip").unwrap_err();
        assert!(why.contains("`tesaki reach` needs fingers of three joints; finger3_tip has 2"), "{why}");
        // The joints of the path move, those of the others do not.
        let (_, finger, chain) = fingers(&model, &target("finger2_tip")).unwrap().remove(0);
        let start = [0.0, 0.332, 0.681, 0.0, 0.332, 0.681, 0.1, 0.2];
        let from = chain.posture(&start[3..6]).tip().translation.vector;
        let to = from - Vector3::new(0.0, 0.0, 0.01);
        let path = TipPath { tip: "finger2_tip".to_owned(), finger, chain, joints: 3..6, from, to };
        let mut points = start.map(at_rest);
        path.follow(0.5, 1.0, &mut points);
        for (joint, (point, start)) in points.iter().zip(start).enumerate() {
            let moves = (point.position - start).abs() > 1e-6;
            assert!(!moves || (3..6).contains(&joint), "{joint}: {point:?}");
        }
        assert!(
            points[4].velocity.abs() > 1e-3 && (points[4].position - start[4]).abs() > 1e-3,
            "{points:?}"
        );
        path.follow(1.0, 1.0, &mut points);
        let angles = [3, 4, 5].map(|joint: usize| points[joint].position);
        let distance = (path.chain.posture(&angles).tip().translation.vector - to).norm();
        assert!(distance < 1e-5 && points[4].velocity.abs() < 1e-3, "{distance}");
    }

    /// The time on the path after each of the set-points, with the time at which it is sent [ms] and the tick
    /// of the latest telemetry.
    fn times<const N: usize>(set_points: [(u64, u32); N]) -> [u128; N] {
        let start = Instant::now();
        let mut clock = PathClock::start(start);
        set_points.map(|(time, tick)| {
            clock = clock.heard(tick).advanced(start + Duration::from_millis(time));
            clock.on_path.as_millis()
        })
    }

    #[test]
    fn the_path_keeps_time_with_the_board_and_jumps_after_no_pause() {
        // Telemetry in each second tick.
        assert_eq!(times([(0, 500), (10, 500), (20, 502), (30, 502), (40, 504)]), [0, 10, 20, 30, 40]);
        // The board, or the link to it, stands still for 70 ms: the set-points it then finds are one place.
        assert_eq!(
            times([(0, 500), (20, 502), (40, 502), (60, 502), (80, 502), (90, 504), (100, 506)]),
            [0, 20, 40, 50, 50, 60, 70]
        );
        // This program stands still.
        assert_eq!(times([(0, 500), (10, 501), (90, 509), (100, 510)]), [0, 10, 30, 40]);
        // Its ticks wrap around.
        let wrapped = [(0, u32::MAX), (20, 1), (40, 3), (60, 5), (80, 7), (100, 9)];
        assert_eq!(times(wrapped), [0, 20, 40, 60, 80, 100]);
        // The board is reset, and counts from 0.
        assert_eq!(times([(0, 500), (10, 501), (20, 0), (30, 1)]), [0, 10, 20, 30]);
    }
}
