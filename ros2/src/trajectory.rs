//! A joint trajectory, interpreted as by ros2_control's joint_trajectory_controller: points in time, joined
//! by splines of the lowest order that meets what both points state. Positions alone are joined by lines,
//! positions and velocities by cubic, positions, velocities and accelerations by quintic polynomials
//! (Siciliano 4.2).

use tesaki::TICK;
use tesaki::control::JointPoint;
use tesaki::robot::{LimitRefusal, Robot};
use tesaki_supervisor::words;

use crate::messages::{ErrorCode, JointTrajectory, Point, Time};

/// Maximum duration of a trajectory [s]: while it is checked, nothing is received from the board.
const MAX_DURATION: f64 = 300.0;
/// Maximum distance of a first point at time 0 from the present reference [rad]: planners begin at measured
/// angles.
const START_TOLERANCE: f64 = 0.02;
/// Relative error of a velocity that is computed from two angles.
const ROUNDING: f32 = 1e-3;
/// Speed below which a trajectory ends at rest [rad/s].
const AT_REST: f64 = 1e-3;

/// Why a goal is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason}")]
pub struct Refused {
    pub code: ErrorCode,
    pub reason: String,
}

impl Refused {
    pub fn new(code: ErrorCode, reason: impl Into<String>) -> Self {
        Self { code, reason: reason.into() }
    }
}

fn invalid<T>(reason: String) -> Result<T, Refused> {
    Err(Refused::new(ErrorCode::InvalidGoal, reason))
}

/// Where a joint is at a point of the trajectory, and what else is stated.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Knot {
    position: f64,
    velocity: Option<f64>,
    acceleration: Option<f64>,
}

/// A trajectory of some joints of a robot that was checked against all limits.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// Indices of its joints among those of the robot.
    joints: Vec<usize>,
    /// Times of its knots [s], from 0 on.
    times: Vec<f64>,
    /// For each time, a knot of each joint.
    knots: Vec<Vec<Knot>>,
}

impl Trajectory {
    /// Checks a trajectory that continues from the `references` of all joints.
    ///
    /// # Errors
    /// The first error in it.
    pub fn check(
        message: &JointTrajectory,
        robot: &Robot,
        references: &[JointPoint],
    ) -> Result<Self, Refused> {
        let joints = indices(&message.joint_names, robot)?;
        let from = |&joint: &usize| {
            let point = references.get(joint).copied().unwrap_or_default();
            Knot {
                position: f64::from(point.position),
                velocity: Some(f64::from(point.velocity)),
                acceleration: Some(f64::from(point.acceleration)),
            }
        };
        let mut times = vec![0.0];
        let mut knots = vec![joints.iter().map(from).collect::<Vec<_>>()];
        let Some(last) = message.points.last() else {
            return invalid("the trajectory has no points".to_owned());
        };
        let mut before = None;
        for (number, point) in message.points.iter().enumerate() {
            let time = point.time_from_start;
            if time < Time::default() || before.is_some_and(|before| time <= before) {
                return invalid(format!(
                    "point {number}: time_from_start is {} s, not after {} s: times must increase",
                    time.seconds(),
                    before.unwrap_or_default().seconds()
                ));
            }
            before = Some(time);
            let knot = knot(number, point, &message.joint_names)?;
            if time == Time::default() {
                begin_with(&mut knots[0], &knot, &message.joint_names)?;
            } else {
                times.push(time.seconds());
                knots.push(knot);
            }
        }
        if last.time_from_start == Time::default() {
            return invalid(
                "its only point has time_from_start 0: give the time in which to get there".to_owned(),
            );
        }
        if last.time_from_start.seconds() > MAX_DURATION {
            return invalid(format!("it takes longer than {MAX_DURATION} s: send it in parts"));
        }
        if let Some((name, velocity)) =
            message.joint_names.iter().zip(&last.velocities).find(|(_, velocity)| velocity.abs() > AT_REST)
        {
            return invalid(format!("{name} still moves at the last point, with {velocity} rad/s"));
        }
        let trajectory = Self { joints, times, knots };
        trajectory.check_limits(robot, references)?;
        Ok(trajectory)
    }

