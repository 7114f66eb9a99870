use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::PerFinger;
use crate::control::ServoMode;

/// A grasp: contacts, forces and control.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct GraspPlan {
    /// Expected contacts of the fingers.
    pub contacts: PerFinger<PlannedContact>,
    /// A fingertip searches for the surface from this distance in front of its contact to the same distance
    /// behind it [m].
    pub clearance: f32,
    /// Normal force that counts as contact [N].
    pub touch_force: f32,
    /// Coefficient of friction; `None`: the hand probes it by sliding two fingers.
    pub friction: Option<f32>,
    /// Form and strength of the internal forces.
    pub internal: InternalForce,
    /// Maximum normal force of a fingertip [N].
    pub force_limit: f32,
    /// Whether the force sensors correct the internal forces.
    pub feedback: bool,
    /// Control of the object's pose.
    pub control: ObjectControl,
    /// Estimate of the object's pose.
    pub object_frame: ObjectFrame,
    /// Source of the load on the fingers.
    pub load: LoadSource,
    /// Joint angles of [`ObjectControl::Differential`].
    pub joint_targets: JointTargets,
}

/// The contact of a finger, as planned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PlannedContact {
    /// A point of the surface, in the base frame [m].
    pub position: [f32; 3],
    /// Normal of the surface there, into the object; of any length.
    pub normal: [f32; 3],
}

/// Form of the internal forces.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum InternalForce {
    /// 0: the smallest forces that hold the load ([`LeastGrip`](crate::grasp::LeastGrip)).
    LeastGrip {
        /// Fraction of the friction that stays unused.
        margin: f32,
        /// Minimum tangential capacity of each contact while the object is held at rest [N]: the normal force
        /// is at least this over the coefficient of friction. It allows for loads that grow faster than the
        /// grip, and for force errors due to the joints' friction.
        capacity_at_rest: f32,
        /// The same while the object moves [N].
        capacity_in_motion: f32,
    },
    /// 1: along the normals, with one degree of freedom (Hand3 section 5.3).
    Normal {
        /// The largest of the normal forces [N].
        strength: f32,
    },
    /// 2: along the lines between the contacts, with three degrees of freedom (Hand3 eq. 18).
    Pairwise {
        /// Forces of the pairs of contacts 2 and 3, 1 and 3, 1 and 2 [N].
        strengths: [f32; 3],
    },
}

/// Control of an object's pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum ObjectControl {
    /// 0: the joint servos follow the object's motion, mapped to the joints (Hand3 eq. 21 to 25).
    Differential(ServoMode),
    /// 1: proportional-integral control of the pose commands the wrench on the object, and the joints are
    /// damped (Hand3 eq. 19, 20).
    Wrench(WrenchGains),
}

/// Estimate of an object's pose from the fingertips' triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum ObjectFrame {
    /// 0: corrected for round tips that roll on the object.
    #[default]
    Rolling,
    /// 1: the frame of the triangle itself (Hand3 section 5.1), as if the tips were points of the object.
    Triangle,
}

/// Source of the load on the fingers, `F_o` of (Hand3 eq. 19).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub enum LoadSource {
    /// 0: the force sensors.
    #[default]
    Measured,
    /// 1: the weight of a known mass at the origin of the object frame. The least grip and the search for a
    /// support still use the sensors.
    Constant {
        /// [kg]
        mass: f32,
    },
}

/// Computation of the joint angles under [`ObjectControl::Differential`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum JointTargets {
    /// 0: closed-form inverse kinematics of the fingertips' positions, without drift.
    #[default]
    ClosedForm,
    /// 1: sum of their changes in each tick (Hand3 eq. 23 to 25).
    Accumulated,
}

