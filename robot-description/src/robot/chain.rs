use tesaki::model::RobotModel;

/// The model of one chain of a robot, for a board of its own: base frame and gravity are the robot's.
///
/// It is called `ROBOT.CHAIN`, or as the chain where that is too long. `None` for a chain that is not there,
/// or whose first joint the motor of another chain moves.
pub fn chain_model(robot: &RobotModel, index: usize) -> Option<RobotModel> {
    let chain = robot.chains.get(index).filter(|chain| chain.mimic.is_none())?;
    let joints = robot.joints.get(robot.chain_ranges().nth(index)?)?;
    let name = format!("{}.{}", robot.name, chain.name);
    Some(RobotModel {
        name: name.as_str().try_into().unwrap_or_else(|_| chain.name.clone()),
        gravity: robot.gravity,
        chains: [chain.clone()].into_iter().collect(),
        joints: joints.iter().cloned().collect(),
        safety: robot.safety,
    })
}