    /// Checks every point that would be sent to the board, by the board's own rules, and the motion from one
    /// to the next: a piece that lies between two of them may be too fast.
    fn check_limits(&self, robot: &Robot, references: &[JointPoint]) -> Result<(), Refused> {
        let mut before = references.to_vec();
        let mut time = 0.0;
        while time < self.duration() {
            time += f64::from(TICK);
            for (joint, point) in self.points(time) {
                let (Some(config), Some(before)) = (robot.joints().get(joint), before.get_mut(joint)) else {
                    continue;
                };
                let number = u8::try_from(joint).unwrap_or(u8::MAX);
                let (value, limit) = ((point.position - before.position) / TICK, config.limits.velocity);
                let is_too_fast = value.abs() > (1.0 + ROUNDING) * limit;
                let step = LimitRefusal::TooFast { joint: number, value, limit };
                let checked = if is_too_fast { Err(step) } else { Ok(()) };
                config.check_point(number, &point, before).and(checked).map_err(|refusal| {
                    let text = named(&refusal, robot);
                    Refused::new(ErrorCode::InvalidGoal, format!("at {time:.2} s: {text}"))
                })?;
                *before = point;
            }
        }
        Ok(())
    }

    /// Returns its duration [s].
    pub fn duration(&self) -> f64 {
        self.times.last().copied().unwrap_or_default()
    }

    /// Returns the indices of its joints.
    pub fn joints(&self) -> &[usize] {
        &self.joints
    }

    /// Returns the points of its joints at `time` [s], each with its index; at rest from its end on.
    pub fn points(&self, time: f64) -> impl Iterator<Item = (usize, JointPoint)> {
        let last = self.times.len().saturating_sub(1);
        let next = self.times.partition_point(|&knot| knot <= time);
        let (from, to) = (next.saturating_sub(1), next.min(last));
        let (start, duration) = (self.times[from], self.times[to] - self.times[from]);
        let knots = self.knots[from].iter().zip(&self.knots[to]);
        self.joints.iter().copied().zip(knots.map(move |(a, b)| {
            narrow(if from == to { [b.position, 0.0, 0.0] } else { spline(a, b, duration, time - start) })
        }))
    }

    /// Returns the points of its joints at its end, at rest.
    pub fn end(&self) -> impl Iterator<Item = (usize, JointPoint)> {
        self.points(f64::INFINITY)
    }
}

/// Returns the indices of the joints with these names.
fn indices(names: &[String], robot: &Robot) -> Result<Vec<usize>, Refused> {
    let known = || robot.model().joints.iter().map(|joint| joint.name.as_str());
    let refuse = |reason| Err(Refused::new(ErrorCode::InvalidJoints, reason));
    if names.is_empty() {
        return refuse("the trajectory names no joint".to_owned());
    }
    let mut joints = Vec::new();
    for name in names {
        let Some(joint) = known().position(|known| known == name) else {
            let known: Vec<&str> = known().collect();
            return refuse(format!(
                "{} has no joint {name:?}; its joints are {}",
                robot.model().name,
                known.join(", ")
            ));
        };
        if joints.contains(&joint) {
            return refuse(format!("{name} is named twice"));
        }
        joints.push(joint);
    }
    Ok(joints)
}

