use nalgebra::Vector3;

use super::tuning::MAX_TARGET_STEP;
use super::{FINGERS, PerFinger};
use crate::control::JointPoint;
use crate::kinematics::{Chain, Finger, Posture};
use crate::math::abs;
use crate::robot::{Actuation, Efforts, Measured, Postures, Robot};

/// The hand, as grasping needs it.
#[derive(Clone, Copy, Debug)]
pub struct GraspHand<'a> {
    /// Fingers 1 to 3, in the order that defines the object frame.
    pub fingers: PerFinger<GraspFinger<'a>>,
    /// Acceleration of gravity in the base frame [m/s²].
    pub gravity: &'a Vector3<f32>,
}

/// A finger of three joints with a round tip.
#[derive(Clone, Copy, Debug)]
pub struct GraspFinger<'a> {
    /// Its kinematics and dynamics.
    pub chain: &'a Chain,
    /// Its inverse kinematics.
    pub inverse: &'a Finger,
    /// Torque limits of the joints [N·m].
    pub torque_limits: [f32; 3],
    /// Coulomb friction of the joints [N·m].
    pub friction: [f32; 3],
    /// Radius of the tip, whose centre is the chain's tip [m]; 0 for a point.
    pub radius: f32,
}

/// Measurements of a finger.
#[derive(Clone, Copy, Debug)]
pub struct FingerSense<'a> {
    /// Posture at the measured angles.
    pub posture: &'a Posture,
    /// Measured joint angles [rad].
    pub angles: [f32; 3],
    /// Measured force of the tip on the object, in base axes [N].
    pub force: [f32; 3],
    /// Torques of the joints beyond their feed-forward in the last tick [N·m], if they are known.
    pub efforts: Option<[f32; 3]>,
}

impl<'a> GraspHand<'a> {
    /// `robot` as a hand; `None` unless it is three fingers with a force sensor each.
    pub fn of(robot: &'a Robot) -> Option<Self> {
        let mut fingers = heapless::Vec::<GraspFinger<'_>, FINGERS>::new();
        for (config, model) in robot.chains().iter().zip(&robot.model().chains) {
            model.force_sensor?;
            let [a, b, c] = robot.joints().get(config.joints())? else { return None };
            let finger = GraspFinger {
                chain: &config.chain,
                inverse: config.finger.as_ref()?,
                torque_limits: [a, b, c].map(|joint| joint.servo.torque_limit()),
                friction: [a, b, c].map(|joint| joint.coulomb),
                radius: model.tip_radius,
            };
            fingers.push(finger).ok()?;
        }
        Some(Self { fingers: fingers.into_array().ok()?, gravity: robot.gravity() })
    }
}

impl GraspFinger<'_> {
    /// The joints' targets for a set-point of the tip's centre, one tick after their `last` ones [rad].
    /// `None` if it is out of reach, or if the joint limits permit only a posture that is far from the last.
    #[inline]
    pub fn target(&self, center: &Vector3<f32>, last: &[f32; 3]) -> Option<[f32; 3]> {
        let angles = self.inverse.nearest(center, last).ok()?;
        let is_near = angles.iter().zip(last).all(|(angle, last)| abs(angle - last) <= MAX_TARGET_STEP);
        is_near.then_some(angles)
    }
}

impl<'a> FingerSense<'a> {
    /// Measurements of the fingers of a hand on one board; `None` before the first tick.
    pub fn of_all(
        measured: &Measured,
        postures: &'a Postures,
        efforts: &dyn Efforts,
    ) -> Option<PerFinger<Self>> {
        let sense = |finger: usize| {
            let angles = measured.angles(3 * finger..3 * finger + 3).first_chunk()?;
            // The sensor measures the force on the tip; the object has the reaction.
            let force = (-measured.force(finger)).into();
            let efforts = Some([0, 1, 2].map(|joint| efforts.effort(3 * finger + joint)));
            Some(Self { posture: postures.kept(finger)?, angles: *angles, force, efforts })
        };
        Some([sense(0)?, sense(1)?, sense(2)?])
    }
}

/// Command of the joints until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandOutput {
    /// Set-points of the joints.
    pub points: PerFinger<[JointPoint; 3]>,
    /// Feed-forward torques for the forces on the object [N·m].
    pub torques: PerFinger<[f32; 3]>,
    /// How the motor torques are computed.
    pub actuation: Actuation,
}
