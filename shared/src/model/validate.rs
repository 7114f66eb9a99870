use core::f32::consts::TAU;

use super::{
    Encoder, Field, ForceSensor, Friction, GAUGE_END, GAUGES, Gauges, Inertial, JointLimits, JointModel,
    MAX_CHAIN_JOINTS, MimicJoint, ModelError, Motor, Problem, RobotModel, Safety, ServoGains,
};
use crate::TICK;
use crate::math::{self, abs};

/// An apparent velocity above this multiple of the velocity limit is an encoder error.
pub(crate) const JUMP_FACTOR: f32 = 2.0;
/// Tolerance of the current check: overshoot of the current loop and error of the current sensor.
pub(crate) const CURRENT_MARGIN: f32 = 1.25;

/// Smallest value, in SI units, of a quantity that must be positive.
const SMALLEST: f32 = 1e-12;
/// Tolerance of the length of a unit quaternion, which is normalised before use.
const UNIT_TOLERANCE: f32 = 1e-3;
/// Tolerance of the length of an axis, which is used as it is.
pub(crate) const AXIS_TOLERANCE: f32 = 1e-5;

// Physical bounds that no robot exceeds.

/// Upper bound of the acceleration of gravity [m/s²]: ten times that of the earth.
const MAX_GRAVITY: f32 = 100.0;
/// Upper bound of lengths [m].
const MAX_LENGTH: f32 = 100.0;
/// Upper bound of masses [kg] and inertias [kg·m²].
const MAX_INERTIA: f32 = 1e4;
/// Upper bound of torques [N·m], forces [N], their derivatives and coefficients, and gains.
const MAX_EFFORT: f32 = 1e6;
/// Upper bound of torque rates [N·m/s]: the largest torque within a tick.
const MAX_TORQUE_RATE: f32 = MAX_EFFORT / TICK;
/// Upper bound of joint angles [rad]: 160 turns. Beyond it single precision is coarser than an encoder.
const MAX_ANGLE: f32 = 1000.0;
/// Upper bound of the ratio of a mimic joint.
const MAX_MULTIPLIER: f32 = 100.0;
/// Upper bound of joint velocities [rad/s]: a quarter turn per tick. A faster motion cannot be distinguished
/// from a jump.
const MAX_VELOCITY: f32 = core::f32::consts::FRAC_PI_2 / TICK;
/// Upper bound of differences between angle and reference [rad].
const MAX_ERROR: f32 = core::f32::consts::PI;
/// Upper bound of bandwidths [rad/s]: half the control frequency.
const MAX_BANDWIDTH: f32 = core::f32::consts::PI / TICK;
/// Upper bound of the bandwidth of a current loop [Hz].
const MAX_MOTOR_BANDWIDTH: f32 = 1e5;
/// Upper bound of the resistance of a winding [Ω].
const MAX_RESISTANCE: f32 = 1e3;
/// Upper bound of the inductance of a winding [H].
const MAX_INDUCTANCE: f32 = 1.0;
/// Upper bound of encoder counts per turn: an `i32` then holds two turns in each direction.
const MAX_COUNTS: f32 = 1e9;
/// Upper bound of the time without a command [s].
const MAX_TIMEOUT: f32 = 10.0;
/// Upper bound of the time constant of the trajectory filter [s].
const MAX_FILTER_TIME: f32 = 100.0;
/// Upper bound of the gain in front of a gauge's converter.
const MAX_GAIN: f32 = 128.0;
/// Upper bound of the range of the gauges, as a multiple of the force limit. A matrix for volts exceeds it a
/// million times.
const MAX_GAUGE_RANGE: f32 = 1e4;
/// Minimum linearly independent part of each normalised row of the calibration matrix. Below it, an error of
/// one per cent in a gauge would be as large as the wrench.
const MIN_INDEPENDENCE: f32 = 0.01;
/// Upper bound of the supply limit [V]: a sensor frame can report at most 65.535 V, which must be a fault.
const MAX_SUPPLY: f32 = 65.534;
/// Upper bound of the current limit [counts]: a sensor frame can report at most 32 767, which must be a
/// fault.
const MAX_CURRENT_COUNT: f32 = 32_766.0;
/// Upper bound of the counts of an angle from 0: half of the range of an `i32`. Beyond it the sign of an
/// angle would be ambiguous.
const MAX_ANGLE_COUNTS: f32 = 65_536.0 * 32_768.0;

