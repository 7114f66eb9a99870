use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::control::{JointPoint, ServoMode};
use crate::model::MAX_JOINTS;

/// What a task wants of the joints until its next tick: the only way from a task to the drives.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct Targets {
    /// How torques are made of the targets.
    pub actuation: Actuation,
    /// How the joint servos damp and learn, under [`Actuation::Servo`].
    pub servo_mode: ServoMode,
    /// A target for each joint.
    pub joints: [JointTarget; MAX_JOINTS],
}

/// What a task wants of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct JointTarget {
    /// Where it should be.
    pub setpoint: JointSetpoint,
    /// Torque besides that of the servo, for forces on what the robot touches [N·m].
    pub feedforward: f32,
    /// Whether the servo begins anew where the joint is, and forgets the disturbance that it has learnt.
    pub restart: bool,
}

/// Where a joint should be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum JointSetpoint {
    /// 0: an angle [rad], approached through the trajectory filter.
    Goal(f32),
    /// 1: a point of a trajectory, past the trajectory filter.
    Point(JointPoint),
}

/// How the torques of the joints are made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Actuation {
    /// 0: by the joint servos, with gravity, inertia and friction fed forward.
    Servo,
    /// 1: feed-forward torques and damping; gravity and friction fed forward when `compensated`.
    Torque {
        /// Torque per speed, Hand3 (20), `K_d` [N·m·s/rad].
        damping: f32,
        /// Whether weight and friction of the links are fed forward.
        compensated: bool,
    },
    /// 2: inverse dynamics of each whole chain for the accelerations of the points, and the feed-forward torques.
    Acceleration {
        /// Fraction of the friction that is fed forward.
        friction: f32,
    },
}

impl Targets {
    /// Goals of 0 for servos under PID.
    pub const NONE: Self = Self {
        actuation: Actuation::Servo,
        servo_mode: ServoMode::Pid,
        joints: [JointTarget::at(0.0); MAX_JOINTS],
    };

    /// All joints at rest at these angles [rad].
    pub fn stand_at(&mut self, positions: &[f32; MAX_JOINTS]) {
        for (target, position) in self.joints.iter_mut().zip(positions) {
            *target = JointTarget::at(*position);
        }
    }
}

impl JointTarget {
    /// At rest at an angle [rad].
    pub const fn at(position: f32) -> Self {
        Self { setpoint: JointSetpoint::Goal(position), feedforward: 0.0, restart: false }
    }
}
