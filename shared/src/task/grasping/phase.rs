use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::tuning::MAX_MOVE_TIME;
use super::{InvalidPlan, PerFinger};
use crate::robot::{Concerns, LimitRefusal};

/// Phase of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Phase {
    /// 0: no object; the fingers are at rest.
    Ready,
    /// 1: the fingertips move to positions in front of the contacts.
    Approach,
    /// 2: they move along the normals until they touch.
    Touch,
    /// 3: the internal forces rise to those of the plan.
    Squeeze,
    /// 4: fingers 1 and 2 press towards each other until one slides, which gives the coefficient of friction.
    ProbeFriction,
    /// 5: the object is held at rest.
    Hold,
    /// 6: the object is moved.
    Move,
    /// 7: the object is lowered until a support carries it.
    Lower,
    /// 8: the internal forces fall, then the fingertips move back.
    Open,
}

/// Failure that is not a fault: the hand has opened, or holds the object as before.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Failure {
    /// 0: a finger met an obstacle on its path to the object. The fingers stop where they are.
    Obstructed {
        /// The finger, 0 to 2.
        finger: u8,
        /// Force on its tip [N].
        force: f32,
    },
    /// 1: a finger found no surface where the object should be. The hand opens.
    NoObject {
        /// The finger, 0 to 2.
        finger: u8,
        /// Distance along which it searched [m].
        distance: f32,
    },
    /// 2: the internal forces did not converge in time. The hand opens.
    NoGrip {
        /// The smallest normal force [N].
        force: f32,
        /// The time [s].
        limit: f32,
    },
    /// 3: no support was found below the object. The hand holds it there.
    NoSupport {
        /// Distance by which it was lowered [m].
        distance: f32,
    },
    /// 4: a fingertip cannot reach its set-point. An object is held at its present pose; before that the
    /// hand opens. Without an object, and at the end of an opening, the fingers stop.
    OutOfReach {
        /// The finger, 0 to 2.
        finger: u8,
    },
}

/// Fault: the object is lost, or has moved in the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GraspFault {
    /// A contact is lost.
    ContactLost {
        /// The finger, 0 to 2.
        finger: u8,
        /// Its normal force [N].
        force: f32,
        /// Minimum normal force [N].
        limit: f32,
    },
    /// The distances between the fingertips changed: the object slid or rotated between them.
    Deformed {
        /// Largest change [m].
        distance: f32,
        /// Its limit [m].
        limit: f32,
    },
    /// The object is away from its target: an external force moved it.
    Displaced {
        /// Its distance from the target [m].
        distance: f32,
        /// Its limit [m].
        limit: f32,
    },
    /// The fingertips are collinear and define no object frame.
    NoFrame,
}

impl fmt::Display for GraspFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ContactLost { finger, force, limit } => {
                write!(f, "finger {} presses on the object with {force} N, less than {limit} N", finger + 1)
            }
            Self::Deformed { distance, limit } => {
                write!(f, "the distances between the fingertips changed by {distance} m, more than {limit} m")
            }
            Self::Displaced { distance, limit } => {
                write!(f, "the object is {distance} m from its target, more than {limit} m")
            }
            Self::NoFrame => f.write_str("the fingertips are collinear and define no object frame"),
        }
    }
}

impl core::error::Error for GraspFault {}

/// Why a command is refused; the state is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GraspRefusal {
    /// 0: the robot is not a hand of three fingers with three joints and a force sensor each.
    NotAHand,
    /// 1: the force sensor of the chain was not tared since power-on, `Home` or the commit of the model.
    NotTared {
        /// The chain.
        chain: u8,
    },
    /// 2: not possible in this phase.
    Busy(Phase),
    /// 3: the plan is not valid.
    Plan(InvalidPlan),
    /// 4: a fingertip cannot reach its position.
    OutOfReach {
        /// The finger, 0 to 2.
        finger: u8,
        /// The nearest position in reach without its joints' limits [m, base frame].
        nearest: [f32; 3],
    },
    /// 5: the motion is not finite, or shorter than a tick.
    NotFinite,
    /// 6: the motion is too fast.
    TooFast {
        /// Its peak speed [m/s] or peak angular speed [rad/s].
        value: f32,
        /// The limit of that speed.
        limit: f32,
    },
    /// 7: a fingertip can reach its position, or follow the path to it, only beyond the limits of a joint.
    Limit(LimitRefusal),
}

impl Concerns for GraspRefusal {
    fn chain(&self) -> Option<u8> {
        match *self {
            Self::NotTared { chain } | Self::OutOfReach { finger: chain, .. } => Some(chain),
            _ => None,
        }
    }

    fn joint(&self) -> Option<u8> {
        match self {
            Self::Limit(refusal) => refusal.joint(),
            _ => None,
        }
    }
}

impl fmt::Display for GraspRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAHand => f.write_str(
                "the robot is not a hand of three fingers, each with a force sensor and three joints whose axes 2 \
                 and 3 are parallel",
            ),
            Self::NotTared { chain } => write!(
                f,
                "the force sensor of chain {chain} was not tared since the model was pushed or the joints were \
                 homed: tare it while nothing touches the tips"
            ),
            Self::Busy(phase) => write!(f, "not possible while the hand {phase}"),
            Self::Plan(plan) => plan.fmt(f),
            Self::OutOfReach { finger, nearest: [x, y, z] } => write!(
                f,
                "finger {} cannot reach its position; the nearest in reach, without its joints' limits, is \
                 ({x:.4}, {y:.4}, {z:.4}) m",
                finger + 1
            ),
            Self::NotFinite => write!(f, "the motion is not finite, shorter than a tick, or longer than {MAX_MOVE_TIME} s"),
            Self::TooFast { value, limit } => {
                write!(
                    f,
                    "the motion's peak speed is {value} m/s or rad/s, the limit is {limit}: make its \
                     duration longer"
                )
            }
            Self::Limit(refusal) => write!(f, "a fingertip cannot be led to its position: {refusal}"),
        }
    }
}

