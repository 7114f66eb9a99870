//! Control of single joints, and the impedance of a tool. Chains and tasks build on it.

mod friction;
mod impedance;
mod joint_servo;
mod observer;
mod pid;

pub use friction::{FrictionFeedforward, FrictionState};
pub use impedance::{DiscreteImpedance, Impedance, ImpedanceTerm, InvalidImpedance};
pub use joint_servo::{JointServo, JointServoState, ServoOutput};
pub use observer::{ErrorObserver, ObserverState};
pub use pid::{Pid, PidState};

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// One point of a joint's trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct JointPoint {
    /// Angle [rad].
    pub position: f32,
    /// Its first derivative [rad/s].
    pub velocity: f32,
    /// Its second derivative [rad/s²].
    pub acceleration: f32,
}

/// How a joint servo damps and how it learns about disturbances.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ServoMode {
    /// 0: PID with pseudo-differentiator, as in the Hand3 paper, section 4.
    Pid,
    /// 1: state feedback on an observer of velocity and disturbance.
    Observer,
}

/// What a joint's torque is made of, besides the command's own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Actuation {
    /// 0: the joint's servo, with gravity, inertia and friction fed forward.
    Servo,
    /// 1: damping of so much torque per speed [N·m·s/rad]; gravity and friction fed forward when `compensated`.
    Torque {
        /// Hand3 (20), `K_d`.
        damping: f32,
        /// Whether weight and friction of the fingers are fed forward.
        compensated: bool,
    },
    /// 2: the torque that the whole arm's dynamics need for the accelerations that a task asks for.
    Acceleration {
        /// Share of the friction that is fed forward.
        friction: f32,
    },
}
