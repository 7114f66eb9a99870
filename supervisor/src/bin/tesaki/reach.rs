//! `reach`: fingertips along straight lines.

use std::cell::Cell;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde_json::json;
use tesaki::TICK;
use tesaki::kinematics::{Chain, Finger, FingerError, TipPoint};
use tesaki::model::{MAX_CHAINS, RobotModel};
use tesaki::protocol::{Request, Telemetry};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_supervisor::trajectory::minimum_jerk;

use crate::args::{Options, Reach};
use crate::failure::Failure;
use crate::motion::{End, Motion, each_once};
use crate::output;

/// Period of the set-points: one for each tick of the board.
const PERIOD: Duration = Duration::from_millis(10);
/// Longest step along the path from a set-point to the next: a late one must not let the joints jump.
const MAX_STEP: Duration = Duration::from_millis(20);
/// Shortest duration of a path [s].
const MIN_DURATION: f32 = 0.5;
/// Longest duration of a path [s].
const MAX_DURATION: f32 = 600.0;
/// Longest wait for arrival after the end of the path.
const ARRIVAL_TIMEOUT: Duration = Duration::from_secs(3);
/// Telemetries in a row within the tolerance that count as arrival.
const ARRIVED: u32 = 10;

/// The path of one fingertip: a straight line with a minimum-jerk profile.
struct TipPath {
    tip: String,
    finger: Finger,
    chain: Chain,
    joints: std::ops::Range<usize>,
    from: Vector3<f32>,
    to: Vector3<f32>,
}