/// Gains of [`ObjectControl::Wrench`]. If all are 0, the joint torques balance only the contact forces,
/// `τ = (D_F J_F)ᵀ f_c` (Hand3 eq. 16, section 6.1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct WrenchGains {
    /// Proportional and integral gain of the position [N/m, N/(m·s)].
    pub position: [f32; 2],
    /// Proportional and integral gain of the orientation [N·m/rad, N·m/(rad·s)].
    pub orientation: [f32; 2],
    /// Damping of the joints [N·m·s/rad].
    pub damping: f32,
    /// Whether gravity and friction of the fingers are compensated; in the paper they are not.
    pub compensated: bool,
}

/// Command of a supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum GraspCommand {
    /// 0: approach, touch, grasp and hold.
    Grasp(GraspPlan),
    /// 1: move the object to a pose relative to that at the grasp.
    Move {
        /// Translation of the object frame's origin, in base axes [m].
        translation: [f32; 3],
        /// Rotation vector about the object frame's origin, in base axes [rad].
        rotation: [f32; 3],
        /// Duration of the motion [s].
        duration: f32,
    },
    /// 2: lower the object until a support carries it, then open.
    PutDown,
    /// 3: open at once; during the approach: draw back by `clearance`.
    Open,
}

/// Why a plan is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InvalidPlan {
    /// 0: a value is outside its range.
    Value {
        /// The field.
        field: PlanField,
        /// Its value.
        value: f32,
        /// Lower bound.
        lower: f32,
        /// Upper bound.
        upper: f32,
    },
    /// 1: the position or the normal of a contact is not finite, or the normal is 0.
    Contact {
        /// The finger, 0 to 2.
        finger: u8,
    },
    /// 2: contacts coincide or are collinear.
    NoTriangle,
    /// 3: no forces of the planned form inside the friction cones balance each other: the contacts do not
    /// oppose each other, or the strengths between pairs of them press across the normals.
    CannotGrip,
    /// 4: forces along the normals do not balance.
    Unbalanced {
        /// Residual wrench over the forces.
        residual: f32,
    },
}

/// A field of a [`GraspPlan`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PlanField {
    /// 0
    Clearance,
    /// 1
    TouchForce,
    /// 2
    Friction,
    /// 3
    ForceLimit,
    /// 4
    Margin,
    /// 5
    Capacity,
    /// 6
    Strength,
    /// 7
    Gain,
    /// 8
    Mass,
}

impl PlanField {
    /// Its name and unit.
    const fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Clearance => ("clearance", "m"),
            Self::TouchForce => ("touch force", "N"),
            Self::Friction => ("coefficient of friction", ""),
            Self::ForceLimit => ("force limit", "N"),
            Self::Margin => ("friction margin", ""),
            Self::Capacity => ("minimum tangential capacity", "N"),
            Self::Strength => ("internal force", "N"),
            Self::Gain => ("gain", ""),
            Self::Mass => ("mass of the object", "kg"),
        }
    }
}

impl GraspPlan {
    /// Whether the internal forces are open loop: the joint servos control positions, without force feedback.
    pub(super) const fn only_feeds_forward(&self) -> bool {
        !self.feedback && matches!(self.control, ObjectControl::Differential(_))
    }
}

impl fmt::Display for InvalidPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Value { field, value, lower, upper } => {
                let (name, unit) = field.name();
                let space = if unit.is_empty() { "" } else { " " };
                write!(f, "the {name} is {value}{space}{unit}; the range is {lower} to {upper}{space}{unit}")
            }
            Self::Contact { finger } => {
                write!(
                    f,
                    "the contact of finger {}: its position or normal is not finite, or its normal is 0",
                    finger + 1
                )
            }
            Self::NoTriangle => {
                write!(f, "the contacts coincide or are collinear: place them on a triangle")
            }
            Self::CannotGrip => write!(
                f,
                "no contact forces of this form inside the friction cones balance each other: the normals \
                 must oppose each other, and pairwise forces press along them: set those between fingers at \
                 the same side to 0, or choose another internal force"
            ),
            Self::Unbalanced { residual } => write!(
                f,
                "forces along the normals do not balance, the residual is {residual} of the forces: place \
                 finger 3 opposite fingers 1 and 2, or choose another internal force"
            ),
        }
    }
}

impl core::error::Error for InvalidPlan {}
