use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{InvalidPlan, PerFinger};
use crate::robot::Concerns;

/// What a hand is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Phase {
    /// 0: nothing; the fingers stand.
    Ready,
    /// 1: the fingertips move to places in front of the contacts.
    Approach,
    /// 2: they move on until they touch.
    Touch,
    /// 3: the grip becomes as firm as planned.
    Squeeze,
    /// 4: fingers 1 and 2 press towards each other until one slides: the friction.
    ProbeFriction,
    /// 5: the object is held still.
    Hold,
    /// 6: the object is moved.
    Move,
    /// 7: the object is lowered until something carries it.
    Lower,
    /// 8: the grip fades, and the fingertips go back.
    Open,
}

/// What went wrong without harm: the hand let go, or holds as before.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Failure {
    /// 0: a finger met something on its way to the object. The fingers stand where they are.
    Obstructed {
        /// The finger, 0 to 2.
        finger: u8,
        /// Force on its tip [N].
        force: f32,
    },
    /// 1: a finger felt nothing where the object should be. The hand opened.
    NothingThere {
        /// The finger, 0 to 2.
        finger: u8,
        /// How far it felt beyond the place in front of the contact [m].
        distance: f32,
    },
    /// 2: the forces did not become what was wanted within the time. The hand opened.
    NoGrip {
        /// The weakest normal force [N].
        force: f32,
        /// The time [s].
        limit: f32,
    },
    /// 3: nothing carried the object as far as it was lowered. The hand holds it there.
    NothingBelow {
        /// How far [m].
        distance: f32,
    },
    /// 4: a fingertip cannot go where it should. The object is held where it is, or the fingers stand.
    OutOfReach {
        /// The finger, 0 to 2.
        finger: u8,
    },
}

/// The object is not in the hand as it was: a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GraspFault {
    /// A finger pushes with less than it must [N].
    Contact {
        /// The finger, 0 to 2.
        finger: u8,
        /// Its normal force [N].
        force: f32,
        /// What it must push with [N].
        limit: f32,
    },
    /// The fingertips are not where they were to each other: the object slid away, or turned between them.
    Deformed {
        /// Change of the largest distance [m].
        distance: f32,
        /// The most that may be [m].
        limit: f32,
    },
    /// The object is not where it should be: something moved it.
    Moved {
        /// How far it is away [m].
        distance: f32,
        /// The most that may be [m].
        limit: f32,
    },
    /// The fingertips make no frame.
    NoFrame,
}

/// Why a command cannot be carried out; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GraspRefusal {
    /// 0: the robot is not a hand of three fingers with three joints and a force sensor each.
    NotAHand,
    /// 1: the force sensor of the chain was not tared since power-on, or since the model was committed.
    NotTared {
        /// The chain.
        chain: u8,
    },
    /// 2: not in this phase.
    Busy(Phase),
    /// 3: the plan is not valid.
    Plan(InvalidPlan),
    /// 4: a fingertip cannot get there.
    OutOfReach {
        /// The finger, 0 to 2.
        finger: u8,
        /// The nearest place that it can reach, were it not for the limits of its joints [m, base frame].
        nearest: [f32; 3],
    },
    /// 5: a motion that is not finite, or takes no time.
    NotFinite,
    /// 6: the motion is too fast.
    TooFast {
        /// Its peak speed [m/s], or the share of the largest one for a rotation [rad/s].
        value: f32,
        /// The most.
        limit: f32,
    },
}

impl Concerns for GraspRefusal {
    fn chain(&self) -> Option<u8> {
        match *self {
            Self::NotTared { chain } | Self::OutOfReach { finger: chain, .. } => Some(chain),
            _ => None,
        }
    }
}

impl fmt::Display for GraspRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAHand => f.write_str(
                "the robot is not a hand of three fingers, each with three joints and a force sensor",
            ),
            Self::NotTared { chain } => write!(
                f,
                "the force sensor of chain {chain} was not tared since the model was pushed: tare it while nothing touches the tips"
            ),
            Self::Busy(phase) => write!(f, "not possible while the hand {phase}"),
            Self::Plan(plan) => plan.fmt(f),
            Self::OutOfReach { finger, nearest: [x, y, z] } => write!(
                f,
                "finger {} does not reach so far; without its joints' limits it would reach ({x}, {y}, {z}) m",
                finger + 1
            ),
            Self::NotFinite => write!(f, "the motion is not finite, or takes no time"),
            Self::TooFast { value, limit } => {
                write!(
                    f,
                    "the motion's peak speed is {value} m/s or rad/s, at most {limit}: give it more time"
                )
            }
        }
    }
}

