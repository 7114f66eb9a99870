//! Control laws of single joints, the current of their motors, and the target impedance of a tool.

mod coupling;
mod current_loop;
mod friction;
mod impedance;
mod joint_servo;
mod observer;
mod pid;

pub use coupling::Coupling;
pub use current_loop::{CurrentLoop, CurrentLoopState, Drive, InvalidCurrentLoop, Switching, Winding};
pub(crate) use friction::STALL_SPEED;
pub use friction::{FrictionFeedforward, FrictionState};
pub use impedance::{DiscreteImpedance, Impedance, ImpedanceAxes, ImpedanceTerm, InvalidImpedance};
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
    /// 2: the PID alone, as printed (Hand3 figure 6): gravity, inertia and friction are not fed forward,
    /// friction is not learnt, and the error is integrated at rest too.
    BarePid,
}
