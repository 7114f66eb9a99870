use nalgebra::{SMatrix, SVector, Vector6};

use crate::kinematics::Jacobian;
use crate::math::{self, Ldlt};
use crate::model::MAX_CHAIN_JOINTS;

/// A value for each joint; those beyond the arm's joints are 0.
pub(super) type Joints = SVector<f32, MAX_CHAIN_JOINTS>;

/// Smallest singular value below which the solution is damped, and the damping at a singular value of 0. Rows in metres
/// and radians as they are: an arm is some half a metre long.
const NEARLY_SINGULAR: f32 = 0.06;
const MAX_DAMPING: f32 = 0.04;
/// Against rounding.
const MIN_PIVOT: f32 = 1e-7;

/// Joint accelerations for a motion of the tool: the damped least-squares solution (Nakamura and Hanafusa 1986), the
/// damping grown from nothing as the smallest singular value falls, so that away from singular postures it is exact.
pub(super) struct Resolver {
    jacobian: Jacobian,
    factors: Ldlt<6>,
}

impl Resolver {
    /// For the `jacobian`, without its column `driven`. `direction` is the weakest direction as far as it is known, a unit
    /// vector, and `weakest` its singular value; both are brought nearer to the true ones.
    pub fn new(
        mut jacobian: Jacobian,
        driven: Option<usize>,
        direction: &mut Vector6<f32>,
        weakest: &mut f32,
    ) -> Self {
        if let Some(mut column) =
            driven.and_then(|driven| (driven < MAX_CHAIN_JOINTS).then(|| jacobian.column_mut(driven)))
        {
            column.fill(0.0);
        }
        let ratio = *weakest * (1.0 / NEARLY_SINGULAR);
        let damping = if ratio < 1.0 { MAX_DAMPING * MAX_DAMPING * (1.0 - ratio * ratio) } else { 0.0 };
        let mut gram = SMatrix::<f32, 6, 6>::zeros();
        for row in 0..6 {
            // Only the lower triangle is read.
            for column in 0..=row {
                let mut sum = 0.0;
                for joint in 0..MAX_CHAIN_JOINTS {
                    sum += jacobian[(row, joint)] * jacobian[(column, joint)];
                }
                gram[(row, column)] = sum;
            }
            gram[(row, row)] += damping;
        }
        let factors = Ldlt::new(&gram, MIN_PIVOT);
        // One step of the inverse iteration.
        let next = factors.solve(direction);
        let size = math::sqrt(next.norm_squared());
        if size.is_finite() && size > 0.0 {
            let square = 1.0 / size - damping;
            *direction = next / size;
            *weakest = math::sqrt(if square > 0.0 { square } else { 0.0 });
        }
        Self { jacobian, factors }
    }

    /// The joint accelerations, the driven joint's aside, whose motion of the tool is nearest to `acceleration`.
    pub fn solve(&self, acceleration: &Vector6<f32>) -> Joints {
        self.jacobian.tr_mul(&self.factors.solve(acceleration))
    }

    /// The wrench on the tool that comes nearest to these joint `torques`, the driven joint's aside.
    pub fn wrench(&self, torques: &Joints) -> Vector6<f32> {
        self.factors.solve(&(self.jacobian * torques))
    }

    /// The part of `motion` that does not move the tool.
    pub fn null(&self, motion: &Joints) -> Joints {
        motion - self.solve(&(self.jacobian * motion))
    }
}
