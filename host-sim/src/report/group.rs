//! The runs of several seeds of one scenario as a group.

use super::number;
use super::summary::{Bound, Metric, Summary};

/// The runs of one scenario on one controller, in the order of their seeds as given.
pub(super) struct Group<'a> {
    pub runs: Vec<&'a Summary>,
}

/// One metric over the runs of a group. If some of them have no limit for it, because they leave no room for
/// it, median and worst value are those of the others.
pub(super) struct Row<'a> {
    /// That of a run with a limit, if there is one.
    pub metric: &'a Metric,
    /// The values in the order of the runs; `None` if a run lacks the metric.
    pub values: Vec<Option<&'a Metric>>,
    pub median: f64,
    pub worst: &'a Metric,
    pub worst_seed: u64,
    /// Number of runs whose value passes.
    pub passed: usize,
    /// The note on the worst value, and why some runs have no limit.
    pub notes: Vec<String>,
}

/// Groups `summaries` by scenario and controller.
pub(super) fn groups(summaries: &[Summary]) -> Vec<Group<'_>> {
    let mut groups: Vec<Group> = Vec::new();
    for run in summaries {
        let same =
            |g: &&mut Group| g.runs[0].scenario == run.scenario && g.runs[0].controller == run.controller;
        match groups.iter_mut().find(same) {
            Some(group) => group.runs.push(run),
            None => groups.push(Group { runs: vec![run] }),
        }
    }
    groups
}

impl<'a> Group<'a> {
    /// Returns its metrics, in the order in which they first appear.
    pub fn rows(&self) -> Vec<Row<'a>> {
        let mut names: Vec<&str> = Vec::new();
        for (name, _) in self.runs.iter().flat_map(|run| run.metrics()) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names.into_iter().filter_map(|name| self.row(name)).collect()
    }

    fn row(&self, name: &str) -> Option<Row<'a>> {
        let values: Vec<Option<&Metric>> = self.runs.iter().map(|run| run.get(name)).collect();
        let found = || self.runs.iter().zip(&values).filter_map(|(run, value)| value.map(|v| (*run, v)));
        let limited = found().any(|(_, m)| m.limit.is_some());
        let judged = || found().filter(|(_, m)| m.limit.is_some() == limited);
        let (_, metric) = judged().next()?;
        let (run, worst) = judged().reduce(|a, b| if b.1.badness() > a.1.badness() { b } else { a })?;
        let mut notes: Vec<String> = worst.note.iter().cloned().collect();
        let mut waived: Vec<(&str, Vec<&Summary>)> = Vec::new();
        for (run, metric) in found().filter(|(_, m)| limited && m.limit.is_none()) {
            let note = metric.note.as_deref().unwrap_or("no limit");
            match waived.iter_mut().find(|(known, _)| *known == note) {
                Some((_, runs)) => runs.push(run),
                None => waived.push((note, vec![run])),
            }
        }
        let named =
            |runs: &[&Summary]| format!("seed{} {}", if runs.len() > 1 { "s" } else { "" }, seeds(runs));
        notes.extend(waived.iter().map(|(note, runs)| format!("{}: {note}", named(runs))));
        // As in the published tables, a run without a value is worse than all others.
        let worst_value = if metric.bound == Bound::AtLeast { f64::NEG_INFINITY } else { f64::INFINITY };
        let missing = values.iter().filter(|value| value.is_none()).map(|_| worst_value);
        let finite = |value: f64| if value.is_finite() { value } else { worst_value };
        let mut sorted: Vec<f64> = judged().map(|(_, m)| finite(m.value)).chain(missing).collect();
        sorted.sort_by(f64::total_cmp);
        let middle = sorted.len() / 2;
        let median = match sorted.len() {
            n if n % 2 == 1 => sorted[middle],
            _ => f64::midpoint(sorted[middle - 1], sorted[middle]),
        };
        let passed = found().filter(|(_, m)| m.pass()).count();
        Some(Row { metric, median, worst, worst_seed: run.seed, passed, values, notes })
    }

    /// Whether image and native controller agreed in all runs; `None` if they were not compared.
    pub fn identical(&self) -> Option<bool> {
        self.runs.iter().filter_map(|run| run.identical).reduce(|a, b| a && b)
    }

    /// Whether every run passes.
    pub fn pass(&self) -> bool {
        self.runs.iter().all(|run| run.pass())
    }
}

impl Row<'_> {
    /// Whether every run has the value and it passes.
    pub fn pass(&self) -> bool {
        self.passed == self.values.len()
    }

    /// Returns `pass`, `FAIL`, `reported`, with the number of failing seeds if there are several.
    pub fn verdict(&self) -> String {
        match (self.pass(), self.metric.limit) {
            (true, Some(_)) => "✓ pass".into(),
            (true, None) => "· reported".into(),
            (false, _) if self.values.len() > 1 => {
                format!("✗ FAIL {}/{}", self.values.len() - self.passed, self.values.len())
            }
            (false, _) => "✗ FAIL".into(),
        }
    }

    /// Returns the median over the seeds, with its unit.
    pub fn median_text(&self) -> String {
        number::with_unit(&number::significant(self.median, 3), &self.metric.unit)
    }
}

/// Returns `PASS`, `FAIL`, or `DONE` where nothing has a limit and nothing failed.
pub(super) fn verdict_word(group: &Group<'_>) -> &'static str {
    match group.pass() {
        false => "FAIL",
        true if group.rows().iter().all(|row| row.metric.limit.is_none()) => "DONE",
        true => "PASS",
    }
}

/// Returns `6 of 7 limits met`, and the other criteria.
pub(super) fn verdict_line(group: &Group<'_>) -> String {
    let rows = group.rows();
    let limits = rows.iter().filter(|r| r.metric.limit.is_some()).count();
    let met = rows.iter().filter(|r| r.metric.limit.is_some() && r.pass()).count();
    let mut parts = match (rows.len(), limits) {
        (0, _) => vec!["no metrics".to_owned()],
        (_, 0) => vec!["reported only, no limits".to_owned()],
        _ => vec![format!("{met} of {limits} limits met")],
    };
    if group.runs.len() > 1 {
        let passed = group.runs.iter().filter(|run| run.pass()).count();
        parts.push(format!("{passed} of {} seeds pass", group.runs.len()));
    }
    if group.identical() == Some(false) {
        parts.push("image and native controller differ".to_owned());
    }
    parts.join(", ")
}

/// Formats the seeds: `1`, `1–20`, or `1, 3, 7`.
pub(super) fn seeds(runs: &[&Summary]) -> String {
    let seeds: Vec<u64> = runs.iter().map(|run| run.seed).collect();
    let consecutive = seeds.windows(2).all(|w| w[0].checked_add(1) == Some(w[1]));
    match seeds.as_slice() {
        [one] => one.to_string(),
        [first, .., last] if consecutive => format!("{first}–{last}"),
        _ => seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", "),
    }
}

/// Formats the ticks: `600`, `20 × 600`, or the sum if the runs differ in length.
pub(super) fn ticks(runs: &[&Summary]) -> String {
    match runs {
        [one] => one.ticks.to_string(),
        [first, rest @ ..] if rest.iter().all(|run| run.ticks == first.ticks) => {
            format!("{} × {}", runs.len(), first.ticks)
        }
        _ => runs.iter().map(|run| run.ticks).sum::<u64>().to_string(),
    }
}
