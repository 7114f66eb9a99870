use tesaki::model::{Gauges, MimicJoint, RobotModel};

/// The model of one chain of a robot, for a board of its own: base frame and gravity are the robot's.
///
/// It is called `ROBOT.CHAIN`, or as the chain where that is too long. `None` for a chain that is not there,
/// or of which the motor of another chain moves a joint.
pub fn chain_model(robot: &RobotModel, index: usize) -> Option<RobotModel> {
    let (chain, range) = (robot.chains.get(index)?, robot.chain_ranges().nth(index)?);
    let joints = robot.joints.get(range.clone())?;
    let own = |mimic: &MimicJoint| {
        let joint = usize::from(mimic.joint).checked_sub(range.start).filter(|joint| *joint < range.len())?;
        Some(MimicJoint { chain: 0, joint: u8::try_from(joint).ok()?, ..*mimic })
    };
    let name = format!("{}.{}", robot.name, chain.name);
    Some(RobotModel {
        name: name.as_str().try_into().unwrap_or_else(|_| chain.name.clone()),
        gravity: robot.gravity,
        chains: [chain.clone()].into_iter().collect(),
        joints: joints.iter().cloned().collect(),
        mimics: robot.mimics_of(index).map(own).collect::<Option<_>>()?,
        gauges: robot.gauges_of(index).map(|gauges| Gauges { chain: 0, ..*gauges }),
        safety: robot.safety,
    })
}
