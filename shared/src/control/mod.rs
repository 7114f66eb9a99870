//! Control laws of single joints, and the target impedance of a tool.

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

/// Feedback law of a joint servo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ServoMode {
    /// 0: PID with pseudo-differentiator, as in the Hand3 paper, section 4.
    Pid,
    /// 1: state feedback on an observer of velocity and disturbance.
    Observer,
}

/// How the joint torques are computed, before a task's feed-forward is added.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Actuation {
    /// 0: the joint's servo, with gravity, inertia and friction fed forward.
    Servo,
    /// 1: torque control with damping.
    Torque {
        /// `K_d` of (Hand3 eq. 20) [N·m·s/rad].
        damping: f32,
        /// Whether gravity and friction of the joints are compensated by feed-forward.
        compensated: bool,
    },
    /// 2: inverse dynamics of the whole chain for the accelerations that a task commands.
    Acceleration {
        /// Fraction of the friction model that is fed forward, 0 to 1.
        friction: f32,
    },
}
