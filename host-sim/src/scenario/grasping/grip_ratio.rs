//! The grip ratio: normal forces of a grip over those of the least grip, which is the solution of the grip
//! optimisation for the wrench that the fingers exert, with the true friction. At rest, and if nothing else
//! bears the object, that is the true load.

use rapier3d::na::Vector3;
use tesaki::grasp::{Contact, GraspMap, GripError, GripState, LeastGrip, ThreeFingers};
use tesaki::kinematics::Chain;
use tesaki::model::RobotModel;

use super::GraspSample;
use crate::plant::ContactTruth;
use crate::scenario::common::largest;

/// The support bears nothing of the object up to this force [N].
const MAX_SUPPORT_FORCE: f64 = 0.01;

/// A grip compared with the least grip for the same load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripRatio {
    /// Sum of the normal forces, divided by that of the least grip; NaN where no forces within the limit hold
    /// the load, and where the support bears a part of it.
    pub ratio: f64,
    /// Largest joint torque of the least grip, without the weight of the fingers [N·m]; NaN where there is
    /// none.
    pub torque: f64,
}

/// The grip ratio of a sample for its load. The normal force of a contact is at most `limit` [N]. `None`
/// unless all fingers touch the object.
pub fn grip_ratio(model: &RobotModel, sample: &GraspSample, limit: f64) -> Option<GripRatio> {
    let map = grasp_map(sample, limit)?;
    let load = map.wrench(&forces(sample));
    let unknown = GripRatio { ratio: f64::NAN, torque: f64::NAN };
    if Vector3::from(sample.object.support_force).norm() > MAX_SUPPORT_FORCE {
        return Some(unknown);
    }
    let grip = LeastGrip::try_new(0.0, 0.0).ok()?;
    match grip.solve(&map, &load, &mut GripState::default()) {
        Ok(grip) => {
            let contacts = grip.forces.iter().zip(map.contacts());
            let least: f32 = contacts.map(|(force, contact)| force.dot(contact.normal())).sum();
            let sum: f64 = sample.contacts.iter().map(ContactTruth::normal_force).sum();
            let torque = largest_torque(model, sample, grip.forces.as_slice().try_into().ok()?);
            Some(GripRatio { ratio: sum / f64::from(least), torque })
        }
        Err(GripError::CannotHold(_)) => Some(unknown),
        Err(_) => None,
    }
}

/// The internal force of each finger: the null-space part of the contact forces [N].
pub fn internal_forces(sample: &GraspSample) -> [Vector3<f64>; 3] {
    let unknown = [Vector3::repeat(f64::NAN); 3];
    let Some(map) = grasp_map(sample, f64::from(f32::MAX)) else { return unknown };
    let mut forces = forces(sample);
    map.inverse().project_to_null_space(&mut forces);
    forces.try_into().map_or(unknown, |forces: [Vector3<f32>; 3]| forces.map(|force| force.map(f64::from)))
}

fn forces(sample: &GraspSample) -> Vec<Vector3<f32>> {
    sample.contacts.iter().map(|contact| Vector3::from(contact.force).map(|part| part as f32)).collect()
}

fn grasp_map(sample: &GraspSample, limit: f64) -> Option<GraspMap> {
    let mut contacts = Vec::new();
    for contact in &sample.contacts {
        let [point, normal] =
            [contact.point, contact.normal].map(|vector| Vector3::from(vector).map(|part| part as f32));
        let friction = sample.object.friction as f32;
        contacts.push(Contact::try_new(point, -normal, friction, limit as f32).ok()?);
    }
    GraspMap::try_new(&contacts, Vector3::zeros()).ok()
}

/// The largest joint torque for these fingertip forces [N·m].
fn largest_torque(model: &RobotModel, sample: &GraspSample, forces: &[Vector3<f32>; 3]) -> f64 {
    let mut fingers = Vec::new();
    let chains = model.chains.iter().zip(model.chain_ranges());
    for ((chain, joints), contact) in chains.zip(&sample.contacts) {
        let angles: Vec<f32> =
            sample.joints.get(joints.clone()).unwrap_or(&[]).iter().map(|&q| q as f32).collect();
        let posture = Chain::new(&model.joints[joints], &chain.tip).posture(&angles);
        let lever = Vector3::from(contact.point).map(|part| part as f32) - posture.tip().translation.vector;
        fingers.push((posture.jacobian(), lever));
    }
    let Ok(fingers) = fingers.try_into() else { return f64::NAN };
    let torques = ThreeFingers::new(&fingers).torques(forces);
    largest(torques.iter().flatten().map(|torque| f64::from(torque.abs())))
}
