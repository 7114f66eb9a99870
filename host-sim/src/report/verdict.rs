//! The verdict on a run, for the page that shows it while it is computed.

use serde::Serialize;

use super::group::{groups, verdict_line};
use super::summary::Summary;

/// Results of a run as text.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether the run passed.
    pub pass: bool,
    /// Number of limits that were met.
    pub text: String,
    /// The quantities.
    pub rows: Vec<VerdictRow>,
}

/// A quantity with its limit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VerdictRow {
    /// Name.
    pub label: String,
    /// Measured value with unit.
    pub measured: String,
    /// Its limit; a dash for a value that is only reported.
    pub limit: String,
    /// Whether it meets its limit; `None` without one.
    pub pass: Option<bool>,
    /// A note on it.
    pub note: Option<String>,
}

impl Verdict {
    /// The verdict on a run.
    pub fn of(summary: &Summary) -> Self {
        let text = groups(std::slice::from_ref(summary)).first().map(verdict_line).unwrap_or_default();
        let row = |(_, metric): (&str, &super::Metric)| VerdictRow {
            label: metric.label.clone(),
            measured: metric.measured_text(),
            limit: metric.limit_text(),
            // A value that is not a number fails even without a limit.
            pass: (metric.limit.is_some() || !metric.pass()).then(|| metric.pass()),
            note: metric.note.clone(),
        };
        Self { pass: summary.pass(), text, rows: summary.metrics().map(row).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Metric;

    #[test]
    fn a_row_says_what_was_measured_and_whether_that_will_do() {
        let mut summary = Summary::new("hand3-servo", "native", 1)
            .metric("peak", Metric::at_most("Peak", 12.5, 12.0, "mrad"))
            .metric("torque", Metric::reported("Torque", 0.5, "N·m"))
            .metric("lost", Metric::reported("Lost", f64::NAN, ""))
            .metric("rise", Metric::at_least("Rise", 1.0, 2.0, "N"));
        summary.waive("rise", "the fingers are too weak");
        let verdict = Verdict::of(&summary);
        let passes: Vec<Option<bool>> = verdict.rows.iter().map(|row| row.pass).collect();
        assert_eq!((verdict.pass, passes), (false, vec![Some(false), None, Some(false), None]));
        assert_eq!(
            verdict.rows[0],
            VerdictRow {
                label: "Peak".to_owned(),
                measured: "12.5 mrad".to_owned(),
                limit: "≤ 12 mrad".to_owned(),
                pass: Some(false),
                note: None
            }
        );
        assert_eq!(verdict.rows[3].note.as_deref(), Some("no limit: the fingers are too weak"));
    }
}
