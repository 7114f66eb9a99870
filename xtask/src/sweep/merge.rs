//! Merges runs, as printed by the simulator, into recorded sweeps.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::record::{Machine, Metric, Sweep};
use super::set::Set;
use crate::commit::require_committed;

/// One run: the line printed by `host-sim run --json`, with the commit if a sweep has added it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// The scenario's name.
    pub scenario: String,
    /// The machine.
    pub seed: u64,
    #[serde(default = "native")]
    controller: String,
    /// Digest of all answers of the control core.
    #[serde(default)]
    pub frames_sha256: String,
    #[serde(default)]
    metrics: Map<String, Value>,
    /// The commit that was run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
    /// Why the run failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

fn native() -> String {
    "native".to_owned()
}

/// A metric of one run.
#[derive(Deserialize)]
struct Measured {
    value: Option<f64>,
    unit: String,
    limit: Option<f64>,
    #[serde(default)]
    paper: String,
    pass: bool,
}

impl Run {
    /// Creates a run that failed.
    pub fn failed(scenario: &str, seed: u64, error: String) -> Self {
        Self {
            scenario: scenario.to_owned(),
            seed,
            controller: native(),
            frames_sha256: String::new(),
            metrics: Map::new(),
            commit: None,
            error: Some(error),
        }
    }

    /// Returns the measured values in the scenario's order: metric, value to six digits, and whether it meets
    /// its limit.
    ///
    /// # Errors
    /// When a metric of the run has a different format.
    pub fn measured(&self) -> Result<Vec<(Metric, Option<f64>, bool)>> {
        let mut all = Vec::new();
        for (name, value) in &self.metrics {
            let Measured { value, unit, limit, paper, pass } =
                serde_json::from_value(value.clone()).with_context(|| format!("metric {name}"))?;
            let paper = (!paper.is_empty()).then_some(paper);
            all.push((Metric { name: name.clone(), unit, limit, paper }, value.map(six_digits), pass));
        }
        Ok(all)
    }
}

