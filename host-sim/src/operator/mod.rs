//! The operator's side of a master-slave system: a person's hand and elbow, the devices that measure them,
//! and the links.
//!
//! ```text
//!  HandMotion ─► MasterArm ─► Link ─► slave          ElbowMotion ─► ElbowSensor ─► Link ─► slave
//!                    ▲                   │
//!                    └─ force ◄─ Link ◄──┘
//! ```
//!
//! A hand with five fingers is an [`OperatorHand`] moved by [`FingersMotion`], and measured by [`Glove`] and
//! [`FingertipMarkers`]; [`calibration_trial`] calibrates it.
//!
//! All poses are in one frame, in which the operator's hand and the slave's hand should coincide; the poses
//! of the devices do not matter outside them. Devices sample with their own rates and phases. All random
//! values are seeded, and all time stamps are from one clock.

pub mod calibration_trial;
mod elbow;
mod glove;
mod link;
mod master_arm;
mod motion;

pub use elbow::{ElbowMotion, ElbowSensor, ElbowSensorValues, ElbowSwing};
pub use glove::{FingerAngles, FingersMotion, FingertipMarkers, Glove, GloveValues, OperatorHand};
pub use link::{Link, LinkValues, Packet};
pub use master_arm::{Impedance, MasterArm, MasterArmValues, MasterPose};
pub use motion::{OperatorHandMotion, OperatorHandState, Stroke, StrokeValues, TREMOR_BAND};

/// Sampling times of a device with a constant rate and a phase.
#[derive(Clone, Copy, Debug)]
struct Sampling {
    rate: f64,
    /// In periods.
    phase: f64,
    count: u32,
}

impl Sampling {
    const fn new(rate: f64, phase: f64) -> Self {
        Self { rate, phase, count: 0 }
    }

    /// Returns the next sampling time, if it is not after `until` [s].
    fn next(&mut self, until: f64) -> Option<f64> {
        let time = (f64::from(self.count) + self.phase) / self.rate;
        (time <= until).then(|| {
            self.count += 1;
            time
        })
    }
}
