//! `reach`: fingertips through space.

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
use crate::motion::{End, Motion};
use crate::output;

/// From one point to the next: one for each tick of the board.
const PERIOD: Duration = Duration::from_millis(10);
/// Shortest way [s].
const SHORTEST: f32 = 0.5;
/// Longest way [s].
const LONGEST: f32 = 600.0;
/// How long to wait at the end of the way.
const PATIENCE: Duration = Duration::from_secs(3);
/// Telemetries in a row within the tolerance that count as arrived.
const ARRIVED: u32 = 10;

/// The way of one fingertip: straight, with minimum jerk.
struct Way {
    tip: String,
    finger: Finger,
    chain: Chain,
    joints: std::ops::Range<usize>,
    from: Vector3<f32>,
    to: Vector3<f32>,
}

pub fn run(options: &Options, aim: &Reach) -> Result<(), Failure> {
    if !(aim.speed > 0.0 && aim.speed.is_finite()) {
        return Err(Failure::Usage(format!("--speed {}: a speed above 0 m/s is needed", aim.speed)));
    }
    let mut motion = Motion::begin(options)?;
    let start = motion.positions()?;
    let ways = ways(&motion.model, &start, aim)?;
    let longest = ways.iter().map(|way| (way.to - way.from).norm()).fold(0.0, f32::max);
    // A motion of minimum jerk is 15/8 times as fast in its middle as on average.
    let duration = (1.875 * longest / aim.speed).max(SHORTEST);
    if duration > LONGEST {
        return Err(Failure::Usage(format!(
            "--speed {}: the way would take {duration:.0} s, more than {LONGEST} s",
            aim.speed
        )));
    }
    check(&motion.model, &ways, &start, duration)?;
    output::confirm(
        options,
        &format!(
            "{} of {} will move for {duration:.1} s. Go on?",
            output::counted(aim.tips.len(), "tip"),
            motion.model.name
        ),
    )?;
    motion.enable(TaskConfig::JointServo(aim.servo.into()))?;
    let begun = Instant::now();
    let set_point = |now: Instant| {
        let share = (now - begun).as_secs_f32() / duration;
        Request::Task(TaskCommand::JointServo(JointCommand::Reach {
            tips: ways.iter().map(|way| way.point(share, duration)).collect(),
        }))
    };
    let deadline = begun + Duration::from_secs_f32(duration) + PATIENCE;
    let (mut near, mut farthest) = (0, (String::new(), 0.0_f32));
    let end = motion.drive(PERIOD, set_point, |news, now| {
        if let Some(telemetry) = &news.telemetry {
            farthest = distance(&ways, telemetry);
            near = if farthest.1 <= aim.tolerance { near + 1 } else { 0 };
        }
        near >= ARRIVED || now >= deadline
    })?;
    if end == End::Interrupted {
        return motion.end(true);
    }
    let (tip, distance) = farthest;
    if near < ARRIVED {
        motion.end(false)?;
        return Err(Failure::Late(format!(
            "{tip} is still {:.2} mm from its place (tolerance {:.2} mm): the board is disarmed. Is a joint blocked?",
            1e3 * distance,
            1e3 * aim.tolerance
        )));
    }
    output::result(options, &json!({ "arrived": true, "largest_error": output::exact(&distance) }), || {
        format!("arrived: the largest error is {:.2} mm", 1e3 * distance)
    })?;
    if aim.hold {
        output::notice(options, "holding; Ctrl-C disarms");
        motion.drive(PERIOD, set_point, |_, _| false)?;
    }
    motion.end(false)
}

