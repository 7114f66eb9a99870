use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::control::ServoMode;
use crate::math::abs;
use crate::robot::{Concerns, LimitRefusal, Robot};

/// Minimum speed of a motion [m/s]: contacts are detected only while the hand moves.
pub const MIN_SPEED: f32 = 5e-3;

/// Tolerances of the axis of a gripper in the arm's chain, which must be the z axis of the hand frame: angle
/// [rad] and distance [m].
const MAX_TILT: f32 = 0.01;
const MAX_OFFSET: f32 = 1e-3;

/// Settings of a gripper with one joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct GripperSettings {
    /// Its joint: the last one of the arm's chain, which rotates the tip about the approach direction, or the
    /// only one of another chain.
    pub joint: u8,
    /// Angle of the open gripper [rad].
    pub open: f32,
    /// Angle of the closed gripper with nothing in it [rad].
    pub closed: f32,
    /// Speed of opening and closing [rad/s]: 0.001 to 0.9 of the joint's velocity limit.
    pub speed: f32,
    /// Torque with which an object is held [N·m]: 0.001 to the joint's torque limit.
    pub torque: f32,
}

/// Settings of the visual approach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct VisualApproachSettings {
    /// The arm's chain, of at least six joints beside the gripper. Its tip is the hand frame, with the
    /// approach direction z.
    pub chain: u8,
    /// The gripper.
    pub gripper: GripperSettings,
    /// Feedback law of the joint servos.
    pub servo_mode: ServoMode,
    /// Largest speed of the hand [m/s]: [`MIN_SPEED`] to 1.
    pub speed: f32,
    /// Largest acceleration of the hand [m/s²]: 0.01 to 10.
    pub acceleration: f32,
    /// Largest force against the motion of the hand, estimated from the torques of the joints [N]: 1 to 500.
    pub contact_force: f32,
    /// Maximum distance of the hand from its position at the start of the task [m]: 0.01 to 2.
    pub reach: f32,
}

impl VisualApproachSettings {
    /// A slow arm with its gripper at joint 0.
    pub const DEFAULT: Self = Self {
        chain: 0,
        gripper: GripperSettings { joint: 0, open: 0.0, closed: 0.0, speed: 1.0, torque: 1.0 },
        servo_mode: ServoMode::Pid,
        speed: 0.1,
        acceleration: 0.5,
        contact_force: 20.0,
        reach: 0.5,
    };

    /// Checks the settings for `robot`.
    ///
    /// # Errors
    /// The first one that is out of range.
    pub fn validate(&self, robot: &Robot) -> Result<(), VisualApproachRefusal> {
        let chains = robot.chains();
        let chain = chains.get(usize::from(self.chain)).filter(|chain| !chain.has_mimics);
        let Some(joints) = chain.map(super::ChainConfig::joints) else {
            return Err(VisualApproachRefusal::NoChain { chain: self.chain });
        };
        let GripperSettings { joint, open, closed, speed, torque } = self.gripper;
        let Some(gripper) = robot.joints().get(usize::from(joint)) else {
            return Err(VisualApproachRefusal::NoGripper { joint });
        };
        let index = usize::from(joint);
        let is_own = joints.contains(&index);
        let is_alone = chains.iter().any(|chain| chain.joints() == (index..index + 1));
        if !(is_alone || is_own && index + 1 == joints.end) {
            return Err(VisualApproachRefusal::NoGripper { joint });
        }
        // With fewer joints the hand can neither keep its orientation nor sense forces in every direction.
        if joints.len() - usize::from(is_own) < 6 {
            return Err(VisualApproachRefusal::NoChain { chain: self.chain });
        }
        let arm = super::GuidedArm::new(robot, self.chain, joint);
        let [tilt, offset] = arm.map_or([0.0; 2], |arm| arm.gripper_axis());
        // Rejects NaN as well.
        if !(tilt <= MAX_TILT && offset <= MAX_OFFSET) {
            return Err(VisualApproachRefusal::GripperAxis { joint, tilt, offset });
        }
        gripper.check_position(joint, open)?;
        gripper.check_position(joint, closed)?;
        let max = gripper.limits.velocity;
        for (field, value, [lower, upper]) in [
            (VisualApproachField::Speed, self.speed, [MIN_SPEED, 1.0]),
            (VisualApproachField::Acceleration, self.acceleration, [0.01, 10.0]),
            (VisualApproachField::ContactForce, self.contact_force, [1.0, 500.0]),
            (VisualApproachField::Reach, self.reach, [0.01, 2.0]),
            (VisualApproachField::GripperRange, abs(closed - open), [0.01, 100.0]),
            (VisualApproachField::GripperSpeed, speed, [1e-3 * max, 0.9 * max]),
            (VisualApproachField::GripperTorque, torque, [1e-3, gripper.servo.torque_limit()]),
        ] {
            if !(lower..=upper).contains(&value) {
                return Err(VisualApproachRefusal::Value { field, value, lower, upper });
            }
        }
        Ok(())
    }
}

