use nalgebra::Matrix6;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::math::{abs, sqrt};

/// Elements of a symmetric 6 × 6 matrix below its diagonal.
pub(super) const ELEMENTS: usize = 15;
/// A coupling of two axes that is smaller than this, relative to the root of the product of their diagonal
/// elements, is negligible.
const NEGLIGIBLE: f32 = 1e-5;

/// Elements of the matrices of an [`Impedance`](super::Impedance) below their diagonals, row by row: (y, x),
/// (z, x), (z, y), and so on to (about z, about y). The matrices are symmetric.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ImpedanceCoupling {
    /// Elements of `M` [kg, kg·m, kg·m²].
    pub mass: [f32; ELEMENTS],
    /// Elements of `B` [N·s/m, N·s, N·m·s].
    pub damping: [f32; ELEMENTS],
    /// Elements of `K` [N/m, N, N·m].
    pub stiffness: [f32; ELEMENTS],
}

impl ImpedanceCoupling {
    /// No coupling.
    pub const NONE: Self =
        Self { mass: [0.0; ELEMENTS], damping: [0.0; ELEMENTS], stiffness: [0.0; ELEMENTS] };

    /// Moves all values by `fraction` of their difference to `goal`.
    pub(super) fn blend_towards(&mut self, goal: &Self, fraction: f32) {
        let own = self.mass.iter_mut().chain(&mut self.damping).chain(&mut self.stiffness);
        let goal = goal.mass.iter().chain(&goal.damping).chain(&goal.stiffness);
        own.zip(goal).for_each(|(own, goal)| *own += fraction * (goal - *own));
    }
}

/// Rows and columns of the elements.
fn places() -> impl Iterator<Item = (usize, usize)> {
    (1..6).flat_map(|row| (0..row).map(move |column| (row, column)))
}

/// The symmetric matrix with this diagonal and these elements below it.
pub(super) fn symmetric(diagonal: &[f32; 6], below: &[f32; ELEMENTS]) -> Matrix6<f32> {
    let mut matrix = Matrix6::from_diagonal(&(*diagonal).into());
    for ((row, column), &value) in places().zip(below) {
        for place in [(row, column), (column, row)] {
            if let Some(element) = matrix.get_mut(place) {
                *element = value;
            }
        }
    }
    matrix
}

/// Diagonal of a symmetric matrix, and the elements below it.
pub(super) fn split(matrix: &Matrix6<f32>) -> ([f32; 6], [f32; ELEMENTS]) {
    let mut below = [0.0; ELEMENTS];
    below.iter_mut().zip(places()).for_each(|(value, place)| *value = matrix[place]);
    (matrix.diagonal().into(), below)
}

/// Whether the elements `below` a `diagonal` are negligible.
pub(super) fn is_negligible(below: &[f32; ELEMENTS], diagonal: &[f32; 6]) -> bool {
    places().zip(below).all(|((row, column), value)| {
        let [a, b] = [row, column].map(|axis| diagonal.get(axis).copied().unwrap_or(0.0));
        abs(*value) <= NEGLIGIBLE * sqrt(a * b)
    })
}

/// The first pivot of the factorisation `L D Lᵀ` of a symmetric matrix that is less than `min`, with its row.
/// If there is none and `min` is not negative, all eigenvalues are positive.
pub(super) fn small_pivot(matrix: &Matrix6<f32>, min: f32) -> Option<(u8, f32)> {
    let mut rest = *matrix;
    for (axis, column) in (0_u8..).zip(0..6) {
        let pivot = rest[(column, column)];
        // NaN is rejected, too.
        if pivot.is_nan() || pivot < min || pivot <= 0.0 {
            return Some((axis, pivot));
        }
        for row in column + 1..6 {
            let factor = rest[(row, column)] / pivot;
            for other in column + 1..=row {
                rest[(row, other)] -= factor * rest[(other, column)];
            }
        }
    }
    None
}
