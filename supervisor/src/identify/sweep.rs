//! Sweeps of joints to and fro without load.

use std::collections::VecDeque;

use heapless::Vec as Points;
use tesaki::control::JointPoint;
use tesaki::model::{JointModel, MAX_JOINTS, RobotModel};
use tesaki::protocol::{Request, Telemetry};
use tesaki::signal::MINIMUM_JERK_PEAK;
use tesaki::task::TaskCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki_description::plant::CONTROL_PERIOD;

use super::procedure::IdentifyError;
use crate::angles::within;
use crate::trajectory::minimum_jerk;

/// Margin to the ends of a joint's range [rad].
const CLEAR: f64 = 0.02;
/// Largest speed of a sweep, as a fraction of the joint's limit.
const SPEED: f64 = 0.5;
/// Peak acceleration of a minimum-jerk motion, 10/√3, relative to distance / time².
const PEAK_ACCELERATION: f64 = 5.773_502_7;
/// Number of sent set-points among which the board's reference is sought: a delayed link is some behind.
const SENT: usize = 12;
/// References that differ by less are the same [rad].
const SAME: f32 = 1e-6;

/// Returns the joints' references at their present positions [rad].
pub fn references(model: &RobotModel, telemetry: &Telemetry) -> Vec<f64> {
    let joints = telemetry.joints.iter().zip(&model.joints);
    joints.map(|(state, joint)| within(state.reference, &joint.limits).into()).collect()
}

/// Returns the range in which each joint is swept [rad]: `amplitude` to either side of its position, shifted
/// inwards at an end of its range.
///
/// # Errors
/// A joint's range is too small.
pub fn ranges(model: &RobotModel, start: &[f64], amplitude: f64) -> Result<Vec<(f64, f64)>, IdentifyError> {
    let range = |(joint, &position): (&JointModel, &f64)| {
        let (lower, upper) = (f64::from(joint.limits.lower) + CLEAR, f64::from(joint.limits.upper) - CLEAR);
        if upper - lower < 2.0 * amplitude {
            let joint = joint.name.to_string();
            return Err(IdentifyError::NoRoom { joint, position, lower, upper, amplitude });
        }
        let low = (position - amplitude).max(lower).min(upper - 2.0 * amplitude);
        Ok((low, low + 2.0 * amplitude))
    };
    model.joints.iter().zip(start).map(range).collect()
}

/// Joints that move at the same time, between the ends of their ranges and back to their start.
pub struct Sweep<'a> {
    pub model: &'a RobotModel,
    /// Positions of all joints [rad].
    pub start: &'a [f64],
    pub ranges: &'a [(f64, f64)],
    /// Indices of the joints that move.
    pub joints: &'a [usize],
    /// Largest torque for the inertia assumed by a joint's servo, as a fraction of its limit.
    pub torque: f64,
}

/// One motion of the moving joints.
pub struct Leg {
    /// Start and end of each joint [rad].
    ways: Vec<(f64, f64)>,
    /// Its duration [s].
    time: f64,
}

impl Sweep<'_> {
    /// Returns the motions: to and fro, in `times` with the duration of each motion and its repetitions, and
    /// back within `back`. All durations are stretched by the same factor if a joint cannot be so fast.
    pub fn legs(&self, times: &[(f64, usize)], back: f64) -> Vec<Leg> {
        let both = times.iter().flat_map(|&(time, repeats)| std::iter::repeat_n(time, repeats));
        let end = |high: bool| {
            let end = |(index, &start): (usize, &f64)| match self.ranges.get(index) {
                Some(&(low, top)) if self.joints.contains(&index) => {
                    if high {
                        top
                    } else {
                        low
                    }
                }
                _ => start,
            };
            self.start.iter().enumerate().map(end).collect::<Vec<f64>>()
        };
        let ways = both.flat_map(|time| [(end(true), time), (end(false), time)]);
        let mut at = self.start.to_vec();
        let leg = |(to, time): (Vec<f64>, f64)| {
            let ways: Vec<(f64, f64)> = std::mem::replace(&mut at, to.clone()).into_iter().zip(to).collect();
            Leg { ways, time }
        };
        let mut legs: Vec<Leg> = ways.chain([(self.start.to_vec(), back)]).map(leg).collect();
        let stretch = legs.iter().map(|leg| self.least_time(leg) / leg.time).fold(1.0, f64::max);
        legs.iter_mut().for_each(|leg| leg.time *= stretch);
        legs
    }

    /// Returns the shortest time that the joints' speeds and torques allow [s].
    fn least_time(&self, leg: &Leg) -> f64 {
        let least = |((from, to), joint): (&(f64, f64), &JointModel)| {
            let (way, limits) = ((to - from).abs(), &joint.limits);
            let by_speed = f64::from(MINIMUM_JERK_PEAK) * way / (SPEED * f64::from(limits.velocity));
            let acceleration =
                self.torque * f64::from(joint.torque_limit()) / f64::from(joint.servo.observer.inertia);
            by_speed.max((PEAK_ACCELERATION * way / acceleration).sqrt())
        };
        leg.ways.iter().zip(&self.model.joints).map(least).fold(0.0, f64::max)
    }
}

