//! Joint servo: every joint follows its own set-point, or every fingertip its own.

use core::fmt;

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::api::{Io, Task, TaskFault};
use crate::control::{JointPoint, ServoMode};
use crate::kinematics::{FingerError, TipPoint};
use crate::model::{MAX_CHAINS, MAX_JOINTS};
use crate::robot::{
    Actuation, Concerns, JointSetpoint, JointTarget, LimitRefusal, Measured, Postures, Robot, count,
};

/// Where the joints are to go. Each command says the whole of it, so it may be repeated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum JointCommand {
    /// 0: angles [rad], approached through the trajectory filter.
    Goal {
        /// An angle for each joint.
        positions: Vec<f32, MAX_JOINTS>,
    },
    /// 1: one point of a trajectory that the sender shapes itself, past the trajectory filter. One a tick.
    Stream {
        /// A point for each joint.
        points: Vec<JointPoint, MAX_JOINTS>,
    },
    /// 2: the same for the tips of fingers: the joint angles follow in closed form, nearest to those before.
    Reach {
        /// A point for the tip of each chain.
        tips: Vec<TipPoint, MAX_CHAINS>,
    },
    /// 3: as 1, with a torque for each joint besides: for forces on an object that several boards hold together.
    Guide {
        /// A point for each joint.
        points: Vec<JointPoint, MAX_JOINTS>,
        /// Torques that the servo does not make up for as long as nothing moves [N·m].
        torques: Vec<f32, MAX_JOINTS>,
    },
}

/// Why a set-point of the joints was refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum JointServoRefusal {
    /// 0: a joint's limit.
    Limit(LimitRefusal),
    /// 1: a set-point for another number of tips than the robot has.
    TipCount {
        /// Tips in the request.
        got: u8,
        /// Tips of the robot.
        expected: u8,
    },
    /// 2: the chain is not of the shape of which the inverse kinematics is known in closed form
    /// ([`Finger`](crate::kinematics::Finger)).
    NotAFinger {
        /// The chain.
        chain: u8,
    },
    /// 3: the chain's tip cannot be there.
    OutOfReach {
        /// The chain.
        chain: u8,
        /// The nearest point that it could reach, were it not for the limits of its joints [m, base frame].
        nearest: [f32; 3],
    },
    /// 4: at this point the chain is nearly singular: its tip can hardly move in some direction.
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
                "chain {chain} is not a three-joint finger, so the board cannot compute its joint angles: send them \
                 (`tesaki eval ik` finds them)"
            ),
            Self::OutOfReach { chain, nearest: [x, y, z] } => write!(
                f,
                "the tip of chain {chain} cannot reach that point; without its joints' limits the nearest is \
                 ({x}, {y}, {z}) m"
            ),
            Self::Singular { chain } => write!(
                f,
                "the tip of chain {chain} can hardly move in some direction there: keep away from the straight finger \
                 and from the axis of its first joint"
            ),
            Self::TipNotFinite { chain } => write!(f, "the tip of chain {chain}: not a finite position"),
        }
    }
}

/// The task. Its set-points are the targets.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct JointServoTask {
    /// Whether points came since the last tick.
    fresh: bool,
    /// Whether the points of the targets may have a velocity.
    moving: bool,
}

impl Task for JointServoTask {
    type Config = ServoMode;
    type Command = JointCommand;
    type Telemetry = ();
    type Refusal = JointServoRefusal;
    const IDLE: Self = Self { fresh: false, moving: false };

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
                    *target = JointTarget::at(position);
                }
            }
            JointCommand::Stream { points } => self.stream(io, points, &[])?,
            JointCommand::Reach { tips } => {
                let points = joint_points(&io, tips)?;
                self.stream(io, &points, &[])?;
            }
            JointCommand::Guide { points, torques } => {
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
        if self.fresh {
            (self.fresh, self.moving) = (false, true);
        } else if self.moving {
            self.moving = false;
            // A point that no other follows is one to stand at.
            for target in io.targets.joints.iter_mut().take(io.robot.joints().len()) {
                if let JointSetpoint::Point(point) = &mut target.setpoint {
                    (point.velocity, point.acceleration) = (0.0, 0.0);
                }
            }
        }
        Ok(())
    }

    fn telemetry(&self, _: &Robot, _: &Measured, _: &Postures) {}
}

impl JointServoTask {
    /// Takes one point for each joint, and torques besides, if there are any.
    fn stream(
        &mut self,
        io: Io<'_>,
        points: &[JointPoint],
        torques: &[f32],
    ) -> Result<(), JointServoRefusal> {
        io.robot.check_count(points.len())?;
        let joints = io.robot.joints().iter().zip(io.references);
        for (index, ((config, reference), point)) in (0..).zip(joints.zip(points)) {
            config.check_point(index, point, reference)?;
        }
        for (target, &point) in io.targets.joints.iter_mut().zip(points) {
            *target = JointTarget { setpoint: JointSetpoint::Point(point), feedforward: 0.0, restart: false };
        }
        for (target, &torque) in io.targets.joints.iter_mut().zip(torques) {
            target.feedforward = torque;
        }
        io.targets.actuation = Actuation::Servo;
        self.fresh = true;
        Ok(())
    }
}

/// What the joints have to do for the tips.
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
            // Cannot fail: there are no more joints than places.
            let _ = points.push(JointPoint { position, velocity, acceleration });
        }
    }
    Ok(points)
}
