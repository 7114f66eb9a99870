use nalgebra::Vector3;

use crate::control::{ErrorObserver, JointPoint};
use crate::kinematics::Chain;
use crate::model::{JointModel, MAX_CHAIN_JOINTS, MAX_JOINTS};
use crate::robot::{Measured, Robot};

/// The configuration of an arm for impedance control.
#[derive(Clone, Copy, Debug)]
pub struct Arm<'a> {
    /// Kinematics and dynamics.
    pub chain: &'a Chain,
    /// Models of the joints: drives, friction, limits.
    pub joints: &'a [JointModel],
    /// Acceleration of gravity in the base frame [m/s²].
    pub gravity: &'a Vector3<f32>,
    /// Tracking feedback of each joint, in accelerations (inertia 1) and without actuator lag.
    pub observer: &'a ErrorObserver,
}

impl<'a> Arm<'a> {
    /// The arm of `robot`; `None` unless the robot is a single chain of six or seven joints, all with a
    /// motor.
    pub fn of(robot: &'a Robot) -> Option<Self> {
        let [config] = robot.chains() else { return None };
        if config.chain.len() < 6 || config.has_mimics {
            return None;
        }
        Some(Self {
            chain: &config.chain,
            joints: &robot.model().joints,
            gravity: robot.gravity(),
            observer: robot.tracking()?,
        })
    }
}

/// Measurements of one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmMeasurement {
    /// Joint angles [rad].
    pub angles: [f32; MAX_CHAIN_JOINTS],
    /// Joint velocities [rad/s].
    pub velocities: [f32; MAX_CHAIN_JOINTS],
    /// External wrench on the tool from the force sensor: force and moment about the tip's origin, base axes
    /// [N, N·m].
    pub wrench: [f32; 6],
}

impl ArmMeasurement {
    /// The measurement of a robot that is an arm. Entries beyond its joints are meaningless.
    pub fn of(measured: &Measured) -> Self {
        let first = |values: &[f32; MAX_JOINTS]| values.first_chunk().copied().unwrap_or_default();
        Self {
            angles: first(&measured.positions),
            velocities: first(&measured.velocities),
            wrench: measured.wrenches[0],
        }
    }
}

/// Joint commands for one control period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmOutput {
    /// Reference of each joint at the start of the period.
    pub points: [JointPoint; MAX_CHAIN_JOINTS],
    /// Tracking feedback, added to the reference acceleration [rad/s²].
    pub feedback: [f32; MAX_CHAIN_JOINTS],
    /// Joint torques that balance the external wrench [N·m].
    pub torques: [f32; MAX_CHAIN_JOINTS],
    /// Fraction of the friction to compensate.
    pub friction: f32,
}
