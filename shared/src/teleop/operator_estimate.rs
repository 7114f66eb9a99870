use core::f32::consts::TAU;

use nalgebra::{SMatrix, SVector};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::follower::Number;
use crate::math;

/// Centre frequency of physiological tremor, 8 to 12 Hz [rad/s].
const TREMOR: f32 = TAU * 10.0;
/// Bandwidth of the tremor: its phase stays correlated for a third of a second [1/s].
const TREMOR_FADES: f32 = 3.0;
/// Initial variances of position, velocity, acceleration and jerk after one sample [m or rad, and s].
const START: [f32; ORDER] = [1e-6, 1e-2, 1.0, 100.0];
/// Place and three derivatives.
const ORDER: usize = 4;
/// And the tremor with its quadrature.
const SIZE: usize = ORDER + 2;
const FACTORIALS: [f32; ORDER] = [1.0, 1.0, 2.0, 6.0];
const COUNT: [f32; 2 * ORDER - 1] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
/// Horizon of the polynomial prediction [s]; beyond it the prediction comes to rest.
const HORIZON: f32 = 0.06;
/// Time constant with which the predicted velocity then decays [s].
const REST_TIME: f32 = 0.08;

/// Prior model of the operator's motion along each axis and of its measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OperatorModel {
    /// How the jerk wanders: in a second by this much [m/s³, rad/s³], and in `t` by `√t` of it. The more, the
    /// sooner a new motion is seen, and the more of the tremor is taken for motion. 0.01 to 10⁴.
    pub jerk_diffusion: f32,
    /// Root mean square of the tremor [m, rad]. A little more than there is does no harm. 10⁻⁶ to 0.1.
    pub tremor: f32,
    /// Standard deviation of a sample [m, rad]: 10⁻⁶ to 0.1.
    pub noise: f32,
}

impl OperatorModel {
    pub(super) const fn numbers(&self) -> [Number; 3] {
        [
            ("jerk diffusion", self.jerk_diffusion, [0.01, 1e4]),
            ("tremor", self.tremor, [1e-6, 0.1]),
            ("noise", self.noise, [1e-6, 0.1]),
        ]
    }
}

/// Predicted motion: position, velocity and acceleration along each axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion<const N: usize> {
    pub place: SVector<f32, N>,
    pub velocity: SVector<f32, N>,
    pub acceleration: SVector<f32, N>,
}

/// What is known of a hand: a Kalman filter whose axes share one covariance, since they are measured at the
/// same times.
///
/// Place, velocity, acceleration and jerk, the latter driven by white noise; and a tremor, an oscillation and
/// its quadrature, that fades and is kept alive by noise. A sample is the sum of place, tremor and noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OperatorEstimate<const N: usize> {
    mean: SMatrix<f32, SIZE, N>,
    covariance: SMatrix<f32, SIZE, SIZE>,
}

impl<const N: usize> OperatorEstimate<N> {
    /// From a first sample, at rest.
    pub fn new(model: &OperatorModel, place: &SVector<f32, N>) -> Self {
        let mut mean = SMatrix::<f32, SIZE, N>::zeros();
        mean.set_row(0, &place.transpose());
        let tremor = model.tremor * model.tremor;
        let mut diagonal = SVector::<f32, SIZE>::repeat(tremor);
        diagonal.iter_mut().zip(START).for_each(|(variance, start)| *variance = start);
        Self { mean, covariance: SMatrix::from_diagonal(&diagonal) }
    }

    /// Time update by `time` [s].
    pub fn advance(&mut self, model: &OperatorModel, time: f32) {
        let fade = math::exp(-TREMOR_FADES * time);
        let (sine, cosine) = math::sin_cos(TREMOR * time);
        let mut transition = SMatrix::<f32, SIZE, SIZE>::identity();
        let mut noise = SMatrix::<f32, SIZE, SIZE>::zeros();
        let mut powers = [1.0; 2 * ORDER];
        (1..powers.len()).for_each(|n| powers[n] = powers[n - 1] * time);
        let q = model.jerk_diffusion * model.jerk_diffusion;
        for row in 0..ORDER {
            for column in row..ORDER {
                transition[(row, column)] = powers[column - row] / FACTORIALS[column - row];
            }
            // White noise, integrated so many times to the one and to the other.
            for column in 0..ORDER {
                let (a, b) = (ORDER - 1 - row, ORDER - 1 - column);
                let power = a + b + 1;
                noise[(row, column)] = q * powers[power] / (FACTORIALS[a] * FACTORIALS[b] * COUNT[a + b]);
            }
        }
        let kept = model.tremor * model.tremor * (1.0 - fade * fade);
        for (row, column, value) in [
            (ORDER, ORDER, cosine),
            (ORDER, ORDER + 1, sine),
            (ORDER + 1, ORDER, -sine),
            (ORDER + 1, ORDER + 1, cosine),
        ] {
            transition[(row, column)] = fade * value;
        }
        noise[(ORDER, ORDER)] = kept;
        noise[(ORDER + 1, ORDER + 1)] = kept;
        self.mean = transition * self.mean;
        self.covariance = transition * self.covariance * transition.transpose() + noise;
    }

    /// Measurement update.
    pub fn correct(&mut self, model: &OperatorModel, sample: &SVector<f32, N>) {
        // What the sample has in common with each part; the sample is place and tremor.
        let common = self.covariance.column(0) + self.covariance.column(ORDER);
        let variance = common[0] + common[ORDER] + model.noise * model.noise;
        let gain = common / variance;
        let missing = sample.transpose() - self.mean.row(0) - self.mean.row(ORDER);
        self.mean += gain * missing;
        self.covariance -= gain * common.transpose();
        // Rounding makes the covariance asymmetric.
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
    }

    /// Returns the estimated position and sets it to 0, as the new origin.
    pub fn rebase(&mut self) -> SVector<f32, N> {
        let place = self.mean.row(0).transpose();
        self.mean.row_mut(0).fill(0.0);
        place
    }

    /// `time` after the last sample [s], without the tremor. It comes to rest when that is long ago.
    pub fn ahead(&self, time: f32) -> Motion<N> {
        let [place, velocity, acceleration, jerk] = [0, 1, 2, 3].map(|row| self.mean.row(row).transpose());
        let near = math::clamp(time, 0.0, HORIZON);
        let place = place + (velocity + (acceleration + jerk * (near / 3.0)) * (near / 2.0)) * near;
        let velocity = velocity + (acceleration + jerk * (near / 2.0)) * near;
        let acceleration = acceleration + jerk * near;
        let late = time - near;
        if late > 0.0 {
            let left = math::exp(-late / REST_TIME);
            return Motion {
                place: place + velocity * (REST_TIME * (1.0 - left)),
                velocity: velocity * left,
                acceleration: velocity * (-left / REST_TIME),
            };
        }
        Motion { place, velocity, acceleration }
    }
}
