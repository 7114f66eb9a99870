//! The tolerances of a goal. As in `control_msgs/JointTolerance`, 0 means the default and a negative number
//! means no limit.

use tesaki::protocol::JointTelemetry;

use crate::controller::{Defaults, Outcome};
use crate::messages::{ErrorCode, Goal, JointTolerance};
use crate::trajectory::{Refused, Trajectory};

/// Largest deviations of a joint; `None` without a limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tolerance {
    /// [rad]
    position: Option<f64>,
    /// [rad/s]
    velocity: Option<f64>,
}

/// The tolerances of a goal, in the order of its joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Tolerances {
    path: Vec<Tolerance>,
    goal: Vec<Tolerance>,
    /// Time after the last point within which all joints must have arrived [s]; infinite without a limit.
    time: f64,
}

impl Tolerances {
    /// Checks the tolerances of a goal.
    ///
    /// # Errors
    /// The first tolerance that cannot be kept.
    pub fn of(goal: &Goal, defaults: &Defaults) -> Result<Self, Refused> {
        let names = &goal.trajectory.joint_names;
        let time = goal.goal_time_tolerance.seconds();
        Ok(Self {
            path: each(names, &goal.path_tolerance, "path_tolerance", Tolerance::default())?,
            goal: each(
                names,
                &goal.goal_tolerance,
                "goal_tolerance",
                Tolerance { position: Some(defaults.tolerance), velocity: None },
            )?,
            time: limit(time, Some(defaults.time)).unwrap_or(f64::INFINITY),
        })
    }

    /// Returns the first violation of the path tolerances.
    pub fn path<'a>(
        &self,
        own: &[usize],
        joints: &[JointTelemetry],
        name: impl Fn(usize) -> &'a str,
    ) -> Option<Refused> {
        own.iter().zip(&self.path).find_map(|(&joint, tolerance)| {
            let state = joints.get(joint)?;
            let error = f64::from((state.reference - state.position).abs());
            let limit = tolerance.position.filter(|&limit| error > limit)?;
            Some(Refused::new(
                ErrorCode::PathToleranceViolated,
                format!(
                    "{} is {error:.4} rad from the trajectory; its path_tolerance is {limit} rad",
                    name(joint)
                ),
            ))
        })
    }

    /// Returns whether all joints have arrived, `late` seconds after the last point.
    pub fn goal<'a>(
        &self,
        trajectory: &Trajectory,
        joints: &[JointTelemetry],
        late: f64,
        name: impl Fn(usize) -> &'a str,
    ) -> Option<Outcome> {
        let away = trajectory.end().zip(&self.goal).find_map(|((joint, goal), tolerance)| {
            let state = joints.get(joint)?;
            let distance = f64::from((goal.position - state.position).abs());
            let speed = f64::from(state.velocity.abs());
            let name = name(joint);
            if let Some(limit) = tolerance.position.filter(|&limit| distance > limit) {
                return Some(format!("{name} is {distance:.4} rad from its goal (tolerance {limit} rad)"));
            }
            let limit = tolerance.velocity.filter(|&limit| speed > limit)?;
            Some(format!("{name} moves with {speed:.4} rad/s (tolerance {limit} rad/s)"))
        });
        match away {
            None => Some(Outcome::Succeeded),
            Some(text) if late > self.time => Some(Outcome::Failed(Refused::new(
                ErrorCode::GoalToleranceViolated,
                format!("{text} {} s after the end of the trajectory", self.time),
            ))),
            Some(_) => None,
        }
    }
}

/// Returns the limit that a number stands for.
fn limit(value: f64, default: Option<f64>) -> Option<f64> {
    match value {
        value if value > 0.0 => Some(value),
        value if value < 0.0 => None,
        _ => default,
    }
}

/// Returns the tolerance of each joint.
fn each(
    names: &[String],
    given: &[JointTolerance],
    what: &str,
    default: Tolerance,
) -> Result<Vec<Tolerance>, Refused> {
    let is_velocity = what == "goal_tolerance";
    for JointTolerance { name, position, velocity, acceleration } in given {
        if !names.contains(name) {
            let text = format!("{what} names {name:?}, which is not in the trajectory");
            return Err(Refused::new(ErrorCode::InvalidJoints, text));
        }
        if [position, velocity, acceleration].iter().any(|value| !value.is_finite()) {
            return Err(Refused::new(ErrorCode::InvalidGoal, format!("{what} of {name} is not finite")));
        }
        if *acceleration > 0.0 || (*velocity > 0.0 && !is_velocity) {
            let text = format!(
                "{what} of {name} limits what is not measured here: only positions, and velocities at the \
                 goal, can be limited"
            );
            return Err(Refused::new(ErrorCode::InvalidGoal, text));
        }
    }
    let of = |name: &String| match given.iter().find(|tolerance| tolerance.name == *name) {
        Some(own) => Tolerance {
            position: limit(own.position, default.position),
            velocity: limit(own.velocity, default.velocity),
        },
        None => default,
    };
    Ok(names.iter().map(of).collect())
}
