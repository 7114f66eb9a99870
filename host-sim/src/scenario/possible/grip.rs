//! The least torque with which a hand can hold an object, by the true machine.

use rapier3d::na::{DMatrix, DVector, Vector3, Vector6};
use tesaki::kinematics::Chain;
use tesaki::model::RobotModel;
use tesaki::task::grasping::GraspPlan;

use super::linear_program::minimize;
use crate::plant::JointFactors;
use crate::scenario::ScenarioError;
use crate::scenario::scene::closed_posture;

/// Edges of the pyramid around each friction cone. With 32 it is wider than the cone by 0.5 %, so that the
/// share of the torque is too small by no more than that.
const EDGES: usize = 32;
/// Length that makes moments about the object comparable with forces [m].
const LENGTH: f64 = 0.05;

/// A finger that presses on an object.
struct FingerTruth {
    point: Vector3<f64>,
    /// Edges of the pyramid around the friction cone, with a normal part of 1.
    edges: Vec<Vector3<f64>>,
    /// Force on the object at `point` to torques of the joints: `Jᵀ`.
    torques_of_force: DMatrix<f64>,
    /// Torques that hold the finger's weight [N·m].
    weight: Vec<f64>,
    /// Torques that the drives can make, with what friction of the joint can bear [N·m].
    capacity: Vec<f64>,
}

/// A hand at an object, as it is.
pub struct GripTruth {
    fingers: Vec<FingerTruth>,
    center: Vector3<f64>,
}

impl GripTruth {
    /// The hand of `model`, that differs from it by `factors`, at the contacts of `plan` around an object
    /// with the coefficient of `friction`. `coulomb` is the Coulomb friction of each joint [N·m], `center`
    /// the object's centre of mass [m].
    pub fn new(
        model: &RobotModel,
        factors: &[JointFactors],
        plan: &GraspPlan,
        friction: f64,
        coulomb: &[f64],
        center: [f64; 3],
    ) -> Result<Self, ScenarioError> {
        let posture = closed_posture(model, plan)?;
        let mut fingers = Vec::new();
        for ((chain, range), contact) in model.chains.iter().zip(model.chain_ranges()).zip(&plan.contacts) {
            let mut joints = model.joints[range.clone()].to_vec();
            for (joint, factors) in joints.iter_mut().zip(&factors[range.clone()]) {
                joint.link.mass *= factors.mass as f32;
            }
            let shape = Chain::new(&joints, &chain.tip);
            let angles: Vec<f32> = posture[range.clone()].iter().map(|&angle| angle as f32).collect();
            let rest = vec![0.0; angles.len()];
            let mut weight = rest.clone();
            shape.inverse_dynamics(&Vector3::from(model.gravity), &angles, &rest, &rest, &mut weight);
            let point = Vector3::from(contact.position).map(f64::from);
            let stands = shape.posture(&angles);
            let jacobian = stands.jacobian();
            let lever = point - stands.tip().translation.vector.map(f64::from);
            let torques_of_force = DMatrix::from_fn(angles.len(), 3, |joint, axis| {
                let column = jacobian.column(joint).map(f64::from);
                let turn = Vector3::new(column[3], column[4], column[5]);
                column[axis] + turn.cross(&lever)[axis]
            });
            let makes = joints.iter().zip(&factors[range.clone()]).zip(&coulomb[range]);
            fingers.push(FingerTruth {
                point,
                edges: pyramid(&Vector3::from(contact.normal).map(f64::from), friction),
                torques_of_force,
                weight: weight.into_iter().map(f64::from).collect(),
                capacity: makes
                    .map(|((joint, factors), coulomb)| {
                        f64::from(joint.torque_limit()) * factors.torque_constant + coulomb
                    })
                    .collect(),
            });
        }
        Ok(Self { fingers, center: center.into() })
    }

