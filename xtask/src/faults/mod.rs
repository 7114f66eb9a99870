//! `cargo xtask faults`: many schedules of faults, judged by the simulator's oracle of safety.

mod record;

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::{Args, Subcommand};
use tesaki_output::say;

use crate::commit::{SIMULATOR, commit, require_committed};
use crate::results::ResultsFile;
use crate::sweep::{self, Simulator, Workload};
use crate::test;
use record::{CHECKED, FILE, Record, Run};

const EXAMPLES: &str = "Examples:
  cargo xtask faults                                    seeds 1 to 200
  cargo xtask faults --seeds 1-10000 --record           keep the result in docs/fault-schedules.json
  cargo xtask faults --seeds 1-10000 --partition 3/8    the third of eight jobs; then, where all files are:
  cargo xtask faults merge target/xtask/faults/*.jsonl
  cargo xtask faults check                              does the simulator still do what is recorded?
  cargo sim faults --seeds 7                            one schedule; the smallest one that fails alike";

/// Seeds of one process.
const BATCH: usize = 5;

/// Options of `cargo xtask faults`.
#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, after_help = EXAMPLES)]
pub struct Options {
    #[command(subcommand)]
    task: Option<Task>,
    #[command(flatten)]
    faults: FaultsOptions,
}

#[derive(Args)]
struct FaultsOptions {
    /// Seeds of the schedules, as 1-200
    #[arg(long, value_parser = seeds, default_value = "1-200")]
    seeds: RangeInclusive<u64>,
    /// Keep the result in docs/fault-schedules.json
    #[arg(long)]
    record: bool,
    #[command(flatten)]
    workload: Workload,
}

#[derive(Subcommand)]
enum Task {
    /// Record the parts of a run
    Merge {
        /// Files with one JSON object a line
        #[arg(required = true, value_parser = crate::given_path)]
        files: Vec<PathBuf>,
    },
    /// Run seeds 1 to 50 again; fail when they differ from docs/fault-schedules.json
    Check,
}

/// More schedules are a typing error.
const MAX_SEEDS: u64 = 1_000_000;

fn seeds(text: &str) -> Result<RangeInclusive<u64>> {
    let number = |part: &str| {
        part.parse::<u64>().map_err(|_| {
            anyhow!("{text:?} is not a range of seeds: expected a number or a range, such as 7 or 1-200")
        })
    };
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let (first, last) = (number(first)?, number(last)?);
    ensure!(first <= last, "the first seed is larger than the last");
    ensure!(last - first < MAX_SEEDS, "expected at most {MAX_SEEDS} seeds");
    Ok(first..=last)
}

/// `cargo xtask faults`.
pub fn run(options: Options) -> Result<()> {
    match options.task {
        None => run_seeds(&options.faults),
        Some(Task::Merge { files }) => merge(&files, Path::new(FILE)),
        Some(Task::Check) => check(&Simulator::build()?),
    }
}

/// Runs the recorded seeds again with the simulator that the host suite has built.
pub fn check_built() -> Result<()> {
    check(&Simulator::built())
}

fn check(simulator: &Simulator) -> Result<()> {
    let record = Record::load(Path::new(FILE))?;
    let record = record.with_context(|| format!("{FILE} is missing: `cargo xtask faults --record`"))?;
    let runs = run_all(simulator, CHECKED.collect(), sweep::cores(), |_| Ok(()))?;
    record.compare(&runs)?;
    let unsafe_runs = runs.iter().filter(|run| !run.violations.is_empty()).count();
    say!("{} schedules run again: the same, {unsafe_runs} of them with a broken rule", runs.len());
    Ok(())
}

fn run_seeds(options: &FaultsOptions) -> Result<()> {
    ensure!(
        !options.record || [CHECKED.start(), CHECKED.end()].iter().all(|seed| options.seeds.contains(seed)),
        "--record needs seeds that contain {} to {}, which the tests run again",
        CHECKED.start(),
        CHECKED.end()
    );
    let commit = commit(SIMULATOR)?;
    if options.record {
        require_committed(&commit)?;
    }
    let simulator = Simulator::build()?;
    let mut file =
        ResultsFile::create(&test::out("faults").join(format!("{}.jsonl", options.workload.partition)))?;
    let seeds = options.workload.partition.select(options.seeds.clone().collect());
    let jobs = options.workload.jobs();
    let runs = run_all(&simulator, seeds, jobs, |run| {
        file.add(&Run { commit: Some(commit.clone()), ..run.clone() })
    })?;
    let path = file.finish()?;
    let broken = print(&runs);
    say!("\nAll runs: {}", path.display());
    if options.record {
        Record::new(&commit, runs)?.save(Path::new(FILE))?;
        say!("Recorded in {FILE}.");
    }
    require_kept(broken)
}

fn require_kept(broken: usize) -> Result<()> {
    ensure!(broken == 0, "{broken} schedules break a rule; `cargo sim faults --seeds N` shrinks one");
    Ok(())
}

fn merge(files: &[PathBuf], record: &Path) -> Result<()> {
    let mut runs = Vec::new();
    for file in files {
        let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
        for line in text.lines() {
            runs.push(serde_json::from_str::<Run>(line).with_context(|| file.display().to_string())?);
        }
    }
    let commit = runs.first().and_then(|run| run.commit.clone()).context("no runs")?;
    ensure!(runs.iter().all(|run| run.commit.as_ref() == Some(&commit)), "the parts are of several commits");
    let broken = print(&runs);
    Record::new(&commit, runs)?.save(record)?;
    require_kept(broken)
}

/// Runs seeds on `jobs` cores; `done` is called with each run as it comes. The runs are in the order of their
/// seeds.
fn run_all(
    simulator: &Simulator,
    seeds: Vec<u64>,
    jobs: usize,
    done: impl FnMut(&Run) -> Result<()> + Send,
) -> Result<Vec<Run>> {
    let batches: Vec<&[u64]> = seeds.chunks(BATCH).collect();
    let (mut runs, mut done) = (Vec::new(), done);
    sweep::for_each(
        &batches,
        jobs,
        |batch| batch_of(simulator, batch),
        |batch| {
            batch.iter().try_for_each(&mut done)?;
            runs.extend(batch);
            Ok(())
        },
    )?;
    runs.sort_by_key(|run| run.seed);
    Ok(runs)
}

fn batch_of(simulator: &Simulator, seeds: &[u64]) -> Result<Vec<Run>> {
    let mut runs = Vec::new();
    // Seeds of a partition are not consecutive.
    let consecutive = seeds.windows(2).all(|pair| pair[0] + 1 == pair[1]);
    let pieces: Vec<&[u64]> = if consecutive { vec![seeds] } else { seeds.chunks(1).collect() };
    for piece in pieces {
        let (Some(first), Some(last)) = (piece.first(), piece.last()) else { continue };
        let mut command = simulator.command();
        command.args(["faults", "--json", "--no-shrink", "--seeds", &format!("{first}-{last}")]);
        let output = command.stdin(Stdio::null()).output().context("cannot start the simulator")?;
        let text = String::from_utf8_lossy(&output.stdout);
        let lines = text.lines().map(serde_json::from_str).collect::<Result<Vec<Run>, _>>();
        let lines = lines.with_context(|| text.clone().into_owned())?;
        if lines.len() != piece.len() {
            let (told, status) = (String::from_utf8_lossy(&output.stderr), output.status);
            let (done, all) = (lines.len(), piece.len());
            bail!("seeds {first} to {last}: {done} of {all} runs, {status}: {}", told.trim());
        }
        runs.extend(lines);
    }
    Ok(runs)
}

/// Prints what was broken; returns the number of schedules that broke a rule.
fn print(runs: &[Run]) -> usize {
    let (mut families, mut rules) = (BTreeMap::<&str, [usize; 2]>::new(), BTreeMap::<&str, usize>::new());
    for run in runs {
        for family in &run.families {
            let [all, broken] = families.entry(family).or_default();
            *all += 1;
            *broken += usize::from(!run.violations.is_empty());
        }
        for violation in &run.violations {
            *rules.entry(&violation.rule).or_default() += 1;
            say!(
                "seed {}, {}, tick {}: {} is broken: {}",
                run.seed,
                run.scenario,
                violation.tick,
                violation.rule,
                violation.text
            );
        }
    }
    let broken = runs.iter().filter(|run| !run.violations.is_empty()).count();
    say!("\n{} schedules, {broken} break a rule", runs.len());
    let shortened = runs.iter().filter(|run| run.ends_early()).count();
    say!("  {shortened:>6} end early");
    for (family, [all, broken]) in families {
        say!("  {all:>6} with faults of {family}, {broken} of them break a rule");
    }
    for (rule, count) in rules {
        say!("  {count:>6} break {rule}");
    }
    broken
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn broken_rules_in_the_parts_of_a_run_are_recorded_and_fail() {
        let folder = tempfile::tempdir().unwrap();
        let (part, record) = (folder.path().join("part"), folder.path().join("record"));
        // With these violations of the first seed.
        let lines = |violations: &str| -> String {
            let line = |seed: u64| {
                let violations = if seed == 1 { violations } else { "" };
                format!(
                    r#"{{"seed":{seed},"scenario":"arm","families":[],"frames_sha256":"0","ticks":[300,300],"violations":[{violations}],"commit":"a"}}"#
                ) + "\n"
            };
            CHECKED.map(line).collect()
        };
        std::fs::write(&part, lines("")).unwrap();
        merge(std::slice::from_ref(&part), &record).unwrap();
        std::fs::write(&part, lines(r#"{"rule":"Energy","tick":7,"text":"1 J"}"#)).unwrap();
        let error = merge(&[part], &record).unwrap_err().to_string();
        assert!(error.starts_with("1 schedules break a rule"), "{error}");
        assert_eq!(Record::load(&record).unwrap().unwrap().violations["Energy"], [1]);
    }

    #[test]
    fn what_is_not_a_range_of_seeds_is_told() {
        let told = seeds("1-x").unwrap_err().to_string();
        assert_eq!(told, "\"1-x\" is not a range of seeds: expected a number or a range, such as 7 or 1-200");
        assert_eq!(seeds("7").unwrap(), 7..=7);
    }

    #[cfg(unix)]
    #[test]
    fn the_error_of_the_simulator_is_told() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("host-sim");
        std::fs::write(&program, "#!/bin/sh\necho host-sim: there is no robot >&2\nexit 2\n").unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        let error = run_all(&Simulator::at(&program), (1..=5).collect(), 1, |_| Ok(())).unwrap_err();
        let told = "seeds 1 to 5: 0 of 5 runs, exit status: 2: host-sim: there is no robot";
        assert_eq!(error.to_string(), told);
    }
}
