//! Median and 95th percentile over machines, towards the worse side.

use anyhow::{Result, ensure};

use super::record::Sweep;
use super::rows::{Bound, Row};

/// A metric over the machines of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// Half of the machines are not worse. Infinite if half of them have no value.
    pub median: f64,
    /// 95 % of the machines are not worse.
    pub percentile_95: f64,
    /// Number of machines that meet the limit; `None` for a metric without one.
    pub met: Option<usize>,
    /// Number of machines that were run.
    pub machines: usize,
    /// Number of machines to which the scenario's limit does not apply.
    pub exempt: usize,
}

/// Returns the middle value, or the mean of the two middle ones.
pub fn median(ascending: &[f64]) -> f64 {
    let middle = ascending.len() / 2;
    if ascending.len().is_multiple_of(2) {
        0.5 * (ascending[middle - 1] + ascending[middle])
    } else {
        ascending[middle]
    }
}

/// Returns the smallest value that at least 95 % of the values do not exceed.
pub fn percentile_95(ascending: &[f64]) -> f64 {
    ascending[(ascending.len() * 95).div_ceil(100) - 1]
}

/// Computes the statistics of a row. A machine without a value counts as the worst, and as missing its limit.
///
/// # Errors
/// When the sweep has no machine or not this metric, or when the row's bound is not that of the scenario.
pub fn of(row: &Row, sweep: &Sweep) -> Result<Statistics> {
    let (index, metric) = sweep.metric(row.metric)?;
    ensure!(!sweep.machines.is_empty(), "{} was recorded without a machine", sweep.scenario);
    let (mut values, mut met, mut exempt) = (Vec::new(), 0, 0);
    for machine in &sweep.machines {
        let value = machine.values.get(index).copied().flatten();
        let is_exempt = machine.exempt.contains(&metric.name);
        let keeps = value.is_some() && !machine.missed.contains(&metric.name);
        if let (Some(value), Some(limit), false) = (value, metric.limit, is_exempt) {
            let near = (value.abs() - limit.abs()).abs() <= 1e-5 * limit.abs();
            let name = row.metric;
            ensure!(near || keeps == row.bound.keeps(value, limit), "{name} has another bound than its row");
        }
        met += usize::from(keeps && !is_exempt);
        exempt += usize::from(is_exempt);
        values.push(value.map_or(f64::INFINITY, |value| row.bound.badness(value)));
    }
    values.sort_by(f64::total_cmp);
    let sign = if row.bound == Bound::AtLeast { -1.0 } else { 1.0 };
    Ok(Statistics {
        median: sign * median(&values),
        percentile_95: sign * percentile_95(&values),
        met: metric.limit.map(|_| met),
        machines: values.len(),
        exempt,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, reason = "tests")]

    use super::*;
    use crate::sweep::record::fixtures::sweep;
    use crate::sweep::rows::fixtures::row;

    #[test]
    fn median_and_percentile_by_hand() {
        assert_eq!((median(&[3.0]), percentile_95(&[3.0])), (3.0, 3.0));
        assert_eq!((median(&[1.0, 4.0]), percentile_95(&[1.0, 4.0])), (2.5, 4.0));
        // 1, 2, …, 20: 95 % of twenty are 19.
        let twenty: Vec<f64> = (1..=20).map(f64::from).collect();
        assert_eq!((median(&twenty), percentile_95(&twenty)), (10.5, 19.0));
        // 95 % of 21 are 19.95: twenty.
        let more: Vec<f64> = (1..=21).map(f64::from).collect();
        assert_eq!((median(&more), percentile_95(&more)), (11.0, 20.0));
    }

    #[test]
    fn a_machine_without_a_value_is_the_worst_and_misses_the_limit() {
        let sweep = sweep(Some(1.0), &[Some(0.25), None, Some(0.75), Some(2.0)]);
        let expected =
            Statistics { median: 1.375, percentile_95: f64::INFINITY, met: Some(2), machines: 4, exempt: 0 };
        assert_eq!(of(&row(Bound::AtMost), &sweep).unwrap(), expected);
    }

    #[test]
    fn a_machine_of_which_the_limit_is_not_demanded_neither_meets_nor_misses_it() {
        let mut sweep = sweep(Some(1.0), &[Some(0.25), Some(3.0), Some(0.75)]);
        sweep.machines[1].missed.clear();
        sweep.machines[1].exempt.push("error".into());
        let expected = Statistics { median: 0.75, percentile_95: 3.0, met: Some(2), machines: 3, exempt: 1 };
        assert_eq!(of(&row(Bound::AtMost), &sweep).unwrap(), expected);
    }

    #[test]
    fn magnitudes_and_lower_bounds() {
        let signed = sweep(None, &[Some(-3.0), Some(1.0), Some(2.0)]);
        let expected = Statistics { median: 2.0, percentile_95: 3.0, met: None, machines: 3, exempt: 0 };
        assert_eq!(of(&row(Bound::Within), &signed).unwrap(), expected);
        // The worst of a value that should be large is the smallest one.
        let expected = Statistics { median: 1.0, percentile_95: -3.0, met: None, machines: 3, exempt: 0 };
        assert_eq!(of(&row(Bound::AtLeast), &signed).unwrap(), expected);
    }

    #[test]
    fn a_row_with_another_bound_than_the_scenario_is_found() {
        let sweep = sweep(Some(1.0), &[Some(0.25)]);
        assert!(of(&row(Bound::AtMost), &sweep).is_ok());
        assert!(of(&row(Bound::AtLeast), &sweep).unwrap_err().to_string().contains("another bound"));
        let unknown = Row { metric: "torque", ..row(Bound::AtMost) };
        assert!(of(&unknown, &sweep).unwrap_err().to_string().contains("no metric torque"));
    }
}
