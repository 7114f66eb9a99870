//! Control laws of single joints, current control of their motors, and the target impedance of a tool.

mod coupling;
mod current_loop;
mod friction;
mod impedance;
mod joint_servo;
mod observer;
mod pid;

pub use coupling::ImpedanceCoupling;
pub use current_loop::{
    CurrentLoop, CurrentLoopField, CurrentLoopState, StageCommand, Supply, Switching, Winding,
};
pub(crate) use friction::STALL_SPEED;
pub use friction::{FrictionFeedforward, FrictionState};
pub(crate) use impedance::axis_name;
pub use impedance::{Impedance, ImpedanceAxes, ImpedanceTerm, InvalidImpedance};
pub use joint_servo::{JointServo, JointServoState, ServoOutput};
pub use observer::{ErrorObserver, ObserverState};
pub use pid::{Pid, PidState};

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{TICK, math};

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

impl JointPoint {
    /// The point one period later, with the same acceleration.
    #[inline]
    pub(crate) fn next(&self) -> Self {
        let velocity = self.velocity + self.acceleration * TICK;
        Self { position: self.position + 0.5 * (self.velocity + velocity) * TICK, velocity, ..*self }
    }

    /// Maximum downward and upward speeds at the end of the starting period [rad/s] from which half of
    /// `acceleration` [rad/s²] brakes before the limits of the angle [rad].
    pub(crate) fn stopping_speeds(&self, [lower, upper]: [f32; 2], acceleration: f32) -> [f32; 2] {
        // (now + v) T/2 + v²/acceleration = space
        let lag = 0.25 * acceleration * TICK;
        let speed = |space: f32| math::sqrt(lag * lag + acceleration * math::max(0.0, space)) - lag;
        let half = 0.5 * self.velocity * TICK;
        [speed(self.position - lower + half), speed(upper - self.position - half)]
    }
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
