use nalgebra::Vector3;
use tesaki::kinematics::{Chain, Finger};
use tesaki::model::{JointModel, RobotModel};
use tesaki::task::grasping::{GraspFinger, GraspHand, PerFinger};

use super::HandError;

/// Kinematics and limits of a hand for grasp control.
#[derive(Clone, Debug)]
pub struct HandModel {
    fingers: PerFinger<FingerModel>,
    gravity: Vector3<f32>,
}

#[derive(Clone, Debug)]
struct FingerModel {
    chain: Chain,
    inverse: Finger,
    torque_limits: [f32; 3],
    friction: [f32; 3],
    planned_speeds: [f32; 3],
    radius: f32,
}

impl HandModel {
    /// Creates the hand of `robot`.
    ///
    /// # Errors
    /// The robot is not such a hand; the error says what it lacks.
    pub fn try_new(robot: &RobotModel) -> Result<Self, HandError> {
        let not = |why: String| HandError::NotAHand { robot: robot.name.to_string(), why };
        let mut fingers = Vec::new();
        for (index, (model, range)) in robot.chains.iter().zip(robot.chain_ranges()).enumerate() {
            let joints = robot.joints.get(range).unwrap_or_default();
            let [a, b, c] = joints else {
                return Err(not(format!("{} has {} joints", model.name, joints.len())));
            };
            if robot.mimics_of(index).next().is_some() {
                return Err(not(format!("{} has a mimic joint", model.name)));
            }
            if model.force_sensor.is_none() {
                return Err(not(format!("{} has no force sensor", model.name)));
            }
            let chain = Chain::new(joints, &model.tip);
            let limits = [a, b, c].map(|joint| (joint.limits.lower, joint.limits.upper));
            let inverse =
                Finger::try_new(&chain, limits).map_err(|error| not(format!("{}: {error}", model.name)))?;
            let torque_limits = [a, b, c].map(JointModel::torque_limit);
            let friction = [a, b, c].map(|joint| joint.friction.coulomb);
            let planned_speeds = [a, b, c].map(|joint| joint.limits.planned_speed());
            let radius = model.tip_radius;
            fingers.push(FingerModel { chain, inverse, torque_limits, friction, planned_speeds, radius });
        }
        let got = fingers.len();
        let fingers = fingers.try_into().map_err(|_| not(format!("it has {got} fingers")))?;
        Ok(Self { fingers, gravity: Vector3::from(robot.gravity) })
    }

    /// Largest planned speeds of the joints [rad/s].
    pub fn planned_speeds(&self) -> PerFinger<[f32; 3]> {
        self.fingers.each_ref().map(|finger| finger.planned_speeds)
    }

    /// The hand in the form that the grasp controller takes.
    pub fn hand(&self) -> GraspHand<'_> {
        let fingers = self.fingers.each_ref().map(|finger| GraspFinger {
            chain: &finger.chain,
            inverse: &finger.inverse,
            torque_limits: finger.torque_limits,
            friction: finger.friction,
            radius: finger.radius,
        });
        GraspHand { fingers, gravity: &self.gravity }
    }
}