/// Whether this names a joint or a tip, and does nothing to a terminal that shows it.
fn is_name(name: &str) -> bool {
    !name.is_empty() && !name.chars().any(char::is_control)
}

impl RobotModel {
    /// Checks every field.
    ///
    /// # Errors
    /// The first invalid field and its joint, with the value and the violated limit.
    pub fn validate(&self) -> Result<(), ModelError> {
        let robot = Check { joint: None };
        robot.all_within(Field::Gravity, &self.gravity, MAX_GRAVITY)?;
        if self.name.chars().any(char::is_control) {
            return Err(robot.error(Field::Name, 0.0, Problem::NotUnique));
        }
        if self.joints.is_empty() {
            return Err(robot.error(Field::Joints, 0.0, Problem::Below(1.0)));
        }
        let mut in_chains = 0;
        for (index, chain) in self.chains.iter().enumerate() {
            let joints = f32::from(chain.joints);
            robot.at_least(Field::Chains, joints, 1.0)?;
            #[expect(clippy::cast_precision_loss, reason = "at most 10")]
            let mimics = self.mimics_of(index).count() as f32;
            #[expect(clippy::cast_precision_loss, reason = "a small constant")]
            robot.at_most(Field::Chains, joints + mimics, MAX_CHAIN_JOINTS as f32)?;
            in_chains += usize::from(chain.joints);
        }
        if in_chains != self.joints.len() {
            #[expect(clippy::cast_precision_loss, reason = "at most 16 and 42")]
            let (got, expected) = (in_chains as f32, self.joints.len() as f32);
            return Err(robot.error(Field::Chains, got, Problem::Count(expected)));
        }
        let mut end = 0;
        for (index, chain) in self.chains.iter().enumerate() {
            end += usize::from(chain.joints);
            #[expect(clippy::cast_possible_truncation, reason = "at most 16")]
            let last = Check { joint: Some(end as u8 - 1) };
            last.all_within(Field::TipTranslation, &chain.tip.translation, MAX_LENGTH)?;
            last.unit(Field::TipRotation, &chain.tip.rotation)?;
            last.within(Field::TipRadius, chain.tip_radius, 0.0, MAX_LENGTH)?;
            if let Some(sensor) = &chain.force_sensor {
                sensor.validate(last)?;
            }
            if let Some(gauges) = self.gauges_of(index) {
                let gauges_error = |problem| last.error(Field::Gauges, f32::from(gauges.chain), problem);
                let sensor = chain.force_sensor.as_ref().ok_or(gauges_error(Problem::NotSupported))?;
                gauges.validate(last, sensor.force_limit)?;
            }
            let all = usize::from(chain.joints) + self.mimics_of(index).count();
            for mimic in self.mimics_of(index) {
                mimic.validate(last, self.joints.len())?;
                let same = self.mimics_of(index).filter(|other| other.place == mimic.place).count();
                if usize::from(mimic.place) >= all || same > 1 {
                    return Err(last.error(Field::MimicPlace, f32::from(mimic.place), Problem::NotSupported));
                }
                if let Some(sensor) = &chain.force_sensor {
                    return Err(last.error(
                        Field::MimicForceSensor,
                        sensor.force_resolution,
                        Problem::NotSupported,
                    ));
                }
            }
            let others = self.chains.iter().take(index);
            if !is_name(&chain.name) || others.into_iter().any(|other| other.name == chain.name) {
                #[expect(clippy::cast_precision_loss, reason = "at most 6")]
                return Err(last.error(Field::ChainName, index as f32, Problem::NotUnique));
            }
        }
        if let Some(stray) = self.mimics.iter().find(|mimic| usize::from(mimic.chain) >= self.chains.len()) {
            return Err(robot.error(Field::MimicChain, f32::from(stray.chain), Problem::NotSupported));
        }
        let stray = self.gauges.filter(|gauges| usize::from(gauges.chain) >= self.chains.len());
        if let Some(Gauges { chain, .. }) = stray {
            return Err(robot.error(Field::Gauges, f32::from(chain), Problem::NotSupported));
        }
        self.safety.validate()?;
        for (index, joint) in self.joints.iter().enumerate() {
            #[expect(clippy::cast_possible_truncation, reason = "at most 16 joints")]
            let check = Check { joint: Some(index as u8) };
            let others = self.joints.iter().take(index);
            if !is_name(&joint.name) || others.into_iter().any(|other| other.name == joint.name) {
                return Err(check.error(
                    Field::Name,
                    f32::from(check.joint.unwrap_or(0)),
                    Problem::NotUnique,
                ));
            }
            joint.validate(check)?;
        }
        Ok(())
    }
}

