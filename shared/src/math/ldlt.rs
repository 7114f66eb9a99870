use nalgebra::{SMatrix, SVector};

/// LDLᵀ factorisation of a symmetric positive definite matrix. Reads the lower triangle only.
pub(crate) struct Ldlt<const M: usize> {
    /// L below the diagonal.
    lower: SMatrix<f32, M, M>,
    /// Inverse of D.
    inverse: SVector<f32, M>,
}

impl<const M: usize> Ldlt<M> {
    /// Pivots below `min_pivot` are replaced by it: rounding can make the last pivot of a nearly singular
    /// matrix negative.
    #[inline]
    pub(crate) fn new(matrix: &SMatrix<f32, M, M>, min_pivot: f32) -> Self {
        let mut lower = *matrix;
        let mut inverse = SVector::<f32, M>::zeros();
        for column in 0..M {
            let mut pivot = lower[(column, column)];
            for k in 0..column {
                let l = lower[(column, k)];
                // Not yet divided by D: l = L·D.
                pivot -= l * l * inverse[k];
            }
            // A NaN pivot is replaced too.
            inverse[column] = 1.0 / if pivot > min_pivot { pivot } else { min_pivot };
            for row in column + 1..M {
                let mut value = lower[(row, column)];
                for k in 0..column {
                    value -= lower[(row, k)] * lower[(column, k)] * inverse[k];
                }
                lower[(row, column)] = value;
            }
        }
        for column in 0..M {
            for row in column + 1..M {
                lower[(row, column)] *= inverse[column];
            }
        }
        Self { lower, inverse }
    }

    #[inline]
    pub(crate) fn solve(&self, right: &SVector<f32, M>) -> SVector<f32, M> {
        let mut x = *right;
        for row in 0..M {
            for k in 0..row {
                x[row] -= self.lower[(row, k)] * x[k];
            }
        }
        for row in (0..M).rev() {
            x[row] *= self.inverse[row];
            for k in row + 1..M {
                x[row] -= self.lower[(k, row)] * x[k];
            }
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_solution_satisfies_the_equation() {
        let lower = SMatrix::<f32, 3, 3>::new(2.0, 0.0, 0.0, 1.0, 3.0, 0.0, -1.0, 0.5, 1.0);
        let (matrix, x) = (lower * lower.transpose(), SVector::<f32, 3>::new(1.0, -2.0, 3.0));
        assert!((Ldlt::new(&matrix, 1e-6).solve(&(matrix * x)) - x).norm() < 1e-5);
        // The upper triangle is not read; a singular matrix gives a finite result.
        let zero = SMatrix::<f32, 3, 3>::zeros();
        assert!(Ldlt::new(&zero, 1e-6).solve(&x).iter().all(|x| x.is_finite()));
    }
}