impl Leg {
    /// Number of ticks it takes.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of ticks")]
    pub fn ticks(&self) -> u32 {
        (self.time / CONTROL_PERIOD).round() as u32
    }

    /// Returns a minimum-jerk set-point for each tick.
    pub fn requests(&self) -> impl Iterator<Item = Request> + '_ {
        let ticks = self.ticks();
        (1..=ticks).map(move |tick| {
            let [value, rate, curvature] = minimum_jerk(f64::from(tick) / f64::from(ticks));
            #[expect(clippy::cast_possible_truncation, reason = "the board computes in single precision")]
            let point = |&(from, to): &(f64, f64)| {
                let change = to - from;
                if change == 0.0 {
                    return JointPoint { position: from as f32, ..JointPoint::default() };
                }
                JointPoint {
                    position: (from + change * value) as f32,
                    velocity: (change * rate / self.time) as f32,
                    acceleration: (change * curvature / (self.time * self.time)) as f32,
                }
            };
            let points: Points<JointPoint, MAX_JOINTS> = self.ways.iter().map(point).collect();
            Request::Task(TaskCommand::JointServo(JointCommand::Stream { points }))
        })
    }
}

/// Whether the board gets one set-point per tick. A sender that is late leaves a tick without a set-point, in
/// which the reference stands still, and then sends two for one tick, at which the reference leaps: the
/// torque of the servo leaps, too. A constant delay is regular.
pub struct Punctuality {
    /// The latest set-points [rad].
    sent: VecDeque<Vec<f32>>,
    /// The reference in the last telemetry [rad], and its tick.
    reference: Vec<f32>,
    tick: u32,
    /// Number of ticks whose telemetry has come.
    pub ticks: u32,
    /// Number of those in which the reference was not the successor of that in the tick before.
    pub irregular: u32,
}

impl Punctuality {
    /// Of joints that stand at `start` [rad] in tick `tick`.
    #[expect(clippy::cast_possible_truncation, reason = "the board computes in single precision")]
    pub fn new(start: &[f64], tick: u32) -> Self {
        let reference: Vec<f32> = start.iter().map(|&position| position as f32).collect();
        let sent = VecDeque::from([reference.clone(), reference.clone()]);
        Self { sent, reference, tick, ticks: 0, irregular: 0 }
    }

    /// Takes a set-point and the telemetry that came after it; returns whether the reference is the successor
    /// of that in the telemetry before.
    pub fn is_regular(&mut self, request: &Request, telemetry: &Telemetry) -> bool {
        if let Request::Task(TaskCommand::JointServo(JointCommand::Stream { points })) = request {
            self.sent.push_back(points.iter().map(|point| point.position).collect());
            if self.sent.len() > SENT {
                self.sent.pop_front();
            }
        }
        let reference: Vec<f32> = telemetry.joints.iter().map(|joint| joint.reference).collect();
        let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < SAME);
        let mut pairs = self.sent.iter().zip(self.sent.iter().skip(1));
        let follows = pairs.any(|(last, next)| same(&self.reference, last) && same(&reference, next));
        let is_regular = follows && telemetry.tick == self.tick.wrapping_add(1);
        self.ticks = self.ticks.saturating_add(1);
        self.irregular = self.irregular.saturating_add((!is_regular).into());
        (self.reference, self.tick) = (reference, telemetry.tick);
        is_regular
    }
}