impl core::error::Error for GraspRefusal {}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ready => "is ready",
            Self::Approach => "approaches an object",
            Self::Touch => "searches for an object",
            Self::Squeeze => "grips an object",
            Self::ProbeFriction => "probes the friction of an object",
            Self::Hold => "holds an object",
            Self::Move => "moves an object",
            Self::Lower => "lowers an object",
            Self::Open => "releases an object",
        })
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Obstructed { finger, force } => {
                write!(
                    f,
                    "finger {} met an obstacle on its path ({force} N): the fingers stopped",
                    finger + 1
                )
            }
            Self::NoObject { finger, distance } => {
                write!(f, "finger {} found no surface within {distance} m: the hand opened", finger + 1)
            }
            Self::NoGrip { force, limit } => write!(
                f,
                "the grip did not converge within {limit} s (smallest normal force {force} N): the hand \
                 opened"
            ),
            Self::NoSupport { distance } => {
                write!(f, "no support within {distance} m below the object: the hand holds it there")
            }
            Self::OutOfReach { finger } => {
                write!(f, "finger {} could not follow: its set-point is out of reach", finger + 1)
            }
        }
    }
}

/// Telemetry of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct GraspTelemetry {
    /// The present phase.
    pub phase: Phase,
    /// The last failure since the last command.
    pub failure: Option<Failure>,
    /// Origin of the object frame [m].
    pub position: [f32; 3],
    /// Orientation of the object frame: a unit quaternion `[x, y, z, w]`.
    pub orientation: [f32; 4],
    /// Wrench of the fingers on the object about that origin, in base axes [N, N·m].
    pub load: [f32; 6],
    /// Target force of each finger on the object, in base axes [N].
    pub target_forces: PerFinger<[f32; 3]>,
    /// Estimated coefficient of friction.
    pub friction: f32,
    /// Ticks with a slip.
    pub slips: u16,
    /// No forces within the limits balance the load: the grip is at its limits.
    pub overloaded: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::grasping::PlanField;

    #[test]
    fn a_phase_completes_a_sentence_about_the_hand() {
        let texts = [
            (Phase::Ready, "is ready"),
            (Phase::Approach, "approaches an object"),
            (Phase::Touch, "searches for an object"),
            (Phase::Squeeze, "grips an object"),
            (Phase::ProbeFriction, "probes the friction of an object"),
            (Phase::Hold, "holds an object"),
            (Phase::Move, "moves an object"),
            (Phase::Lower, "lowers an object"),
            (Phase::Open, "releases an object"),
        ];
        for (phase, text) in texts {
            assert_eq!(phase.to_string(), text);
            assert_eq!(GraspRefusal::Busy(phase).to_string(), format!("not possible while the hand {text}"));
        }
    }

    #[test]
    fn a_failure_names_finger_value_and_what_the_hand_did() {
        let texts = [
            (
                Failure::Obstructed { finger: 0, force: 0.75 },
                "finger 1 met an obstacle on its path (0.75 N): the fingers stopped",
            ),
            (
                Failure::NoObject { finger: 2, distance: 0.02 },
                "finger 3 found no surface within 0.02 m: the hand opened",
            ),
            (
                Failure::NoGrip { force: 0.25, limit: 3.0 },
                "the grip did not converge within 3 s (smallest normal force 0.25 N): the hand opened",
            ),
            (
                Failure::NoSupport { distance: 0.05 },
                "no support within 0.05 m below the object: the hand holds it there",
            ),
            (Failure::OutOfReach { finger: 1 }, "finger 2 could not follow: its set-point is out of reach"),
        ];
        for (failure, text) in texts {
            assert_eq!(failure.to_string(), text);
        }
    }

    #[test]
    fn a_refusal_names_value_and_limit() {
        let plan = InvalidPlan::Value { field: PlanField::Clearance, value: 0.5, lower: 0.001, upper: 0.05 };
        let texts = [
            (
                GraspRefusal::OutOfReach { finger: 2, nearest: [0.1, 0.0, -0.25] },
                "finger 3 cannot reach its position; the nearest in reach, without its joints' limits, is \
                 (0.1000, 0.0000, -0.2500) m",
            ),
            (GraspRefusal::NotFinite, "the motion is not finite, shorter than a tick, or longer than 600 s"),
            (
                GraspRefusal::TooFast { value: 0.375, limit: 0.2 },
                "the motion's peak speed is 0.375 m/s or rad/s, the limit is 0.2: make its duration longer",
            ),
            (
                GraspRefusal::Limit(LimitRefusal::OutsideLimits {
                    joint: 4,
                    value: 1.75,
                    lower: -0.5,
                    upper: 1.5,
                }),
                "a fingertip cannot be led to its position: joint 4: 1.75 rad is outside its limits -0.5 to 1.5 rad",
            ),
            (GraspRefusal::Plan(plan), "the clearance is 0.5 m; the range is 0.001 to 0.05 m"),
        ];
        for (refusal, text) in texts {
            assert_eq!(refusal.to_string(), text);
        }
    }
}
