//! A recorded sweep: one file per scenario and set, with one line per machine.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};

use super::set::Set;

/// Folder of the sweeps.
pub const FOLDER: &str = "docs/sweeps";

/// Description of a metric, for all machines.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metric {
    /// Its name in the scenario.
    pub name: String,
    /// Unit of values and limit; empty for counts and ratios.
    pub unit: String,
    /// The limit; `None` for a value that is only reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<f64>,
    /// The paper's value, as printed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paper: Option<String>,
}

/// Result of one machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Seed of its deviations and noise.
    pub seed: u64,
    /// Digest of all answers of the control core; empty for a failed run.
    pub frames_sha256: String,
    /// Metrics that miss their limit or are not numbers.
    pub missed: Vec<String>,
    /// Metrics whose limit is not demanded of this machine, because its physics leaves no room for it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exempt: Vec<String>,
    /// In the order of [`Sweep::metrics`], to six digits; `None` if the run has no such value.
    pub values: Vec<Option<f64>>,
    /// Why the run failed. Then it has no values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// One scenario on the machines of one set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    /// The scenario's name.
    pub scenario: String,
    /// The set of its machines.
    pub set: Set,
    /// The commit that was run.
    pub commit: String,
    /// The metrics, in the order of each machine's values.
    pub metrics: Vec<Metric>,
    /// In ascending order of their seeds. A sweep may hold only a part of the set.
    pub machines: Vec<Machine>,
}

/// Returns the path of a scenario's sweep under `folder`.
pub fn path(folder: &Path, scenario: &str, set: Set) -> PathBuf {
    folder.join(set.name()).join(format!("{scenario}.json"))
}

impl Sweep {
    /// Reads a recorded sweep; `None` if there is none.
    ///
    /// # Errors
    /// When the file cannot be read, or holds something else.
    pub fn load(folder: &Path, scenario: &str, set: Set) -> Result<Option<Self>> {
        let path = path(folder, scenario, set);
        if !path.exists() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let sweep: Self = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
        sweep.check().with_context(|| path.display().to_string())?;
        Ok(Some(sweep))
    }

    fn check(&self) -> Result<()> {
        let ascending = self.machines.windows(2).all(|pair| pair[0].seed < pair[1].seed);
        ensure!(ascending, "the machines are not in ascending order of their seeds");
        for machine in &self.machines {
            let (seed, values) = (machine.seed, machine.values.len());
            let set = Set::of(&self.scenario, seed)?;
            ensure!(set == self.set, "seed {seed} does not belong to the {} set", self.set.name());
            let expected = if machine.error.is_some() { 0 } else { self.metrics.len() };
            ensure!(values == expected, "seed {seed} has {values} values for {expected} metrics");
        }
        Ok(())
    }

    /// Writes the sweep; returns its path.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, folder: &Path) -> Result<PathBuf> {
        let path = path(folder, &self.scenario, self.set);
        std::fs::create_dir_all(path.parent().unwrap_or(folder))?;
        std::fs::write(&path, self.to_text()?).with_context(|| path.display().to_string())?;
        Ok(path)
    }

    /// Formats it as JSON with one line per metric and per machine, so that differences of two versions are
    /// readable.
    fn to_text(&self) -> Result<String> {
        let (scenario, set) = (serde_json::to_string(&self.scenario)?, serde_json::to_string(&self.set)?);
        let commit = serde_json::to_string(&self.commit)?;
        let mut text = format!("{{\n\"scenario\": {scenario}, \"set\": {set}, \"commit\": {commit},\n");
        writeln!(text, "\"metrics\": [\n{}\n],", lines(&self.metrics)?)?;
        writeln!(text, "\"machines\": [\n{}\n]\n}}", lines(&self.machines)?)?;
        Ok(text)
    }

    /// Removes the limits of `impossible` metrics from the machine of a seed; returns whether that changed
    /// anything. Metrics without a limit, and those that the sweep does not have, are skipped.
    ///
    /// # Errors
    /// When the machine was recorded without a limit that is possible, because it is unknown whether it met
    /// it.
    pub fn exempt(&mut self, seed: u64, impossible: &[String]) -> Result<bool> {
        let limited = self.metrics.iter().filter(|metric| metric.limit.is_some());
        let names = limited.map(|metric| metric.name.clone()).filter(|name| impossible.contains(name));
        let exempt: Vec<String> = names.collect();
        let Some(machine) = self.machines.iter_mut().find(|machine| machine.seed == seed) else {
            return Ok(false);
        };
        if machine.error.is_some() || machine.exempt == exempt {
            return Ok(false);
        }
        if let Some(name) = machine.exempt.iter().find(|name| !exempt.contains(name)) {
            bail!("{}, seed {seed}: {name} is possible now; record the scenario anew", self.scenario);
        }
        let is_number = |name: &String| {
            let place = self.metrics.iter().position(|metric| metric.name == *name);
            place.and_then(|place| machine.values.get(place).copied().flatten()).is_some()
        };
        let missed = machine.missed.iter().filter(|name| !(exempt.contains(name) && is_number(name)));
        machine.missed = missed.cloned().collect();
        machine.exempt = exempt;
        Ok(true)
    }

    /// Returns the index of a metric's values, and its description.
    ///
    /// # Errors
    /// When the scenario has no such metric.
    pub fn metric(&self, name: &str) -> Result<(usize, &Metric)> {
        let found = self.metrics.iter().enumerate().find(|(_, metric)| metric.name == name);
        found.with_context(|| format!("{} has no metric {name}", self.scenario))
    }
}

