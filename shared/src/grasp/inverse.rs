use core::fmt;

use nalgebra::{Matrix3, Vector3, Vector6};

use super::ContactForces;
use super::map::GraspMap;
use crate::collect::collect;
use crate::math::{self, abs};

/// Relative tolerance of the rank: singular values below this fraction of the largest count as 0.
const RANK_TOLERANCE: f32 = 1e-3;
/// Contacts count as nearly collinear when the smallest eigenvalue is below this fraction of the largest.
const NEAR_LINE: f32 = 0.1;
/// Tolerance of an unresisted moment over the load, for collinear contacts.
const AXIAL_TOLERANCE: f32 = 1e-4;
/// Squarings of the inverse in the power iteration. Each squares the ratio of the two smallest eigenvalues;
/// in the worst case, a ratio near 1, the singular value is 0.1 % too large.
const SQUARES: usize = 8;

/// Conditioning of the grasp: singular values of the grasp map about the contacts' centroid with moments over
/// [`GraspMap::length`], independent of origin and axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditioning {
    /// 6, or 5 for collinear contacts, which resist no moment about their line.
    pub rank: u8,
    /// Largest singular value: √n for n contacts.
    pub sigma_max: f32,
    /// Smallest singular value: 0 for collinear contacts, at most √(2n/3).
    pub sigma_min: f32,
    /// `sigma_max`/`sigma_min`; infinite for rank 5.
    pub condition: f32,
    /// Unit vector of the moment with the least resistance: the angular part of the left singular vector of
    /// `sigma_min`.
    pub axis: Vector3<f32>,
}

/// Pseudo-inverse of the grasp map: the contact forces of minimum norm for a wrench (Hand3 eq. 18).
///
/// About the centroid, `G Gᵀ` is block diagonal: `n` times the identity for forces and a 3 × 3 block for
/// moments, whose smallest eigenvector is found by inverse iteration. For nearly collinear contacts this
/// eigenvector is deflated and the well-conditioned remainder is inverted, so no significant digits are lost.
#[derive(Clone, Debug)]
pub struct WrenchInverse<'a> {
    map: &'a GraspMap,
    conditioning: Conditioning,
    /// Inverse of the moments' block; deflated for nearly collinear contacts.
    across: Matrix3<f32>,
    /// Inverse of the deflated eigenvalue, or 0 if it is below the rank tolerance.
    along: f32,
}

/// Why there are no contact forces for a wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WrenchInverseError {
    /// The wrench is not finite.
    NotFinite,
    /// The contacts are collinear and resist no moment about their line.
    NotResisted {
        /// Direction of the line.
        axis: Vector3<f32>,
        /// The wrench's moment about it [N·m].
        moment: f32,
    },
}

impl GraspMap {
    /// The pseudo-inverse of the grasp map, with its rank and condition.
    pub fn inverse(&self) -> WrenchInverse<'_> {
        let mut block = Matrix3::zeros();
        for lever in &self.levers {
            // (r^)(r^)ᵀ = |r|² 1 − r rᵀ
            block -= lever * lever.transpose();
        }
        #[expect(clippy::cast_precision_loss, reason = "2 to 6")]
        let count = self.levers.len() as f32;
        let spread = -block.trace();
        block += Matrix3::from_diagonal_element(spread);
        // The adjugate is a multiple of the inverse and exists for collinear contacts too.
        let mut power = adjugate(&block);
        for _ in 0..SQUARES {
            let scale = 1.0 / power.trace();
            power = power * power * (scale * scale);
        }
        let axis = longest_column(&power);
        // From the distances to the axis: without cancellation.
        let sigma_min: f32 = self.levers.iter().map(|lever| axis.cross(lever).norm_squared()).sum();
        let sigma_max = math::sqrt(count);
        let full = sigma_min > RANK_TOLERANCE * RANK_TOLERANCE * count;
        // Away from collinearity the block is inverted as it is. Otherwise the eigenvector is deflated: its
        // eigenvalue is replaced by one as large as the others and handled separately.
        let near = sigma_min < NEAR_LINE * count;
        let shift = if near { count - sigma_min } else { 0.0 };
        let outer = axis * axis.transpose();
        let deflated = block + outer * shift;
        let cofactors = adjugate(&deflated);
        let mut across = cofactors / deflated.column(0).dot(&cofactors.column(0));
        if near {
            across -= outer / count;
        }
        let along = if near && full { 1.0 / sigma_min } else { 0.0 };
        let root = math::sqrt(sigma_min);
        let conditioning = Conditioning {
            rank: if full { 6 } else { 5 },
            sigma_max,
            sigma_min: root,
            condition: if full { sigma_max / root } else { f32::INFINITY },
            axis,
        };
        WrenchInverse { map: self, conditioning, across, along }
    }
}

