use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Why a model was refused: which joint, which field, which value.
///
/// The board knows the joint by its number; [`ModelError::joint`] indexes [`super::RobotModel::joints`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ModelError {
    /// Index of the joint; for a field of a chain or of a joint without motor, that of the last joint of the
    /// chain that has a motor; `None` for a field of the whole robot.
    pub joint: Option<u8>,
    /// The field.
    pub field: Field,
    /// Its value, in SI units; for a name, the index of its joint or chain, and for [`Field::Gauges`] that of
    /// their chain.
    pub value: f32,
    /// What is wrong with it.
    pub problem: Problem,
}

/// A field of the model. The position in this list is the number on the wire: add at the end, never reorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(missing_docs, reason = "the names are those of the model's fields")]
pub enum Field {
    Joints,
    Chains,
    Gravity,
    Name,
    OriginTranslation,
    OriginRotation,
    Axis,
    Mass,
    CenterOfMass,
    Inertia,
    RotorInertia,
    TorqueConstant,
    CurrentLimit,
    CurrentResolution,
    MotorBandwidth,
    MotorDelay,
    Coulomb,
    Viscous,
    CountsPerTurn,
    LimitLower,
    LimitUpper,
    LimitVelocity,
    LimitTorque,
    LimitTorqueRate,
    LimitFollowingError,
    FilterTime,
    Proportional,
    Integral,
    Derivative,
    Cutoff,
    ServoInertia,
    Bandwidth,
    ObserverBandwidth,
    CommandTimeout,
    Damping,
    SupplyMin,
    SupplyMax,
    RestError,
    ChainName,
    TipTranslation,
    TipRotation,
    ForceResolution,
    TorqueResolution,
    Saturation,
    ForceLimit,
    TipMass,
    TipCenterOfMass,
    TipRadius,
    MimicJoint,
    MimicMultiplier,
    MimicOffset,
    MimicForceSensor,
    EncoderRelative,
    MotorResistance,
    MotorInductance,
    MimicChain,
    MimicPlace,
    Gauges,
    CalibrationMatrix,
    GaugeRange,
    GaugeGains,
}

impl Field {
    /// The field's path as users write it in `controller.toml` or know it from the URDF.
    pub const fn path(self) -> &'static str {
        match self {
            Self::Joints => "joints",
            Self::Chains => "chains",
            Self::Gravity => "gravity",
            Self::Name => "name",
            Self::OriginTranslation => "origin xyz",
            Self::OriginRotation => "origin rpy",
            Self::Axis => "axis",
            Self::Mass => "inertial mass",
            Self::CenterOfMass => "inertial origin xyz",
            Self::Inertia => "inertial inertia",
            Self::RotorInertia => "motor.rotor_inertia",
            Self::TorqueConstant => "motor.torque_constant",
            Self::CurrentLimit => "motor.current_limit",
            Self::CurrentResolution => "motor.current_resolution",
            Self::MotorBandwidth => "motor.bandwidth",
            Self::MotorDelay => "motor.delay",
            Self::Coulomb => "friction.coulomb",
            Self::Viscous => "friction.viscous",
            Self::CountsPerTurn => "encoder.counts_per_turn",
            Self::LimitLower => "limits.lower",
            Self::LimitUpper => "limits.upper",
            Self::LimitVelocity => "limits.velocity",
            Self::LimitTorque => "limits.torque",
            Self::LimitTorqueRate => "limits.torque_rate",
            Self::LimitFollowingError => "limits.following_error",
            Self::FilterTime => "servo.filter_time",
            Self::Proportional => "servo.pid.proportional",
            Self::Integral => "servo.pid.integral",
            Self::Derivative => "servo.pid.derivative",
            Self::Cutoff => "servo.pid.cutoff",
            Self::ServoInertia => "servo.observer.inertia",
            Self::Bandwidth => "servo.observer.bandwidth",
            Self::ObserverBandwidth => "servo.observer.observer_bandwidth",
            Self::CommandTimeout => "safety.command_timeout",
            Self::Damping => "safety.damping",
            Self::SupplyMin => "safety.supply_min",
            Self::SupplyMax => "safety.supply_max",
            Self::RestError => "servo.rest_error",
            Self::ChainName => "name of the tip",
            Self::TipTranslation => "tip xyz",
            Self::TipRotation => "tip rpy",
            Self::ForceResolution => "force_sensor.force_resolution",
            Self::TorqueResolution => "force_sensor.torque_resolution",
            Self::Saturation => "force_sensor.saturation",
            Self::ForceLimit => "force_sensor.force_limit",
            Self::TipMass => "mass of the tip",
            Self::TipCenterOfMass => "centre of mass of the tip",
            Self::TipRadius => "radius of the tip",
            Self::MimicJoint => "mimic joint",
            Self::MimicMultiplier => "mimic multiplier",
            Self::MimicOffset => "mimic offset",
            Self::MimicForceSensor => "force_sensor of a chain with a mimic joint",
            Self::EncoderRelative => "encoder.relative",
            Self::MotorResistance => "motor.resistance",
            Self::MotorInductance => "motor.inductance",
            Self::MimicChain => "chain of a mimic joint",
            Self::MimicPlace => "place of a mimic joint in its chain",
            Self::Gauges => "force_sensor.gauges",
            Self::CalibrationMatrix => "force_sensor.gauges.calibration_matrix",
            Self::GaugeRange => "range of force_sensor.gauges.calibration_matrix",
            Self::GaugeGains => "force_sensor.gauges.gains",
        }
    }
}

