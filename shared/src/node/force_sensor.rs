use core::array::from_fn;

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::fault::FaultCause;
use crate::kinematics::Posture;
use crate::math::{self, abs};
use crate::model::ForceSensor;

/// Ticks without a change of any of the six counts: noise alone changes those of a live sensor.
const STUCK_TICKS: u16 = 50;
/// Share of a new reading in the mean that taring takes: some 16 ticks.
const MEAN_SHARE: f32 = 1.0 / 16.0;

/// What the force sensor of a tip reads.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct ForceSensorState {
    counts: [i32; 6],
    /// Ticks since one of the counts changed.
    still: u16,
    /// Mean of the latest readings less the weight of what the sensor carries [N, N·m].
    mean: [f32; 6],
    /// What is taken off: the mean when the sensor was tared.
    tare: [f32; 6],
    /// Whether there was a reading.
    read: bool,
}

impl ForceSensorState {
    pub const fn new() -> Self {
        Self { counts: [0; 6], still: 0, mean: [0.0; 6], tare: [0.0; 6], read: false }
    }

    /// The state with the longest encoding.
    #[cfg(test)]
    pub fn extreme() -> Self {
        Self { counts: [i32::MIN; 6], still: u16::MAX, ..Self::new() }
    }

    /// Takes over the counts of a sensor on a tip in `posture`, under `gravity` [m/s², base frame]. Returns force and torque
    /// of the world on the tip, in base axes [N, N·m], and what is wrong with them: cause, value, limit.
    pub fn read(
        &mut self,
        sensor: &ForceSensor,
        counts: &[i32; 6],
        posture: &Posture,
        gravity: &Vector3<f32>,
        tared: bool,
    ) -> ([f32; 6], Option<(FaultCause, f32, f32)>) {
        let same = self.read && self.counts == *counts;
        self.still = if same { self.still.saturating_add(1) } else { 0 };
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
        let share = if self.read { MEAN_SHARE } else { 1.0 };
        for (mean, reading) in self.mean.iter_mut().zip(&reading) {
            *mean += share * (reading - *mean);
        }
        self.read = true;
        let mut wrench = reading;
        wrench.iter_mut().zip(&self.tare).for_each(|(value, tare)| *value -= tare);
        let [fx, fy, fz, tx, ty, tz] = wrench;
        let (force, torque) = (rotation * Vector3::new(fx, fy, fz), rotation * Vector3::new(tx, ty, tz));
        let wrench = [force.x, force.y, force.z, torque.x, torque.y, torque.z];
        (wrench, self.inspect(sensor, &force, tared))
    }

    /// What is wrong with the last reading.
    fn inspect(
        &self,
        sensor: &ForceSensor,
        force: &Vector3<f32>,
        tared: bool,
    ) -> Option<(FaultCause, f32, f32)> {
        #[expect(clippy::cast_precision_loss, reason = "figures for people")]
        {
            if let Some(&count) = self.counts.iter().find(|count| count.unsigned_abs() >= sensor.saturation) {
                return Some((FaultCause::ForceSaturated, abs(count as f32), sensor.saturation as f32));
            }
            if self.still >= STUCK_TICKS {
                return Some((FaultCause::ForceStuck, self.still.into(), STUCK_TICKS.into()));
            }
        }
        let size = math::sqrt(force.norm_squared());
        let beyond = tared && size > sensor.force_limit;
        beyond.then_some((FaultCause::ForceLimit, size, sensor.force_limit))
    }

    /// What it reads now is what it reads without contact.
    pub fn take_tare(&mut self) {
        self.tare = self.mean;
    }
}