impl WrenchInverse<'_> {
    /// Rank, singular values and condition number.
    pub const fn conditioning(&self) -> &Conditioning {
        &self.conditioning
    }

    /// `f = Gᵀ (G Gᵀ)⁻¹ w`: the contact forces [N] of minimum norm for `wrench` [N; N·m]. Their normal parts
    /// may be negative.
    ///
    /// # Errors
    /// The wrench is not finite, or collinear contacts do not resist it.
    pub fn forces(&self, wrench: &Vector6<f32>) -> Result<ContactForces, WrenchInverseError> {
        if !wrench.sum().is_finite() {
            return Err(WrenchInverseError::NotFinite);
        }
        let (force, moment) = self.map.scaled(wrench);
        let axis = self.conditioning.axis;
        let axial = axis.dot(&moment);
        let norm = math::sqrt(force.norm_squared() + moment.norm_squared());
        if self.conditioning.rank < 6 && abs(axial) > AXIAL_TOLERANCE * norm {
            return Err(WrenchInverseError::NotResisted { axis, moment: axial * self.map.length });
        }
        let mut forces: ContactForces = collect(self.map.levers.iter().map(|_| Vector3::zeros()));
        // One step of iterative refinement.
        for _ in 0..2 {
            let (force_sum, moment_sum) = self.map.scaled_sum(&forces);
            self.add(&(force - force_sum), &(moment - moment_sum), &mut forces);
        }
        Ok(forces)
    }

    /// Projects `forces` [N] orthogonally onto the null space of `G`: the nearest internal forces.
    #[inline(never)]
    pub fn project_to_null_space(&self, forces: &mut [Vector3<f32>]) {
        for _ in 0..2 {
            let (force_sum, moment_sum) = self.map.scaled_sum(forces);
            self.add(&-force_sum, &-moment_sum, forces);
        }
    }

    /// Adds the minimum-norm forces for a wrench about the centroid, with its moment over the length.
    #[inline(never)]
    fn add(&self, force: &Vector3<f32>, moment: &Vector3<f32>, forces: &mut [Vector3<f32>]) {
        let axis = &self.conditioning.axis;
        let rotational = self.across * moment + axis * (self.along * axis.dot(moment));
        let each = force / (self.conditioning.sigma_max * self.conditioning.sigma_max);
        for (lever, force) in self.map.levers.iter().zip(forces) {
            *force += each + rotational.cross(lever);
        }
    }
}

/// The matrix of cofactors of a symmetric matrix.
fn adjugate(m: &Matrix3<f32>) -> Matrix3<f32> {
    let (a, b, c) = (m.column(0), m.column(1), m.column(2));
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

/// The column of largest norm, normalised.
fn longest_column(m: &Matrix3<f32>) -> Vector3<f32> {
    let [a, b, c] = [0, 1, 2].map(|index| m.column(index).norm_squared());
    let (column, square) = if a >= b && a >= c {
        (m.column(0), a)
    } else if b >= c {
        (m.column(1), b)
    } else {
        (m.column(2), c)
    };
    column / math::sqrt(square)
}

impl fmt::Display for WrenchInverseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "the wrench is not finite"),
            Self::NotResisted { axis, moment } => write!(
                f,
                "the contacts are collinear along ({}, {}, {}) and resist no moment about it; the load has \
                 {moment} N·m",
                axis.x, axis.y, axis.z
            ),
        }
    }
}

impl core::error::Error for WrenchInverseError {}
