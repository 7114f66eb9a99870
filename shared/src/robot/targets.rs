use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::control::{JointPoint, ServoMode};
use crate::model::MAX_JOINTS;

/// Targets of the joints for one period: the only path from a task to the drives.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct Targets {
    /// Control law from targets to torques.
    pub actuation: Actuation,
    /// Feedback law of the joint servos under [`Actuation::Servo`].
    pub servo_mode: ServoMode,
    /// Target of each joint.
    pub joints: [JointTarget; MAX_JOINTS],
}

/// Target of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct JointTarget {
    /// Set-point.
    pub setpoint: JointSetpoint,
    /// Feed-forward torque, for contact forces [N·m].
    pub feedforward: f32,
    /// Whether the servo restarts at the joint's position and resets its disturbance estimate.
    pub restart: bool,
}

/// Set-point of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum JointSetpoint {
    /// 0: an angle [rad], approached through the trajectory filter.
    Goal(f32),
    /// 1: a trajectory point, without the trajectory filter.
    Point(JointPoint),
    /// 2: brakes the reference to rest within the joint limits.
    Brake,
    /// 3: as a goal, but the reference keeps to the velocity limit. It becomes a `Goal` once it is near
    /// enough.
    FarGoal(f32),
}

/// Control law from targets to torques.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Actuation {
    /// 0: by the joint servos, with gravity, inertia and friction fed forward.
    Servo,
    /// 1: feed-forward torques and damping; gravity and friction fed forward when `compensated`.
    Torque {
        /// Torque per speed, Hand3 (20), `K_d` [N·m·s/rad].
        damping: f32,
        /// Whether gravity and friction are fed forward.
        compensated: bool,
    },
    /// 2: inverse dynamics of each chain for the accelerations of the points, plus the feed-forward torques.
    Acceleration {
        /// Fraction of the friction that is fed forward.
        friction: f32,
    },
}

impl Targets {
    /// Goals of 0, servos under PID.
    pub const NONE: Self = Self {
        actuation: Actuation::Servo,
        servo_mode: ServoMode::Pid,
        joints: [JointTarget::at(0.0); MAX_JOINTS],
    };
}

impl JointTarget {
    /// The target at rest at an angle [rad].
    pub const fn at(position: f32) -> Self {
        Self { setpoint: JointSetpoint::Goal(position), feedforward: 0.0, restart: false }
    }

    /// The target that is a point of a trajectory.
    pub const fn point(point: JointPoint) -> Self {
        Self { setpoint: JointSetpoint::Point(point), feedforward: 0.0, restart: false }
    }
}