impl core::error::Error for GraspRefusal {}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ready => "is ready",
            Self::Approach => "approaches an object",
            Self::Touch => "feels for an object",
            Self::Squeeze => "takes hold of an object",
            Self::ProbeFriction => "feels the friction of an object",
            Self::Hold => "holds an object",
            Self::Move => "moves an object",
            Self::Lower => "lowers an object",
            Self::Open => "lets go of an object",
        })
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Obstructed { finger, force } => {
                write!(f, "finger {} met something on its way ({force} N) and stopped", finger + 1)
            }
            Self::NothingThere { finger, distance } => {
                write!(f, "finger {} felt nothing within {distance} m: the hand opened", finger + 1)
            }
            Self::NoGrip { force, limit } => write!(
                f,
                "the grip was not as wanted within {limit} s (weakest normal force {force} N): the hand opened"
            ),
            Self::NothingBelow { distance } => {
                write!(f, "nothing carried the object within {distance} m: the hand holds it there")
            }
            Self::OutOfReach { finger } => {
                write!(f, "finger {} could not follow: it does not reach so far", finger + 1)
            }
        }
    }
}

/// What the supervisor sees of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct GraspTelemetry {
    /// What the hand does.
    pub phase: Phase,
    /// What went wrong last, since the last command.
    pub failure: Option<Failure>,
    /// The object frame's origin [m], and its orientation as a unit quaternion `[x, y, z, w]`.
    pub position: [f32; 3],
    /// See `position`.
    pub orientation: [f32; 4],
    /// Wrench of the fingers on the object about that origin, in base axes [N, N·m].
    pub load: [f32; 6],
    /// Wanted force of each finger on the object, in base axes [N].
    pub wanted: PerFinger<[f32; 3]>,
    /// Coefficient of friction that is counted on.
    pub friction: f32,
    /// Ticks in which a contact slid.
    pub slips: u16,
    /// No forces within the limits hold the load.
    pub overloaded: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::grasping::PlanField;

    #[test]
    fn a_phase_of_the_protocol_completes_what_the_hand_does() {
        let texts = [
            (Phase::Ready, "is ready"),
            (Phase::Approach, "approaches an object"),
            (Phase::Touch, "feels for an object"),
            (Phase::Squeeze, "takes hold of an object"),
            (Phase::ProbeFriction, "feels the friction of an object"),
            (Phase::Hold, "holds an object"),
            (Phase::Move, "moves an object"),
            (Phase::Lower, "lowers an object"),
            (Phase::Open, "lets go of an object"),
        ];
        for (phase, text) in texts {
            assert_eq!(phase.to_string(), text);
            assert_eq!(GraspRefusal::Busy(phase).to_string(), format!("not possible while the hand {text}"));
        }
    }

    #[test]
    fn a_failure_of_the_protocol_says_which_finger_how_much_and_what_the_hand_did() {
        let texts = [
            (
                Failure::Obstructed { finger: 0, force: 0.75 },
                "finger 1 met something on its way (0.75 N) and stopped",
            ),
            (
                Failure::NothingThere { finger: 2, distance: 0.02 },
                "finger 3 felt nothing within 0.02 m: the hand opened",
            ),
            (
                Failure::NoGrip { force: 0.25, limit: 3.0 },
                "the grip was not as wanted within 3 s (weakest normal force 0.25 N): the hand opened",
            ),
            (
                Failure::NothingBelow { distance: 0.05 },
                "nothing carried the object within 0.05 m: the hand holds it there",
            ),
            (Failure::OutOfReach { finger: 1 }, "finger 2 could not follow: it does not reach so far"),
        ];
        for (failure, text) in texts {
            assert_eq!(failure.to_string(), text);
        }
    }

    #[test]
    fn what_the_protocol_refuses_to_a_hand_is_said_with_what_it_could() {
        let plan = InvalidPlan::Value { field: PlanField::Clearance, value: 0.5, lower: 0.001, upper: 0.05 };
        let texts = [
            (
                GraspRefusal::OutOfReach { finger: 2, nearest: [0.1, 0.0, -0.25] },
                "finger 3 does not reach so far; without its joints' limits it would reach (0.1, 0, -0.25) m",
            ),
            (GraspRefusal::NotFinite, "the motion is not finite, or takes no time"),
            (
                GraspRefusal::TooFast { value: 0.375, limit: 0.2 },
                "the motion's peak speed is 0.375 m/s or rad/s, at most 0.2: give it more time",
            ),
            (GraspRefusal::Plan(plan), "the clearance is 0.5 m; possible is 0.001 to 0.05 m"),
        ];
        for (unable, text) in texts {
            assert_eq!(unable.to_string(), text);
        }
    }
}
