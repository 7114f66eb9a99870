//! The operator's fingertips between samples.

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::TelexistenceRefusal;
use crate::TICK;
use crate::kinematics::MAX_FINGERS;
use crate::math::abs;
use crate::teleop::{MAX_COORDINATE, OperatorFingertips, is_near, is_unit};

/// A fingertip is extrapolated with its velocity for this time after its measurement [s].
pub const MAX_EXTRAPOLATION: f32 = 0.05;
/// Largest velocity of a fingertip along an axis [m/s]; hands reach a tenth of it.
const MAX_VELOCITY: f32 = 20.0;
/// Largest age of a sample on arrival [s].
const MAX_AGE: f32 = 1.0;

/// A fingertip of the operator, in the frame of the operator's hand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FingertipPoint {
    /// Position [m].
    pub position: [f32; 3],
    /// Velocity [m/s]; 0 if the source knows none.
    pub velocity: [f32; 3],
    /// Direction in which it points, a unit vector, if the source knows it.
    pub direction: Option<[f32; 3]>,
}

/// The operator's fingertips at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FingertipSample {
    /// Number of the sample, larger than that of the one before; it may wrap around.
    pub number: u16,
    /// Time since the measurement [s]: delay of filter and link.
    pub age: f32,
    /// The fingertips, thumb to little finger; `None` for one that is not visible now.
    pub tips: [Option<FingertipPoint>; MAX_FINGERS],
}

impl FingertipSample {
    /// Checks all values.
    ///
    /// # Errors
    /// The age, or the first finger, that is out of range.
    pub fn validate(&self) -> Result<(), TelexistenceRefusal> {
        if !(0.0..=MAX_AGE).contains(&self.age) {
            return Err(TelexistenceRefusal::Age { value: self.age });
        }
        for (finger, tip) in (0..).zip(&self.tips) {
            let Some(tip) = tip else { continue };
            let valid = is_near(&tip.position.into())
                && tip.velocity.iter().all(|value| abs(*value) <= MAX_VELOCITY)
                && tip.direction.is_none_or(|direction| is_unit(&Vector3::from(direction)));
            if !valid {
                return Err(TelexistenceRefusal::Fingertip { finger });
            }
        }
        Ok(())
    }
}

/// The last measurement of a fingertip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
struct TipMeasurement {
    point: FingertipPoint,
    /// Time since then [s].
    age: f32,
}

/// The last known fingertips of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct Fingertips {
    /// Number of the last sample.
    number: Option<u16>,
    /// Ticks since its arrival.
    ticks: u8,
    tips: [Option<TipMeasurement>; MAX_FINGERS],
}

impl Fingertips {
    pub const NONE: Self = Self { number: None, ticks: 0, tips: [None; MAX_FINGERS] };

    /// Stores a valid sample. Returns `false` if it is not newer than the last. After a pause of 2.55 s it
    /// may have any number: another leader counts from another one.
    pub fn take(&mut self, sample: &FingertipSample) -> bool {
        let is_newer =
            |last| self.ticks == u8::MAX || (1..0x8000).contains(&sample.number.wrapping_sub(last));
        if !self.number.is_none_or(is_newer) {
            return false;
        }
        (self.number, self.ticks) = (Some(sample.number), 0);
        for (known, tip) in self.tips.iter_mut().zip(&sample.tips) {
            if let Some(point) = tip {
                *known = Some(TipMeasurement { point: *point, age: sample.age });
            }
        }
        true
    }

    /// Discards the positions of the fingertips, but not the number of the last sample.
    pub const fn forget(&mut self) {
        self.tips = [None; MAX_FINGERS];
    }

    /// Advances by one period. Measurements older than `max_age` [s] are discarded.
    pub fn advance(&mut self, max_age: f32) {
        self.ticks = self.ticks.saturating_add(1);
        for tip in &mut self.tips {
            if let Some(measurement) = tip {
                measurement.age += TICK;
                if measurement.age > max_age {
                    *tip = None;
                }
            }
        }
    }

    /// The extrapolated fingertips.
    pub fn present(&self) -> OperatorFingertips {
        let mut present = OperatorFingertips::default();
        let places = present.positions.iter_mut().zip(&mut present.directions);
        for ((position, direction), tip) in places.zip(&self.tips) {
            let Some(TipMeasurement { point, age }) = tip else { continue };
            let ahead = age.min(MAX_EXTRAPOLATION);
            let place = Vector3::from(point.position) + Vector3::from(point.velocity) * ahead;
            *position = Some(place.map(|value| crate::math::clamp(value, -MAX_COORDINATE, MAX_COORDINATE)));
            *direction = point.direction.map(Vector3::from);
        }
        present
    }

    /// Ticks since the last sample.
    pub const fn age(&self) -> u8 {
        self.ticks
    }

    /// Bit `i`: finger `i` is not known.
    pub fn unknown(&self) -> u8 {
        (0..).zip(&self.tips).filter(|(_, tip)| tip.is_none()).fold(0, |bits, (finger, _)| bits | 1 << finger)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_leader_is_heard_after_a_pause() {
        let sample = |number| FingertipSample { number, age: 0.0, tips: [None; MAX_FINGERS] };
        let mut fingertips = Fingertips::NONE;
        assert!(fingertips.take(&sample(20_000)));
        assert!(!fingertips.take(&sample(20_000)) && !fingertips.take(&sample(0)));
        (0..254).for_each(|_| fingertips.advance(1.0));
        assert!(!fingertips.take(&sample(0)));
        fingertips.advance(1.0);
        assert!(fingertips.take(&sample(0)) && !fingertips.take(&sample(0)) && fingertips.take(&sample(1)));
    }
}