impl MimicJoint {
    /// `joints`: number of joints of the robot.
    fn validate(&self, check: Check, joints: usize) -> Result<(), ModelError> {
        if usize::from(self.joint) >= joints {
            return Err(check.error(Field::MimicJoint, f32::from(self.joint), Problem::NoSuchJoint));
        }
        check.within(Field::MimicMultiplier, self.multiplier, -MAX_MULTIPLIER, MAX_MULTIPLIER)?;
        if self.multiplier == 0.0 {
            return Err(check.error(Field::MimicMultiplier, 0.0, Problem::NotSupported));
        }
        check.within(Field::MimicOffset, self.offset, -MAX_ANGLE, MAX_ANGLE)?;
        check.all_within(Field::OriginTranslation, &self.origin.translation, MAX_LENGTH)?;
        check.unit(Field::OriginRotation, &self.origin.rotation)?;
        check.unit(Field::Axis, &self.axis)?;
        self.link.validate(check)
    }
}

impl JointModel {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.all_within(Field::OriginTranslation, &self.origin.translation, MAX_LENGTH)?;
        check.unit(Field::OriginRotation, &self.origin.rotation)?;
        check.unit(Field::Axis, &self.axis)?;
        self.link.validate(check)?;
        self.motor.validate(check)?;
        self.friction.validate(check)?;
        self.encoder.validate(check)?;
        self.limits.validate(check)?;
        self.encoder.validate_range(check, &self.limits)?;
        self.servo.validate(check)
    }
}

impl Inertial {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.within(Field::Mass, self.mass, 0.0, MAX_INERTIA)?;
        check.all_within(Field::CenterOfMass, &self.center_of_mass, MAX_LENGTH)?;
        check.all_within(Field::Inertia, &self.inertia, MAX_INERTIA)?;
        let mut tensor = self.tensor();
        let trace = tensor.trace();
        // Half the trace minus each principal moment is a second moment of mass, and none can be negative.
        math::diagonalize(&mut tensor);
        let moments = tensor.diagonal();
        let worst = moments.min().min(trace / 2.0 - moments.max());
        if worst < -1e-3 * abs(trace) - 1e-12 {
            return Err(check.error(Field::Inertia, worst, Problem::NotPhysical));
        }
        Ok(())
    }
}

impl ForceSensor {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.positive(Field::ForceResolution, self.force_resolution, MAX_EFFORT)?;
        check.positive(Field::TorqueResolution, self.torque_resolution, MAX_EFFORT)?;
        #[expect(clippy::cast_precision_loss, reason = "a figure for people")]
        check.above(Field::Saturation, self.saturation as f32, 0.0)?;
        check.positive(Field::ForceLimit, self.force_limit, MAX_EFFORT)?;
        check.within(Field::TipMass, self.mass, 0.0, MAX_INERTIA)?;
        check.all_within(Field::TipCenterOfMass, &self.center_of_mass, MAX_LENGTH)
    }
}

impl Gauges {
    fn validate(&self, check: Check, force_limit: f32) -> Result<(), ModelError> {
        for row in &self.calibration_matrix {
            check.all_within(Field::CalibrationMatrix, row, MAX_EFFORT)?;
        }
        let independence = independence(&self.calibration_matrix);
        if independence < MIN_INDEPENDENCE {
            return Err(check.error(Field::CalibrationMatrix, independence, Problem::Singular));
        }
        // A force limit above the range of all gauges together could never trip.
        for row in self.calibration_matrix.iter().take(3) {
            let range = GAUGE_END * row.iter().map(|value| abs(*value)).sum::<f32>();
            check.within(Field::GaugeRange, range, force_limit, MAX_GAUGE_RANGE * force_limit)?;
        }
        for gain in self.gains {
            check.within(Field::GaugeGains, f32::from(gain), 1.0, MAX_GAIN)?;
            if !gain.is_power_of_two() {
                return Err(check.error(Field::GaugeGains, f32::from(gain), Problem::NotSupported));
            }
        }
        Ok(())
    }
}

