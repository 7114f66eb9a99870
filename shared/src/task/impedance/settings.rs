use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::control::{Impedance, InvalidImpedance};
use crate::model::MAX_CHAIN_JOINTS;

/// How an arm is to behave.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ImpedanceSettings {
    /// How the tool yields.
    pub impedance: Impedance,
    /// How that is brought about.
    pub law: Law,
    /// What becomes of the joint that the tool's pose leaves free.
    pub redundancy: Redundancy,
    /// Bandwidth of the elbow's control [rad/s].
    pub elbow_bandwidth: f32,
    /// Where the force on the tool is known from.
    pub force: ForceSource,
    /// Pushed by more than this, the tool is in contact [N]; by less than two thirds of it no longer. Beyond what may be
    /// felt without a contact.
    pub contact_force: f32,
    /// The tool may be this far from its set-point [m, rad]: farther is a fault, and a set-point farther off is refused.
    pub reach: [f32; 2],
}

impl ImpedanceSettings {
    /// Of an arm that is not controlled yet.
    pub(super) const NONE: Self = Self {
        impedance: Impedance { mass: [1.0; 6], damping: [0.0; 6], stiffness: [0.0; 6] },
        law: Law::Direct,
        redundancy: Redundancy::None,
        elbow_bandwidth: 1.0,
        force: ForceSource::Sensor,
        contact_force: 1.0,
        reach: [0.0; 2],
    };
}

/// Where the force on the tool is known from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceSource {
    /// 0: the force sensor behind the tip.
    Sensor,
    /// 1: the motors' torques, less what the motion needs by the model: a momentum observer (De Luca and Mattone 2005).
    /// Friction and weight that the model does not know look like pushes; what of them there is once the arm has rested for
    /// 0.4 s after it was enabled is left out. Until then there is no force.
    Observer {
        /// Of its filter: 10 to 50 rad/s.
        bandwidth: f32,
    },
}

/// How the impedance is brought about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Law {
    /// 0: as the paper has it: measured state, the acceleration held for a period, no friction compensated.
    Direct,
    /// 1: an ideal arm moves as the impedance says and the real one follows it; in contact the measured state counts.
    ModelFollowing,
}

/// What becomes of the joint that the tool's pose leaves free.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Redundancy {
    /// 0: there is none: six joints. Of seven, the least motion of all.
    None,
    /// 1: of seven joints, one follows [`ElbowSetpoint`](crate::kinematics::ElbowSetpoint) by itself and six take the tool (Arm7, section 2.2: shoulder yaw).
    /// Not the elbow: nothing else takes the wrist nearer to the shoulder.
    DrivenJoint {
        /// Which.
        joint: u8,
    },
    /// 2: the arm angle ([`super::ArmAngle`]) follows [`ElbowSetpoint`](crate::kinematics::ElbowSetpoint) by motions of all seven joints that leave the tool in
    /// peace.
    ArmAngle,
}

/// What is wrong with [`ImpedanceSettings`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InvalidSettings {
    /// 0
    Impedance(InvalidImpedance),
    /// 1: the arm has no such joint.
    Joint {
        /// As given.
        joint: u8,
        /// How many it has.
        joints: u8,
    },
    /// 2: only arms of seven joints have an arm angle.
    NoArmAngle,
    /// 3: the bandwidth of the elbow's control [rad/s].
    ElbowBandwidth {
        /// As given.
        value: f32,
        /// Largest.
        limit: f32,
    },
    /// 4: the contact force must be positive and finite [N].
    ContactForce {
        /// As given.
        value: f32,
    },
    /// 5: the reach must be positive and finite; rotations less than half a turn [m, rad].
    Reach {
        /// As given.
        value: f32,
    },
    /// 6: the bandwidth of the force observer [rad/s].
    ForceBandwidth {
        /// As given.
        value: f32,
        /// Largest.
        limit: f32,
    },
    /// 7: six joints take the tool, and there is no seventh to be driven by itself.
    NoFreeJoint,
}

impl fmt::Display for InvalidSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Impedance(bad) => bad.fmt(f),
            Self::Joint { joint, joints } => {
                write!(
                    f,
                    "joint {joint} is to be driven by itself, but the arm has joints 0 to {}",
                    joints - 1
                )
            }
            Self::NoFreeJoint => {
                f.write_str("a joint can be driven by itself in an arm of seven joints: six take the tool")
            }
            Self::NoArmAngle => f.write_str("only an arm of seven joints has an arm angle"),
            Self::ElbowBandwidth { value, limit } => {
                write!(
                    f,
                    "the bandwidth of the elbow is {value} rad/s; possible is more than 0, and {limit} rad/s at most"
                )
            }
            Self::ForceBandwidth { value, limit } => {
                write!(
                    f,
                    "the bandwidth of the force observer is {value} rad/s; possible is {MIN_FORCE_BANDWIDTH} to {limit} rad/s"
                )
            }
            Self::ContactForce { value } => {
                write!(f, "the contact force is {value} N; it must be positive and finite")
            }
            Self::Reach { value } => {
                write!(
                    f,
                    "the reach is {value}; it must be positive, and less than half a turn for rotations"
                )
            }
        }
    }
}

/// Of the force observer: slower, it would not have settled when it is tared.
const MIN_FORCE_BANDWIDTH: f32 = 10.0;
/// Half of what a control period allows.
const MAX_BANDWIDTH: f32 = 50.0;

impl ImpedanceSettings {
    /// Whether an arm of so many joints can behave like that.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn validate(&self, joints: usize) -> Result<(), InvalidSettings> {
        self.impedance.validate().map_err(InvalidSettings::Impedance)?;
        match self.redundancy {
            Redundancy::None => {}
            Redundancy::DrivenJoint { .. } if joints < MAX_CHAIN_JOINTS => {
                return Err(InvalidSettings::NoFreeJoint);
            }
            Redundancy::DrivenJoint { joint } if usize::from(joint) < joints => {}
            #[expect(clippy::cast_possible_truncation, reason = "at most seven")]
            Redundancy::DrivenJoint { joint } => {
                return Err(InvalidSettings::Joint { joint, joints: joints as u8 });
            }
            Redundancy::ArmAngle if joints == MAX_CHAIN_JOINTS => {}
            Redundancy::ArmAngle => return Err(InvalidSettings::NoArmAngle),
        }
        let value = self.elbow_bandwidth;
        if !(value > 0.0 && value <= MAX_BANDWIDTH) {
            return Err(InvalidSettings::ElbowBandwidth { value, limit: MAX_BANDWIDTH });
        }
        if let ForceSource::Observer { bandwidth: value } = self.force
            && !(MIN_FORCE_BANDWIDTH..=MAX_BANDWIDTH).contains(&value)
        {
            return Err(InvalidSettings::ForceBandwidth { value, limit: MAX_BANDWIDTH });
        }
        let value = self.contact_force;
        if !(value > 0.0 && value.is_finite()) {
            return Err(InvalidSettings::ContactForce { value });
        }
        for (value, most) in self.reach.into_iter().zip([f32::MAX, 3.0]) {
            if !(value > 0.0 && value <= most) {
                return Err(InvalidSettings::Reach { value });
            }
        }
        Ok(())
    }
}
