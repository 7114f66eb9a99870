use tesaki::model::{Gauges, MimicJoint, RobotModel};
use tesaki::robot::Concerns;

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

/// The length of a chain along its links [m].
pub fn chain_length(model: &RobotModel, chain: usize) -> f32 {
    let norm = |[x, y, z]: [f32; 3]| tesaki::math::sqrt(x * x + y * y + z * z);
    let tip = model.chains.get(chain).map_or(0.0, |chain| norm(chain.tip.translation));
    model.joints_of(chain).map(|joint| norm(joint.body().0.translation)).sum::<f32>() + tip
}

/// Puts the name of the joint or tip that a refusal concerns in the place of its number in `text`.
pub fn named(refusal: &impl Concerns, text: &str, model: Option<&RobotModel>) -> String {
    let Some(model) = model else { return text.to_owned() };
    if let Some(joint) = refusal.joint() {
        return text.replacen(&format!("joint {joint}"), model.joint_name(usize::from(joint)), 1);
    }
    let tip = refusal.chain().and_then(|chain| Some((chain, model.chains.get(usize::from(chain))?)));
    tip.map_or_else(|| text.to_owned(), |(chain, tip)| text.replacen(&format!("chain {chain}"), &tip.name, 1))
}
