use core::fmt;

use nalgebra::Quaternion;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::control::{Impedance, InvalidImpedance};
use crate::model::MAX_CHAIN_JOINTS;
use crate::{TICK, math};

/// How an arm is to behave.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ArmSettings {
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

/// Where the force on the tool is known from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceSource {
    /// 0: the force sensor behind the tip.
    Sensor,
    /// 1: the motors' torques, less what the motion needs by the model: a momentum observer (De Luca and Mattone 2005).
    /// Friction and weight that the model does not know look like pushes; what of them there is once the arm has rested for
    /// 0.4 s after arming is left out. Until then there is no force.
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
    Printed,
    /// 1: an ideal arm moves as the impedance says and the real one follows it; in contact the measured state counts.
    Following,
}

/// What becomes of the joint that the tool's pose leaves free.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Redundancy {
    /// 0: there is none: six joints. Of seven, the least motion of all.
    None,
    /// 1: of seven joints, one follows [`ElbowPoint`] by itself and six take the tool (Arm7, section 2.2: shoulder yaw).
    /// Not the elbow: nothing else takes the wrist nearer to the shoulder.
    Driven {
        /// Which.
        joint: u8,
    },
    /// 2: the arm angle ([`super::ArmAngle`]) follows [`ElbowPoint`] by motions of all seven joints that leave the tool in
    /// peace.
    ArmAngle,
}

/// Where the tool should be, how fast, and how that changes. In the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PosePoint {
    /// Position [m].
    pub position: [f32; 3],
    /// Orientation as a unit quaternion, `[x, y, z, w]`.
    pub rotation: [f32; 4],
    /// `[v; ω]` [m/s, rad/s].
    pub velocity: [f32; 6],
    /// Its derivative [m/s², rad/s²].
    pub acceleration: [f32; 6],
}

/// Where the elbow should be: angle of the driven joint, or the arm angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ElbowPoint {
    /// [rad]
    pub angle: f32,
    /// [rad/s]
    pub velocity: f32,
    /// [rad/s²]
    pub acceleration: f32,
}

/// Share of its velocity that a set-point keeps in a period without a new one: it comes to rest within some 0.2 s.
const COAST: f32 = 0.8;

impl PosePoint {
    /// A control period later without a new one.
    #[must_use]
    pub(super) fn coasted(&self) -> Self {
        let mut next = Self { acceleration: [0.0; 6], ..*self };
        let [vx, vy, vz, wx, wy, wz] = self.velocity;
        next.position.iter_mut().zip([vx, vy, vz]).for_each(|(place, speed)| *place += speed * TICK);
        if [wx, wy, wz].iter().any(|rate| *rate != 0.0) {
            // Half the way as a quaternion; a period's turn is small, and what the norm loses is given back.
            let [x, y, z, w] = self.rotation;
            let turn = Quaternion::new(0.0, wx, wy, wz) * Quaternion::new(w, x, y, z) * (0.5 * TICK);
            let turned = Quaternion::new(w, x, y, z) + turn;
            let scale = 1.0 / math::sqrt(turned.norm_squared());
            next.rotation = (turned * scale).coords.into();
        }
        next.velocity.iter_mut().for_each(|speed| *speed *= COAST);
        next
    }

    /// Where it is a control period later, its acceleration included.
    #[must_use]
    pub(super) fn ahead(&self) -> Self {
        let mut faster = *self;
        let speeds = faster.velocity.iter_mut().zip(&self.acceleration);
        speeds.for_each(|(speed, acceleration)| *speed += acceleration * TICK);
        faster.coasted()
    }
}

impl ElbowPoint {
    /// A control period later without a new one.
    #[must_use]
    pub(super) const fn coasted(&self) -> Self {
        Self { angle: self.angle + self.velocity * TICK, velocity: COAST * self.velocity, acceleration: 0.0 }
    }
}

/// What is wrong with [`ArmSettings`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BadSettings {
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

impl fmt::Display for BadSettings {
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
                    "the bandwidth of the force observer is {value} rad/s; possible is {LEAST_FORCE_BANDWIDTH} to {limit} rad/s"
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
const LEAST_FORCE_BANDWIDTH: f32 = 10.0;
/// Half of what a control period allows.
const MOST_BANDWIDTH: f32 = 50.0;

impl ArmSettings {
    /// Whether an arm of so many joints can behave like that.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn validate(&self, joints: usize) -> Result<(), BadSettings> {
        self.impedance.validate().map_err(BadSettings::Impedance)?;
        match self.redundancy {
            Redundancy::None => {}
            Redundancy::Driven { .. } if joints < MAX_CHAIN_JOINTS => return Err(BadSettings::NoFreeJoint),
            Redundancy::Driven { joint } if usize::from(joint) < joints => {}
            #[expect(clippy::cast_possible_truncation, reason = "at most seven")]
            Redundancy::Driven { joint } => return Err(BadSettings::Joint { joint, joints: joints as u8 }),
            Redundancy::ArmAngle if joints == MAX_CHAIN_JOINTS => {}
            Redundancy::ArmAngle => return Err(BadSettings::NoArmAngle),
        }
        let value = self.elbow_bandwidth;
        if !(value > 0.0 && value <= MOST_BANDWIDTH) {
            return Err(BadSettings::ElbowBandwidth { value, limit: MOST_BANDWIDTH });
        }
        if let ForceSource::Observer { bandwidth: value } = self.force
            && !(LEAST_FORCE_BANDWIDTH..=MOST_BANDWIDTH).contains(&value)
        {
            return Err(BadSettings::ForceBandwidth { value, limit: MOST_BANDWIDTH });
        }
        let value = self.contact_force;
        if !(value > 0.0 && value.is_finite()) {
            return Err(BadSettings::ContactForce { value });
        }
        for (value, most) in self.reach.into_iter().zip([f32::MAX, 3.0]) {
            if !(value > 0.0 && value <= most) {
                return Err(BadSettings::Reach { value });
            }
        }
        Ok(())
    }
}
