use nalgebra::Matrix3;

use super::{
    Encoder, Field, ForceSensor, Friction, Inertial, JointLimits, JointModel, MAX_CHAIN_JOINTS, ModelError,
    Motor, Problem, RobotModel, Safety, ServoGains,
};
use crate::TICK;
use crate::math::{self, abs};

/// How far a unit vector's length may be from 1.
const UNIT_TOLERANCE: f32 = 1e-3;

impl RobotModel {
    /// Checks every field.
    ///
    /// # Errors
    /// The first thing that is wrong, by joint and field, with its value and the limit that it breaks.
    pub fn validate(&self) -> Result<(), ModelError> {
        let robot = Check { joint: None };
        robot.all_finite(Field::Gravity, &self.gravity)?;
        if self.joints.is_empty() {
            return Err(robot.error(Field::Joints, 0.0, Problem::Below(1.0)));
        }
        let mut in_chains = 0;
        for chain in &self.chains {
            let joints = f32::from(chain.joints);
            robot.at_least(Field::Chains, joints, 1.0)?;
            #[expect(clippy::cast_precision_loss, reason = "a small constant")]
            robot.at_most(Field::Chains, joints, MAX_CHAIN_JOINTS as f32)?;
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
            last.all_finite(Field::TipTranslation, &chain.tip.translation)?;
            last.unit(Field::TipRotation, &chain.tip.rotation)?;
            last.at_least(Field::TipRadius, chain.tip_radius, 0.0)?;
            if let Some(sensor) = &chain.force_sensor {
                sensor.validate(last)?;
            }
            let others = self.chains.iter().take(index);
            if chain.name.is_empty() || others.into_iter().any(|other| other.name == chain.name) {
                #[expect(clippy::cast_precision_loss, reason = "at most 6")]
                return Err(last.error(Field::ChainName, index as f32, Problem::NotUnique));
            }
        }
        self.safety.validate()?;
        for (index, joint) in self.joints.iter().enumerate() {
            #[expect(clippy::cast_possible_truncation, reason = "at most 16 joints")]
            let check = Check { joint: Some(index as u8) };
            let others = self.joints.iter().take(index);
            if joint.name.is_empty() || others.into_iter().any(|other| other.name == joint.name) {
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

impl JointModel {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.all_finite(Field::OriginTranslation, &self.origin.translation)?;
        check.unit(Field::OriginRotation, &self.origin.rotation)?;
        check.unit(Field::Axis, &self.axis)?;
        self.link.validate(check)?;
        self.motor.validate(check)?;
        self.friction.validate(check)?;
        self.encoder.validate(check)?;
        self.limits.validate(check)?;
        self.servo.validate(check)
    }
}

impl Inertial {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.at_least(Field::Mass, self.mass, 0.0)?;
        check.all_finite(Field::CenterOfMass, &self.center_of_mass)?;
        check.all_finite(Field::Inertia, &self.inertia)?;
        let [ixx, iyy, izz, ixy, ixz, iyz] = self.inertia;
        let tensor = Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
        // Half the trace minus each principal moment is a second moment of mass, and none can be negative.
        let moments = tensor.symmetric_eigenvalues();
        let margin = tensor.trace() / 2.0 - moments.max();
        let worst = moments.min().min(margin);
        if worst < -1e-3 * abs(tensor.trace()) - 1e-12 {
            return Err(check.error(Field::Inertia, worst, Problem::NotPhysical));
        }
        Ok(())
    }
}

impl ForceSensor {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.above(Field::ForceResolution, self.force_resolution, 0.0)?;
        check.above(Field::TorqueResolution, self.torque_resolution, 0.0)?;
        #[expect(clippy::cast_precision_loss, reason = "a figure for people")]
        check.above(Field::Saturation, self.saturation as f32, 0.0)?;
        check.above(Field::ForceLimit, self.force_limit, 0.0)?;
        check.at_least(Field::TipMass, self.mass, 0.0)?;
        check.all_finite(Field::TipCenterOfMass, &self.center_of_mass)
    }
}

impl Motor {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.at_least(Field::RotorInertia, self.rotor_inertia, 0.0)?;
        check.above(Field::TorqueConstant, self.torque_constant, 0.0)?;
        check.above(Field::CurrentLimit, self.current_limit, 0.0)?;
        check.above(Field::CurrentResolution, self.current_resolution, 0.0)?;
        check.above(Field::MotorBandwidth, self.bandwidth, 0.0)?;
        check.at_least(Field::MotorDelay, self.delay, 0.0)?;
        check.at_most(Field::MotorDelay, self.delay, TICK)
    }
}

impl Friction {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.at_least(Field::Coulomb, self.coulomb, 0.0)?;
        check.at_least(Field::Viscous, self.viscous, 0.0)
    }
}

impl Encoder {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.at_least(Field::CountsPerTurn, self.counts_per_turn, 1.0)
    }
}