/// The smallest part of a row that is orthogonal to the rows before it, after columns and rows are scaled to
/// length 1 (newtons and newton metres, gauges with different gains): the smallest magnitude on the diagonal
/// of R in the QR decomposition, by the modified Gram–Schmidt method. 0 for a singular matrix.
fn independence(matrix: &[[f32; GAUGES]; 6]) -> f32 {
    let mut rows = *matrix;
    for column in 0..GAUGES {
        let mut values = rows.map(|row| row.get(column).copied().unwrap_or(0.0));
        if normalize(&mut values) == 0.0 {
            return 0.0;
        }
        for (row, value) in rows.iter_mut().zip(values) {
            row.iter_mut().skip(column).take(1).for_each(|place| *place = value);
        }
    }
    for row in &mut rows {
        normalize(row);
    }
    let mut smallest = 1.0_f32;
    let mut rest = &mut rows[..];
    while let Some((first, others)) = rest.split_first_mut() {
        smallest = smallest.min(normalize(first));
        for other in &mut *others {
            let along: f32 = first.iter().zip(&*other).map(|(a, b)| a * b).sum();
            other.iter_mut().zip(&*first).for_each(|(value, unit)| *value -= along * unit);
        }
        rest = others;
    }
    smallest
}

/// Scales a vector to length 1, unless it is 0. Returns its previous length.
fn normalize(vector: &mut [f32; GAUGES]) -> f32 {
    // Scaled first: squares of tiny values would underflow to 0.
    let scale = vector.iter().fold(0.0_f32, |max, value| max.max(abs(*value)));
    if scale == 0.0 {
        return 0.0;
    }
    vector.iter_mut().for_each(|value| *value /= scale);
    let length = math::sqrt(vector.iter().map(|value| value * value).sum());
    vector.iter_mut().for_each(|value| *value /= length);
    length * scale
}

impl Motor {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.within(Field::RotorInertia, self.rotor_inertia, 0.0, MAX_INERTIA)?;
        check.positive(Field::TorqueConstant, self.torque_constant, MAX_EFFORT)?;
        check.positive(Field::CurrentLimit, self.current_limit, MAX_EFFORT)?;
        check.positive(Field::CurrentResolution, self.current_resolution, MAX_EFFORT)?;
        let max_shown = MAX_CURRENT_COUNT / CURRENT_MARGIN * self.current_resolution;
        check.at_most(Field::CurrentLimit, self.current_limit, max_shown)?;
        check.positive(Field::MotorBandwidth, self.bandwidth, MAX_MOTOR_BANDWIDTH)?;
        check.within(Field::MotorDelay, self.delay, 0.0, TICK)?;
        if let Some(resistance) = self.resistance {
            check.positive(Field::MotorResistance, resistance, MAX_RESISTANCE)?;
        }
        if let Some(inductance) = self.inductance {
            check.positive(Field::MotorInductance, inductance, MAX_INDUCTANCE)?;
        }
        Ok(())
    }
}

impl Friction {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.within(Field::Coulomb, self.coulomb, 0.0, MAX_EFFORT)?;
        check.within(Field::Viscous, self.viscous, 0.0, MAX_EFFORT)
    }
}

impl Encoder {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.within(Field::CountsPerTurn, self.counts_per_turn, 1.0, MAX_COUNTS)
    }

    /// Checks that every angle up to the fault limit, and one tick beyond, has a unique count.
    fn validate_range(&self, check: Check, limits: &JointLimits) -> Result<(), ModelError> {
        let beyond = limits.following_error + JUMP_FACTOR * limits.velocity * TICK;
        let largest = abs(limits.lower).max(abs(limits.upper)) + beyond;
        check.at_most(Field::CountsPerTurn, self.counts_per_turn, MAX_ANGLE_COUNTS * TAU / largest)
    }
}

impl JointLimits {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.within(Field::LimitLower, self.lower, -MAX_ANGLE, MAX_ANGLE)?;
        check.above(Field::LimitUpper, self.upper, self.lower)?;
        check.at_most(Field::LimitUpper, self.upper, MAX_ANGLE)?;
        check.positive(Field::LimitVelocity, self.velocity, MAX_VELOCITY)?;
        check.positive(Field::LimitTorque, self.torque, MAX_EFFORT)?;
        check.positive(Field::LimitTorqueRate, self.torque_rate, MAX_TORQUE_RATE)?;
        check.positive(Field::LimitFollowingError, self.following_error, MAX_ERROR)
    }
}