/// What is wrong with a field. The position in this list is the number on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Problem {
    /// 0: NaN or infinite.
    NotFinite,
    /// 1: below the limit given.
    Below(f32),
    /// 2: not above the limit given.
    NotAbove(f32),
    /// 3: above the limit given.
    Above(f32),
    /// 4: not a unit vector or unit quaternion; the value is its length.
    NotUnit,
    /// 5: no mass distribution has this inertia: a principal moment is negative, or larger than the sum of
    /// the other two. The value is the smallest principal moment, or half of the sum of two minus the third.
    NotPhysical,
    /// 6: a wrong number of elements; the limit given is the expected number.
    Count(f32),
    /// 7: empty, or the same as another's.
    NotUnique,
    /// 8: not a joint of the robot.
    NoSuchJoint,
    /// 9: impossible, or not supported.
    NotSupported,
    /// 10: more than this board has or can bear; the limit given.
    BoardLimit(f32),
    /// 11: not given, and this board needs it.
    Missing,
    /// 12: a row of a matrix is linearly dependent on the others, or nearly; the value is its independent
    /// part after columns and rows are scaled to length 1.
    Singular,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "is not a finite number"),
            Self::Below(limit) => write!(f, "is below {limit}"),
            Self::NotAbove(limit) => write!(f, "must be above {limit}"),
            Self::Above(limit) => write!(f, "is above {limit}"),
            Self::NotUnit => write!(f, "is the length of what must be a unit vector"),
            Self::NotPhysical => {
                write!(f, "is the margin by which no mass distribution can have this inertia tensor")
            }
            Self::Count(expected) => write!(f, "does not fit: {expected} expected"),
            Self::NotUnique => write!(f, "must be a name of its own, without control characters"),
            Self::NoSuchJoint => write!(f, "must be a joint with a motor"),
            Self::NotSupported => write!(f, "is not supported"),
            Self::Singular => {
                write!(f, "is the part of a row that does not depend on the others: it must be 0.01 at least")
            }
            Self::Missing => write!(f, "is not given: this board cannot do without"),
            Self::BoardLimit(limit) => write!(f, "is more than this board can do: {limit}"),
        }
    }
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(joint) = self.joint {
            write!(f, "joint {joint}: ")?;
        }
        if self.problem == Problem::Missing {
            return write!(f, "{} {}", self.field.path(), self.problem);
        }
        write!(f, "{} = {} {}", self.field.path(), self.value, self.problem)
    }
}

impl core::error::Error for ModelError {}
