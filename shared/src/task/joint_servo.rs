//! Joint servo: set-points for joints or for fingertips.

use core::fmt;

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::api::{Io, Task, TaskFault};
use crate::TICK;
use crate::control::{JointPoint, ServoMode};
use crate::kinematics::{FingerError, TipPoint};
use crate::math::{self, abs};
use crate::model::{MAX_CHAINS, MAX_JOINTS};
use crate::robot::{Concerns, JointSetpoint, LimitRefusal, Measured, Postures, Robot, count};

/// Commands of the joint servo. Each states the set-points of all joints, so it may be repeated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum JointCommand {
    /// 0: goal angles, approached through the trajectory filter.
    Goal {
        /// Angle of each joint [rad].
        positions: Vec<f32, MAX_JOINTS>,
    },
    /// 1: one point of the sender's own trajectory per tick, without the trajectory filter. The steps from
    /// point to point keep to the velocity limit as well, with a tolerance of 100 ms for delayed links, which
    /// deliver several points at once.
    Stream {
        /// Point of each joint.
        points: Vec<JointPoint, MAX_JOINTS>,
    },
    /// 2: one trajectory point of each fingertip. The closed-form inverse kinematics gives the joints, with
    /// the solution nearest to the last one.
    StreamTips {
        /// Point of each chain's tip.
        tips: Vec<TipPoint, MAX_CHAINS>,
    },
    /// 3: as 1, with feed-forward torques, for example for an object that several boards hold together.
    StreamTorques {
        /// Point of each joint.
        points: Vec<JointPoint, MAX_JOINTS>,
        /// Torque of each joint [N·m]. The servo does not compensate it while the joint is at rest.
        torques: Vec<f32, MAX_JOINTS>,
    },
}

/// Why the joint servo refuses a command.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum JointServoRefusal {
    /// 0: a joint limit.
    Limit(LimitRefusal),
    /// 1: wrong number of tips.
    TipCount {
        /// Tips in the request.
        got: u8,
        /// Tips of the robot.
        expected: u8,
    },
    /// 2: the chain has no closed-form inverse kinematics: it is not a [`Finger`](crate::kinematics::Finger).
    NotAFinger {
        /// The chain.
        chain: u8,
    },
    /// 3: the point is out of the chain's reach.
    OutOfReach {
        /// The chain.
        chain: u8,
        /// Nearest point within reach, without joint limits [m, base frame].
        nearest: [f32; 3],
    },
    /// 4: the posture at this point is nearly singular.
    Singular {
        /// The chain.
        chain: u8,
    },
    /// 5: the point of a tip is not finite.
    TipNotFinite {
        /// The chain.
        chain: u8,
    },
}

impl From<LimitRefusal> for JointServoRefusal {
    fn from(refusal: LimitRefusal) -> Self {
        Self::Limit(refusal)
    }
}

impl Concerns for JointServoRefusal {
    fn joint(&self) -> Option<u8> {
        if let Self::Limit(refusal) = self { refusal.joint() } else { None }
    }

    fn chain(&self) -> Option<u8> {
        match *self {
            Self::Limit(_) | Self::TipCount { .. } => None,
            Self::NotAFinger { chain }
            | Self::OutOfReach { chain, .. }
            | Self::Singular { chain }
            | Self::TipNotFinite { chain } => Some(chain),
        }
    }
}

impl fmt::Display for JointServoRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Limit(refusal) => refusal.fmt(f),
            Self::TipCount { got, expected } => write!(f, "{got} tips given, the robot has {expected}"),
            Self::NotAFinger { chain } => write!(
                f,
                "chain {chain} is not a three-joint finger, so the board cannot compute its joint angles: send joint angles \
                 (`tesaki eval ik` computes them)"
            ),
            Self::OutOfReach { chain, nearest: [x, y, z] } => write!(
                f,
                "the tip of chain {chain} cannot reach this point; without joint limits the nearest is \
                 ({x:.4}, {y:.4}, {z:.4}) m"
            ),
            Self::Singular { chain } => write!(
                f,
                "the posture of chain {chain} is nearly singular at this point: avoid the straight finger and the axis \
                 of its first joint"
            ),
            Self::TipNotFinite { chain } => write!(f, "the point for the tip of chain {chain} is not finite"),
        }
    }
}

impl core::error::Error for JointServoRefusal {}

/// How far a stream may run ahead of the velocity limit [ticks]: a delayed link delivers several points at
/// once.
const LINK_TICKS: f32 = 10.0;
/// Maximum number of the sender's ticks per tick of the board: clocks without a crystal differ by some per
/// cent.
const CLOCK_RATIO: f32 = 1.1;

/// The task. The targets hold its set-points.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct JointServoTask {
    /// How far the stream is ahead of the velocity limit, and the advance by the points since the last tick:
    /// the time that the joints need for their step at that limit [ticks].
    ahead: f32,
    step: f32,
    /// Whether set-points arrived since the last tick.
    updated: bool,
    /// Their feed-forward torques [N·m]. The targets get them with the tick, so that a stop before it leaves
    /// those that were applied.
    torques: [f32; MAX_JOINTS],
    /// Whether the points of the targets may have a velocity.
    moving: bool,
}

impl Task for JointServoTask {
    type Config = ServoMode;
    type Command = JointCommand;
    type Telemetry = ();
    type Refusal = JointServoRefusal;
    const IDLE: Self =
        Self { ahead: 0.0, step: 0.0, updated: false, torques: [0.0; MAX_JOINTS], moving: false };

