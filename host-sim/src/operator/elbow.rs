//! The operator's elbow, and the sensor that measures its tilt.

use core::f64::consts::TAU;

use tesaki_rng::Rng;
use tesaki_supervisor::trajectory::minimum_jerk;

use super::Sampling;
use crate::purpose::Purpose;

/// Acceleration of gravity [m/s²].
const GRAVITY: f64 = 9.81;

/// A swing of the elbow about the line from shoulder to wrist, from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElbowSwing {
    /// Start time [s].
    pub begin: f64,
    /// Duration [s].
    pub duration: f64,
    /// Change of the tilt [rad].
    pub angle: f64,
}

/// Trajectory of an operator's elbow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ElbowMotion {
    /// Tilt at the start; 0 with the elbow straight down [rad].
    pub start: f64,
    /// Swings, which may overlap.
    pub swings: Vec<ElbowSwing>,
}

impl ElbowMotion {
    /// Returns the tilt [rad] and its first and second derivative at a time [s].
    pub fn at(&self, time: f64) -> [f64; 3] {
        let mut sum = [self.start, 0.0, 0.0];
        for ElbowSwing { begin, duration, angle } in &self.swings {
            let [fraction, rate, change] = minimum_jerk((time - begin) / duration);
            sum[0] += angle * fraction;
            sum[1] += angle * rate / duration;
            sum[2] += angle * change / (duration * duration);
        }
        sum
    }
}

/// Parameters of a tilt sensor that measures the direction of gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElbowSensorValues {
    /// Sampling rate [Hz].
    pub rate: f64,
    /// Cut-off frequency of its first-order low-pass filter [Hz].
    pub bandwidth: f64,
    /// Standard deviation of a sample [rad].
    pub noise: f64,
    /// Largest constant mounting error [rad].
    pub offset: f64,
    /// Its distance from the axis of the swing [m]: tangential acceleration appears as tilt.
    pub radius: f64,
}

impl Default for ElbowSensorValues {
    /// A small accelerometer on the elbow.
    fn default() -> Self {
        Self { rate: 100.0, bandwidth: 10.0, noise: 5e-3, offset: 0.02, radius: 0.15 }
    }
}

/// A simulated tilt sensor.
#[derive(Clone, Debug)]
pub struct ElbowSensor {
    values: ElbowSensorValues,
    sampling: Sampling,
    offset: f64,
    /// Last input and output of the filter.
    output: Option<(f64, f64)>,
    rng: Rng,
}

impl ElbowSensor {
    /// Creates a sensor with a seeded sampling phase.
    pub fn new(values: ElbowSensorValues, seed: u64) -> Self {
        let mut rng = Purpose::ElbowSensor.rng(seed);
        let sampling = Sampling::new(values.rate, 0.5 + 0.5 * rng.symmetric());
        let offset = values.offset * rng.symmetric();
        Self { values, sampling, offset, output: None, rng }
    }

    /// Its constant error [rad].
    pub const fn offset(&self) -> f64 {
        self.offset
    }

    /// Returns the samples since the last call, up to a time [s]: time [s] and tilt [rad].
    pub fn run(&mut self, motion: &ElbowMotion, until: f64) -> Vec<(f64, f64)> {
        let mut samples = Vec::new();
        while let Some(time) = self.sampling.next(until) {
            let [tilt, _, acceleration] = motion.at(time);
            let apparent = tilt + libm::atan2(self.values.radius * acceleration, GRAVITY);
            // Exact for an input that is linear between the samples.
            let output = match self.output {
                None => apparent,
                Some((before, output)) => self.filter(output, before, apparent),
            };
            self.output = Some((apparent, output));
            samples.push((time, output + self.offset + self.values.noise * self.rng.normal()));
        }
        samples
    }

    fn filter(&self, output: f64, before: f64, apparent: f64) -> f64 {
        let lag = TAU * self.values.bandwidth / self.values.rate;
        let decay = libm::exp(-lag);
        let slope = (apparent - before) / lag;
        apparent - slope + (output - before + slope) * decay
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_and_offset_have_their_sizes() {
        let values = ElbowSensorValues::default();
        let motion = ElbowMotion { start: 0.3, ..ElbowMotion::default() };
        let mut offsets = Vec::new();
        for seed in 0..50 {
            let samples = ElbowSensor::new(values, seed).run(&motion, 20.0);
            assert!((1999..=2001).contains(&samples.len()));
            let mean = samples.iter().map(|(_, tilt)| tilt).sum::<f64>() / samples.len() as f64;
            let square = samples.iter().map(|(_, tilt)| (tilt - mean).powi(2)).sum::<f64>();
            let deviation = (square / samples.len() as f64).sqrt();
            assert!((deviation / 5e-3 - 1.0).abs() < 0.07, "{deviation}");
            offsets.push(mean - 0.3);
        }
        let largest = offsets.iter().fold(0.0_f64, |largest, offset| largest.max(offset.abs()));
        assert!(largest > 0.015 && largest < 0.0205, "{largest}");
    }

    /// 30° in 1 s: at the end, the lag of 1/(2π 10 Hz) has decayed; during the swing the tilt is late by it.
    #[test]
    fn a_swing_comes_late_and_acceleration_tilts_it() {
        let values =
            ElbowSensorValues { noise: 0.0, offset: 0.0, radius: 0.0, ..ElbowSensorValues::default() };
        let swing = ElbowSwing { begin: 0.5, duration: 1.0, angle: core::f64::consts::FRAC_PI_6 };
        let motion = ElbowMotion { start: 0.0, swings: vec![swing] };
        let samples = ElbowSensor::new(values, 1).run(&motion, 3.0);
        for &(time, tilt) in samples.iter().filter(|(time, _)| *time > 0.8 && *time < 1.2) {
            let late = motion.at(time - 1.0 / (TAU * 10.0))[0];
            assert!((tilt - late).abs() < 1e-3, "{time} {tilt} {late}");
        }
        assert!(samples.last().is_some_and(|(_, tilt)| (tilt - swing.angle).abs() < 1e-6));
        let fast = ElbowSensorValues { bandwidth: 1000.0, radius: 0.15, ..values };
        let worst = ElbowSensor::new(fast, 1)
            .run(&motion, 3.0)
            .iter()
            .fold(0.0_f64, |worst, &(time, tilt)| worst.max((tilt - motion.at(time)[0]).abs()));
        // The largest acceleration of minimum jerk is 5.77 A/T²: 0.15 · 3.02 / 9.81.
        assert!((worst - 0.0462).abs() < 1e-3, "{worst}");
    }
}
