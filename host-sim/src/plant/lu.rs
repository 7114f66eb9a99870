//! Solution of linear equations, with the same operations in the same order as nalgebra's `LU`.

/// A square matrix in column-major order, and its factors.
pub struct Lu {
    size: usize,
    matrix: Vec<f32>,
    factors: Vec<f32>,
    /// Rows that were swapped, in order.
    swaps: Vec<(usize, usize)>,
}

impl Lu {
    pub fn new(size: usize) -> Self {
        let zeros = || vec![0.0; size * size];
        Self { size, matrix: zeros(), factors: zeros(), swaps: Vec::with_capacity(size) }
    }

    /// The matrix, in column-major order.
    pub fn matrix(&self) -> &[f32] {
        &self.matrix
    }

    /// The matrix, in column-major order.
    pub fn matrix_mut(&mut self) -> &mut [f32] {
        &mut self.matrix
    }

    /// Factorises the matrix, with row pivoting.
    pub fn factorise(&mut self) {
        let size = self.size;
        self.factors.copy_from_slice(&self.matrix);
        self.swaps.clear();
        let factors = &mut self.factors;
        for step in 0..size {
            let column = &factors[step * size..][..size];
            let mut pivot = step;
            for row in step + 1..size {
                if column[row].abs() > column[pivot].abs() {
                    pivot = row;
                }
            }
            let diagonal = column[pivot];
            if diagonal == 0.0 {
                continue;
            }
            if pivot != step {
                self.swaps.push((step, pivot));
                factors.chunks_exact_mut(size).for_each(|column| column.swap(step, pivot));
            }
            let inverse = 1.0 / diagonal;
            let (done, rest) = factors.split_at_mut((step + 1) * size);
            let coefficients = &mut done[step * size..][step + 1..size];
            coefficients.iter_mut().for_each(|coefficient| *coefficient *= inverse);
            for column in rest.chunks_exact_mut(size) {
                let (upper, lower) = column.split_at_mut(step + 1);
                add_scaled(lower, -upper[step], coefficients);
            }
        }
    }

    /// Solves for one right-hand side, in place; if the matrix is singular, the solution is incomplete.
    pub fn solve(&self, right: &mut [f32]) {
        let size = self.size;
        for &(one, other) in &self.swaps {
            right.swap(one, other);
        }
        for (step, column) in self.factors.chunks_exact(size).enumerate() {
            let (upper, lower) = right.split_at_mut(step + 1);
            // Most entries of the right-hand sides are 0.
            if upper[step] != 0.0 {
                add_scaled(lower, -upper[step], &column[step + 1..]);
            }
        }
        for (step, column) in self.factors.chunks_exact(size).enumerate().rev() {
            if column[step] == 0.0 {
                return;
            }
            let solution = right[step] / column[step];
            right[step] = solution;
            add_scaled(&mut right[..step], -solution, &column[..step]);
        }
    }
}

/// Adds `factor` times `vector` to `sum`.
pub fn add_scaled(sum: &mut [f32], factor: f32, vector: &[f32]) {
    for (sum, value) in sum.iter_mut().zip(vector) {
        *sum += factor * value;
    }
}

/// Computes the scalar product, with eight partial sums.
pub fn dot(one: &[f32], other: &[f32]) -> f32 {
    let (chunks, others) = (one.chunks_exact(8), other.chunks_exact(8));
    let rest = chunks.remainder().iter().zip(others.remainder());
    let mut sums = [0.0; 8];
    for (one, other) in chunks.zip(others) {
        for (sum, (one, other)) in sums.iter_mut().zip(one.iter().zip(other)) {
            *sum += one * other;
        }
    }
    let mut sum = 0.0;
    for half in 0..4 {
        sum += sums[half] + sums[half + 4];
    }
    rest.fold(sum, |sum, (one, other)| sum + one * other)
}
