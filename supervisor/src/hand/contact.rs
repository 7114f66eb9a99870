use nalgebra::Vector3;
use tesaki::kinematics::{Chain, Finger};
use tesaki::model::RobotModel;
use tesaki::task::grasping::PlannedContact;

use crate::words::unreachable;

/// Joint angles of a finger with its tip at a distance from a contact [rad], or why it cannot stand there.
///
/// `None` if that chain is not a finger of three joints.
pub fn angles_at(
    model: &RobotModel,
    finger: usize,
    contact: &PlannedContact,
    distance: f32,
) -> Option<Result<[f32; 3], String>> {
    let (chain, range) = (model.chains.get(finger)?, model.chain_ranges().nth(finger)?);
    let joints = model.joints.get(range)?;
    let [a, b, c] = joints else { return None };
    let limits = [a, b, c].map(|joint| (joint.limits.lower, joint.limits.upper));
    let finger = Finger::try_new(&Chain::new(joints, &chain.tip), limits).ok()?;
    let normal = Vector3::from(contact.normal).normalize();
    let position = Vector3::from(contact.position) - normal * (chain.tip_radius + distance);
    // Starts from a bent finger: a straight finger can bend in both directions.
    let position: [f32; 3] = position.into();
    Some(finger.nearest(&position.into(), &[0.0, 0.3, 0.7]).map_err(|error| {
        let [x, y, z] = position;
        format!("{x:.4}, {y:.4}, {z:.4} m {}", unreachable(&error, joints))
    }))
}
