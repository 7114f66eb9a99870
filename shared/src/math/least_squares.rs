use nalgebra::{SMatrix, SVector};

use super::{abs, norm, sqrt};

/// Sweeps of the Jacobi iteration. It converges quadratically, some six for 12 columns, and ends when no
/// rotation is left.
const SWEEPS: usize = 16;

/// Least squares over any number of rows, in constant memory: the triangular factor of `[A | b]`, to which
/// Givens rotations add one row after another (Golub and Van Loan, section 6.5.3). `AᵀA`, whose condition is
/// the square of that of `A`, is never formed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct IncrementalQr<const N: usize> {
    /// Upper triangle R.
    factor: SMatrix<f32, N, N>,
    /// Qᵀb.
    right: SVector<f32, N>,
    /// `‖b − Ax‖²` at the least-squares solution.
    residual: f32,
}

impl<const N: usize> IncrementalQr<N> {
    pub(crate) fn new() -> Self {
        Self { factor: SMatrix::zeros(), right: SVector::zeros(), residual: 0.0 }
    }

    /// Multiplies the weight of all rows so far, in the sum of squares.
    pub(crate) fn forget(&mut self, factor: f32) {
        let root = sqrt(factor);
        self.factor *= root;
        self.right *= root;
        self.residual *= factor;
    }

    /// Adds the equation `row · x = value`.
    pub(crate) fn add(&mut self, mut row: SVector<f32, N>, mut value: f32) {
        for k in 0..N {
            let (pivot, entry) = (self.factor[(k, k)], row[k]);
            let length = sqrt(pivot * pivot + entry * entry);
            // The length is also 0 if the square of the entry underflows.
            if entry == 0.0 || length == 0.0 {
                continue;
            }
            let (cosine, sine) = (pivot / length, entry / length);
            for column in k..N {
                let (upper, lower) = (self.factor[(k, column)], row[column]);
                self.factor[(k, column)] = cosine * upper + sine * lower;
                row[column] = cosine * lower - sine * upper;
            }
            let upper = self.right[k];
            self.right[k] = cosine * upper + sine * value;
            value = cosine * value - sine * upper;
        }
        self.residual += value * value;
    }

    /// Sum of squared residuals of the least-squares solution without truncation.
    pub(crate) const fn residual(&self) -> f32 {
        self.residual
    }

    /// Minimum-norm solution of the system without the singular values below `threshold`.
    pub(crate) fn solve(&self, threshold: f32) -> TruncatedSolution<N> {
        let svd = Svd::new(&self.factor);
        let (mut x, mut rank) = (SVector::zeros(), 0);
        for k in 0..N {
            let sigma = svd.values[k];
            if sigma > threshold && sigma > 0.0 {
                x += svd.right.column(k) * (svd.scaled.column(k).dot(&self.right) / (sigma * sigma));
                rank += 1;
            }
        }
        let residual = self.residual + (self.right - self.factor * x).norm_squared();
        TruncatedSolution { x, rank, residual, values: svd.values, directions: svd.right }
    }
}

/// Least squares by a truncated singular value decomposition.
pub(crate) struct TruncatedSolution<const N: usize> {
    pub x: SVector<f32, N>,
    /// Number of singular values that were kept; they come first.
    pub rank: usize,
    /// Sum of squared residuals.
    pub residual: f32,
    /// Singular values in descending order.
    pub values: SVector<f32, N>,
    /// Right singular vectors, in columns.
    pub directions: SMatrix<f32, N, N>,
}

/// Singular value decomposition `A V = U Σ` by one-sided Jacobi rotations (Golub and Van Loan, section
/// 8.6.3).
pub(crate) struct Svd<const N: usize> {
    /// `U Σ`: orthogonal columns whose lengths are the singular values.
    pub scaled: SMatrix<f32, N, N>,
    /// Singular values in descending order.
    pub values: SVector<f32, N>,
    /// `V`.
    pub right: SMatrix<f32, N, N>,
}

impl<const N: usize> Svd<N> {
    pub(crate) fn new(matrix: &SMatrix<f32, N, N>) -> Self {
        let (mut scaled, mut right) = (*matrix, SMatrix::<f32, N, N>::identity());
        for _ in 0..SWEEPS {
            let mut rotated = false;
            for p in 0..N {
                for q in p + 1..N {
                    let (a, b) = (scaled.column(p).norm_squared(), scaled.column(q).norm_squared());
                    let c = scaled.column(p).dot(&scaled.column(q));
                    if abs(c) <= 1e-7 * sqrt(a) * sqrt(b) || abs(c) < f32::MIN_POSITIVE {
                        continue;
                    }
                    rotated = true;
                    let zeta = (b - a) / (2.0 * c);
                    let root = abs(zeta) + sqrt(1.0 + zeta * zeta);
                    let tangent = if zeta < 0.0 { -1.0 / root } else { 1.0 / root };
                    let cosine = 1.0 / sqrt(1.0 + tangent * tangent);
                    rotate_columns(&mut scaled, p, q, cosine, cosine * tangent);
                    rotate_columns(&mut right, p, q, cosine, cosine * tangent);
                }
            }
            if !rotated {
                break;
            }
        }
        let mut values = SVector::<f32, N>::from_fn(|k, _| norm(&scaled.column(k)));
        for k in 0..N {
            let largest =
                (k..N).fold(k, |best, other| if values[other] > values[best] { other } else { best });
            values.swap_rows(k, largest);
            scaled.swap_columns(k, largest);
            right.swap_columns(k, largest);
        }
        Self { scaled, values, right }
    }
}

fn rotate_columns<const N: usize>(m: &mut SMatrix<f32, N, N>, p: usize, q: usize, cosine: f32, sine: f32) {
    for row in 0..N {
        let (first, second) = (m[(row, p)], m[(row, q)]);
        m[(row, p)] = cosine * first - sine * second;
        m[(row, q)] = sine * first + cosine * second;
    }
}
