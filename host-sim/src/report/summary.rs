//! Measured values and their limits.

use serde::ser::{Serialize, SerializeMap, SerializeStruct, Serializer};

use super::number;

/// Side of the limit on which a value must be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bound {
    /// `value ≤ limit`, including the sign.
    #[default]
    AtMost,
    /// `value ≥ limit`.
    AtLeast,
    /// `|value| ≤ limit`.
    Within,
}

/// A measured value and its limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Name for people.
    pub label: String,
    /// The value in `unit`.
    pub value: f64,
    /// The unit of `value` and `limit`; empty for counts and ratios.
    pub unit: String,
    /// The limit; `None` for a value that is only reported.
    pub limit: Option<f64>,
    /// How `limit` applies.
    pub bound: Bound,
    /// The paper's value, as printed (`1–2 mm`).
    pub paper: Option<String>,
    /// A note on this row. Not in the JSON.
    pub note: Option<String>,
}

impl Metric {
    /// Creates a value that is only reported.
    pub fn reported(label: impl Into<String>, value: f64, unit: impl Into<String>) -> Self {
        Self {
            label: label.into(),
            value,
            unit: unit.into(),
            limit: None,
            bound: Bound::AtMost,
            paper: None,
            note: None,
        }
    }

    /// Creates a value that must be `limit` or less; for a signed one see [`Metric::within`].
    pub fn at_most(label: impl Into<String>, value: f64, limit: f64, unit: impl Into<String>) -> Self {
        Self { limit: Some(limit), ..Self::reported(label, value, unit) }
    }

    /// Creates a value that must be `limit` or more.
    pub fn at_least(label: impl Into<String>, value: f64, limit: f64, unit: impl Into<String>) -> Self {
        Self { limit: Some(limit), bound: Bound::AtLeast, ..Self::reported(label, value, unit) }
    }

    /// Creates a value that must lie between `-limit` and `limit`.
    pub fn within(label: impl Into<String>, value: f64, limit: f64, unit: impl Into<String>) -> Self {
        Self { limit: Some(limit), bound: Bound::Within, ..Self::reported(label, value, unit) }
    }

    /// Adds the paper's value.
    #[must_use]
    pub fn paper(mut self, paper: impl Into<String>) -> Self {
        self.paper = Some(paper.into());
        self
    }

    /// Adds a note.
    #[must_use]
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.note = Some(note.into());
        self
    }

    /// Returns whether the value is finite and meets its limit, if it has one.
    pub fn pass(&self) -> bool {
        self.value.is_finite()
            && self.limit.is_none_or(|limit| {
                limit.is_finite()
                    && match self.bound {
                        Bound::AtMost => self.value <= limit,
                        Bound::AtLeast => self.value >= limit,
                        Bound::Within => self.value.abs() <= limit,
                    }
            })
    }

    /// Severity of a value: larger if it is farther beyond its limit. A value that is not finite is the
    /// worst.
    pub(super) fn badness(&self) -> f64 {
        match self.bound {
            _ if !self.value.is_finite() => f64::INFINITY,
            _ if self.limit.is_none() => self.value.abs(),
            Bound::AtMost => self.value,
            Bound::AtLeast => -self.value,
            Bound::Within => self.value.abs(),
        }
    }

    /// Formats the limit, such as `≤ 12 mrad`; an en dash for a value that is only reported.
    pub(super) fn limit_text(&self) -> String {
        let sign = match self.bound {
            Bound::AtMost => "≤ ",
            Bound::AtLeast => "≥ ",
            Bound::Within => "±",
        };
        self.limit.map_or_else(
            || "–".to_owned(),
            |limit| format!("{sign}{}", number::with_unit(&number::exact(limit), &self.unit)),
        )
    }

    /// Formats the value, such as `8.31 mrad`.
    pub(super) fn measured_text(&self) -> String {
        number::with_unit(&number::measured(self.value, self.limit), &self.unit)
    }
}

