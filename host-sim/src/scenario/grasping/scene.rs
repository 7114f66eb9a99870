//! Initial scene of a grasp: fingers open around the object, object on a support.

use rapier3d::na::{Quaternion, UnitQuaternion, Vector3};
use tesaki::kinematics::{Chain, Finger};
use tesaki::model::RobotModel;
use tesaki::task::grasping::GraspPlan;
use tesaki_description::grasp::PlacedGrasp;

use crate::plant::{ObjectValues, Support};

/// From the fingertips to the surfaces at the start [m].
const OPEN: f32 = 0.02;
/// Thickness of the support [m].
const THICKNESS: f64 = 0.02;

/// Why the open posture cannot be computed.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// Not three of them, or not of three joints.
    #[error("{0} is not a hand for grasping: three fingers of three joints each are needed")]
    NotAHand(String),
    /// One does not reach.
    #[error("{finger} cannot stand {} mm in front of its contact: {why}", 1e3 * OPEN)]
    OutOfReach {
        /// Its tip's name.
        finger: String,
        /// What it would take.
        why: String,
    },
}

/// Joint angles with each fingertip in front of its contact [rad].
///
/// # Errors
/// A finger does not reach its initial position.
pub fn open_posture(model: &RobotModel, plan: &GraspPlan) -> Result<Vec<f64>, SceneError> {
    let not_a_hand = || SceneError::NotAHand(model.name.to_string());
    if model.chains.len() != plan.contacts.len() {
        return Err(not_a_hand());
    }
    let mut posture = Vec::new();
    for ((chain, range), contact) in model.chains.iter().zip(model.chain_ranges()).zip(&plan.contacts) {
        let joints = model.joints.get(range).unwrap_or_default();
        let [a, b, c] = joints else { return Err(not_a_hand()) };
        let limits = [a, b, c].map(|joint| (joint.limits.lower, joint.limits.upper));
        let shape = Chain::new(joints, &chain.tip);
        let finger = Finger::try_new(&shape, limits).map_err(|_| not_a_hand())?;
        let normal = Vector3::from(contact.normal).normalize();
        let place = Vector3::from(contact.position) - normal * (chain.tip_radius + OPEN);
        // From a bent finger, not from the straight one, which is bent both ways.
        let place: [f32; 3] = place.into();
        let angles = finger.nearest(&place.into(), &[0.0, 0.3, 0.7]).map_err(|error| {
            SceneError::OutOfReach { finger: chain.name.to_string(), why: format!("{error:?}") }
        })?;
        posture.extend(angles.map(f64::from));
    }
    Ok(posture)
}

/// The object where the grasp expects it, on a block.
pub fn on_support(object: ObjectValues, grasp: &PlacedGrasp) -> ObjectValues {
    let [x, y, z, w] = grasp.orientation;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let [width, length, height] = object.size;
    let below = Vector3::from(grasp.position) - turn * Vector3::new(0.0, 0.0, 0.5 * (height + THICKNESS));
    let size = [0.5 * width, 0.5 * length, THICKNESS];
    let support = Support { size, position: below.into(), orientation: grasp.orientation };
    object.at(grasp.position, grasp.orientation).on(support)
}