/// A way for each chain; those that are not named stay.
fn ways(model: &RobotModel, start: &[f32], aim: &Reach) -> Result<Vec<Way>, Failure> {
    let named = |name: &str| model.chains.iter().any(|chain| chain.name == name);
    if let Some((unknown, _)) = aim.tips.iter().find(|(name, _)| !named(name)) {
        let names: Vec<&str> = model.chains.iter().map(|chain| chain.name.as_str()).collect();
        return Err(Failure::Usage(format!(
            "{} has no tip {unknown:?}; its tips are {}",
            model.name,
            names.join(", ")
        )));
    }
    let mut ways = Vec::with_capacity(MAX_CHAINS);
    for (tip, joints) in model.chains.iter().zip(model.chain_ranges()) {
        let (models, angles) = (&model.joints[joints.clone()], &start[joints.clone()]);
        let chain = Chain::new(models, &tip.tip);
        let not_a_finger = |why: String| {
            Failure::Usage(format!(
                "{}: the board cannot lead it through space, because {why}; `tesaki eval ik` finds joint angles for `tesaki move`",
                tip.name
            ))
        };
        let limits: Vec<(f32, f32)> =
            models.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
        let limits = <[(f32, f32); 3]>::try_from(limits)
            .map_err(|_| not_a_finger("it has not 3 joints".to_owned()))?;
        let finger = Finger::try_new(&chain, limits).map_err(|error| not_a_finger(error.to_string()))?;
        let from = chain.posture(angles).tip().translation.vector;
        let place = aim.tips.iter().find(|(name, _)| *name == tip.name.as_str()).map(|(_, place)| *place);
        let to = match place {
            None => from,
            Some(place) if aim.relative => from + Vector3::from(place),
            Some(place) => Vector3::from(place),
        };
        ways.push(Way { tip: tip.name.to_string(), finger, chain, joints, from, to });
    }
    Ok(ways)
}

/// Goes the whole way here first: what the board would refuse in the middle is refused before anything moves.
fn check(model: &RobotModel, ways: &[Way], start: &[f32], duration: f32) -> Result<(), Failure> {
    for way in ways {
        let mut near = [0.0; 3];
        near.copy_from_slice(&start[way.joints.clone()]);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of ticks")]
        let steps = (duration / TICK) as u16;
        for step in 0..=steps {
            let share = f32::from(step) / f32::from(steps);
            let place = Vector3::from(way.point(share, duration).position);
            let gone = 1e3 * (place - way.from).norm();
            let angles = way.finger.nearest(&place, &near).map_err(|error| {
                let why = match error {
                    FingerError::NotFinite => "that is no place".to_owned(),
                    FingerError::OutOfReach { nearest } => format!(
                        "it does not reach there; without its joints' limits it would reach {:.4},{:.4},{:.4}",
                        nearest.x, nearest.y, nearest.z
                    ),
                    FingerError::OutsideLimits { joint, value, lower, upper } => format!(
                        "{} would have to be at {value:.3} rad, outside its limits {lower} to {upper} rad",
                        model.joint_name(way.joints.start + usize::from(joint))
                    ),
                };
                Failure::Usage(format!("{}: {gone:.1} mm on its way: {why}", way.tip))
            })?;
            for (index, (angle, near)) in way.joints.clone().zip(angles.iter().zip(&near)) {
                let joint = &model.joints[index];
                let speed = (angle - near).abs() / TICK;
                if step > 0 && speed > joint.limits.velocity {
                    return Err(Failure::Usage(format!(
                        "{}: {gone:.1} mm on its way {} would turn at {speed:.1} rad/s, more than its {} rad/s: a lower --speed, \
                         or a way that keeps from the straight finger and from its root's axis",
                        way.tip, joint.name, joint.limits.velocity
                    )));
                }
            }
            near = angles;
        }
    }
    Ok(())
}

/// The tip that is farthest from its place, and how far [m].
fn distance(ways: &[Way], telemetry: &Telemetry) -> (String, f32) {
    let mut farthest = (String::new(), 0.0);
    for way in ways {
        let joints = telemetry.joints.iter().skip(way.joints.start).take(way.joints.len());
        let angles: Vec<f32> = joints.map(|joint| joint.position).collect();
        let distance = (way.chain.posture(&angles).tip().translation.vector - way.to).norm();
        if distance >= farthest.1 {
            farthest = (way.tip.clone(), distance);
        }
    }
    farthest
}

impl Way {
    /// The point at `share` of the time, 0 to 1.
    fn point(&self, share: f32, duration: f32) -> TipPoint {
        let way = self.to - self.from;
        #[expect(clippy::cast_possible_truncation, reason = "the board computes in single precision")]
        let [value, rate, change] = minimum_jerk(share.into()).map(|value| value as f32);
        TipPoint {
            position: (self.from + way * value).into(),
            velocity: (way * (rate / duration)).into(),
            acceleration: (way * (change / (duration * duration))).into(),
        }
    }
}
