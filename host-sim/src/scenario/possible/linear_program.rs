//! Linear programs in standard form, by the simplex method.

use rapier3d::na::{DMatrix, DVector};

/// What counts as 0, of numbers of the order of 1: costs and values, and pivots.
const TOLERANCE: f64 = 1e-9;
const MIN_PIVOT: f64 = 1e-7;
/// Exchanges by the steepest descent, before Bland's rule, which is slower and does not cycle.
const STEEPEST: usize = 1000;

/// The `x ≥ 0` with `constraints · x = values` that has the smallest `costs · x`; `None` where no such `x`
/// exists, or the costs have no smallest value. Rows and columns should be scaled to the order of 1.
///
/// Two phases (Chvátal 1983, chapters 3 and 8).
pub fn minimize(
    constraints: &DMatrix<f64>,
    values: &DVector<f64>,
    costs: &DVector<f64>,
) -> Option<DVector<f64>> {
    let (rows, columns) = constraints.shape();
    // An artificial variable a row is the first basis; the last column holds the values.
    let mut tableau = DMatrix::zeros(rows, columns + rows + 1);
    for row in 0..rows {
        let sign = if values[row] < 0.0 { -1.0 } else { 1.0 };
        for column in 0..columns {
            tableau[(row, column)] = sign * constraints[(row, column)];
        }
        tableau[(row, columns + row)] = 1.0;
        tableau[(row, columns + rows)] = sign * values[row];
    }
    let mut basis: Vec<usize> = (columns..columns + rows).collect();
    let artificial = |column: usize| if column < columns { 0.0 } else { 1.0 };
    descend(&mut tableau, &mut basis, &artificial, columns + rows)?;
    let infeasibility: f64 =
        basis.iter().enumerate().map(|(row, &of)| artificial(of) * tableau[(row, columns + rows)]).sum();
    if infeasibility > TOLERANCE {
        return None;
    }
    // Artificial variables that are left in the basis are 0, and stay so: their columns cost more than
    // anything.
    let most = 1e6 * costs.amax().max(1.0);
    let cost = |column: usize| costs.get(column).copied().unwrap_or(most);
    descend(&mut tableau, &mut basis, &cost, columns)?;
    let mut solution = DVector::zeros(columns);
    for (row, &of) in basis.iter().enumerate().filter(|(_, of)| **of < columns) {
        solution[of] = tableau[(row, columns + rows)];
    }
    Some(solution)
}

/// Exchanges variables of the basis for the first `allowed` ones while the cost falls; `None` where it falls
/// for ever.
fn descend(
    tableau: &mut DMatrix<f64>,
    basis: &mut [usize],
    cost: &dyn Fn(usize) -> f64,
    allowed: usize,
) -> Option<()> {
    let last = tableau.ncols() - 1;
    for exchange in 0..10 * STEEPEST {
        let basic: Vec<f64> = basis.iter().map(|&of| cost(of)).collect();
        let falls = |column: &usize| {
            cost(*column) - basic.iter().zip(tableau.column(*column).iter()).map(|(c, v)| c * v).sum::<f64>()
        };
        let mut candidates =
            (0..allowed).map(|column| (column, falls(&column))).filter(|(_, falls)| *falls < -TOLERANCE);
        let enters = if exchange < STEEPEST {
            candidates.min_by(|(_, a), (_, b)| a.total_cmp(b))
        } else {
            candidates.next()
        };
        let Some((enters, _)) = enters else { return Some(()) };
        let ratio = |row: usize| tableau[(row, last)].max(0.0) / tableau[(row, enters)];
        let rows: Vec<usize> = (0..basis.len()).filter(|&row| tableau[(row, enters)] > MIN_PIVOT).collect();
        let least = rows.iter().map(|&row| ratio(row)).min_by(f64::total_cmp)?;
        // Of rows that are as good, the one with the largest pivot, for the sake of rounding; later the first
        // variable.
        let equal = rows.into_iter().filter(|&row| ratio(row) <= least + TOLERANCE);
        let leaves = if exchange < STEEPEST {
            equal.max_by(|&a, &b| tableau[(a, enters)].total_cmp(&tableau[(b, enters)]))?
        } else {
            equal.min_by_key(|&row| basis[row])?
        };
        let pivot = tableau[(leaves, enters)];
        tableau.row_mut(leaves).scale_mut(1.0 / pivot);
        let row = tableau.row(leaves).into_owned();
        for other in (0..basis.len()).filter(|&other| other != leaves) {
            let factor = tableau[(other, enters)];
            let mut changed = tableau.row_mut(other);
            changed -= &row * factor;
        }
        basis[leaves] = enters;
    }
    unreachable!("Bland's rule does not cycle")
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_program_by_hand() {
        // max 3x + 5y, x ≤ 4, 2y ≤ 12, 3x + 2y ≤ 18 (Hillier and Lieberman): x = 2, y = 6.
        let constraints = DMatrix::from_row_slice(
            3,
            5,
            &[1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 3.0, 2.0, 0.0, 0.0, 1.0],
        );
        let values = DVector::from_vec(vec![4.0, 12.0, 18.0]);
        let costs = DVector::from_vec(vec![-3.0, -5.0, 0.0, 0.0, 0.0]);
        let found = minimize(&constraints, &values, &costs).unwrap();
        assert!((found[0] - 2.0).abs() < 1e-12 && (found[1] - 6.0).abs() < 1e-12, "{found}");
    }

    #[test]
    fn what_has_no_solution_has_none() {
        let row = |values: &[f64]| DMatrix::from_row_slice(1, values.len(), values);
        let one = DVector::from_vec(vec![1.0]);
        // −x = 1; x − y = 1 with a cost that falls along x = y + 1.
        assert_eq!(minimize(&row(&[-1.0]), &one, &one), None);
        assert_eq!(minimize(&row(&[1.0, -1.0]), &one, &DVector::from_vec(vec![-1.0, 0.0])), None);
        // The same row twice leaves an artificial variable in the basis.
        let twice = DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, 1.0]);
        let costs = DVector::from_vec(vec![1.0, 2.0]);
        let found = minimize(&twice, &DVector::from_vec(vec![3.0, 3.0]), &costs).unwrap();
        assert_eq!(found.as_slice(), [3.0, 0.0]);
    }
}