/// Rounds a value to six significant digits.
fn six_digits(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// Reads runs, one per line. Files without a line are still being written: they are returned for the caller
/// to report.
///
/// # Errors
/// When a file cannot be read, or a line is not a run.
pub fn read(files: &[PathBuf]) -> Result<(Vec<Run>, Vec<&Path>)> {
    let (mut runs, mut empty) = (Vec::new(), Vec::new());
    for file in files {
        let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
        let before = runs.len();
        for line in text.lines().filter(|line| !line.trim().is_empty()) {
            let run = serde_json::from_str(line);
            runs.push(run.with_context(|| format!("{}: not a run of host-sim", file.display()))?);
        }
        if runs.len() == before {
            empty.push(file.as_path());
        }
    }
    Ok((runs, empty))
}

/// Adds runs to the sweeps in `folder` and writes them. Runs of the recorded commit are added to its
/// machines; runs of another commit replace the sweep. Returns a line per sweep, for people.
///
/// # Errors
/// When runs contradict each other, lack their commit, are of uncommitted sources, or do not belong to a
/// sweep.
pub fn merge(folder: &Path, runs: Vec<Run>, commit: Option<&str>) -> Result<Vec<String>> {
    let mut sorted: BTreeMap<(String, Set), Vec<Run>> = BTreeMap::new();
    for run in runs {
        sorted.entry((run.scenario.clone(), Set::of(&run.scenario, run.seed)?)).or_default().push(run);
    }
    let mut told = Vec::new();
    for ((scenario, set), runs) in sorted {
        let commit = commit_of(&runs, commit).with_context(|| scenario.clone())?;
        let recorded = Sweep::load(folder, &scenario, set)?;
        let before = recorded.as_ref().map(|sweep| (sweep.commit.clone(), sweep.machines.len()));
        let kept = recorded.filter(|sweep| sweep.commit == commit);
        let replaces = kept.is_none();
        let sweep = combine(&scenario, set, commit, kept, runs).with_context(|| scenario.clone())?;
        let (have, all) = (sweep.machines.len(), set.seeds(&scenario).len());
        let mut line = format!("{}: {have} of {all} machines", sweep.save(folder)?.display());
        if let Some((old, machines)) = before.filter(|_| replaces) {
            line += &format!(", instead of the {machines} of {old}");
        }
        told.push(line);
    }
    Ok(told)
}

fn commit_of(runs: &[Run], given: Option<&str>) -> Result<String> {
    let mut commits: Vec<&str> = runs.iter().filter_map(|run| run.commit.as_deref().or(given)).collect();
    ensure!(commits.len() == runs.len(), "the runs do not say of which commit they are: add --commit");
    commits.dedup();
    match commits[..] {
        [commit] => {
            require_committed(commit)?;
            Ok(commit.to_owned())
        }
        _ => bail!("runs of different commits: {}", commits.join(", ")),
    }
}

/// Combines the recorded machines of the same commit and new runs into one sweep.
fn combine(
    scenario: &str,
    set: Set,
    commit: String,
    kept: Option<Sweep>,
    mut runs: Vec<Run>,
) -> Result<Sweep> {
    let empty = Sweep { scenario: scenario.into(), set, commit, metrics: Vec::new(), machines: Vec::new() };
    let mut sweep = kept.unwrap_or(empty);
    runs.sort_by_key(|run| run.seed);
    for run in runs {
        let seed = run.seed;
        let machine = machine(&mut sweep, &run).with_context(|| format!("seed {seed}"))?;
        match sweep.machines.binary_search_by_key(&seed, |machine| machine.seed) {
            Err(place) => sweep.machines.insert(place, machine),
            Ok(place) => {
                let same = sweep.machines[place] == machine;
                ensure!(same, "seed {seed}: two runs of commit {} differ", sweep.commit);
            }
        }
    }
    // Metrics that first appeared with a later machine are missing on the earlier ones.
    let count = sweep.metrics.len();
    for machine in sweep.machines.iter_mut().filter(|machine| machine.error.is_none()) {
        machine.values.resize(count, None);
    }
    Ok(sweep)
}

/// Converts the run into a line of the sweep, and adds new metrics to the sweep.
fn machine(sweep: &mut Sweep, run: &Run) -> Result<Machine> {
    ensure!(run.controller == "native", "run with the controller {}, not native", run.controller);
    ensure!(run.error.is_some() || !run.frames_sha256.is_empty(), "the run has no digest of its frames");
    let mut values = vec![None; sweep.metrics.len()];
    let (mut missed, mut exempt) = (Vec::new(), Vec::new());
    for (metric, value, pass) in run.measured()? {
        if !pass {
            missed.push(metric.name.clone());
        }
        match sweep.metrics.iter().position(|known| known.name == metric.name) {
            Some(place) => {
                let known = &mut sweep.metrics[place];
                let unlimited = |metric: &Metric| Metric { limit: None, ..metric.clone() };
                let limits_agree =
                    known.limit.zip(metric.limit).is_none_or(|(old, new)| old.total_cmp(&new).is_eq());
                ensure!(
                    limits_agree && unlimited(known) == unlimited(&metric),
                    "{} was recorded as {known:?}, and is {metric:?}",
                    metric.name
                );
                if known.limit.is_some() && metric.limit.is_none() {
                    exempt.push(metric.name.clone());
                }
                if known.limit.is_none() && metric.limit.is_some() {
                    known.limit = metric.limit;
                    let has_value =
                        |machine: &&mut Machine| machine.values.get(place).is_some_and(Option::is_some);
                    let earlier = sweep.machines.iter_mut().filter(has_value);
                    earlier.for_each(|machine| machine.exempt.push(metric.name.clone()));
                }
                values[place] = value;
            }
            None => {
                sweep.metrics.push(metric);
                values.push(value);
            }
        }
    }
    if run.error.is_some() {
        values.clear();
    }
    let (seed, frames_sha256) = (run.seed, run.frames_sha256.clone());
    Ok(Machine { seed, frames_sha256, missed, exempt, values, error: run.error.clone() })
}

#[cfg(test)]
pub mod fixtures {
    use super::*;

    /// Creates a run as printed by the simulator, with one metric.
    pub fn run(seed: u64, digest: &str, value: f64) -> Run {
        let pass = value <= 1.0;
        let line = format!(
            r#"{{"scenario":"arm","controller":"native","seed":{seed},"ticks":9,"frames_sha256":"{digest}",
                "metrics":{{"error":{{"value":{value},"unit":"mm","limit":1.0,"pass":{pass}}}}},
                "pass":{pass}}}"#
        );
        serde_json::from_str(&line).expect("a run")
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::fixtures::run;
    use super::*;

    fn recorded(folder: &Path, set: Set) -> Sweep {
        Sweep::load(folder, "arm", set).unwrap().unwrap()
    }

    #[test]
    fn runs_are_sorted_into_sets_and_by_seed() {
        let folder = tempfile::tempdir().unwrap();
        let runs = vec![run(1002, "c", 1.5), run(3, "a", 0.123_456_78), run(1001, "b", 0.5)];
        let told = merge(folder.path(), runs, Some("one")).unwrap();
        assert!(told[0].ends_with("development/arm.json: 1 of 20 machines"), "{told:?}");
        assert!(told[1].ends_with("evaluation/arm.json: 2 of 100 machines"), "{told:?}");
        let development = recorded(folder.path(), Set::Development);
        assert_eq!(development.machines[0].values, [Some(0.123_457)]);
        let evaluation = recorded(folder.path(), Set::Evaluation);
        let seeds: Vec<u64> = evaluation.machines.iter().map(|machine| machine.seed).collect();
        assert_eq!(seeds, [1001, 1002]);
        assert_eq!(
            (evaluation.commit.as_str(), &evaluation.machines[1].missed[..]),
            ("one", &["error".into()][..])
        );
    }

    #[test]
    fn the_same_commit_adds_machines_and_another_one_replaces_them() {
        let folder = tempfile::tempdir().unwrap();
        merge(folder.path(), vec![run(1, "a", 0.1), run(2, "b", 0.2)], Some("one")).unwrap();
        // Seed 2 again with the same result, and seed 3.
        merge(folder.path(), vec![run(3, "c", 0.3), run(2, "b", 0.2)], Some("one")).unwrap();
        assert_eq!(recorded(folder.path(), Set::Development).machines.len(), 3);
        let told = merge(folder.path(), vec![run(1, "d", 0.4)], Some("two")).unwrap();
        assert!(told[0].ends_with("1 of 20 machines, instead of the 3 of one"), "{told:?}");
        assert_eq!(recorded(folder.path(), Set::Development).machines.len(), 1);
    }

    #[test]
    fn contradictions_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let refused =
            |runs: Vec<Run>, commit| format!("{:#}", merge(folder.path(), runs, commit).unwrap_err());
        let told = refused(vec![run(1, "a", 0.1), run(1, "b", 0.1)], Some("one"));
        assert!(told.contains("two runs of commit one differ"), "{told}");
        assert!(refused(vec![run(1, "a", 0.1)], None).contains("--commit"));
        assert!(refused(vec![run(500, "a", 0.1)], Some("one")).contains("neither"));
        let of = |seed, commit: &str| Run { commit: Some(commit.into()), ..run(seed, "a", 0.1) };
        assert!(refused(vec![of(1, "one"), of(2, "two")], None).contains("different commits"));
        assert!(refused(vec![of(1, "one-dirty")], None).contains("arm: results of one-dirty"));
        let mut other = run(2, "b", 0.1);
        other.metrics["error"]["limit"] = 2.0.into();
        assert!(refused(vec![run(1, "a", 0.1), other], Some("one")).contains("was recorded as"));
    }

    #[test]
    fn a_machine_without_the_limit_of_the_others_is_exempt() {
        let folder = tempfile::tempdir().unwrap();
        let without = |seed| {
            let mut run = run(seed, "a", 3.0);
            run.metrics["error"]["limit"] = Value::Null;
            run.metrics["error"]["pass"] = true.into();
            run
        };
        merge(folder.path(), vec![without(1), run(2, "b", 0.5), without(3)], Some("one")).unwrap();
        let sweep = recorded(folder.path(), Set::Development);
        assert_eq!(sweep.metrics[0].limit, Some(1.0));
        let exempt: Vec<usize> = sweep.machines.iter().map(|machine| machine.exempt.len()).collect();
        assert_eq!(exempt, [1, 0, 1]);
    }

    #[test]
    fn a_metric_that_only_some_machines_have_is_none_on_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let mut more = run(2, "b", 0.2);
        let metric = more.metrics["error"].clone();
        more.metrics.insert("drift".into(), metric);
        let failed = Run::failed("arm", 4, "the board is gone".into());
        merge(folder.path(), vec![run(1, "a", 0.1), more, run(3, "c", 0.3), failed], Some("one")).unwrap();
        let values: Vec<_> =
            recorded(folder.path(), Set::Development).machines.into_iter().map(|m| m.values).collect();
        assert_eq!(
            values,
            [vec![Some(0.1), None], vec![Some(0.2), Some(0.2)], vec![Some(0.3), None], vec![]]
        );
    }
}
