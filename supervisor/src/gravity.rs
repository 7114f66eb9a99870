//! Torques of gravity.

use nalgebra::Vector3;
use tesaki::kinematics::Chain;
use tesaki::model::{ChainJoint, MAX_CHAIN_JOINTS, MAX_JOINTS, RobotModel};

/// The torque that each joint's motor needs against the weight of the links at rest at `angles` [N·m], with that of
/// the joints without motor that follow it.
pub fn torques(model: &RobotModel, angles: &[f32]) -> [f32; MAX_JOINTS] {
    let gravity = Vector3::from(model.gravity);
    let mut carried = [0.0; MAX_JOINTS];
    for index in 0..model.chains.len() {
        let mut torques = [0.0; MAX_CHAIN_JOINTS];
        let chain = Chain::of_model(model, index);
        let angles = model.chain_angles(index, angles);
        chain.nonlinear_effects(&gravity, &angles, &[0.0; MAX_CHAIN_JOINTS], &mut torques);
        for (torque, joint) in torques.into_iter().zip(model.joints_of(index)) {
            match joint {
                ChainJoint::Driven(joint, _) => carried[joint] += torque,
                ChainJoint::Mimic(mimic) => carried[usize::from(mimic.joint)] += mimic.multiplier * torque,
            }
        }
    }
    carried
}