impl ServoGains {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.within(Field::FilterTime, self.filter_time, TICK, MAX_FILTER_TIME)?;
        check.within(Field::Proportional, self.pid.proportional, 0.0, MAX_EFFORT)?;
        check.within(Field::Integral, self.pid.integral, 0.0, MAX_EFFORT)?;
        check.within(Field::Derivative, self.pid.derivative, 0.0, MAX_EFFORT)?;
        check.positive(Field::Cutoff, self.pid.cutoff, MAX_BANDWIDTH)?;
        check.positive(Field::ServoInertia, self.observer.inertia, MAX_INERTIA)?;
        check.positive(Field::Bandwidth, self.observer.bandwidth, MAX_BANDWIDTH)?;
        check.positive(Field::ObserverBandwidth, self.observer.observer_bandwidth, MAX_BANDWIDTH)?;
        check.within(Field::RestError, self.rest_error, 0.0, MAX_ERROR)
    }
}

impl Safety {
    fn validate(&self) -> Result<(), ModelError> {
        let check = Check { joint: None };
        check.within(Field::CommandTimeout, self.command_timeout, TICK, MAX_TIMEOUT)?;
        check.within(Field::Damping, self.damping, 0.0, MAX_EFFORT)?;
        check.at_least(Field::SupplyMin, self.supply_min, 0.0)?;
        check.above(Field::SupplyMax, self.supply_max, self.supply_min)?;
        check.at_most(Field::SupplyMax, self.supply_max, MAX_SUPPLY)
    }
}

/// Checks fields of one joint, or of the whole robot, and creates the errors.
#[derive(Clone, Copy)]
struct Check {
    joint: Option<u8>,
}

impl Check {
    const fn error(self, field: Field, value: f32, problem: Problem) -> ModelError {
        ModelError { joint: self.joint, field, value, problem }
    }

    fn finite(self, field: Field, value: f32) -> Result<(), ModelError> {
        if value.is_finite() { Ok(()) } else { Err(self.error(field, value, Problem::NotFinite)) }
    }

    /// Checks that all values are within ±`max`.
    fn all_within(self, field: Field, values: &[f32], max: f32) -> Result<(), ModelError> {
        values.iter().try_for_each(|&value| self.within(field, value, -max, max))
    }

    #[inline(never)]
    fn within(self, field: Field, value: f32, min: f32, max: f32) -> Result<(), ModelError> {
        let problem = if !value.is_finite() {
            Problem::NotFinite
        } else if value < min {
            Problem::Below(min)
        } else if value > max {
            Problem::Above(max)
        } else {
            return Ok(());
        };
        Err(self.error(field, value, problem))
    }

    /// Checks that the value is positive, and large enough that its reciprocal is finite.
    #[inline(never)]
    fn positive(self, field: Field, value: f32, max: f32) -> Result<(), ModelError> {
        self.above(field, value, 0.0)?;
        self.at_least(field, value, SMALLEST)?;
        self.at_most(field, value, max)
    }

    fn at_least(self, field: Field, value: f32, limit: f32) -> Result<(), ModelError> {
        self.finite(field, value)?;
        if value < limit { Err(self.error(field, value, Problem::Below(limit))) } else { Ok(()) }
    }

    fn above(self, field: Field, value: f32, limit: f32) -> Result<(), ModelError> {
        self.finite(field, value)?;
        if value <= limit { Err(self.error(field, value, Problem::NotAbove(limit))) } else { Ok(()) }
    }

    fn at_most(self, field: Field, value: f32, limit: f32) -> Result<(), ModelError> {
        self.finite(field, value)?;
        if value > limit { Err(self.error(field, value, Problem::Above(limit))) } else { Ok(()) }
    }

    fn unit(self, field: Field, vector: &[f32]) -> Result<(), ModelError> {
        self.all_within(field, vector, 2.0)?;
        let length = math::sqrt(vector.iter().map(|x| x * x).sum());
        let tolerance = if field == Field::Axis { AXIS_TOLERANCE } else { UNIT_TOLERANCE };
        if abs(length - 1.0) > tolerance {
            return Err(self.error(field, length, Problem::NotUnit));
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "validate_tests.rs"]
mod tests;
