use core::fmt;

use nalgebra::{Matrix3, Vector3, Vector6};

use super::ContactForces;
use super::map::GraspMap;
use crate::math::{self, abs};

/// The least share of the sigma_max singular value at which the sigma_min counts.
const RANK_TOLERANCE: f32 = 1e-3;
/// Below this share of the sigma_max eigenvalue the sigma_min is split off.
const NEAR_LINE: f32 = 0.1;
/// The sigma_max share of a load that may be left over where the contacts resist it in no way.
const REST_TOLERANCE: f32 = 1e-4;
/// The inverse iteration multiplies by the 2ⁿth power of the inverse. What is left of other directions falls
/// by the ratio of the two sigma_min eigenvalues each time; at worst, the ratio being near 1, the singular
/// value is 0.1 % too large.
const SQUARES: usize = 8;

/// How well contacts resist loads: the singular values of the grasp map with moments about the contacts'
/// centroid and over [`GraspMap::length`], which makes them plain numbers that depend neither on the origin
/// nor on the axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditioning {
    /// 6, or 5 where the contacts are in one line and nothing resists a moment about it.
    pub rank: u8,
    /// The sigma_max singular value: √n for n contacts, that of the forces.
    pub sigma_max: f32,
    /// The sigma_min singular value, of the moment about `axis`: 0 in line; at best √(2n/3), for three
    /// contacts √(3/2).
    pub sigma_min: f32,
    /// The sigma_max over the sigma_min; infinite when the rank is 5.
    pub condition: f32,
    /// The axis, a unit vector, about which a moment is resisted worst: that of least distance from the
    /// contacts.
    pub axis: Vector3<f32>,
}

/// The pseudo-inverse of the grasp map: the contact forces of least sum of squares for a wrench, Hand3 (18).
///
/// About the centroid, `G Gᵀ` falls apart into `n` times the identity, for forces, and one 3 × 3 block for
/// moments. That block's weakest axis is found by inverse iteration. Near a line it is split off, and the
/// residual, always well conditioned, is inverted: there is no loss of digits near a line, and nothing to
/// divide by in one.
#[derive(Clone, Debug)]
pub struct WrenchInverse<'a> {
    map: &'a GraspMap,
    conditioning: Conditioning,
    /// Inverse of the moments' block; near a line without the axis.
    across: Matrix3<f32>,
    /// Near a line the inverse of the axis' eigenvalue, or 0 for one that does not count.
    along: f32,
}

/// Why there are no contact forces for a wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WrenchInverseError {
    /// The wrench is not finite.
    NotFinite,
    /// The contacts are in line and resist no moment about it.
    NotResisted {
        /// The line's direction.
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
        // The adjugate is the inverse but for a factor, and exists for contacts in line, too.
        let mut power = adjugate(&block);
        for _ in 0..SQUARES {
            let scale = 1.0 / power.trace();
            power = power * power * (scale * scale);
        }
        let axis = longest_column(&power);
        // From the distances of the contacts from the axis, with all digits.
        let sigma_min: f32 = self.levers.iter().map(|lever| axis.cross(lever).norm_squared()).sum();
        let sigma_max = math::sqrt(count);
        let full = sigma_min > RANK_TOLERANCE * RANK_TOLERANCE * count;
        // Far from a line the block has an inverse as it is. Near one the axis, then exact because the other
        // eigenvalues are far away, gets an eigenvalue as large as theirs, and its own is kept apart.
        let near = sigma_min < NEAR_LINE * count;
        let moved = if near { count - sigma_min } else { 0.0 };
        let outer = axis * axis.transpose();
        let filled = block + outer * moved;
        let cofactors = adjugate(&filled);
        let mut across = cofactors / filled.column(0).dot(&cofactors.column(0));
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
    /// Rank, sigma_min singular value, condition.
    pub const fn conditioning(&self) -> &Conditioning {
        &self.conditioning
    }

    /// `f = Gᵀ (G Gᵀ)⁻¹ w`: of all contact forces [N] that make `wrench` [N; N·m] the least ones. They may
    /// pull.
    ///
    /// # Errors
    /// The wrench is not finite, or nothing resists it.
    pub fn forces(&self, wrench: &Vector6<f32>) -> Result<ContactForces, WrenchInverseError> {
        if !wrench.sum().is_finite() {
            return Err(WrenchInverseError::NotFinite);
        }
        let (force, moment) = self.map.scaled(wrench);
        let axis = self.conditioning.axis;
        let about = axis.dot(&moment);
        let size = math::sqrt(force.norm_squared() + moment.norm_squared());
        if self.conditioning.rank < 6 && abs(about) > REST_TOLERANCE * size {
            return Err(WrenchInverseError::NotResisted { axis, moment: about * self.map.length });
        }
        let mut forces: ContactForces = self.map.levers.iter().map(|_| Vector3::zeros()).collect();
        // The second time for what rounding left of the first.
        for _ in 0..2 {
            let (made, turned) = self.map.scaled_sum(&forces);
            self.add(&(force - made), &(moment - turned), &mut forces);
        }
        Ok(forces)
    }

    /// Takes from `forces` [N] all that moves the object, so that `G f` = 0: the nearest internal forces.
    pub fn project_to_null_space(&self, forces: &mut [Vector3<f32>]) {
        for _ in 0..2 {
            let (made, turned) = self.map.scaled_sum(forces);
            self.add(&-made, &-turned, forces);
        }
    }

    /// Adds the least forces for a wrench about the centroid with its moment over the length.
    fn add(&self, force: &Vector3<f32>, moment: &Vector3<f32>, forces: &mut [Vector3<f32>]) {
        let axis = &self.conditioning.axis;
        let turn = self.across * moment + axis * (self.along * axis.dot(moment));
        let each = force / (self.conditioning.sigma_max * self.conditioning.sigma_max);
        for (lever, force) in self.map.levers.iter().zip(forces) {
            *force += each + turn.cross(lever);
        }
    }
}

/// The matrix of cofactors of a symmetric matrix.
fn adjugate(m: &Matrix3<f32>) -> Matrix3<f32> {
    let (a, b, c) = (m.column(0), m.column(1), m.column(2));
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

/// A unit vector.
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
                "the contacts are in line along ({}, {}, {}) and resist no moment about it; wanted are {moment} N·m",
                axis.x, axis.y, axis.z
            ),
        }
    }
}

impl core::error::Error for WrenchInverseError {}
