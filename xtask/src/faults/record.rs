//! The record of fault schedules: what was run, and what was broken.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::commit::require_committed;

/// Where it is kept.
pub const FILE: &str = "docs/fault-schedules.json";
/// The seeds that the tests run again.
pub const CHECKED: std::ops::RangeInclusive<u64> = 1..=50;

/// A broken rule, as the simulator tells it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Violation {
    /// Name of the rule.
    pub rule: String,
    /// When, in ticks of the trial.
    pub tick: u32,
    /// The values.
    pub text: String,
}

/// What one schedule came to, as `host-sim faults --json` prints it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    /// Its seed.
    pub seed: u64,
    /// Where it ran.
    pub scenario: String,
    /// Families of its faults.
    pub families: Vec<String>,
    /// Digest of all that the board answered.
    pub frames_sha256: String,
    /// Ticks that were run, and ticks planned.
    pub ticks: [u32; 2],
    /// Broken rules.
    pub violations: Vec<Violation>,
    /// What was run; only in the files of a partition.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
}

impl Run {
    /// Whether the scenario ended before the schedule.
    pub fn ends_early(&self) -> bool {
        self.ticks[0] < self.ticks[1]
    }
}

/// What is recorded of many schedules.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// What was run.
    pub commit: String,
    /// First and last seed.
    pub seeds: [u64; 2],
    /// Schedules that were run.
    pub schedules: usize,
    /// Those whose scenario ended before the schedule.
    #[serde(default)]
    pub ended_early: usize,
    /// Schedules with faults of each family.
    pub families: BTreeMap<String, usize>,
    /// Seeds that broke each rule.
    pub violations: BTreeMap<String, Vec<u64>>,
    /// Digest over the runs of the seeds that the tests run again.
    pub checked_sha256: String,
}

impl Record {
    /// Of runs, in any order.
    ///
    /// # Errors
    /// When a seed is missing, or there twice, or the sources were not committed.
    pub fn new(commit: &str, mut runs: Vec<Run>) -> Result<Self> {
        require_committed(commit)?;
        runs.sort_by_key(|run| run.seed);
        let seeds: Vec<u64> = runs.iter().map(|run| run.seed).collect();
        let (first, last) = seeds.first().zip(seeds.last()).context("no runs")?;
        let whole = seeds.iter().copied().eq(*first..=*last);
        ensure!(whole, "seeds {first} to {last} are not there once each: {} runs", seeds.len());
        ensure!(
            seeds.contains(CHECKED.start()) && seeds.contains(CHECKED.end()),
            "only seeds that contain {} to {}, which the tests run again, can be recorded",
            CHECKED.start(),
            CHECKED.end()
        );
        let (mut families, mut violations) = (BTreeMap::new(), BTreeMap::<_, Vec<u64>>::new());
        for run in &runs {
            for family in &run.families {
                *families.entry(family.clone()).or_default() += 1;
            }
            for violation in &run.violations {
                violations.entry(violation.rule.clone()).or_default().push(run.seed);
            }
        }
        Ok(Self {
            commit: commit.to_owned(),
            seeds: [*first, *last],
            schedules: runs.len(),
            ended_early: runs.iter().filter(|run| run.ends_early()).count(),
            families,
            violations,
            checked_sha256: digest(&runs),
        })
    }

    /// Reads the record; `None` where there is none.
    ///
    /// # Errors
    /// When the file cannot be read, or holds something else.
    pub fn load(path: &Path) -> Result<Option<Self>> {
        if !path.exists() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        serde_json::from_str(&text).map(Some).with_context(|| path.display().to_string())
    }

