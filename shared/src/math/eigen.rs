use nalgebra::SMatrix;

use super::{abs, inlined_sqrt};

/// Sweeps of Jacobi's method; it converges quadratically, and for 6 × 6 matrices six are enough in single
/// precision.
const SWEEPS: usize = 6;

/// Eigenvectors of a symmetric matrix, in columns, by Jacobi's method. It leaves the eigenvalues on the
/// diagonal of `matrix`.
pub(crate) fn diagonalize<const N: usize>(matrix: &mut SMatrix<f32, N, N>) -> SMatrix<f32, N, N> {
    let mut vectors = SMatrix::identity();
    for _ in 0..SWEEPS {
        for p in 0..N {
            for q in p + 1..N {
                let off = matrix[(p, q)];
                if abs(off) <= f32::MIN_POSITIVE {
                    continue;
                }
                // The smaller rotation that makes this element 0.
                let ratio = (matrix[(q, q)] - matrix[(p, p)]) / (2.0 * off);
                let size = abs(ratio);
                let root = if size < 1e6 { inlined_sqrt(ratio * ratio + 1.0) } else { size };
                let tangent = (1.0 / (size + root)).copysign(ratio);
                let cosine = 1.0 / inlined_sqrt(tangent * tangent + 1.0);
                let sine = tangent * cosine;
                let rotate = |a: f32, b: f32| (cosine * a - sine * b, sine * a + cosine * b);
                for k in 0..N {
                    (matrix[(k, p)], matrix[(k, q)]) = rotate(matrix[(k, p)], matrix[(k, q)]);
                }
                for k in 0..N {
                    (matrix[(p, k)], matrix[(q, k)]) = rotate(matrix[(p, k)], matrix[(q, k)]);
                    (vectors[(k, p)], vectors[(k, q)]) = rotate(vectors[(k, p)], vectors[(k, q)]);
                }
            }
        }
    }
    vectors
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;

    /// Eigenvalues 1, 2 and 4 about axes at 3-4-5 angles; and all the same.
    #[test]
    fn a_symmetric_matrix_is_diagonalised() {
        let axes = Matrix3::new(0.6, -0.8, 0.0, 0.8, 0.6, 0.0, 0.0, 0.0, 1.0)
            * Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.8, -0.6, 0.0, 0.6, 0.8);
        for scale in [1.0, 1e-6] {
            let matrix =
                axes * Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 4.0)) * axes.transpose() * scale;
            let mut values = matrix;
            let vectors = diagonalize(&mut values);
            let mut sorted: [f32; 3] = (values.diagonal() / scale).into();
            sorted.sort_by(f32::total_cmp);
            for (value, expected) in sorted.into_iter().zip([1.0, 2.0, 4.0]) {
                assert!((value - expected).abs() < 1e-5, "{value}");
            }
            let again = vectors * Matrix3::from_diagonal(&values.diagonal()) * vectors.transpose();
            assert!((again - matrix).norm() < 1e-5 * scale, "{again}");
        }
        let mut round = Matrix3::identity() * 3.0;
        assert_eq!((diagonalize(&mut round), round), (Matrix3::identity(), Matrix3::identity() * 3.0));
    }
}
