//! The six strain gauges of a force sensor: computes a wrench from their converter's values each control
//! period.

use embedded_hal::spi::SpiDevice;
use tesaki::model::{ForceSensor, GAUGES, Gauges};
use tesaki::protocol::ForceSensorFault;

use crate::ads131m06::{Ads131m06, OVERSAMPLING, ReadError};

/// The converter's clock [Hz].
const CLOCK: f32 = 8.192e6;
/// Values in a control period. A sample of the modulator takes two clocks; a value is 0.75 ms old when it is
/// ready, the group delay of the converter's filters.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "10")]
const EXPECTED: u8 = (tesaki::TICK * CLOCK / (2.0 * OVERSAMPLING as f32) + 0.5) as u8;
/// With fewer trusted values, a control period has a fault.
const MIN_TRUSTED: u8 = EXPECTED / 2;
/// More edges on the data-ready line are noise, such as on an open line.
const MAX_SEEN: u8 = EXPECTED + EXPECTED / 2;

/// The calibration matrix of a sensor, scaled to the counts of the sensor frame.
#[derive(Clone, Copy, Debug)]
pub struct Calibration([[f32; GAUGES]; 6]);

impl Calibration {
    /// Scales the matrix of a sensor's gauges.
    pub fn new(sensor: &ForceSensor, gauges: &Gauges) -> Self {
        let mut rows = gauges.calibration_matrix;
        for (axis, row) in rows.iter_mut().enumerate() {
            let resolution = if axis < 3 { sensor.force_resolution } else { sensor.torque_resolution };
            row.iter_mut().for_each(|value| *value /= resolution);
        }
        Self(rows)
    }

    /// Computes the wrench from the counts of the gauges, in counts of the sensor's resolutions, rounded:
    /// forces along x, y, z, then torques.
    pub fn wrench(&self, gauges: &[i32; GAUGES]) -> [i32; 6] {
        let mut wrench = [0; 6];
        for (count, row) in wrench.iter_mut().zip(&self.0) {
            // 24 bits are exact in an `f32`.
            #[expect(clippy::cast_precision_loss, reason = "24 bits")]
            let sum: f32 = row.iter().zip(gauges).map(|(value, gauge)| value * *gauge as f32).sum();
            #[expect(clippy::cast_possible_truncation, reason = "saturates")]
            let rounded = (if sum < 0.0 { sum - 0.5 } else { sum + 0.5 }) as i32;
            *count = rounded;
        }
        wrench
    }
}

/// The result of a control period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// The wrench of the last trusted value, see [`Calibration::wrench`]. Without a fault, disturbances make
    /// it at most half a control period older.
    pub wrench: [i32; 6],
    /// Why it cannot be trusted.
    pub fault: Option<ForceSensorFault>,
}

/// The gauges of one sensor behind an ADS131M06.
#[derive(Debug)]
pub struct ForceGauges<S> {
    converter: Ads131m06<S>,
    /// `None` when the robot has no such sensor.
    calibration: Option<Calibration>,
    /// Whether the converter is set up.
    is_started: bool,
    values: [i32; GAUGES],
    /// Conversions in this period, and how many of them can be trusted.
    seen: u8,
    trusted: u8,
    /// The first certain fault of this period, or else the last one.
    fault: Option<ForceSensorFault>,
    /// Whether the converter may still hold an old conversion.
    may_be_late: bool,
}

impl<S: SpiDevice> ForceGauges<S> {
    /// Creates gauges without a robot.
    pub const fn new(spi: S) -> Self {
        Self {
            converter: Ads131m06::new(spi),
            calibration: None,
            is_started: false,
            values: [0; GAUGES],
            seen: 0,
            trusted: 0,
            fault: None,
            may_be_late: true,
        }
    }

    /// Takes a robot's sensor with its gauges, or `None` without one. The converter is set up in the periods
    /// that follow.
    pub fn configure(&mut self, of: Option<(&ForceSensor, &Gauges)>) {
        if let Some((_, gauges)) = of {
            self.converter.configure(&gauges.gains);
        }
        self.calibration = of.map(|(sensor, gauges)| Calibration::new(sensor, gauges));
        self.is_started = false;
        self.values = [0; GAUGES];
        (self.seen, self.trusted, self.fault) = (0, 0, None);
    }

    /// Returns whether the robot has such a sensor.
    pub const fn is_used(&self) -> bool {
        self.calibration.is_some()
    }

    /// Handles the signal for a new conversion: reads one frame, or two after one was missed. Returns whether
    /// there may be more in this control period; otherwise the line is noisy and should be ignored until the
    /// next one.
    pub fn on_ready(&mut self) -> bool {
        if !self.is_used() || self.seen >= MAX_SEEN {
            return false;
        }
        self.seen += 1;
        if !self.is_started {
            return true;
        }
        if core::mem::take(&mut self.may_be_late) {
            // The value is old, or there is none.
            let _ = self.converter.read();
        }
        match self.converter.read() {
            Ok(values) => {
                self.values = values;
                self.trusted += 1;
            }
            Err(error) => {
                let fault = match error {
                    ReadError::Checksum => ForceSensorFault::Damaged,
                    ReadError::Restarted => ForceSensorFault::Restarted,
                    ReadError::Stuck(channel) => ForceSensorFault::Stuck(channel),
                    ReadError::Saturated(channel) => ForceSensorFault::Saturated(channel),
                    ReadError::Bus(_) | ReadError::NotReady => ForceSensorFault::Silent,
                };
                if !self.fault.is_some_and(is_certain) {
                    self.fault = Some(fault);
                }
                self.is_started = fault != ForceSensorFault::Restarted;
            }
        }
        true
    }

    /// Ends a control period. Exchanges at most one frame, to set the converter up. Returns `None` when the
    /// robot has no such sensor.
    ///
    /// Values that come late or are damaged on the way are left out; a period with fewer than half of its
    /// values is a fault. An error that the converter itself reports is a fault at once.
    pub fn update(&mut self) -> Option<Reading> {
        let calibration = self.calibration?;
        let (seen, trusted) = (core::mem::take(&mut self.seen), core::mem::take(&mut self.trusted));
        let found = self.fault.take();
        // One was missed, and the converter still holds it; or its clock has slipped by a conversion.
        self.may_be_late |= seen != EXPECTED;
        let fault = match found {
            Some(fault) if is_certain(fault) => found,
            _ if trusted >= MIN_TRUSTED => None,
            found => found.or(Some(ForceSensorFault::Silent)),
        };
        if !self.is_started {
            // After an error, the set-up begins again.
            self.is_started = matches!(self.converter.start(), Ok(true));
            self.may_be_late = true;
        }
        Some(Reading { wrench: calibration.wrench(&self.values), fault })
    }
}

/// Returns whether the converter itself reports that its values are wrong. Occasional disturbances of the
/// line say nothing about them.
const fn is_certain(fault: ForceSensorFault) -> bool {
    !matches!(fault, ForceSensorFault::Silent | ForceSensorFault::Damaged)
}

#[cfg(test)]
#[path = "gauges_tests.rs"]
mod tests;
