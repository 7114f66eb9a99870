//! The operator's side of a master-slave system: a person's hand and elbow, the devices that measure them,
//! and the links.
//!
//! ```text
//!  HandMotion ─► MasterArm ─► Link ─► slave          ElbowMotion ─► ElbowSensor ─► Link ─► slave
//!                    ▲                   │
//!                    └─ force ◄─ Link ◄──┘
//! ```
//!
//! For a hand with five fingers: [`OperatorHand`] moved by [`FingersMotion`], measured by [`Glove`] and
//! [`FingertipMarkers`]; [`calibration_trial`] calibrates it.
//!
//! All poses are in one frame, in which the operator's hand and the slave's hand are to be at the same place;
//! where the devices stand is their own matter. Devices sample at rates and phases of their own. Everything
//! random is seeded, and all time stamps are of one clock.

pub mod calibration_trial;
mod elbow;
mod glove;
mod link;
mod master_arm;
mod motion;
mod recorded;

pub use elbow::{ElbowMotion, ElbowSensor, ElbowSensorValues, ElbowSwing};
pub use glove::{FingerAngles, FingersMotion, FingertipMarkers, Glove, GloveValues, OperatorHand};
pub use link::{Link, LinkValues, Packet};
pub use master_arm::{Impedance, MasterArm, MasterArmValues, MasterPose};
pub use motion::{OperatorHandMotion, OperatorHandState, Stroke, StrokeValues, TREMOR_BAND};
pub use recorded::{Recorded, RecordedError};

/// Instants of a device that samples at a steady rate from a phase on.
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

    /// The next instant, if it is not after `until` [s].
    fn next(&mut self, until: f64) -> Option<f64> {
        let time = (f64::from(self.count) + self.phase) / self.rate;
        (time <= until).then(|| {
            self.count += 1;
            time
        })
    }
}
