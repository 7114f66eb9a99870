use core::f32::consts::TAU;

use nalgebra::{SMatrix, SVector};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::follower::Setting;
use crate::math;

/// Centre frequency of physiological tremor, 8 to 12 Hz [rad/s].
const TREMOR: f32 = TAU * 10.0;
/// Bandwidth of the tremor [1/s]: a correlation time of a third of a second.
const TREMOR_BANDWIDTH: f32 = 3.0;
/// Initial variances of velocity, acceleration and jerk [m or rad, and s].
const INITIAL_VARIANCES: [f32; ORDER - 1] = [1e-2, 1.0, 100.0];
/// Position and three derivatives.
const ORDER: usize = 4;
/// Number of states, with the tremor and its quadrature.
const SIZE: usize = ORDER + 2;
const FACTORIALS: [f32; ORDER] = [1.0, 1.0, 2.0, 6.0];
const INTEGERS: [f32; 2 * ORDER - 1] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
/// Horizon of the polynomial prediction [s]; beyond it the prediction comes to rest.
const HORIZON: f32 = 0.06;
/// Time constant with which the predicted velocity then decays [s].
const REST_TIME: f32 = 0.08;

/// Prior model of the operator's motion along each axis and of its measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OperatorModel {
    /// Diffusion of the jerk: its standard deviation after one second [m/s³, rad/s³]; after `t` seconds it is
    /// `√t` times that. A larger one detects a new motion sooner and follows more of the tremor. 0.01 to 10⁴.
    pub jerk_diffusion: f32,
    /// Root mean square of the tremor [m, rad]; better too large than too small. 10⁻⁶ to 0.1.
    pub tremor: f32,
    /// Standard deviation of a sample [m, rad]: 10⁻⁶ to 0.1.
    pub noise: f32,
}

impl OperatorModel {
    pub(super) const fn settings(&self) -> [Setting; 3] {
        [
            ("jerk diffusion", self.jerk_diffusion, [0.01, 1e4]),
            ("tremor", self.tremor, [1e-6, 0.1]),
            ("noise", self.noise, [1e-6, 0.1]),
        ]
    }
}

/// Predicted motion: position, velocity and acceleration along each axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct PredictedMotion<const N: usize> {
    pub position: SVector<f32, N>,
    pub velocity: SVector<f32, N>,
    pub acceleration: SVector<f32, N>,
}

/// Kalman filter of the operator's motion. The axes share one covariance, because they are measured at the
/// same times.
///
/// States: position, velocity, acceleration and jerk, driven by white noise; and the tremor, a damped
/// oscillation with its quadrature, driven by white noise. A sample is the sum of position, tremor and noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OperatorEstimate<const N: usize> {
    mean: SMatrix<f32, SIZE, N>,
    covariance: SMatrix<f32, SIZE, SIZE>,
}

impl<const N: usize> OperatorEstimate<N> {
    /// The estimate after a first sample: at rest.
    pub fn new(model: &OperatorModel, position: &SVector<f32, N>) -> Self {
        let mut mean = SMatrix::<f32, SIZE, N>::zeros();
        mean.set_row(0, &position.transpose());
        let tremor = model.tremor * model.tremor;
        let mut diagonal = SVector::<f32, SIZE>::repeat(tremor);
        // Nothing was known of the position before: it is the sample minus tremor and noise.
        diagonal[0] += model.noise * model.noise;
        diagonal.iter_mut().skip(1).zip(INITIAL_VARIANCES).for_each(|(variance, value)| *variance = value);
        let mut covariance = SMatrix::from_diagonal(&diagonal);
        (covariance[(0, ORDER)], covariance[(ORDER, 0)]) = (-tremor, -tremor);
        Self { mean, covariance }
    }

    /// Time update by `time` [s].
    pub fn advance(&mut self, model: &OperatorModel, time: f32) {
        let decay = math::exp(-TREMOR_BANDWIDTH * time);
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
            // Covariance of white noise after a and b integrations.
            for column in 0..ORDER {
                let (a, b) = (ORDER - 1 - row, ORDER - 1 - column);
                let power = a + b + 1;
                noise[(row, column)] = q * powers[power] / (FACTORIALS[a] * FACTORIALS[b] * INTEGERS[a + b]);
            }
        }
        let tremor_noise = model.tremor * model.tremor * (1.0 - decay * decay);
        for (row, column, value) in [
            (ORDER, ORDER, cosine),
            (ORDER, ORDER + 1, sine),
            (ORDER + 1, ORDER, -sine),
            (ORDER + 1, ORDER + 1, cosine),
        ] {
            transition[(row, column)] = decay * value;
        }
        noise[(ORDER, ORDER)] = tremor_noise;
        noise[(ORDER + 1, ORDER + 1)] = tremor_noise;
        self.mean = transition * self.mean;
        self.covariance = transition * self.covariance * transition.transpose() + noise;
    }

    /// Measurement update.
    pub fn correct(&mut self, model: &OperatorModel, sample: &SVector<f32, N>) {
        // Covariance of the state with the sample, which is position plus tremor.
        let common = self.covariance.column(0) + self.covariance.column(ORDER);
        let variance = common[0] + common[ORDER] + model.noise * model.noise;
        let gain = common / variance;
        let innovation = sample.transpose() - self.mean.row(0) - self.mean.row(ORDER);
        self.mean += gain * innovation;
        self.covariance -= gain * common.transpose();
        // Rounding makes the covariance asymmetric.
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
    }

    /// Returns the estimated position and sets it to 0, as the new origin.
    pub fn rebase(&mut self) -> SVector<f32, N> {
        let position = self.mean.row(0).transpose();
        self.mean.row_mut(0).fill(0.0);
        position
    }

    /// Predicts the motion `time` after the last sample [s], without tremor. Beyond the horizon it comes to
    /// rest.
    pub fn predict(&self, time: f32) -> PredictedMotion<N> {
        let [position, velocity, acceleration, jerk] = [0, 1, 2, 3].map(|row| self.mean.row(row).transpose());
        let near = math::clamp(time, 0.0, HORIZON);
        let position = position + (velocity + (acceleration + jerk * (near / 3.0)) * (near / 2.0)) * near;
        let velocity = velocity + (acceleration + jerk * (near / 2.0)) * near;
        let acceleration = acceleration + jerk * near;
        let late = time - near;
        if late > 0.0 {
            let decay = math::exp(-late / REST_TIME);
            return PredictedMotion {
                position: position + velocity * (REST_TIME * (1.0 - decay)),
                velocity: velocity * decay,
                acceleration: velocity * (-decay / REST_TIME),
            };
        }
        PredictedMotion { position, velocity, acceleration }
    }
}
