//! Commands the joints while the board is enabled: they follow a trajectory, brake, or hold.

use tesaki::TICK;
use tesaki::control::JointPoint;
use tesaki::protocol::JointTelemetry;
use tesaki::robot::{JointConfig, Robot};
use tesaki_description::plant::CONTROL_PERIOD_NS;
use tesaki_supervisor::angles::within;

use crate::messages::{ErrorCode, Goal, JointTrajectory, Point, Time};
use crate::tolerances::Tolerances;
use crate::trajectory::{Refused, Trajectory};

/// Speed below which a joint counts as at rest [rad/s].
const AT_REST: f32 = 1e-6;

/// How a goal ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    Succeeded,
    /// The joints are at rest after a cancellation.
    Canceled,
    /// The goal failed for this reason, and the joints brake.
    Failed(Refused),
}

/// A goal that is carried out.
struct Motion {
    trajectory: Trajectory,
    tolerances: Tolerances,
    /// When it begins [ns since 1970]; 0: at once.
    stamp: u64,
    /// The goal's trajectory message, until it begins.
    delayed: Option<JointTrajectory>,
    /// The tick at which it began.
    begun: Option<u32>,
}

/// The joints of an enabled board.
pub struct Controller {
    robot: Box<Robot>,
    /// The last point that was sent to each joint.
    references: Vec<JointPoint>,
    motion: Option<Motion>,
    /// Whether the goal that ends once the joints are at rest was cancelled.
    cancels: bool,
}

impl Controller {
    /// Holds the joints at `positions` [rad].
    pub fn hold(robot: Box<Robot>, positions: &[f32]) -> Self {
        let mut controller = Self { robot, references: Vec::new(), motion: None, cancels: false };
        controller.hold_at(positions);
        controller
    }

    /// Ends the motion, and holds the joints at `positions` [rad].
    pub fn hold_at(&mut self, positions: &[f32]) {
        self.brake();
        let at = |(&position, config): (&f32, &JointConfig)| rest(within(position, &config.limits));
        self.references = positions.iter().zip(self.robot.joints()).map(at).collect();
    }

    /// Returns the points that were sent last.
    pub fn references(&self) -> &[JointPoint] {
        &self.references
    }

    /// Returns the robot.
    pub const fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Checks a goal that would begin `now` [ns since 1970], and replaces the present one with it.
    ///
    /// # Errors
    /// Why it is refused. The present goal continues.
    pub fn follow(&mut self, goal: &Goal, now: u64, defaults: &Defaults) -> Result<(), Refused> {
        let several = &goal.multi_dof_trajectory;
        let components = [&goal.component_path_tolerance, &goal.component_goal_tolerance];
        if !several.joint_names.is_empty()
            || !several.points.is_empty()
            || components.iter().any(|list| !list.is_empty())
        {
            return Err(Refused::new(
                ErrorCode::InvalidGoal,
                "joints with several degrees of freedom are named: every joint has one here",
            ));
        }
        let stamp = nanoseconds(goal.trajectory.header.stamp);
        let end = goal.trajectory.points.last().map_or(0, |last| nanoseconds(last.time_from_start));
        if stamp != 0 && stamp.saturating_add(end) < now {
            return Err(Refused::new(
                ErrorCode::OldHeaderTimestamp,
                "the trajectory ends in the past by its stamp: a stamp of 0 means at once",
            ));
        }
        let references = self.braked(stamp.saturating_sub(now) / CONTROL_PERIOD_NS);
        let trajectory = Trajectory::check(&goal.trajectory, &self.robot, &references)?;
        let tolerances = Tolerances::of(goal, defaults)?;
        let delayed = (stamp > now).then(|| goal.trajectory.clone());
        self.motion = Some(Motion { trajectory, tolerances, stamp, delayed, begun: None });
        self.cancels = false;
        Ok(())
    }

    /// Returns the references after this number of `periods` in which the joints brake.
    fn braked(&self, periods: u64) -> Vec<JointPoint> {
        let mut references = self.references.clone();
        for _ in 0..periods {
            if references.iter().all(|point| point.velocity.abs() < AT_REST) {
                break;
            }
            brake(&self.robot, &mut references);
        }
        references
    }

    /// Brakes; the goal ends as soon as the joints are at rest.
    pub fn cancel(&mut self) {
        self.motion = None;
        self.cancels = true;
    }

