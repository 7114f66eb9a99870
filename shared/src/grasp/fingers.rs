use core::fmt;

use nalgebra::{Matrix3, Vector3, Vector6};

use crate::kinematics::Jacobian;
use crate::math::halves;
use crate::zip::zip;

/// Threshold of singularity: determinant of a finger's block over the product of its columns' norms.
const MIN_DETERMINANT: f32 = 1e-4;

/// Three fingers of three joints that hold an object: the block-diagonal matrix `D_F J_F`, 9 × 9.
#[derive(Clone, Debug, PartialEq)]
pub struct ThreeFingers {
    blocks: [Matrix3<f32>; 3],
}

/// A finger in a singular posture: straight, folded, or with the contact on its first axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SingularFinger {
    /// The finger, 0 to 2.
    pub finger: u8,
}

impl ThreeFingers {
    /// `fingers`: Jacobian of the tip, of which the first three columns are used, and lever `r` from the tip
    /// to the contact [m], in the axes of the Jacobian.
    ///
    /// `D_Fi = [1 −r^]` maps the tip's twist to the velocity of the contact: (Hand3 eq. 13) without the rows
    /// of the rotation, which a point contact does not constrain.
    pub fn new(fingers: &[(Jacobian, Vector3<f32>); 3]) -> Self {
        let block = |(jacobian, lever): &(Jacobian, Vector3<f32>)| {
            let mut block = Matrix3::zeros();
            // `D_Fi J_Fi`, without products with 0.
            for (mut column, joint) in block.column_iter_mut().zip(jacobian.column_iter()) {
                let (linear, angular) = (joint.fixed_rows::<3>(0), joint.fixed_rows::<3>(3));
                column.copy_from(&(linear + angular.cross(lever)));
            }
            block
        };
        Self { blocks: fingers.each_ref().map(block) }
    }

    /// `D_Fi J_Fi` of the three fingers [m/rad]: the contact velocities for the joint velocities (Hand3
    /// eq. 15).
    pub const fn blocks(&self) -> &[Matrix3<f32>; 3] {
        &self.blocks
    }

    /// `(D_F J_F)ᵀ f` (Hand3 eq. 16): the joint torques [N·m] of each finger that exert `forces` [N] on the
    /// object.
    #[inline(never)]
    pub fn torques(&self, forces: &[Vector3<f32>; 3]) -> [Vector3<f32>; 3] {
        let [a, b, c] = &self.blocks;
        let [f, g, h] = forces;
        [a.tr_mul(f), b.tr_mul(g), c.tr_mul(h)]
    }

    /// `(D_F J_F)⁻¹ D_o V` (Hand3 eq. 22, 23): joint velocities [rad/s] that follow an object with `twist`
    /// [m/s; rad/s] and contacts at `levers` [m] from its origin.
    ///
    /// # Errors
    /// A finger in a singular posture.
    pub fn joint_velocities(
        &self,
        levers: &[Vector3<f32>; 3],
        twist: &Vector6<f32>,
    ) -> Result<[Vector3<f32>; 3], SingularFinger> {
        let [linear, angular] = halves(twist);
        let mut joints = [Vector3::zeros(); 3];
        for (finger, block, lever, joints) in zip((0.., &self.blocks, levers, &mut joints)) {
            let velocity = linear + angular.cross(lever);
            *joints = solve(block, &velocity).ok_or(SingularFinger { finger })?;
        }
        Ok(joints)
    }
}

/// Solves by Cramer's rule; `None` for a singular matrix or one that is not finite.
fn solve(matrix: &Matrix3<f32>, right: &Vector3<f32>) -> Option<Vector3<f32>> {
    let (a, b, c) = (matrix.column(0), matrix.column(1), matrix.column(2));
    let across = b.cross(&c);
    let determinant = a.dot(&across);
    // Squares need no roots.
    let product = a.norm_squared() * b.norm_squared() * c.norm_squared();
    let regular = determinant * determinant > MIN_DETERMINANT * MIN_DETERMINANT * product;
    let inverse = 1.0 / determinant;
    regular.then(|| Vector3::new(across.dot(right), c.cross(&a).dot(right), a.cross(&b).dot(right)) * inverse)
}

impl fmt::Display for SingularFinger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "finger {} is in a singular posture", self.finger + 1)
    }
}

impl core::error::Error for SingularFinger {}
