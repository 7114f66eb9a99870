//! The commands `enable` and `move`.

use std::time::{Duration, Instant};

use serde_json::json;
use tesaki::model::{JointModel, RobotModel};
use tesaki::protocol::{JointTelemetry, Request};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_supervisor::BoardError;
use tesaki_supervisor::arrival::{Arrival, farthest_joint};
use tesaki_supervisor::gravity::{Load, TooHeavy};

use crate::args::{Enable, Move, Options};
use crate::failure::Failure;
use crate::motion::{End, KEEP_ALIVE, Motion, News};
use crate::output;

/// From this share of its limit on, a torque counts as limited.
const AT_LIMIT: f32 = 0.95;

/// A move that has not arrived after this time is late, unless its trajectory takes longer.
const USUAL_TIME: Duration = Duration::from_secs(20);

pub fn enable(options: &Options, args: &Enable) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    output::confirm(
        options,
        &format!("The joints of {} will be powered and hold their angles. Continue?", motion.model.name),
    )?;
    // The joints may have moved during the question.
    let goal = motion.positions()?;
    motion.enable(TaskConfig::JointServo(args.servo.into()))?;
    output::notice(options, "enabled: the joints hold");
    motion.announce_ctrl_c(Load::at(&motion.model, &goal).as_ref());
    let until = args.duration.map(|duration| Instant::now() + duration);
    let hold = goal_request(&goal)?;
    let end = motion.drive(KEEP_ALIVE, |_| hold.clone(), |_, now| until.is_some_and(|until| now >= until))?;
    motion.end(end == End::Interrupted)
}

pub fn move_joints(options: &Options, args: &Move) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    goal(&mut motion, args)?;
    let count = output::counted(args.joints.len(), "joint");
    output::confirm(options, &format!("{count} of {} will move. Continue?", motion.model.name))?;
    // The joints may have moved during the question.
    let goal = goal(&mut motion, args)?;
    let within = match args.within {
        Some(within) => within,
        None => {
            let from = motion.positions()?;
            longest_time(&motion.model, &from, &goal, args.tolerance)
        }
    };
    motion.enable(TaskConfig::JointServo(args.servo.into()))?;
    let load = Load::at(&motion.model, &goal);
    motion.announce_ctrl_c(load.as_ref());
    if let Some(heavy) = TooHeavy::at(&motion.model, &goal) {
        output::notice(options, &format!("warning: at the goal {heavy}"));
    }
    let deadline = Instant::now() + within;
    let (mut arrival, mut farthest) = (Arrival::default(), (0, 0.0));
    let mut last = JointTelemetry::default();
    let set_point = goal_request(&goal)?;
    let done = |news: &News, now| {
        if let Some(telemetry) = &news.telemetry {
            farthest = farthest_joint(telemetry, &goal);
            last = telemetry.joints.get(farthest.0).copied().unwrap_or_default();
            arrival.update(farthest.1, args.tolerance);
        }
        arrival.has_come() || now >= deadline
    };
    if motion.drive(KEEP_ALIVE, |_| set_point.clone(), done)? == End::Interrupted {
        return motion.break_off();
    }
    let (joint, error) = farthest;
    let to_go = goal.get(joint).map_or(0.0, |goal| (goal - last.reference).abs());
    let limit = motion.model.joints.get(joint).map_or(f32::INFINITY, JointModel::torque_limit);
    let joint = motion.model.joint_name(joint).to_owned();
    if !arrival.has_come() {
        let late = format!(
            "{joint} is still {error:.4} rad from its target after {} s (tolerance {} rad)",
            within.as_secs_f64(),
            args.tolerance
        );
        // Not at the goal, where something may be in the way.
        let here = goal_request(&motion.angles_within_limits())?;
        if (args.stay.hold || motion.load().is_some()) && !args.stay.no_hold {
            if options.json {
                let value =
                    json!({ "arrived": false, "joint": joint, "largest_error": output::exact(&error) });
                output::line(&value.to_string())?;
            }
            output::notice(options, &format!("{late}; it holds where it is until Ctrl-C"));
            motion.drive(KEEP_ALIVE, |_| here.clone(), |_, _| false)?;
        }
        motion.end(false)?;
        let why = if to_go > args.tolerance {
            format!(
                "Its reference is still {to_go:.4} rad from the target: give more time with --within, or shorten its \
                 `servo.filter_time`"
            )
        } else if last.torque.abs() < AT_LIMIT * limit {
            "Is the joint blocked, or --within too short?".to_owned()
        } else {
            format!(
                "Its torque is at the limit of {limit} N·m: is the joint blocked, is the limit too low, or are \
                 `encoder.counts_per_turn` or `encoder.reversed` wrong?"
            )
        };
        return Err(Failure::Late(format!("{late}; the board is disabled. {why}")));
    }
    let value = json!({ "arrived": true, "joint": joint, "largest_error": output::exact(&error) });
    output::result(options, &value, || format!("arrived: the largest error is {error:.4} rad, of {joint}"))?;
    motion.stay(args.stay.hold, args.stay.no_hold, load.as_ref(), KEEP_ALIVE, |_| set_point.clone())?;
    motion.end(false)
}