fn lines<T: Serialize>(items: &[T]) -> Result<String> {
    let lines: Vec<String> = items.iter().map(serde_json::to_string).collect::<Result<_, _>>()?;
    Ok(lines.join(",\n"))
}

#[cfg(test)]
pub mod fixtures {
    use super::*;

    /// Creates a sweep with one metric, with that limit in millimetres and these `values` on seeds 1001,
    /// 1002, …
    pub fn sweep(limit: Option<f64>, values: &[Option<f64>]) -> Sweep {
        let machine = |(seed, &value): (u64, &Option<f64>)| {
            let misses = value.is_none_or(|value| limit.is_some_and(|limit| value > limit));
            let missed = if misses { vec!["error".to_owned()] } else { Vec::new() };
            let frames_sha256 = format!("{seed:x}");
            Machine { seed, frames_sha256, missed, exempt: Vec::new(), values: vec![value], error: None }
        };
        Sweep {
            scenario: "arm".into(),
            set: Set::Evaluation,
            commit: "0123abc".into(),
            metrics: vec![Metric { name: "error".into(), unit: "mm".into(), limit, paper: None }],
            machines: (1001..).zip(values).map(machine).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::fixtures::sweep;
    use super::*;

    #[test]
    fn a_file_has_a_line_a_metric_and_a_line_a_machine() {
        let text = sweep(Some(1.0), &[Some(0.5), Some(2.0), None]).to_text().unwrap();
        let expected = r#"{
"scenario": "arm", "set": "evaluation", "commit": "0123abc",
"metrics": [
{"name":"error","unit":"mm","limit":1.0}
],
"machines": [
{"seed":1001,"frames_sha256":"3e9","missed":[],"values":[0.5]},
{"seed":1002,"frames_sha256":"3ea","missed":["error"],"values":[2.0]},
{"seed":1003,"frames_sha256":"3eb","missed":["error"],"values":[null]}
]
}
"#;
        assert_eq!(text, expected);
    }

    #[test]
    fn a_limit_that_is_impossible_is_neither_met_nor_missed() {
        let mut kept = sweep(Some(1.0), &[Some(2.0), None, Some(0.5)]);
        let impossible = ["error".to_owned(), "speed".to_owned()];
        for seed in 1001..=1003 {
            assert!(kept.exempt(seed, &impossible).unwrap());
            assert!(!kept.exempt(seed, &impossible).unwrap(), "twice");
        }
        // A missing value counts as missed, regardless of the limit.
        let missed: Vec<usize> = kept.machines.iter().map(|machine| machine.missed.len()).collect();
        assert_eq!(missed, [0, 1, 0]);
        assert!(kept.machines.iter().all(|machine| machine.exempt == ["error"]));
        assert!(!kept.exempt(1004, &impossible).unwrap());
        let told = kept.exempt(1001, &[]).unwrap_err().to_string();
        assert!(told.contains("seed 1001: error is possible now"), "{told}");
        // Metrics without a limit cannot be exempt.
        assert!(!sweep(None, &[Some(2.0)]).exempt(1001, &impossible).unwrap());
    }

    #[test]
    fn what_is_written_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let mut kept = sweep(None, &[Some(0.5), None]);
        kept.machines[1].error = Some("the board is gone".into());
        kept.machines[1].values.clear();
        kept.save(folder.path()).unwrap();
        assert_eq!(Sweep::load(folder.path(), "arm", Set::Evaluation).unwrap(), Some(kept.clone()));
        assert_eq!(Sweep::load(folder.path(), "arm", Set::Development).unwrap(), None);
        kept.machines[0].seed = 1;
        kept.save(folder.path()).unwrap();
        assert!(Sweep::load(folder.path(), "arm", Set::Evaluation).is_err());
    }
}
