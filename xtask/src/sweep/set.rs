//! The two sets of machines. The seed decides a machine's deviations from the model and its noise.

use std::num::NonZeroUsize;

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};

/// Evaluation machines that were inspected: robot, as the names of its scenarios begin, and seed. From then
/// on each is a development machine of this robot, and is replaced by the first free seed after the set:
/// 1101, 1102, …
const LOOKED_INTO: &[(&str, u64)] = &[
    // Why a fault ended a contact in arm7-contact.
    ("arm7", 1005),
    ("arm7", 1007),
    ("arm7", 1008),
    ("arm7", 1019),
    ("arm7", 1024),
    ("arm7", 1030),
    ("arm7", 1031),
    ("arm7", 1046),
    ("arm7", 1052),
    ("arm7", 1053),
    ("arm7", 1069),
    ("arm7", 1077),
    ("arm7", 1084),
    ("arm7", 1098),
    // Why the tool misses its motion after a release in arm7-release.
    ("arm7", 1088),
];

const FIRST_EVALUATION: u64 = 1001;
/// Number of evaluation machines of each scenario.
pub const EVALUATION_MACHINES: usize = 100;

/// A set of machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Set {
    /// To tune and to debug.
    Development,
    /// To measure. Never traced, never tuned to.
    Evaluation,
}

impl Set {
    /// Both sets.
    pub const ALL: [Self; 2] = [Self::Development, Self::Evaluation];

    /// Its name, and that of its folder.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Development => "development",
            Self::Evaluation => "evaluation",
        }
    }

    /// Returns the seeds of a scenario's machines, in ascending order.
    pub fn seeds(self, scenario: &str) -> Vec<u64> {
        let robot = scenario.split('-').next();
        let looked_into = LOOKED_INTO.iter().filter(|(of, _)| robot == Some(of)).map(|&(_, seed)| seed);
        self.seeds_without(&looked_into.collect::<Vec<_>>())
    }

    fn seeds_without(self, looked_into: &[u64]) -> Vec<u64> {
        match self {
            Self::Development => {
                let mut seeds: Vec<u64> = (1..=20).chain(looked_into.iter().copied()).collect();
                seeds.sort_unstable();
                seeds
            }
            Self::Evaluation => {
                let all = FIRST_EVALUATION..;
                let left = all.filter(|seed| !looked_into.contains(seed));
                left.take(EVALUATION_MACHINES).collect()
            }
        }
    }

    /// Returns the set of a seed in a scenario.
    ///
    /// # Errors
    /// When it belongs to none.
    pub fn of(scenario: &str, seed: u64) -> Result<Self> {
        let set = Self::ALL.into_iter().find(|set| set.seeds(scenario).contains(&seed));
        set.with_context(|| {
            format!("seed {seed} belongs to neither the development nor the evaluation set of {scenario}")
        })
    }
}

/// How much of a sweep is done here, and how much of that at once. For options that have `--record`.
#[derive(Args)]
pub struct Workload {
    /// Simulations at once [default: one a core]
    #[arg(long)]
    jobs: Option<NonZeroUsize>,
    /// Part i of n, for the job arrays of a cluster; `merge` puts the parts together
    #[arg(
        long,
        value_name = "I/N",
        default_value = "1/1",
        hide_default_value = true,
        conflicts_with = "record"
    )]
    pub partition: Partition,
}

impl Workload {
    /// Number of simulations that run at once.
    pub fn jobs(&self) -> usize {
        self.jobs.map_or_else(super::cores, NonZeroUsize::get)
    }
}

/// A part of a sweep, for a job array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Partition {
    index: usize,
    count: usize,
}

impl Default for Partition {
    fn default() -> Self {
        Self { index: 1, count: 1 }
    }
}

impl Partition {
    /// Returns whether this part is the whole sweep.
    pub const fn is_whole(self) -> bool {
        self.count == 1
    }

    /// Selects the items of this part: each `count`-th. All parts together have each item once.
    pub fn select<T>(self, items: Vec<T>) -> Vec<T> {
        items.into_iter().skip(self.index - 1).step_by(self.count).collect()
    }
}

impl std::fmt::Display for Partition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-of-{}", self.index, self.count)
    }
}

impl std::str::FromStr for Partition {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let (index, count) = text.split_once('/').context("write it as 3/8: the third of eight parts")?;
        let (index, count) = (index.parse::<usize>()?, count.parse::<usize>()?);
        ensure!((1..=count).contains(&index), "there is no part {index} of {count}");
        Ok(Self { index, count })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_that_was_looked_into_is_replaced() {
        let development = Set::Development.seeds_without(&[1007, 1101]);
        assert_eq!(development, (1..=20).chain([1007, 1101]).collect::<Vec<_>>());
        let evaluation = Set::Evaluation.seeds_without(&[1007, 1101]);
        let expected: Vec<u64> = (1001..=1006).chain(1008..=1100).chain([1102]).collect();
        assert_eq!((evaluation.len(), evaluation), (100, expected));
    }

    #[test]
    fn a_seed_tells_its_set() {
        assert_eq!(Set::of("arm7-wall", 20).ok(), Some(Set::Development));
        assert_eq!(Set::of("arm7-wall", 1001).ok(), Some(Set::Evaluation));
        assert!(Set::of("arm7-wall", 21).is_err() && Set::of("arm7-wall", 2000).is_err());
        // A machine of one robot says nothing about that of another with the same seed.
        let (robot, seed) = LOOKED_INTO[0];
        assert_eq!(Set::of(&format!("{robot}-wall"), seed).ok(), Some(Set::Development));
        assert_eq!(Set::of("none-wall", seed).ok(), Some(Set::Evaluation));
    }

    #[test]
    fn the_parts_of_an_array_share_the_work() {
        let items: Vec<u32> = (0..10).collect();
        let part = |text: &str| text.parse::<Partition>().map(|part| part.select(items.clone()));
        assert_eq!(part("1/3").ok(), Some(vec![0, 3, 6, 9]));
        assert_eq!(part("2/3").ok(), Some(vec![1, 4, 7]));
        assert_eq!(part("3/3").ok(), Some(vec![2, 5, 8]));
        assert!(part("0/3").is_err() && part("4/3").is_err() && part("3").is_err());
    }
}
