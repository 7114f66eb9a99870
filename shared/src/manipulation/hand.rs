use nalgebra::Vector3;

use super::Each;
use crate::control::{Actuation, JointPoint};
use crate::kinematics::{Chain, Finger};

/// What the control of an object knows of the hand.
#[derive(Clone, Copy, Debug)]
pub struct Hand<'a> {
    /// Its fingers, in the order that defines the object frame.
    pub fingers: Each<HandFinger<'a>>,
    /// Acceleration of gravity in the base frame [m/s²].
    pub gravity: &'a Vector3<f32>,
}

/// A finger of three joints with a round tip.
#[derive(Clone, Copy, Debug)]
pub struct HandFinger<'a> {
    /// Its joints.
    pub chain: &'a Chain,
    /// Their inverse kinematics.
    pub inverse: &'a Finger,
    /// Torque limits of the joints [N·m].
    pub torque_limits: [f32; 3],
    /// Radius of the tip, whose middle is the chain's tip [m]; 0 for a pointed one.
    pub radius: f32,
}

/// What a finger senses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerSense {
    /// Joint angles [rad].
    pub angles: [f32; 3],
    /// Joint velocities [rad/s].
    pub velocities: [f32; 3],
    /// Force of the tip on what it touches, in base axes [N].
    pub force: [f32; 3],
}

impl FingerSense {
    /// A finger at rest with all angles 0 that touches nothing.
    pub const REST: Self = Self { angles: [0.0; 3], velocities: [0.0; 3], force: [0.0; 3] };
}

/// What the joints are to do until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandCommand {
    /// Where each joint is to be.
    pub points: Each<[JointPoint; 3]>,
    /// Torques for the forces on the object [N·m].
    pub torques: Each<[f32; 3]>,
    /// Who brings the joints there.
    pub drive: Actuation,
}