impl Serialize for Metric {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut s = serializer.serialize_struct("Metric", 4 + usize::from(self.paper.is_some()))?;
        s.serialize_field("value", &self.value)?;
        s.serialize_field("unit", &self.unit)?;
        s.serialize_field("limit", &self.limit)?;
        match &self.paper {
            Some(paper) => s.serialize_field("paper", paper)?,
            None => s.skip_field("paper")?,
        }
        s.serialize_field("pass", &self.pass())?;
        s.end()
    }
}

/// Result of one run with one seed.
///
/// As JSON: `{"scenario", "controller", "seed", "ticks", "frames_sha256"?, "elf_sha256"?, "identical"?,
/// "metrics": {name: {"value", "unit", "limit", "paper"?, "pass"}}, "pass"}`, with the metrics in the order
/// in which they were added, the fields marked `?` left out where there is nothing to say, and `null` for a
/// value that is not a number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// The scenario's name.
    pub scenario: String,
    /// Where the controller ran: `native`, `qemu` or `chip`.
    pub controller: String,
    /// Seed of all random values in the run.
    pub seed: u64,
    /// Number of control periods.
    pub ticks: u64,
    /// Digest of all the controller's answers ([`FramesDigest`](crate::digest::FramesDigest)).
    pub frames_sha256: Option<String>,
    /// Hash of the firmware image, if one ran.
    pub elf_sha256: Option<String>,
    /// Whether image and native controller sent the same bytes, if both ran.
    pub identical: Option<bool>,
    metrics: Vec<(String, Metric)>,
}

impl Summary {
    /// Creates a run without metrics, which therefore does not pass.
    pub fn new(scenario: impl Into<String>, controller: impl Into<String>, seed: u64) -> Self {
        Self { scenario: scenario.into(), controller: controller.into(), seed, ..Self::default() }
    }

    /// Sets the number of control periods.
    #[must_use]
    pub fn ticks(mut self, ticks: u64) -> Self {
        self.ticks = ticks;
        self
    }

    /// Sets the digest of all the controller's answers.
    #[must_use]
    pub fn frames_sha256(mut self, digest: impl Into<String>) -> Self {
        self.frames_sha256 = Some(digest.into());
        self
    }

    /// Sets the hash of the image that ran.
    #[must_use]
    pub fn elf_sha256(mut self, hash: impl Into<String>) -> Self {
        self.elf_sha256 = Some(hash.into());
        self
    }

    /// Sets the result of the comparison with the native controller.
    #[must_use]
    pub fn identical(mut self, identical: bool) -> Self {
        self.identical = Some(identical);
        self
    }

    /// Adds a metric.
    #[must_use]
    pub fn metric(mut self, name: impl Into<String>, metric: Metric) -> Self {
        self.insert(name, metric);
        self
    }

    /// Adds a metric at the end, or replaces the one with the same name.
    pub fn insert(&mut self, name: impl Into<String>, metric: Metric) {
        let name = name.into();
        match self.metrics.iter_mut().find(|(n, _)| *n == name) {
            Some((_, old)) => *old = metric,
            None => self.metrics.push((name, metric)),
        }
    }

    /// Removes the limit of a metric, and states the reason in a note. Does nothing if there is no such
    /// metric.
    pub fn waive(&mut self, name: &str, why: &str) {
        if let Some((_, metric)) = self.metrics.iter_mut().find(|(known, _)| known == name) {
            metric.limit = None;
            metric.note = Some(format!("no limit: {why}"));
        }
    }

    /// Removes the limits of all metrics, with a note on those that had one.
    pub fn waive_all(&mut self, note: &str) {
        for (_, metric) in self.metrics.iter_mut().filter(|(_, metric)| metric.limit.is_some()) {
            metric.limit = None;
            metric.note = Some(note.to_owned());
        }
    }

    /// Returns the metric with that name.
    pub fn get(&self, name: &str) -> Option<&Metric> {
        self.metrics().find_map(|(n, metric)| (n == name).then_some(metric))
    }

