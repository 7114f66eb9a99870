//! Initial scene of a grasp: the fingers are open around the object, the object stands on a support.

use std::path::Path;

use rapier3d::na::Vector3;
use tesaki::model::RobotModel;
use tesaki::task::grasping::GraspPlan;
use tesaki_description::grasp::{PlacedGrasp, load_placed};
use tesaki_supervisor::hand::angles_at;

use crate::plant::{ObjectValues, PlantOptions, Support, unit_quaternion};
use crate::scenario::ScenarioError;

/// Distance from each fingertip to the surface at the start [m].
const OPENING: f32 = 0.02;
/// Thickness of the support [m].
const THICKNESS: f64 = 0.02;

/// Why the open posture cannot be computed.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// Not three fingers, or a finger without three joints.
    #[error("{0} is not a hand for grasping: three fingers of three joints each are needed")]
    NotAHand(String),
    /// A finger does not reach its position.
    #[error("{finger} cannot stand {} mm in front of its contact: {why}; move the object or the contact", 1e3 * distance)]
    OutOfReach {
        /// Its tip's name.
        finger: String,
        /// How far from the contact [m].
        distance: f32,
        /// Why it cannot.
        why: String,
    },
}

/// Joint angles with each fingertip in front of its contact [rad].
///
/// # Errors
/// A finger does not reach its initial position.
pub fn open_posture(model: &RobotModel, plan: &GraspPlan) -> Result<Vec<f64>, SceneError> {
    posture(model, plan, OPENING)
}

/// Joint angles with each fingertip at its contact [rad].
///
/// # Errors
/// A finger does not reach its contact.
pub fn closed_posture(model: &RobotModel, plan: &GraspPlan) -> Result<Vec<f64>, SceneError> {
    posture(model, plan, 0.0)
}

/// Joint angles with each fingertip at a distance from its contact [m].
fn posture(model: &RobotModel, plan: &GraspPlan, distance: f32) -> Result<Vec<f64>, SceneError> {
    let not_a_hand = || SceneError::NotAHand(model.name.to_string());
    if model.chains.len() != plan.contacts.len() {
        return Err(not_a_hand());
    }
    let mut posture = Vec::new();
    for (index, (chain, contact)) in model.chains.iter().zip(&plan.contacts).enumerate() {
        let angles = angles_at(model, index, contact, distance).ok_or_else(not_a_hand)?;
        let angles =
            angles.map_err(|why| SceneError::OutOfReach { finger: chain.name.to_string(), distance, why })?;
        posture.extend(angles.map(f64::from));
    }
    Ok(posture)
}

/// A machine whose fingers are open around the object of the grasp in `grasp`; the object in `object`, if one
/// is given, is on its support.
///
/// # Errors
/// A file cannot be used, or the hand cannot reach there.
pub fn around_object(
    mut options: PlantOptions,
    model: &RobotModel,
    grasp: &Path,
    object: Option<&Path>,
) -> Result<PlantOptions, ScenarioError> {
    let plan = load_placed(grasp)?;
    let posture = open_posture(model, &plan.plan);
    options.posture =
        Some(posture.map_err(|source| ScenarioError::Grasp { path: grasp.to_owned(), source })?);
    let object = object.map(ObjectValues::load).transpose()?;
    options.object = object.map(|object| on_support(object, &plan, model.gravity));
    Ok(options)
}

/// The object at its nominal position, on a block as support below the face that points down.
pub fn on_support(object: ObjectValues, grasp: &PlacedGrasp, gravity: [f32; 3]) -> ObjectValues {
    let (axis, direction) = down(grasp, gravity);
    let mut size = object.size.map(|edge| 0.5 * edge);
    size[axis] = THICKNESS;
    let mut offset = Vector3::zeros();
    offset[axis] = direction * 0.5 * (object.size[axis] + THICKNESS);
    let position = Vector3::from(grasp.position) + unit_quaternion(grasp.orientation) * offset;
    let support = Support { size, position: position.into(), orientation: grasp.orientation };
    object.at(grasp.position, grasp.orientation).on(support)
}

/// The axis of the object's frame that points down most, and in which direction; −z without gravity.
pub fn down(grasp: &PlacedGrasp, gravity: [f32; 3]) -> (usize, f64) {
    let gravity = unit_quaternion(grasp.orientation).inverse() * Vector3::from(gravity.map(f64::from));
    let axis = if gravity == Vector3::zeros() { 2 } else { gravity.iamax() };
    (axis, if gravity[axis] > 0.0 { 1.0 } else { -1.0 })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_support_is_below_whatever_the_orientation() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
        let grasp = load_placed(&folder.join("grasps/box.toml")).unwrap();
        let object = ObjectValues::load(&folder.join("objects/box.toml")).unwrap();
        let [width, length, height] = object.size;
        let quarter = 0.5_f64.sqrt();
        // Gravity in the base frame, orientation of the object, edge that is vertical.
        for (gravity, orientation, vertical) in [
            ([0.0, 0.0, -9.81], [0.0, 0.0, 0.0, 1.0], height),
            ([0.0, 0.0, 9.81], [0.0, 0.0, 0.0, 1.0], height),
            ([9.81, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], width),
            // A quarter turn about y: x of the object points down.
            ([0.0, 0.0, -9.81], [0.0, quarter, 0.0, quarter], width),
            ([0.0, 0.0, -9.81], [quarter, 0.0, 0.0, quarter], length),
        ] {
            let grasp = PlacedGrasp { orientation, ..grasp };
            let placed = on_support(object.clone(), &grasp, gravity);
            let support = placed.support.unwrap();
            let from_object = Vector3::from(support.position) - Vector3::from(grasp.position);
            let down = Vector3::from(gravity.map(f64::from)).normalize();
            let expected = down * 0.5 * (vertical + THICKNESS);
            assert!((from_object - expected).norm() < 1e-9, "{gravity:?} {orientation:?}: {from_object:?}");
        }
    }
}