    /// Writes it.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let mut text = serde_json::to_string_pretty(self)?;
        // A list of seeds on one line.
        for seeds in self.violations.values() {
            let many = serde_json::to_string_pretty(&BTreeMap::from([("", seeds)]))?;
            let list = many.split_once('[').map_or("", |(_, list)| list.trim_end_matches(['}', '\n']));
            let long = format!("[{}", list.replace('\n', "\n  "));
            text = text.replace(&long, &serde_json::to_string(seeds)?);
        }
        std::fs::write(path, text + "\n").with_context(|| path.display().to_string())
    }

    /// Whether runs of the checked seeds come to what is recorded; else what differs.
    ///
    /// # Errors
    /// A rule that is broken and was not, or another digest.
    pub fn compare(&self, runs: &[Run]) -> Result<()> {
        for run in runs {
            for Violation { rule, tick, text } in &run.violations {
                let known = self.violations.get(rule).is_some_and(|seeds| seeds.contains(&run.seed));
                ensure!(
                    known,
                    "seed {}, {}, tick {tick}: {rule} is broken: {text}. The smallest schedule that breaks \
                     it: `cargo sim faults --seeds {}`",
                    run.seed,
                    run.scenario,
                    run.seed
                );
            }
        }
        let stale = digest(runs) != self.checked_sha256;
        let repaired = self.violations.iter().find_map(|(rule, seeds)| {
            let seed = seeds.iter().find(|seed| {
                runs.iter().any(|run| {
                    run.seed == **seed && run.violations.iter().all(|violation| violation.rule != *rule)
                })
            })?;
            Some(format!(" (seed {seed} no longer breaks {rule})"))
        });
        ensure!(
            !stale && repaired.is_none(),
            "the control core answers the fault schedules with other frames than recorded of commit {}{}. If \
             that is meant, record them anew: `cargo xtask faults --record`",
            self.commit,
            repaired.unwrap_or_default()
        );
        Ok(())
    }
}

/// Digest over the runs of the seeds that are checked, in their order.
fn digest(runs: &[Run]) -> String {
    let mut runs: Vec<&Run> = runs.iter().filter(|run| CHECKED.contains(&run.seed)).collect();
    runs.sort_by_key(|run| run.seed);
    let mut digest = Sha256::new();
    for run in runs {
        digest.update(format!("{} {}\n", run.seed, run.frames_sha256));
    }
    format!("{:x}", digest.finalize())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn runs() -> Vec<Run> {
        let run = |seed: u64| Run {
            seed,
            scenario: "arm".into(),
            families: vec!["link".into()],
            frames_sha256: format!("{seed:x}"),
            ticks: [300, 300],
            violations: Vec::new(),
            commit: None,
        };
        (1..=200).map(run).collect()
    }

    fn broken() -> Violation {
        Violation { rule: "Energy".into(), tick: 7, text: "1 J".into() }
    }

    #[test]
    fn the_same_runs_are_not_stale() {
        let mut known = runs();
        known[4].violations.push(broken());
        let record = Record::new("0123abc", known.clone()).unwrap();
        assert_eq!((record.schedules, record.families["link"]), (200, 200));
        assert_eq!(record.violations["Energy"], [5]);
        record.compare(&known).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("record.json");
        assert_eq!(Record::load(&path).unwrap(), None);
        record.save(&path).unwrap();
        assert_eq!(Record::load(&path).unwrap(), Some(record));
        assert!(std::fs::read_to_string(&path).unwrap().contains("\"Energy\": [5]"));
    }

    #[test]
    fn a_record_has_the_seeds_that_the_tests_run_again() {
        let error = Record::new("0123abc", runs().split_off(50)).unwrap_err().to_string();
        assert!(error.contains("1 to 50"), "{error}");
    }

    #[test]
    fn a_new_violation_is_told_with_its_command() {
        let record = Record::new("0123abc", runs()).unwrap();
        let mut now = runs();
        now[4].violations.push(broken());
        let told = record.compare(&now).unwrap_err().to_string();
        assert!(told.starts_with("seed 5, arm, tick 7: Energy is broken: 1 J"), "{told}");
        assert!(told.contains("`cargo sim faults --seeds 5`"), "{told}");
    }

    #[test]
    fn another_digest_and_a_repaired_rule_are_stale() {
        let mut known = runs();
        known[4].violations.push(broken());
        let record = Record::new("0123abc", known.clone()).unwrap();
        let told = record.compare(&runs()).unwrap_err().to_string();
        assert!(told.contains("seed 5 no longer breaks Energy"), "{told}");
        known[9].frames_sha256 = "other".into();
        let told = record.compare(&known).unwrap_err().to_string();
        assert!(told.contains("commit 0123abc. If that is meant"), "{told}");
    }

    #[test]
    fn schedules_of_uncommitted_sources_are_not_recorded() {
        let told = Record::new("0123abc-dirty", runs()).unwrap_err().to_string();
        assert!(told.starts_with("results of 0123abc-dirty cannot be recorded"), "{told}");
    }

    #[test]
    fn a_record_has_every_seed_once() {
        let mut some = runs();
        some.remove(3);
        assert!(Record::new("0123abc", some).is_err());
        assert!(Record::new("0123abc", [runs(), runs()].concat()).is_err());
    }
}