pub fn run(options: &Options, args: &Reach) -> Result<(), Failure> {
    if !(args.speed > 0.0 && args.speed.is_finite()) {
        return Err(Failure::Usage(format!("--speed {}: the speed must be above 0 m/s", args.speed)));
    }
    let mut motion = Motion::begin(options)?;
    let start = motion.positions()?;
    let paths = paths(&motion.model, &start, args)?;
    let duration = duration(&paths, args.speed)?;
    check(&motion.model, &paths, &start, duration)?;
    output::confirm(
        options,
        &format!(
            "{} of {} will move for {duration:.1} s. Continue?",
            output::counted(args.tips.len(), "tip"),
            motion.model.name
        ),
    )?;
    motion.enable(TaskConfig::JointServo(args.servo.into()))?;
    // The time of the last set-point, and that on the path: after a pause it goes on from where it was.
    let clock = Cell::new((Instant::now(), Duration::ZERO));
    let set_point = |now: Instant| {
        let (last, on_path) = clock.get();
        let on_path = on_path + now.saturating_duration_since(last).min(MAX_STEP);
        clock.set((now, on_path));
        let fraction = on_path.as_secs_f32() / duration;
        Request::Task(TaskCommand::JointServo(JointCommand::StreamTips {
            tips: paths.iter().map(|path| path.point(fraction, duration)).collect(),
        }))
    };
    let end = Duration::from_secs_f32(duration) + ARRIVAL_TIMEOUT;
    let is_late = || clock.get().1 >= end;
    let (mut near, mut farthest) = (0, (String::new(), 0.0_f32));
    let end = motion.drive(PERIOD, set_point, |news, _| {
        if let Some(telemetry) = &news.telemetry {
            farthest = distance(&paths, telemetry);
            near = if farthest.1 <= args.tolerance { near + 1 } else { 0 };
        }
        near >= ARRIVED || is_late()
    })?;
    if end == End::Interrupted {
        return motion.end(true);
    }
    let (tip, distance) = farthest;
    if near < ARRIVED {
        if motion.load().is_some() && !args.no_hold {
            output::notice(options, &format!("{tip} has not arrived; the robot holds until Ctrl-C"));
            motion.drive(PERIOD, set_point, |_, _| false)?;
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
    motion.stay(args.hold, args.no_hold, load.as_ref(), PERIOD, set_point)?;
    motion.end(false)
}

/// Duration of the longest path at the maximum speed [s].
fn duration(paths: &[TipPath], speed: f32) -> Result<f32, Failure> {
    let longest = paths.iter().map(|path| (path.to - path.from).norm()).fold(0.0, f32::max);
    // The peak speed of a minimum-jerk motion is 15/8 of its mean speed.
    let duration = (1.875 * longest / speed).max(MIN_DURATION);
    if duration > MAX_DURATION {
        return Err(Failure::Usage(format!(
            "--speed {}: the path would take {duration:.0} s, more than {MAX_DURATION} s",
            speed
        )));
    }
    Ok(duration)
}

/// A path for each chain; tips that are not named hold their positions.
fn paths(model: &RobotModel, start: &[f32], args: &Reach) -> Result<Vec<TipPath>, Failure> {
    each_once(&args.tips, "tip")?;
    let named = |name: &str| model.chains.iter().any(|chain| chain.name == name);
    if let Some((unknown, _)) = args.tips.iter().find(|(name, _)| !named(name)) {
        let names: Vec<&str> = model.chains.iter().map(|chain| chain.name.as_str()).collect();
        return Err(Failure::Usage(format!(
            "{} has no tip {unknown:?}; its tips are {}",
            model.name,
            names.join(", ")
        )));
    }
    let mut paths = Vec::with_capacity(MAX_CHAINS);
    for (tip, joints) in model.chains.iter().zip(model.chain_ranges()) {
        let (models, angles) = (&model.joints[joints.clone()], &start[joints.clone()]);
        let chain = Chain::new(models, &tip.tip);
        let not_a_finger = |why: String| {
            Failure::Usage(format!(
                "the tips of {} cannot be moved along lines, because every chain must be a finger and the one to \
                 {} is none: {why}. Use `tesaki eval ik` to find joint angles for `tesaki move`",
                model.name, tip.name
            ))
        };
        let limits: Vec<(f32, f32)> =
            models.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
        let limits = <[(f32, f32); 3]>::try_from(limits)
            .map_err(|_| not_a_finger("its chain does not have 3 joints".to_owned()))?;
        let finger = Finger::try_new(&chain, limits).map_err(|error| not_a_finger(error.to_string()))?;
        let from = chain.posture(angles).tip().translation.vector;
        let target = args.tips.iter().find(|(name, _)| *name == tip.name.as_str()).map(|(_, target)| *target);
        let to = match target {
            None => from,
            Some(target) if args.relative => from + Vector3::from(target),
            Some(target) => Vector3::from(target),
        };
        paths.push(TipPath { tip: tip.name.to_string(), finger, chain, joints, from, to });
    }
    Ok(paths)
}

/// Checks all points of the paths, so that no set-point is refused during the motion.
fn check(model: &RobotModel, paths: &[TipPath], start: &[f32], duration: f32) -> Result<(), Failure> {
    for path in paths {
        let mut last = [0.0; 3];
        last.copy_from_slice(&start[path.joints.clone()]);
        let unreachable = |place: &str, error| {
            let why = match error {
                FingerError::NotFinite => "the position is not finite".to_owned(),
                FingerError::OutOfReach { nearest } => format!(
                    "out of reach; the nearest position, ignoring joint limits, is {:.4},{:.4},{:.4}",
                    nearest.x, nearest.y, nearest.z
                ),
                FingerError::OutsideLimits { joint, value, lower, upper } => format!(
                    "{} would need {value:.3} rad, outside its limits {lower} to {upper} rad",
                    model.joint_name(path.joints.start + usize::from(joint))
                ),
            };
            let role = if path.from == path.to { " (to be held where it is)" } else { "" };
            Failure::Usage(format!("{}{role}: {place}: {why}", path.tip))
        };
        path.finger.nearest(&path.to, &last).map_err(|error| unreachable("the target", error))?;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of ticks")]
        let steps = (duration / TICK) as u16;
        for step in 0..=steps {
            let fraction = f32::from(step) / f32::from(steps);
            let position = Vector3::from(path.point(fraction, duration).position);
            let distance = 1e3 * (position - path.from).norm();
            let angles = path
                .finger
                .nearest(&position, &last)
                .map_err(|error| unreachable(&format!("{distance:.1} mm along the path"), error))?;
            for (index, (angle, last)) in path.joints.clone().zip(angles.iter().zip(&last)) {
                let joint = &model.joints[index];
                let speed = (angle - last).abs() / TICK;
                if step > 0 && speed > joint.limits.velocity {
                    return Err(Failure::Usage(format!(
                        "{}: {distance:.1} mm along the path {} would turn at {speed:.1} rad/s, above its limit of {} rad/s. Choose \
                         a lower --speed, or a path away from the singularities (straight finger; tip on the axis of the \
                         first joint)",
                        path.tip, joint.name, joint.limits.velocity
                    )));
                }
            }
            last = angles;
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

impl TipPath {
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
