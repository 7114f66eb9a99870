use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::tuning::{MAX_BANDWIDTH, MIN_FORCE_BANDWIDTH};
use crate::control::{Impedance, InvalidImpedance, axis_name};
use crate::model::MAX_CHAIN_JOINTS;

/// Settings of the impedance control.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ImpedanceSettings {
    /// Target impedance of the tool.
    pub impedance: Impedance,
    /// Control law that realises it.
    pub law: Law,
    /// Resolution of the redundant degree of freedom.
    pub redundancy: Redundancy,
    /// Bandwidth of the elbow's control [rad/s]: more than 0, at most 50.
    pub elbow_bandwidth: f32,
    /// Source of the external wrench.
    pub force: ForceSource,
    /// Contact begins above this external force and ends below two thirds of it [N]. It must exceed the error
    /// of the force measurement in free space.
    pub contact_force: f32,
    /// Maximum distance and angle of the tool from its set-point [m, rad]. A larger deviation is a fault; a
    /// set-point beyond it, or one of the elbow by more than the angle, is refused.
    pub max_deviation: [f32; 2],
}

impl ImpedanceSettings {
    /// Settings before the first configuration.
    pub(super) const NONE: Self = Self {
        impedance: Impedance::diagonal([1.0; 6], [0.0; 6], [0.0; 6]),
        law: Law::ModelFollowing,
        redundancy: Redundancy::None,
        elbow_bandwidth: 1.0,
        force: ForceSource::Sensor,
        contact_force: 1.0,
        max_deviation: [0.0; 2],
    };
}

/// Source of the external wrench on the tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceSource {
    /// 0: the force sensor behind the tip.
    Sensor,
    /// 1: an estimate from the motor torques: the filtered residual of the inverse dynamics, in continuous
    /// time equal to the momentum observer (De Luca and Mattone 2005). Unmodelled friction and weight appear
    /// as external forces; the estimate tares them once the arm has been at rest for 0.4 s. Until then the
    /// force is 0. The model-following law yields to what exceeds the contact force.
    Observer {
        /// Bandwidth of its filter [rad/s]: 10 to 50.
        bandwidth: f32,
    },
}

/// Control law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Law {
    /// 0: the paper's loop on the measured state, without discretisation.
    Direct(DirectLaw),
    /// 1: the arm tracks a reference arm with the target impedance; during contact the loop uses the measured
    /// state.
    ModelFollowing,
}

/// Options of the law [`Law::Direct`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DirectLaw {
    /// Fraction of the friction at the measured velocity that the torques compensate: 0 to 1. Coulomb
    /// friction is that of the model, corrected by what the joint servo has learnt since the model was
    /// pushed. The paper attributes its errors at velocity reversals to this term (Arm7, section 3.2.1).
    pub friction: f32,
    /// Whether the other joints compensate the acceleration of the driven one: the term `j_yaw θ̈*_yaw`,
    /// which step 4 of the paper omits.
    pub driven_term: bool,
    /// Whether motion in the null space is damped where the elbow has no set-point. The pseudo-inverse alone
    /// (Arm7 eq. 3) does not.
    pub null_space_damping: bool,
}

impl DirectLaw {
    /// As printed.
    pub const PRINTED: Self = Self { friction: 1.0, driven_term: false, null_space_damping: false };
    /// With the terms that the paper omits, and without friction compensation.
    pub const CORRECTED: Self = Self { friction: 0.0, driven_term: true, null_space_damping: true };
}

impl Law {
    /// The options of the direct law; `None` under another.
    pub(super) const fn direct(&self) -> Option<&DirectLaw> {
        match self {
            Self::Direct(options) => Some(options),
            Self::ModelFollowing => None,
        }
    }
}

/// Resolution of the redundant degree of freedom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Redundancy {
    /// 0: none. Seven joints then have the minimum-norm solution (the pseudo-inverse, Arm7 eq. 3), with
    /// damped null-space motion unless [`DirectLaw`] says otherwise.
    None,
    /// 1: one of seven joints follows [`ElbowSetpoint`](crate::kinematics::ElbowSetpoint), the other six move
    /// the tool (Arm7, section 2.2: shoulder yaw). Not the elbow joint: no other joint changes the distance
    /// from wrist to shoulder.
    DrivenJoint {
        /// Index of the driven joint.
        joint: u8,
    },
    /// 2: the arm angle ([`super::ArmAngle`]) follows [`ElbowSetpoint`](crate::kinematics::ElbowSetpoint) by
    /// null-space motion of all seven joints.
    ArmAngle,
}

