use nalgebra::{SMatrix, SVector, Vector6};

use super::tuning::{DAMPED_BELOW, MAX_DAMPING, MIN_PIVOT};
use crate::kinematics::Jacobian;
use crate::math::{self, Ldlt};
use crate::model::MAX_CHAIN_JOINTS;

/// One value per joint; 0 beyond the arm's joints.
pub(super) type JointVector = SVector<f32, MAX_CHAIN_JOINTS>;

/// Damped least-squares inverse of the tool's Jacobian (Nakamura and Hanafusa 1986). The damping grows from 0
/// as the smallest singular value falls below a threshold, so the inverse is exact away from singular
/// postures.
pub(super) struct Resolver {
    jacobian: Jacobian,
    factors: Ldlt<6>,
}

impl Resolver {
    /// Factorises `jacobian` without the column of the driven joint. Improves the estimates of the smallest
    /// singular value `sigma_min` and of its left singular vector, a unit vector, by one step of the inverse
    /// iteration.
    pub fn new(
        jacobian: &Jacobian,
        driven: Option<usize>,
        left_singular_vector: &mut Vector6<f32>,
        sigma_min: &mut f32,
    ) -> Self {
        let mut jacobian = *jacobian;
        if let Some(driven) = driven.filter(|&driven| driven < MAX_CHAIN_JOINTS) {
            jacobian.column_mut(driven).fill(0.0);
        }
        let ratio = *sigma_min * (1.0 / DAMPED_BELOW);
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
        // Inverse iteration on J Jᵀ.
        let next = factors.solve(left_singular_vector);
        let size = math::norm(&next);
        if size.is_finite() && size > 0.0 {
            let square = 1.0 / size - damping;
            *left_singular_vector = next / size;
            *sigma_min = math::sqrt(if square > 0.0 { square } else { 0.0 });
        }
        Self { jacobian, factors }
    }

    /// Joint accelerations for the tool's `acceleration`, without the driven joint (Arm7 eq. 3).
    pub fn solve(&self, acceleration: &Vector6<f32>) -> JointVector {
        self.jacobian.tr_mul(&self.factors.solve(acceleration))
    }

    /// The wrench on the tool that best explains these joint `torques`, without the driven joint.
    pub fn wrench(&self, torques: &JointVector) -> Vector6<f32> {
        self.factors.solve(&(self.jacobian * torques))
    }

    /// Projects `motion` to the null space of the Jacobian: the part that does not move the tool.
    #[inline]
    pub fn project_to_null_space(&self, motion: &JointVector) -> JointVector {
        motion - self.solve(&(self.jacobian * motion))
    }
}
