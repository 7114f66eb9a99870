//! A six-axis force sensor of `board-weact`: six strain gauges that a wrench strains, behind an ADS131M06.
//!
//! Written from the board's wiring page and from what a calibration matrix means, not from the driver.

use crate::ads131m06::Ads131m06;
use crate::gpio::Gpio;
use crate::pins::Pin;
use crate::spi::Sent;

const SELECT: Pin = Pin(0, 15);
const DATA: Pin = Pin(2, 4);
const SPI: [(Pin, &str); 3] = [(Pin(1, 3), "SCK"), (Pin(1, 4), "MISO"), (Pin(1, 5), "MOSI")];
/// The converter's own reference as a fraction of the gauges'.
const REFERENCE: f64 = 0.85;

pub struct ForceSensor {
    pub converter: Ads131m06,
    /// Wrench on the tip: forces along x, y, z [N] and torques [N·m].
    pub wrench: [f64; 6],
    /// Counts of each gauge for 1 N and 1 N·m, at a gain of 1.
    sensitivity: [[f64; 6]; 6],
    /// Counts of each gauge without a wrench, at a gain of 1.
    pub offsets: [f64; 6],
    /// Amplitude of the uniform noise, at a gain of 1 [counts].
    pub noise: f64,
    random: u32,
}

impl ForceSensor {
    /// Creates a sensor with gauges whose wrench is `calibration` · counts, where the converter has these
    /// gains.
    pub fn new(calibration: &[[f64; 6]; 6], gains: [u8; 6]) -> Self {
        let mut sensitivity = inverse(calibration);
        for (row, gain) in sensitivity.iter_mut().zip(gains) {
            row.iter_mut().for_each(|value| *value /= f64::from(gain));
        }
        Self {
            converter: Ads131m06::default(),
            wrench: [0.0; 6],
            sensitivity,
            offsets: [0.0; 6],
            noise: 2.0,
            random: 1,
        }
    }

    pub fn next(&self) -> u64 {
        self.converter.next()
    }

    /// Takes the levels of the chip's outputs, and performs the conversions up to `now`.
    pub fn observe(&mut self, gpio: &Gpio, now: u64) {
        if self.converter.next() <= now {
            let Self { wrench, sensitivity, offsets, noise, .. } = *self;
            let random: [f64; 6] = std::array::from_fn(|_| {
                self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                noise * (f64::from(self.random >> 8) / f64::from(1 << 23) - 1.0)
            });
            self.converter.advance(now, |external, gauge| {
                let strain: f64 = sensitivity[gauge].iter().zip(wrench).map(|(a, b)| a * b).sum();
                (strain + offsets[gauge] + random[gauge]) / if external { 1.0 } else { REFERENCE }
            });
        }
        self.converter.select(gpio.output(SELECT) == Some(false), now);
    }

    /// Returns the line that signals new values.
    pub fn data_line(&self) -> Option<(Pin, bool)> {
        // A resistor of the chip holds an open line.
        Some((DATA, self.converter.ready_line().unwrap_or(true)))
    }

    /// Exchanges a word over the bus, if the pins are set up for it.
    pub fn exchange(&mut self, sent: &Sent, gpio: &Gpio) -> u32 {
        let [clock, answer, data] = SPI.map(|(pin, name)| gpio.signal(pin) == Some(("SPI1", name)));
        if !clock || !data {
            return 0;
        }
        let word = self.converter.exchange(sent).unwrap_or(0);
        if answer { word } else { 0 }
    }
}

/// Inverts by elimination with pivoting.
fn inverse(matrix: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    let (mut left, mut right) = (*matrix, [[0.0; 6]; 6]);
    (0..6).for_each(|place| right[place][place] = 1.0);
    for column in 0..6 {
        let largest = |a: &usize, b: &usize| left[*a][column].abs().total_cmp(&left[*b][column].abs());
        let pivot = (column..6).max_by(largest).unwrap_or(column);
        left.swap(column, pivot);
        right.swap(column, pivot);
        let scale = left[column][column];
        left[column].iter_mut().chain(&mut right[column]).for_each(|value| *value /= scale);
        for row in (0..6).filter(|row| *row != column) {
            let factor = left[row][column];
            for place in 0..6 {
                left[row][place] -= factor * left[column][place];
                right[row][place] -= factor * right[column][place];
            }
        }
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_times_its_inverse_is_one() {
        let matrix: [[f64; 6]; 6] = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                ((7 * row + 3 * column) % 11) as f64 + 5.0 * f64::from(row == column)
            })
        });
        let inverse = inverse(&matrix);
        for (row, column) in (0..36).map(|place| (place / 6, place % 6)) {
            let product: f64 = (0..6).map(|k| matrix[row][k] * inverse[k][column]).sum();
            assert!((product - f64::from(row == column)).abs() < 1e-12);
        }
    }
}