    /// Names and metrics in the order in which they were added.
    pub fn metrics(&self) -> impl Iterator<Item = (&str, &Metric)> {
        self.metrics.iter().map(|(name, metric)| (name.as_str(), metric))
    }

    /// Returns whether something was measured, every metric passes, and the image agreed if it was compared.
    pub fn pass(&self) -> bool {
        !self.metrics.is_empty()
            && self.metrics.iter().all(|(_, m)| m.pass())
            && self.identical != Some(false)
    }
}

struct Metrics<'a>(&'a [(String, Metric)]);

impl Serialize for Metrics<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (name, metric) in self.0 {
            map.serialize_entry(name, metric)?;
        }
        map.end()
    }
}

impl Serialize for Summary {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let optional = [self.frames_sha256.is_some(), self.elf_sha256.is_some(), self.identical.is_some()];
        let optional = optional.iter().filter(|there| **there).count();
        let mut s = serializer.serialize_struct("Summary", 6 + optional)?;
        s.serialize_field("scenario", &self.scenario)?;
        s.serialize_field("controller", &self.controller)?;
        s.serialize_field("seed", &self.seed)?;
        s.serialize_field("ticks", &self.ticks)?;
        match &self.frames_sha256 {
            Some(digest) => s.serialize_field("frames_sha256", digest)?,
            None => s.skip_field("frames_sha256")?,
        }
        match &self.elf_sha256 {
            Some(hash) => s.serialize_field("elf_sha256", hash)?,
            None => s.skip_field("elf_sha256")?,
        }
        match &self.identical {
            Some(identical) => s.serialize_field("identical", identical)?,
            None => s.skip_field("identical")?,
        }
        s.serialize_field("metrics", &Metrics(&self.metrics))?;
        s.serialize_field("pass", &self.pass())?;
        s.end()
    }
}

/// Returns the JSON of one run, or an array for several.
pub fn json(summaries: &[Summary]) -> String {
    let text = match summaries {
        [one] => serde_json::to_string_pretty(one),
        several => serde_json::to_string_pretty(several),
    };
    // Strings, numbers and maps with string keys can always be represented.
    text.expect("a summary is representable as JSON") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_a_number_never_passes_and_is_null() {
        for value in [f64::NAN, f64::INFINITY] {
            let metric = Metric::at_most("error", value, 12.0, "mrad");
            assert!(!metric.pass() && !Metric::reported("error", value, "mrad").pass());
            let json = serde_json::to_string(&metric).expect("a metric is a plain value");
            assert_eq!(json, r#"{"value":null,"unit":"mrad","limit":12.0,"pass":false}"#);
        }
    }

    #[test]
    fn a_summary_has_the_documented_shape() {
        let summary = Summary::new("hand3-servo", "qemu", 3)
            .ticks(600)
            .frames_sha256("cd")
            .elf_sha256("ab")
            .identical(true)
            .metric("peak", Metric::at_most("Peak", 8.5, 12.0, "mrad"))
            .metric("torque", Metric::reported("Torque", 0.5, "N·m"));
        assert_eq!(
            serde_json::to_string(&summary).expect("a summary is a plain value"),
            concat!(
                r#"{"scenario":"hand3-servo","controller":"qemu","seed":3,"ticks":600,"frames_sha256":"cd","elf_sha256":"ab","#,
                r#""identical":true,"metrics":{"peak":{"value":8.5,"unit":"mrad","limit":12.0,"pass":true},"#,
                r#""torque":{"value":0.5,"unit":"N·m","limit":null,"pass":true}},"pass":true}"#
            )
        );
        let failed =
            Summary::new("a", "native", 1).metric("peak", Metric::at_most("Peak", 12.5, 12.0, "mrad"));
        assert!(!failed.pass());
        assert!(!summary.identical(false).pass(), "different bytes are a failure whatever the metrics say");
    }
}