    /// Brakes; the caller decides the outcome of the goal.
    pub fn brake(&mut self) {
        (self.motion, self.cancels) = (None, false);
    }

    /// Returns whether all references are at rest.
    pub fn is_at_rest(&self) -> bool {
        self.motion.is_none() && self.references.iter().all(|point| point.velocity.abs() < AT_REST)
    }

    /// Advances to the period after `tick`, in which `joints` were measured. Returns how the goal ended, if
    /// it did.
    pub fn step(&mut self, tick: u32, now: u64, joints: &[JointTelemetry]) -> Option<Outcome> {
        let begun = self.begin_delayed(now);
        brake(&self.robot, &mut self.references);
        if let Err(refused) = begun {
            self.motion = None;
            return Some(Outcome::Failed(refused));
        }
        let Some(motion) = &mut self.motion else {
            let is_canceled = self.cancels && self.is_at_rest();
            self.cancels &= !is_canceled;
            return is_canceled.then_some(Outcome::Canceled);
        };
        if motion.begun.is_none() && motion.stamp > now {
            return None;
        }
        // A board that was reset meanwhile begins again at tick 0, and is disabled.
        let ticks = tick.wrapping_sub(*motion.begun.get_or_insert(tick));
        let time = f64::from(TICK) * (f64::from(ticks) + 1.0);
        for (joint, point) in motion.trajectory.points(time) {
            if let Some(reference) = self.references.get_mut(joint) {
                *reference = point;
            }
        }
        let late = time - motion.trajectory.duration();
        let names = &self.robot.model().joints;
        let name = |joint: usize| names.get(joint).map_or("", |joint| joint.name.as_str());
        let outcome = if late < 0.0 {
            motion.tolerances.path(motion.trajectory.joints(), joints, name).map(Outcome::Failed)
        } else {
            motion.tolerances.goal(&motion.trajectory, joints, late, name)
        };
        if outcome.is_some() {
            self.motion = None;
        }
        outcome
    }

    /// Begins a goal whose stamp has come, from the present references.
    fn begin_delayed(&mut self, now: u64) -> Result<(), Refused> {
        if let Some(motion) = self.motion.as_mut().filter(|motion| motion.stamp <= now)
            && let Some(message) = motion.delayed.take()
        {
            motion.trajectory = Trajectory::check(&message, &self.robot, &self.references)?;
        }
        Ok(())
    }

    /// Returns feedback on the goal: its joints' names, and desired, actual and error points.
    pub fn feedback(&self, joints: &[JointTelemetry]) -> Option<(Vec<String>, [Point; 3])> {
        let own = self.motion.as_ref()?.trajectory.joints();
        let names =
            own.iter().filter_map(|&joint| Some(self.robot.model().joints.get(joint)?.name.to_string()));
        let values = |of: fn(&JointTelemetry) -> f32| -> Vec<f64> {
            own.iter().filter_map(|&joint| joints.get(joint)).map(|joint| f64::from(of(joint))).collect()
        };
        let desired = Point { positions: values(|joint| joint.reference), ..Point::default() };
        let actual = Point {
            positions: values(|joint| joint.position),
            velocities: values(|joint| joint.velocity),
            ..Point::default()
        };
        let error = Point { positions: values(|joint| joint.reference - joint.position), ..Point::default() };
        Some((names.collect(), [desired, actual, error]))
    }
}

/// Brakes all joints for a period.
fn brake(robot: &Robot, references: &mut [JointPoint]) {
    for (config, point) in robot.joints().iter().zip(references) {
        let next = config.brake(point);
        *point = if next.velocity.abs() < AT_REST { rest(next.position) } else { next };
    }
}

/// Returns a point at rest at a position.
fn rest(position: f32) -> JointPoint {
    JointPoint { position, ..JointPoint::default() }
}

/// Converts a time to nanoseconds.
fn nanoseconds(time: Time) -> u64 {
    1_000_000_000 * u64::try_from(time.sec).unwrap_or_default() + u64::from(time.nanosec)
}

/// What applies where a goal states nothing.
#[derive(Clone, Copy, Debug)]
pub struct Defaults {
    /// Distance from its goal at which a joint has arrived [rad].
    pub tolerance: f64,
    /// Time after the last point within which all joints must have arrived [s].
    pub time: f64,
}

#[cfg(test)]
mod tests;
