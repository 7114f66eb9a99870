//! Amplifier, motor and sensors of a joint.

use core::f64::consts::TAU;

use super::current_loop::Lag;
use super::factors::JointFactors;
use super::tree::Body;
use super::values::{Drive, PlantOptions, PlantValues};
use crate::purpose::Purpose;

/// Largest magnitude of a relative encoder's count at power-on.
const POWER_ON_COUNTS: f64 = 1e6;

/// Rate at which the deflection follows the torque: about the natural frequency of a light arm [rad/s].
const DEFLECTION_RATE: f64 = 60.0;

/// A joint's drive and sensors.
#[derive(Clone, Debug)]
pub struct DriveState {
    pub joint: String,
    /// Torque constant assumed by amplifier and controller, and the true one [N·m/A].
    nominal_constant: f64,
    torque_constant: f64,
    /// Largest nominal torque of the amplifier [N·m].
    effort: f64,
    /// Current loop; its output is the nominal torque: current times `nominal_constant`.
    lag: Lag,
    current_resolution: f64,
    counts_per_radian: f64,
    /// Count at angle 0.
    zero: i32,
    /// Homed angle minus true angle [rad].
    pub homing_error: f64,
    /// End stops of the joint [rad].
    pub stops: Option<[f64; 2]>,
    /// Compliance of the joint [rad/(N·m)], and its present deflection: angle of the motor minus angle of the
    /// link [rad].
    compliance: f64,
    deflection: f64,
    /// Part of the homing error that an absolute encoder's count contains [rad].
    encoder_error: f64,
}

/// Creates the states of a plant's drives, in their order.
pub fn states(
    drives: &[Drive],
    bodies: &[Body],
    drive_of: &[usize],
    factors: &[JointFactors],
    values: &PlantValues,
    options: &PlantOptions,
) -> Vec<DriveState> {
    let mut homing = Purpose::Homing.rng(options.seed);
    let mut power_on = Purpose::PowerOn.rng(options.seed);
    let effort = |index: usize| {
        let body = drive_of.iter().position(|&drive| drive == index).and_then(|body| bodies.get(body));
        // A URDF without an effort limit states 0.
        body.map(|body| body.effort).filter(|&effort| effort > 0.0).unwrap_or(f64::INFINITY)
    };
    let stops = |index: usize| {
        let body = drive_of.iter().position(|&drive| drive == index).and_then(|body| bodies.get(body));
        body.and_then(|body| body.stops)
    };
    let make = |(index, (drive, factors)): (usize, (&Drive, &JointFactors))| {
        let (motor, encoder) = (&drive.motor, &drive.encoder);
        let constant = f64::from(motor.torque_constant);
        let homing_error = values.mismatch.homing_error * homing.symmetric();
        let homing_error = if options.ideal_sensors { 0.0 } else { homing_error };
        let offset = round(POWER_ON_COUNTS * power_on.symmetric());
        let scale = f64::from(encoder.counts_per_turn) / TAU;
        DriveState {
            joint: drive.joint.clone(),
            nominal_constant: constant,
            torque_constant: constant * factors.torque_constant,
            effort: effort(index),
            lag: Lag::new(&values.inner_loop),
            current_resolution: f64::from(motor.current_resolution),
            counts_per_radian: if encoder.reversed { -scale } else { scale },
            zero: if encoder.relative { offset } else { encoder.zero },
            homing_error,
            stops: stops(index),
            compliance: values.elasticity.get(&drive.joint).map_or(0.0, |stiffness| 1.0 / stiffness),
            deflection: 0.0,
            encoder_error: if encoder.relative { 0.0 } else { homing_error },
        }
    };
    drives.iter().zip(factors).enumerate().map(make).collect()
}

impl DriveState {
    /// Sets the torque constant that the amplifier assumes [N·m/A].
    pub const fn set_nominal_constant(&mut self, torque_constant: f64) {
        self.nominal_constant = torque_constant;
    }

    /// Commands a torque, which takes effect after `delay` [s].
    pub fn command(&mut self, torque: f64, delay: f64) {
        self.lag.set(torque.clamp(-self.effort, self.effort), delay);
    }

    /// Advances by `time` and returns the mean torque at the joint [N·m].
    pub fn advance(&mut self, time: f64) -> f64 {
        let torque = self.lag.advance(time) * self.torque_constant / self.nominal_constant;
        if self.compliance > 0.0 {
            let target = torque * self.compliance;
            self.deflection += (target - self.deflection) * (1.0 - libm::exp(-DEFLECTION_RATE * time));
        }
        torque
    }

    /// Returns the torque at the joint, `time` from now [N·m].
    pub fn torque(&self, time: f64) -> f64 {
        self.lag.ahead(time) * self.torque_constant / self.nominal_constant
    }

    /// Angle of the motor minus angle of the link [rad].
    pub const fn deflection(&self) -> f64 {
        self.deflection
    }

    /// Returns the encoder's count at a joint angle.
    pub fn encoder_count(&self, position: f64) -> i32 {
        self.zero
            .wrapping_add(round((position + self.deflection + self.encoder_error) * self.counts_per_radian))
    }

    /// Returns the current sensor's count, `time` from now, with `noise` [A].
    pub fn current_count(&self, time: f64, noise: f64) -> i16 {
        let current = self.lag.ahead(time) / self.nominal_constant + noise;
        #[expect(clippy::cast_possible_truncation, reason = "saturates, as a sensor does")]
        let count = libm::round(current / self.current_resolution) as i16;
        count
    }
}

#[expect(clippy::cast_possible_truncation, reason = "saturates, as a counter that is read in time does not")]
fn round(value: f64) -> i32 {
    libm::round(value) as i32
}