    fn check(_: &Robot, _: &Measured, _: &ServoMode) -> Result<(), JointServoRefusal> {
        Ok(())
    }

    fn begin(&mut self, io: Io<'_>, mode: &ServoMode) {
        io.targets.servo_mode = *mode;
    }

    fn command(&mut self, io: Io<'_>, command: &JointCommand) -> Result<(), JointServoRefusal> {
        match command {
            JointCommand::Goal { positions } => {
                io.robot.check_count(positions.len())?;
                for (index, (config, &position)) in (0..).zip(io.robot.joints().iter().zip(positions)) {
                    config.check_position(index, position)?;
                }
                for (target, &position) in io.targets.joints.iter_mut().zip(positions) {
                    target.setpoint = JointSetpoint::FarGoal(position);
                }
                self.update(&[]);
            }
            JointCommand::Stream { points } => self.stream(io, points, &[])?,
            JointCommand::StreamTips { tips } => {
                let points = joint_points(&io, tips)?;
                self.stream(io, &points, &[])?;
            }
            JointCommand::StreamTorques { points, torques } => {
                io.robot.check_count(torques.len())?;
                for (index, (config, &torque)) in (0..).zip(io.robot.joints().iter().zip(torques)) {
                    config.check_torque(index, torque)?;
                }
                self.stream(io, points, torques)?;
            }
        }
        Ok(())
    }

    #[inline]
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
        if self.updated {
            (self.updated, self.moving) = (false, true);
            for (target, &torque) in io.targets.joints.iter_mut().zip(&self.torques) {
                target.feedforward = torque;
            }
        } else if self.moving {
            self.moving = false;
            // Without a successor the joints hold the point: velocity and acceleration are 0.
            for target in io.targets.joints.iter_mut().take(io.robot.joints().len()) {
                if let JointSetpoint::Point(point) = &mut target.setpoint {
                    (point.velocity, point.acceleration) = (0.0, 0.0);
                }
            }
        }
        self.ahead = math::clamp(self.ahead + self.step - CLOCK_RATIO, 0.0, LINK_TICKS);
        self.step = 0.0;
        Ok(())
    }

    fn telemetry(&self, _: &Robot, _: &Measured, _: &Postures) {}
}

impl JointServoTask {
    /// Sets one point per joint, and feed-forward torques if there are any.
    fn stream(
        &mut self,
        io: Io<'_>,
        points: &[JointPoint],
        torques: &[f32],
    ) -> Result<(), JointServoRefusal> {
        io.robot.check_count(points.len())?;
        let joints = io.robot.joints().iter().zip(io.references);
        // Always positive, see `tick`.
        let available = LINK_TICKS - self.ahead;
        let mut step = 0.0_f32;
        for (joint, ((config, reference), point)) in (0..).zip(joints.zip(points)) {
            config.check_point(joint, point, reference)?;
            let limit = config.limits.velocity;
            let needed = abs(point.position - reference.position) / (limit * TICK);
            if needed > available {
                return Err(LimitRefusal::TooFast { joint, value: limit * needed / available, limit }.into());
            }
            step = step.max(needed);
        }
        self.step = step;
        for (target, &point) in io.targets.joints.iter_mut().zip(points) {
            target.setpoint = JointSetpoint::Point(point);
        }
        self.update(torques);
        Ok(())
    }

    /// Takes the feed-forward torques of new set-points, 0 if there are none.
    fn update(&mut self, torques: &[f32]) {
        self.torques = [0.0; MAX_JOINTS];
        self.torques.iter_mut().zip(torques).for_each(|(own, torque)| *own = *torque);
        self.updated = true;
    }
}

/// Joint points for points of the fingertips.
fn joint_points(io: &Io<'_>, tips: &[TipPoint]) -> Result<Vec<JointPoint, MAX_JOINTS>, JointServoRefusal> {
    let expected = io.robot.chains().len();
    if tips.len() != expected {
        return Err(JointServoRefusal::TipCount { got: count(tips.len()), expected: count(expected) });
    }
    let mut points = Vec::new();
    for (chain, (config, tip)) in (0..).zip(io.robot.chains().iter().zip(tips)) {
        let finger = config.finger.as_ref().ok_or(JointServoRefusal::NotAFinger { chain })?;
        let joints = config.joints();
        let first = count(joints.start);
        let mut near = [0.0; 3];
        let references = io.references.get(joints).unwrap_or_default();
        near.iter_mut().zip(references).for_each(|(near, reference)| *near = reference.position);
        let angles = finger.nearest(&tip.position.into(), &near).map_err(|error| match error {
            FingerError::NotFinite => JointServoRefusal::TipNotFinite { chain },
            FingerError::OutOfReach { nearest } => {
                JointServoRefusal::OutOfReach { chain, nearest: nearest.into() }
            }
            FingerError::OutsideLimits { joint, value, lower, upper } => {
                LimitRefusal::OutsideLimits { joint: first + joint, value, lower, upper }.into()
            }
        })?;
        let motion = config.chain.posture(&angles).joint_motion(tip);
        let (velocities, accelerations) = motion.ok_or(JointServoRefusal::Singular { chain })?;
        for ((position, velocity), acceleration) in angles.into_iter().zip(velocities).zip(accelerations) {
            // Cannot fail: the capacity is that of the robot.
            let _ = points.push(JointPoint { position, velocity, acceleration });
        }
    }
    Ok(points)
}