/// A setting that is a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum VisualApproachField {
    /// 0: speed of the hand [m/s].
    Speed,
    /// 1: its acceleration [m/s²].
    Acceleration,
    /// 2: contact force [N].
    ContactForce,
    /// 3: reach [m].
    Reach,
    /// 4: angle between the open and the closed gripper [rad].
    GripperRange,
    /// 5: speed of the gripper [rad/s].
    GripperSpeed,
    /// 6: torque of the gripper [N·m].
    GripperTorque,
}

impl fmt::Display for VisualApproachField {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Speed => "the speed of the hand [m/s]",
            Self::Acceleration => "the acceleration of the hand [m/s²]",
            Self::ContactForce => "the contact force [N]",
            Self::Reach => "the reach [m]",
            Self::GripperRange => "the angle between the open and the closed gripper [rad]",
            Self::GripperSpeed => "the speed of the gripper [rad/s]",
            Self::GripperTorque => "the torque of the gripper [N·m]",
        })
    }
}

/// Why the visual approach refuses its settings or a command.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum VisualApproachRefusal {
    /// 0: the robot has no such chain, it has a mimic joint, or fewer than six joints beside the gripper.
    NoChain {
        /// The chain.
        chain: u8,
    },
    /// 1: the robot has no such joint, or it moves an arm.
    NoGripper {
        /// The joint.
        joint: u8,
    },
    /// 2: a limit of the gripper's joint.
    Limit(LimitRefusal),
    /// 3: a setting is out of its range.
    Value {
        /// The setting.
        field: VisualApproachField,
        /// The value.
        value: f32,
        /// Minimum.
        lower: f32,
        /// Maximum.
        upper: f32,
    },
    /// 4: the target is not finite, or out of reach.
    Target {
        /// Its distance from the hand's position at the start of the task [m].
        distance: f32,
        /// The reach [m].
        reach: f32,
    },
    /// 5: the speed of a motion is below [`MIN_SPEED`], or beyond that of the settings.
    Speed {
        /// The speed [m/s].
        value: f32,
        /// The largest [m/s].
        limit: f32,
    },
    /// 6: the target is beyond the contact that ended a motion, or in a direction in which the posture cannot
    /// sense forces.
    Blocked {
        /// How far [m].
        ahead: f32,
    },
    /// 7: the gripper's axis is not the z axis of the hand frame.
    GripperAxis {
        /// The gripper's joint.
        joint: u8,
        /// Sine of the angle between them.
        tilt: f32,
        /// Distance of the axis from the origin of the hand frame [m].
        offset: f32,
    },
    /// 8: the arm is near a singular posture, in which it cannot sense forces in every direction.
    Singular {
        /// The arm's chain.
        chain: u8,
    },
}

impl From<LimitRefusal> for VisualApproachRefusal {
    fn from(refusal: LimitRefusal) -> Self {
        Self::Limit(refusal)
    }
}

impl Concerns for VisualApproachRefusal {
    fn joint(&self) -> Option<u8> {
        match self {
            Self::NoGripper { joint } | Self::GripperAxis { joint, .. } => Some(*joint),
            Self::Limit(refusal) => refusal.joint(),
            _ => None,
        }
    }

    fn chain(&self) -> Option<u8> {
        match self {
            Self::NoChain { chain } | Self::Singular { chain } => Some(*chain),
            _ => None,
        }
    }
}

impl fmt::Display for VisualApproachRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoChain { chain } => write!(
                f,
                "the robot has no arm as chain {chain}: it must have at least six joints beside the gripper, and no mimic joint"
            ),
            Self::NoGripper { joint } => write!(
                f,
                "joint {joint} is no gripper: it must be the last joint of the arm's chain, or the only one of another"
            ),
            Self::Limit(refusal) => refusal.fmt(f),
            Self::Value { field, value, lower, upper } => {
                write!(f, "{field} is {value}; it must be {lower} to {upper}")
            }
            Self::Target { distance, reach } => write!(
                f,
                "the target is {distance} m from where the hand was when the task began; the reach is {reach} m"
            ),
            Self::Speed { value, limit } => {
                write!(f, "the speed of the motion is {value} m/s; it must be {MIN_SPEED} to {limit} m/s")
            }
            Self::Blocked { ahead } => write!(
                f,
                "the target is {ahead} m against what stopped the hand: go back by 0.015 m first, or acknowledge the contact"
            ),
            Self::GripperAxis { joint, tilt, offset } => write!(
                f,
                "the axis of the gripper, joint {joint}, is off the z axis of the hand frame by {tilt} (sine of the angle; at \
                 most {MAX_TILT}) and by {offset} m (at most {MAX_OFFSET} m): correct the tip of the chain"
            ),
            Self::Singular { chain } => write!(
                f,
                "chain {chain} is near a singular posture, in which its joints do not show every contact: bend it first"
            ),
        }
    }
}

impl core::error::Error for VisualApproachRefusal {}