    /// The least share of its torque that the joint which is loaded most needs to hold the object against
    /// `load`: force [N], and moment about the centre of mass [N·m]. `None` where no forces within friction
    /// hold it at all.
    ///
    /// A linear program: each contact force is a sum of edges of its pyramid with factors that are not
    /// negative, the forces balance the load, and no torque is more than the share, which is to be the least.
    pub fn torque_share(&self, load: &Vector6<f64>) -> Option<f64> {
        let joints: usize = self.fingers.iter().map(|finger| finger.capacity.len()).sum();
        let edges: usize = self.fingers.iter().map(|finger| finger.edges.len()).sum();
        // Edges, the share, and a slack for each torque in each direction.
        let (rows, share, slack) = (6 + 2 * joints, edges, edges + 1);
        let mut constraints = DMatrix::zeros(rows, slack + 2 * joints);
        let mut values = DVector::zeros(rows);
        for axis in 0..3 {
            values[axis] = -load[axis];
            values[3 + axis] = -load[3 + axis] / LENGTH;
        }
        let (mut column, mut row) = (0, 6);
        for finger in &self.fingers {
            let lever = (finger.point - self.center) / LENGTH;
            for edge in &finger.edges {
                let moment = lever.cross(edge);
                let torques = &finger.torques_of_force * edge;
                for axis in 0..3 {
                    constraints[(axis, column)] = edge[axis];
                    constraints[(3 + axis, column)] = moment[axis];
                }
                for (joint, torque) in torques.iter().enumerate() {
                    let torque = torque / finger.capacity[joint];
                    constraints[(row + 2 * joint, column)] = torque;
                    constraints[(row + 2 * joint + 1, column)] = -torque;
                }
                column += 1;
            }
            for (weight, capacity) in finger.weight.iter().zip(&finger.capacity) {
                for sign in [1.0, -1.0] {
                    constraints[(row, share)] = -1.0;
                    constraints[(row, slack + row - 6)] = 1.0;
                    values[row] = -sign * weight / capacity;
                    row += 1;
                }
            }
        }
        let mut costs = DVector::zeros(constraints.ncols());
        costs[share] = 1.0;
        minimize(&constraints, &values, &costs).map(|found| found[share])
    }
}

/// Edges of the pyramid around the friction cone about `normal`, which points into the object.
fn pyramid(normal: &Vector3<f64>, friction: f64) -> Vec<Vector3<f64>> {
    let normal = normal.normalize();
    let across = normal.cross(&if normal.x.abs() < 0.5 { Vector3::x() } else { Vector3::y() }).normalize();
    let radius = friction / (std::f64::consts::PI / EDGES as f64).cos();
    let edge = |index: usize| {
        let (sine, cosine) = (std::f64::consts::TAU * index as f64 / EDGES as f64).sin_cos();
        normal + (across * cosine + normal.cross(&across) * sine) * radius
    };
    (0..EDGES).map(edge).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    type Row = (f64, [[f64; 21]; 3], [f64; 6], f64);

    /// Friction; point, normal, block of the Jacobian, weight and capacity of each finger; load; least share
    /// of the torque from `tests/oracles/torque_share.py`, negative where nothing holds the load.
    const ORACLE: &[Row] = include!("../../../../tests/oracles/data/torque_share.in");

    #[test]
    fn agrees_with_scipy_on_round_cones() {
        let mut held = 0;
        for (friction, fingers, load, expected) in ORACLE {
            let finger = |numbers: &[f64; 21]| FingerTruth {
                point: Vector3::from_column_slice(&numbers[..3]),
                edges: pyramid(&Vector3::from_column_slice(&numbers[3..6]), *friction),
                torques_of_force: DMatrix::from_row_slice(3, 3, &numbers[6..15]).transpose(),
                weight: numbers[15..18].to_vec(),
                capacity: numbers[18..].to_vec(),
            };
            let truth = GripTruth { fingers: fingers.iter().map(finger).collect(), center: Vector3::zeros() };
            let share = truth.torque_share(&Vector6::from(*load));
            if let (Some(share), true) = (share, *expected > 0.0) {
                held += 1;
                // The pyramid is wider than the cone.
                let ratio = share / expected;
                assert!((0.99..1.0 + 1e-6).contains(&ratio), "{share} {expected}");
            } else {
                assert!(share.is_none() && *expected < 0.0, "{share:?} {expected}");
            }
        }
        assert!(held >= 10 && held < ORACLE.len(), "{held}");
    }
}