impl JointLimits {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.finite(Field::LimitLower, self.lower)?;
        check.above(Field::LimitUpper, self.upper, self.lower)?;
        check.above(Field::LimitVelocity, self.velocity, 0.0)?;
        check.above(Field::LimitTorque, self.torque, 0.0)?;
        check.above(Field::LimitTorqueRate, self.torque_rate, 0.0)?;
        check.above(Field::LimitFollowingError, self.following_error, 0.0)
    }
}

impl ServoGains {
    fn validate(&self, check: Check) -> Result<(), ModelError> {
        check.at_least(Field::FilterTime, self.filter_time, TICK)?;
        check.at_least(Field::Proportional, self.pid.proportional, 0.0)?;
        check.at_least(Field::Integral, self.pid.integral, 0.0)?;
        check.at_least(Field::Derivative, self.pid.derivative, 0.0)?;
        check.above(Field::Cutoff, self.pid.cutoff, 0.0)?;
        check.above(Field::ServoInertia, self.observer.inertia, 0.0)?;
        check.above(Field::Bandwidth, self.observer.bandwidth, 0.0)?;
        check.above(Field::ObserverBandwidth, self.observer.observer_bandwidth, 0.0)?;
        check.at_least(Field::RestError, self.rest_error, 0.0)
    }
}

impl Safety {
    fn validate(&self) -> Result<(), ModelError> {
        let check = Check { joint: None };
        check.at_least(Field::CommandTimeout, self.command_timeout, TICK)?;
        check.at_least(Field::Damping, self.damping, 0.0)?;
        check.at_least(Field::SupplyMin, self.supply_min, 0.0)?;
        check.above(Field::SupplyMax, self.supply_max, self.supply_min)
    }
}

/// Makes errors that know their joint.
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

    fn all_finite(self, field: Field, values: &[f32]) -> Result<(), ModelError> {
        values.iter().try_for_each(|&value| self.finite(field, value))
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
        self.all_finite(field, vector)?;
        let length = math::sqrt(vector.iter().map(|x| x * x).sum());
        if length.is_nan() || abs(length - 1.0) > UNIT_TOLERANCE {
            return Err(self.error(field, length, Problem::NotUnit));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::joint as test_joint;

    fn refused(mass: f32, inertia: [f32; 6]) -> Option<ModelError> {
        let joint =
            JointModel { link: Inertial { mass, center_of_mass: [0.0; 3], inertia }, ..test_joint("elbow") };
        joint.validate(Check { joint: Some(4) }).err()
    }

    #[test]
    fn masses_that_no_body_has_are_refused_with_joint_field_and_margin() {
        let expect = |error: Option<ModelError>, field: Field, problem: Problem, value: f32| {
            let error = error.unwrap_or_else(|| panic!("{field:?} {problem:?}: accepted"));
            assert_eq!((error.joint, error.field, error.problem), (Some(4), field, problem));
            assert!((error.value - value).abs() < 1e-6, "{error}");
        };
        let rod = [1e-4, 2e-3, 2e-3, 0.0, 0.0, 0.0];
        expect(refused(-0.5, rod), Field::Mass, Problem::Below(0.0), -0.5);
        // A negative principal moment: on the diagonal, and only off it.
        let negative = [-1e-3, 2e-3, 2e-3, 0.0, 0.0, 0.0];
        expect(refused(0.5, negative), Field::Inertia, Problem::NotPhysical, -1e-3);
        // xy = 3e-3: principal moments 2e-3 and 2e-3 ± 3e-3; half the trace less the largest is −2e-3.
        let indefinite = [2e-3, 2e-3, 2e-3, 3e-3, 0.0, 0.0];
        expect(refused(0.5, indefinite), Field::Inertia, Problem::NotPhysical, -2e-3);
        // The triangle inequality: 9e-3 is more than 2e-3 + 2e-3, by 5e-3; the margin is half of that.
        let triangle = [9e-3, 2e-3, 2e-3, 0.0, 0.0, 0.0];
        expect(refused(0.5, triangle), Field::Inertia, Problem::NotPhysical, -2.5e-3);
        for value in [f32::NAN, f32::INFINITY] {
            let error =
                refused(0.5, [value, 2e-3, 2e-3, 0.0, 0.0, 0.0]).map(|error| (error.field, error.problem));
            assert_eq!(error, Some((Field::Inertia, Problem::NotFinite)));
        }
    }

    #[test]
    fn rods_plates_points_and_cut_digits_are_bodies() {
        let plate = [1e-3, 1e-3, 2e-3, 0.0, 0.0, 0.0];
        let cut = [1e-3, 1e-3, 2.001e-3, 0.0, 0.0, 0.0];
        for inertia in [plate, cut, [0.0, 1e-3, 1e-3, 0.0, 0.0, 0.0], [0.0; 6]] {
            assert_eq!(refused(0.5, inertia), None, "{inertia:?}");
        }
    }
}
