use core::array::from_fn;

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::fault::{FaultCause, Finding};
use crate::kinematics::Posture;
use crate::math::{self, abs};
use crate::model::ForceSensor;

/// Ticks without a change of any count after which the sensor counts as dead: in a live sensor noise alone
/// changes them.
const STUCK_TICKS: u16 = 50;
/// Gain of the low-pass filter for the tare: a time constant of 16 ticks. A smaller gain suppresses more
/// noise and requires a longer time without contact.
const TARE_FILTER_GAIN: f32 = 1.0 / 16.0;

/// Ticks after homing in which no sensor is tared: then 0.2 % of the filtered reading are of weights at the
/// earlier angles.
pub(super) const TARE_DELAY: u8 = 100;

/// State of a force sensor.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct ForceSensorState {
    counts: [i32; 6],
    /// Ticks since a count changed.
    unchanged: u16,
    /// Low-pass filtered reading without the weight on the sensor [N, N·m].
    mean: [f32; 6],
    /// Offset: the filtered reading at the tare [N, N·m].
    tare: [f32; 6],
    /// Whether there was a valid reading since the state was created or invalidated.
    initialized: bool,
}

impl ForceSensorState {
    pub const fn new() -> Self {
        Self { counts: [0; 6], unchanged: 0, mean: [0.0; 6], tare: [0.0; 6], initialized: false }
    }

    /// The state with the longest encoding.
    #[cfg(test)]
    pub fn extreme() -> Self {
        Self { counts: [i32::MIN; 6], unchanged: u16::MAX, ..Self::new() }
    }

    /// Reads the counts of a sensor on a tip in `posture`, under `gravity` [m/s², base frame]. Returns the
    /// external wrench on the tip, in base axes [N, N·m], and its fault, if any.
    pub fn read(
        &mut self,
        sensor: &ForceSensor,
        counts: &[i32; 6],
        posture: &Posture,
        gravity: &Vector3<f32>,
        tared: bool,
    ) -> ([f32; 6], Option<Finding>) {
        let same = self.initialized && self.counts == *counts;
        self.unchanged = if same { self.unchanged.saturating_add(1) } else { 0 };
        self.counts = *counts;

        let rotation = &posture.tip().rotation;
        let weight = rotation.inverse_transform_vector(gravity) * sensor.mass;
        let moment = Vector3::from(sensor.center_of_mass).cross(&weight);
        let own = [weight.x, weight.y, weight.z, moment.x, moment.y, moment.z];
        #[expect(clippy::cast_precision_loss, reason = "a saturated sensor has fewer bits")]
        let reading: [f32; 6] = from_fn(|axis| {
            let scale = if axis < 3 { sensor.force_resolution } else { sensor.torque_resolution };
            counts.get(axis).map_or(0.0, |&count| count as f32 * scale) - own.get(axis).unwrap_or(&0.0)
        });
        let gain = if self.initialized { TARE_FILTER_GAIN } else { 1.0 };
        for (mean, reading) in self.mean.iter_mut().zip(&reading) {
            *mean += gain * (reading - *mean);
        }
        self.initialized = true;
        let mut wrench = reading;
        wrench.iter_mut().zip(&self.tare).for_each(|(value, tare)| *value -= tare);
        let [fx, fy, fz, tx, ty, tz] = wrench;
        let (force, torque) = (rotation * Vector3::new(fx, fy, fz), rotation * Vector3::new(tx, ty, tz));
        let wrench = [force.x, force.y, force.z, torque.x, torque.y, torque.z];
        (wrench, self.check(sensor, &force, tared))
    }

    /// Checks the last reading.
    fn check(&self, sensor: &ForceSensor, force: &Vector3<f32>, tared: bool) -> Option<Finding> {
        let fault = self.counts_fault(sensor);
        let size = math::norm(force);
        if fault.is_some() || !tared || size <= sensor.force_limit {
            return fault;
        }
        Some(Finding { cause: FaultCause::ForceLimit, value: size, limit: sensor.force_limit })
    }

    /// Checks the counts alone: saturated or stuck.
    #[expect(clippy::cast_precision_loss, reason = "for display")]
    fn counts_fault(&self, sensor: &ForceSensor) -> Option<Finding> {
        if let Some(&count) = self.counts.iter().find(|count| count.unsigned_abs() >= sensor.saturation) {
            let (value, limit) = (abs(count as f32), sensor.saturation as f32);
            return Some(Finding { cause: FaultCause::ForceSaturated, value, limit });
        }
        let stuck = self.unchanged >= STUCK_TICKS;
        let (value, limit) = (self.unchanged.into(), STUCK_TICKS.into());
        stuck.then_some(Finding { cause: FaultCause::ForceStuck, value, limit })
    }

    /// Invalidates the last reading: filter and stuck counter restart with the next valid one.
    pub const fn lose(&mut self) {
        self.initialized = false;
    }

    /// Whether the last tick had a reading from a sensor that is neither stuck nor saturated.
    pub fn has_read(&self, sensor: &ForceSensor) -> bool {
        self.initialized && self.counts_fault(sensor).is_none()
    }

    /// Takes the filtered reading as the offset without contact.
    pub fn tare(&mut self) {
        self.tare = self.mean;
    }
}