/// Converts a point of the message to a knot for each joint.
fn knot(number: usize, point: &Point, names: &[String]) -> Result<Vec<Knot>, Refused> {
    let count = names.len();
    let lists = [
        ("positions", &point.positions, false),
        ("velocities", &point.velocities, true),
        ("accelerations", &point.accelerations, true),
    ];
    for (what, values, optional) in lists {
        if values.len() != count && !(optional && values.is_empty()) {
            return invalid(format!("point {number} has {} {what} for {count} joints", values.len()));
        }
        if let Some((name, value)) = names.iter().zip(values).find(|(_, value)| !value.is_finite()) {
            return invalid(format!("point {number}: {what} of {name} is {value}"));
        }
    }
    if !point.effort.is_empty() {
        return invalid(format!("point {number} has efforts: the joints are commanded by position"));
    }
    if point.velocities.is_empty() && !point.accelerations.is_empty() {
        return invalid(format!(
            "point {number} has accelerations without velocities: give both, or neither"
        ));
    }
    let of = |values: &[f64], joint| values.get(joint).copied();
    Ok((0..count)
        .map(|joint| Knot {
            position: of(&point.positions, joint).unwrap_or_default(),
            velocity: of(&point.velocities, joint),
            acceleration: of(&point.accelerations, joint),
        })
        .collect())
}

/// Applies a first point at time 0, which must be near the present references: the motion begins from those,
/// with their velocity and acceleration if the point states them; otherwise these are left open.
fn begin_with(start: &mut [Knot], first: &[Knot], names: &[String]) -> Result<(), Refused> {
    for ((start, first), name) in start.iter_mut().zip(first).zip(names) {
        let distance = (first.position - start.position).abs();
        if distance > START_TOLERANCE {
            return invalid(format!(
                "{name} is at {:.4} rad, and the trajectory begins at {:.4} rad at time 0: begin where it is \
                 (within {START_TOLERANCE} rad), or at a later time",
                start.position, first.position
            ));
        }
        start.velocity = start.velocity.filter(|_| first.velocity.is_some());
        start.acceleration = start.acceleration.filter(|_| first.acceleration.is_some());
    }
    Ok(())
}

/// Computes position, velocity and acceleration at `time` between knots that are `duration` apart [s].
fn spline(a: &Knot, b: &Knot, duration: f64, time: f64) -> [f64; 3] {
    let distance = b.position - a.position;
    let (t, s) = (time, time / duration);
    match (a.velocity.zip(b.velocity), a.acceleration.zip(b.acceleration)) {
        (Some((va, vb)), Some((aa, ab))) => {
            // Coefficients of the powers of s beyond the first three.
            let (va, vb) = (va * duration, vb * duration);
            let (aa, ab) = (aa * duration * duration, ab * duration * duration);
            let c3 = 10.0 * distance - 6.0 * va - 4.0 * vb - 1.5 * aa + 0.5 * ab;
            let c4 = -15.0 * distance + 8.0 * va + 7.0 * vb + 1.5 * aa - ab;
            let c5 = 6.0 * distance - 3.0 * (va + vb) - 0.5 * (aa - ab);
            [
                a.position + s * (va + s * (0.5 * aa + s * (c3 + s * (c4 + s * c5)))),
                (va + s * (aa + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))) / duration,
                (aa + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))) / (duration * duration),
            ]
        }
        (Some((va, vb)), None) => {
            let c2 = (3.0 * distance / duration - 2.0 * va - vb) / duration;
            let c3 = (va + vb - 2.0 * distance / duration) / (duration * duration);
            [
                a.position + t * (va + t * (c2 + t * c3)),
                va + t * (2.0 * c2 + t * 3.0 * c3),
                2.0 * c2 + 6.0 * c3 * t,
            ]
        }
        (None, _) => [a.position + distance * s, distance / duration, 0.0],
    }
}

/// Converts to the single precision of the protocol.
#[expect(clippy::cast_possible_truncation, reason = "single precision on the wire")]
fn narrow(values: [f64; 3]) -> JointPoint {
    let [position, velocity, acceleration] = values.map(|value| value as f32);
    JointPoint { position, velocity, acceleration }
}

/// Describes a refusal with the name of its joint.
pub fn named(refusal: &LimitRefusal, robot: &Robot) -> String {
    words::named(refusal, &refusal.to_string(), Some(robot.model()))
}

#[cfg(test)]
pub mod tests;