/// The time after which a move is late: the references of the joints, which their trajectory filters
/// `1/(T s + 1)²` lead to the goal, take this long, and some time for the joints themselves.
fn longest_time(model: &RobotModel, from: &[f32], goal: &[f32], tolerance: f32) -> Duration {
    let ways = from.iter().zip(goal).map(|(from, goal)| (goal - from).abs());
    let times = model.joints.iter().zip(ways).map(|(joint, way)| {
        // The way that is left after x time constants is (1 + x) exp(−x) of the whole.
        let left = |x: f32| way * (1.0 + x) * tesaki::math::exp(-x);
        let x = (0..40_u8).map(f32::from).find(|x| left(*x) < 0.5 * tolerance).unwrap_or(40.0);
        x * joint.servo.filter_time
    });
    USUAL_TIME.max(Duration::from_secs_f32(1.2 * times.fold(0.0, f32::max) + 2.0))
}

/// The present angles, with those of `args` in their place [rad].
fn goal(motion: &mut Motion, args: &Move) -> Result<Vec<f32>, Failure> {
    let mut goal = motion.positions()?;
    set_goals(&mut goal, &motion.model, args)?;
    Ok(goal)
}

/// Replaces the angles of the joints that are named.
fn set_goals(goal: &mut [f32], model: &RobotModel, args: &Move) -> Result<(), Failure> {
    let unit = if args.degrees { core::f32::consts::PI / 180.0 } else { 1.0 };
    each_once(&args.joints, "joint")?;
    for (name, angle) in &args.joints {
        let (index, joint) = find(model, name)?;
        let base = if args.relative { goal[index] } else { 0.0 };
        goal[index] = base + angle * unit;
        check_typed(joint, goal[index], args.degrees)?;
    }
    Ok(())
}

/// Refuses what is named twice.
pub fn each_once<T>(named: &[(String, T)], what: &str) -> Result<(), Failure> {
    for (index, (name, _)) in named.iter().enumerate() {
        if named.iter().take(index).any(|(earlier, _)| earlier == name) {
            return Err(Failure::Usage(format!("the {what} {name} is given twice: which is meant?")));
        }
    }
    Ok(())
}

pub fn goal_request(goal: &[f32]) -> Result<Request, Failure> {
    let positions = heapless::Vec::from_slice(goal).map_err(|_| BoardError::TooManyJoints(goal.len()))?;
    Ok(Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions })))
}

/// The joint called `name`.
pub fn find<'a>(model: &'a RobotModel, name: &str) -> Result<(usize, &'a JointModel), Failure> {
    model.joints.iter().enumerate().find(|(_, joint)| joint.name == name).ok_or_else(|| {
        let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
        Failure::Usage(format!("{} has no joint {name:?}; its joints are {}", model.name, names.join(", ")))
    })
}

/// The board checks this too, but cannot name the joint.
pub fn check(joint: &JointModel, angle: f32) -> Result<(), Failure> {
    let limits = joint.limits;
    if angle >= limits.lower && angle <= limits.upper {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "{}: {angle} rad is outside its limits {} to {} rad",
        joint.name, limits.lower, limits.upper
    )))
}

/// Where a joint stands, if that is outside its limits by more than a tolerance [rad].
pub fn outside(joint: &JointModel, angle: f32, tolerance: f32) -> Option<String> {
    let (lower, upper) = (joint.limits.lower, joint.limits.upper);
    (angle < lower - tolerance || angle > upper + tolerance).then(|| {
        format!("{} stands at {angle:.3} rad, outside its limits {lower} to {upper} rad", joint.name)
    })
}

/// As [`check`], of an angle [rad] that was typed in rad or degrees.
pub fn check_typed(joint: &JointModel, angle: f32, degrees: bool) -> Result<(), Failure> {
    let Err(failure) = check(joint, angle) else { return Ok(()) };
    Err(Failure::Usage(if degrees {
        let limits = joint.limits;
        let [angle, lower, upper] = [angle, limits.lower, limits.upper].map(f32::to_degrees);
        // With the digits that tell it from the limit.
        let beyond = (lower - angle).max(angle - upper);
        let digits = if beyond < 0.1 { 3 } else { 1 };
        format!(
            "{}: {angle:.digits$}° is outside its limits {lower:.digits$}° to {upper:.digits$}°",
            joint.name
        )
    } else {
        let hint = if angle.abs() > core::f32::consts::TAU { " (--degrees for degrees)" } else { "" };
        format!("{failure}{hint}")
    }))
}