/// Why [`ImpedanceSettings`] are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InvalidImpedanceSettings {
    /// 0: the target impedance.
    Impedance(InvalidImpedance),
    /// 1: the arm has no such joint.
    Joint {
        /// Index of the driven joint.
        joint: u8,
        /// Number of joints of the arm.
        joints: u8,
    },
    /// 2: only an arm of seven joints has an arm angle.
    NoArmAngle,
    /// 3: the bandwidth of the elbow's control [rad/s].
    ElbowBandwidth {
        /// The value.
        value: f32,
        /// Maximum.
        limit: f32,
    },
    /// 4: the contact force must be positive and finite [N].
    ContactForce {
        /// The value.
        value: f32,
    },
    /// 5: the maximum deviation must be positive and finite, at most 3 rad for the rotation [m, rad].
    MaxDeviation {
        /// The value.
        value: f32,
    },
    /// 6: the bandwidth of the force observer [rad/s].
    ForceBandwidth {
        /// The value.
        value: f32,
        /// Maximum.
        limit: f32,
    },
    /// 7: a driven joint needs an arm of seven joints: the pose of the tool requires six.
    NoRedundantJoint,
    /// 8: the fraction of the friction that the direct law compensates.
    Friction {
        /// The value.
        value: f32,
    },
    /// 9: the mass of the impedance along an axis is far below the arm's own mass [kg].
    MassInContact {
        /// 0 to 2: along x, y, z.
        axis: u8,
        /// The value.
        value: f32,
        /// The arm's own mass in its posture.
        own: f32,
        /// Minimum.
        limit: f32,
    },
}

impl fmt::Display for InvalidImpedanceSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Impedance(bad) => bad.fmt(f),
            Self::Joint { joint, joints } => {
                write!(f, "the driven joint is {joint}; the arm has joints 0 to {}", joints - 1)
            }
            Self::Friction { value } => {
                write!(f, "the compensated fraction of the friction is {value}; it must be from 0 to 1")
            }
            Self::MassInContact { axis, value, own, limit } => {
                let axis = axis_name(*axis);
                write!(
                    f,
                    "the mass along {axis} is {value} kg and the arm's own there {own} kg: it would chatter on a stiff \
                     surface; take at least {limit} kg"
                )
            }
            Self::NoRedundantJoint => f.write_str("a driven joint needs an arm of seven joints"),
            Self::NoArmAngle => f.write_str("only an arm of seven joints has an arm angle"),
            Self::ElbowBandwidth { value, limit } => {
                write!(
                    f,
                    "the elbow bandwidth is {value} rad/s; it must be more than 0 and at most {limit} rad/s"
                )
            }
            Self::ForceBandwidth { value, limit } => {
                write!(
                    f,
                    "the bandwidth of the force observer is {value} rad/s; it must be between {MIN_FORCE_BANDWIDTH} and \
                     {limit} rad/s"
                )
            }
            Self::ContactForce { value } => {
                write!(f, "the contact force is {value} N; it must be positive and finite")
            }
            Self::MaxDeviation { value } => write!(
                f,
                "the maximum deviation is {value}; it must be positive, at most {MAX_DISTANCE} m and {MAX_ROTATION} rad"
            ),
        }
    }
}

impl core::error::Error for InvalidImpedanceSettings {}

/// Largest deviation [m]: about the length of an arm. From farther away, a spring would throw the tool.
const MAX_DISTANCE: f32 = 1.0;
/// Maximum rotation from the set-point [rad]; near π the rotation vector is ambiguous.
const MAX_ROTATION: f32 = 3.0;

impl ImpedanceSettings {
    /// Checks the settings for an arm of `joints` joints.
    ///
    /// # Errors
    /// The first invalid setting.
    pub fn validate(&self, joints: usize) -> Result<(), InvalidImpedanceSettings> {
        self.impedance.validate().map_err(InvalidImpedanceSettings::Impedance)?;
        match self.redundancy {
            Redundancy::None => {}
            Redundancy::DrivenJoint { .. } if joints < MAX_CHAIN_JOINTS => {
                return Err(InvalidImpedanceSettings::NoRedundantJoint);
            }
            Redundancy::DrivenJoint { joint } if usize::from(joint) < joints => {}
            #[expect(clippy::cast_possible_truncation, reason = "at most seven")]
            Redundancy::DrivenJoint { joint } => {
                return Err(InvalidImpedanceSettings::Joint { joint, joints: joints as u8 });
            }
            Redundancy::ArmAngle if joints == MAX_CHAIN_JOINTS => {}
            Redundancy::ArmAngle => return Err(InvalidImpedanceSettings::NoArmAngle),
        }
        if let Law::Direct(DirectLaw { friction: value, .. }) = self.law
            && !(0.0..=1.0).contains(&value)
        {
            return Err(InvalidImpedanceSettings::Friction { value });
        }
        let value = self.elbow_bandwidth;
        if !(value > 0.0 && value <= MAX_BANDWIDTH) {
            return Err(InvalidImpedanceSettings::ElbowBandwidth { value, limit: MAX_BANDWIDTH });
        }
        if let ForceSource::Observer { bandwidth: value } = self.force
            && !(MIN_FORCE_BANDWIDTH..=MAX_BANDWIDTH).contains(&value)
        {
            return Err(InvalidImpedanceSettings::ForceBandwidth { value, limit: MAX_BANDWIDTH });
        }
        let value = self.contact_force;
        if !(value > 0.0 && value.is_finite()) {
            return Err(InvalidImpedanceSettings::ContactForce { value });
        }
        for (value, max) in self.max_deviation.into_iter().zip([MAX_DISTANCE, MAX_ROTATION]) {
            if !(value > 0.0 && value <= max) {
                return Err(InvalidImpedanceSettings::MaxDeviation { value });
            }
        }
        Ok(())
    }
}
