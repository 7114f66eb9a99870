//! `cargo xtask sweep`: runs every scenario on many machines, and keeps the results with their commit.

mod check;
mod merge;
mod pool;
mod record;
mod rows;
mod set;
mod stats;
mod tables;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use clap::{Args, Subcommand};
use tesaki_output::say;

use crate::commit::{SIMULATOR, commit, require_committed};
use crate::results::ResultsFile;
use crate::test;
use merge::Run;
pub use pool::{Simulator, for_each};
use record::{FOLDER, Sweep};
use set::Set;
pub use set::Workload;

const EXAMPLES: &str = "Examples:
  cargo xtask sweep                                  all scenarios on the development machines
  cargo xtask sweep arm7-wall hand3-turn             two of them
  cargo xtask sweep --evaluation --record            record what has changed on the evaluation machines
  cargo xtask sweep --evaluation --partition 3/8     the third of eight jobs; then, where all files are:
  cargo xtask sweep merge target/xtask/sweep/evaluation-*.jsonl
  cargo xtask sweep tables                           write the tables of the documents from docs/sweeps
  cargo xtask sweep check                            does the simulator still do what docs/sweeps says?";

/// Options of `cargo xtask sweep`.
#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, after_help = EXAMPLES)]
pub struct Options {
    #[command(subcommand)]
    task: Option<Task>,
    #[command(flatten)]
    sweep: SweepOptions,
}

#[derive(Args)]
struct SweepOptions {
    /// Scenarios, see `cargo sim list`; without one, all
    scenarios: Vec<String>,
    /// The evaluation machines instead of the development machines
    #[arg(long)]
    evaluation: bool,
    /// Keep the results in docs/sweeps. If no scenario is named, those are left out of which a machine,
    /// another one for each, answers as recorded
    #[arg(long)]
    record: bool,
    /// With --record: leave none out
    #[arg(long, requires = "record")]
    force: bool,
    #[command(flatten)]
    workload: Workload,
}

#[derive(Subcommand)]
enum Task {
    /// Record runs: files with the lines of `host-sim run --json`, or the parts of a sweep; a seed tells its
    /// set
    Merge {
        /// Files with one JSON object a line
        #[arg(required = true, value_parser = crate::given_path)]
        files: Vec<PathBuf>,
        /// What was run, where the lines do not say it
        #[arg(long)]
        commit: Option<String>,
    },
    /// Run two recorded machines of every scenario again; fail when they differ from docs/sweeps
    Check,
    /// Count machines apart in docs/sweeps whose physics leaves no room for a limit; nothing is run
    Limits,
    /// Write the tables of the documents from docs/sweeps
    Tables {
        /// Write nothing; fail when a table differs
        #[arg(long)]
        check: bool,
    },
}

/// Runs `cargo xtask sweep`.
pub fn run(options: Options) -> Result<()> {
    match options.task {
        None => sweep(&options.sweep),
        Some(Task::Merge { files, commit }) => merge_files(&files, commit.as_deref()),
        Some(Task::Check) => check(&Simulator::build()?, |_| Set::ALL),
        Some(Task::Limits) => limits(&Simulator::build()?),
        Some(Task::Tables { check }) => tables::run(check),
    }
}

/// Checks that the tables of the documents match their sweeps.
pub fn check_tables() -> Result<()> {
    tables::run(true)
}

/// Checks a machine of every scenario with the simulator that the host suite has built, of every third one a
/// development machine. Returns the folder with the recordings of their runs.
pub fn check_built() -> Result<PathBuf> {
    let folder = std::path::absolute(test::out("recordings"))?;
    let set = |index| if index % 3 == 0 { [Set::Development] } else { [Set::Evaluation] };
    check(&Simulator::built().recording(folder.clone())?, set)?;
    Ok(folder)
}

/// Number of cores of this machine.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

fn merge_files(files: &[PathBuf], commit: Option<&str>) -> Result<()> {
    let (runs, empty) = merge::read(files)?;
    for told in merge::merge(Path::new(FOLDER), runs, commit)? {
        say!("{told}");
    }
    if !empty.is_empty() {
        let names: Vec<String> = empty.iter().map(|file| file.display().to_string()).collect();
        say!("{} files without a result, left out: {}", names.len(), names.join(", "));
    }
    say!("Now run `cargo xtask sweep tables`.");
    Ok(())
}

/// Runs the sweep; a complete one fails if a machine misses a limit.
fn sweep(options: &SweepOptions) -> Result<()> {
    let commit = commit(SIMULATOR)?;
    if options.record {
        require_committed(&commit)?;
    }
    let simulator = Simulator::build()?;
    let known = simulator.scenarios()?;
    for scenario in &options.scenarios {
        ensure!(known.contains(scenario), "there is no scenario {scenario}; there are: {}", known.join(", "));
    }
    let mut scenarios = if options.scenarios.is_empty() { known } else { options.scenarios.clone() };
    let set = if options.evaluation { Set::Evaluation } else { Set::Development };
    let jobs = options.workload.jobs();
    if options.record && !options.force && options.scenarios.is_empty() {
        scenarios = changed(&simulator, scenarios, set, jobs)?;
        if scenarios.is_empty() {
            say!("Nothing to record: one machine of each scenario answers as recorded (all: --force).");
            return Ok(());
        }
    }
    // Ordered by seed, so that the remaining time can be estimated from the first ones.
    let each = |scenario: &String| {
        let scenario = scenario.clone();
        set.seeds(&scenario).into_iter().map(move |seed| (scenario.clone(), seed))
    };
    let mut runs: Vec<_> = scenarios.iter().flat_map(each).collect();
    runs.sort_by_key(|(_, seed)| *seed);
    let runs = options.workload.partition.select(runs);
    let name = format!("{}-{}.jsonl", set.name(), options.workload.partition);
    let mut file = ResultsFile::create(&test::out("sweep").join(name))?;
    let mut results = Vec::new();
    simulator.run_all(&runs, jobs, |mut run| {
        run.commit = Some(commit.clone());
        file.add(&run)?;
        results.push(run);
        Ok(())
    })?;
    let path = file.finish()?;
    if options.record {
        for told in merge::merge(Path::new(FOLDER), results.clone(), None)? {
            say!("{told}");
        }
        say!("Now run `cargo xtask sweep tables`.");
    }
    let missed = print(&results)?;
    say!("\nAll runs: {}", path.display());
    if !options.workload.partition.is_whole() {
        say!("When all parts are done: `cargo xtask sweep merge` with their files.");
        // A part is done when its machines have run; missed limits are in its file.
        return Ok(());
    }
    ensure!(missed.is_empty(), "limits missed in {}", missed.join(", "));
    Ok(())
}

/// Returns the scenarios that are not recorded completely, or whose recorded machine has a different result
/// now.
fn changed(simulator: &Simulator, scenarios: Vec<String>, set: Set, jobs: usize) -> Result<Vec<String>> {
    let mut recorded = BTreeMap::new();
    for (index, scenario) in scenarios.iter().enumerate() {
        let Some(sweep) = Sweep::load(Path::new(FOLDER), scenario, set)? else { continue };
        if sweep.machines.len() == set.seeds(scenario).len()
            && let Some(seed) = check::chosen(&sweep, index)
        {
            recorded.insert(scenario.clone(), (sweep, seed));
        }
    }
    let probes: Vec<_> = recorded.iter().map(|(name, (_, seed))| (name.clone(), *seed)).collect();
    let mut same = Vec::new();
    simulator.run_all(&probes, jobs, |run| {
        if check::compare(&recorded[&run.scenario].0, &run).is_ok() {
            say!("{} answers as recorded of commit {}", run.scenario, recorded[&run.scenario].0.commit);
            same.push(run.scenario);
        }
        Ok(())
    })?;
    Ok(scenarios.into_iter().filter(|scenario| !same.contains(scenario)).collect())
}

/// Removes the limits of recorded machines that leave no room for them.
fn limits(simulator: &Simulator) -> Result<()> {
    for scenario in simulator.scenarios()? {
        for set in Set::ALL {
            let Some(mut sweep) = Sweep::load(Path::new(FOLDER), &scenario, set)? else { continue };
            let seeds: Vec<u64> = sweep.machines.iter().map(|machine| machine.seed).collect();
            let mut changed = 0;
            for (seed, impossible) in simulator.impossible(&scenario, &seeds)? {
                changed += usize::from(sweep.exempt(seed, &impossible)?);
            }
            if changed > 0 {
                say!("{}: {changed} machines", sweep.save(Path::new(FOLDER))?.display());
            }
        }
    }
    say!("Now run `cargo xtask sweep tables`.");
    Ok(())
}

/// Runs a machine of each set that `sets` gives for a scenario again, and compares it with the record.
fn check<const N: usize>(simulator: &Simulator, sets: impl Fn(usize) -> [Set; N]) -> Result<()> {
    let mut recorded = BTreeMap::new();
    let mut runs = Vec::new();
    let mut stale = Vec::new();
    for (index, scenario) in simulator.scenarios()?.into_iter().enumerate() {
        for set in sets(index) {
            let sweep = Sweep::load(Path::new(FOLDER), &scenario, set)?;
            let chosen = sweep.as_ref().and_then(|sweep| check::chosen(sweep, index));
            if let (Some(sweep), Some(seed)) = (sweep, chosen) {
                runs.push((scenario.clone(), seed));
                recorded.insert((scenario.clone(), seed), sweep);
            } else {
                stale.push(format!("{scenario}: no {} machine is recorded", set.name()));
            }
        }
    }
    simulator.run_all(&runs, cores(), |run| {
        let sweep = &recorded[&(run.scenario.clone(), run.seed)];
        if let Err(error) = check::compare(sweep, &run) {
            stale.push(error.to_string());
        }
        Ok(())
    })?;
    stale.sort();
    if !stale.is_empty() {
        bail!("{FOLDER} is stale:\n{}", stale.join("\n"));
    }
    say!("{} recorded machines run again: the same", runs.len());
    Ok(())
}

/// Prints the smallest, the median and the largest value of each metric, infinite where it is unknown;
/// returns the scenarios with a machine that misses a limit.
fn print(results: &[Run]) -> Result<Vec<String>> {
    let mut by_scenario: BTreeMap<&str, Vec<&Run>> = BTreeMap::new();
    for run in results {
        by_scenario.entry(&run.scenario).or_default().push(run);
    }
    let mut missed = Vec::new();
    for (scenario, runs) in by_scenario {
        let mut failed = false;
        say!(
            "\n{scenario}, {} machines {:>38} {:>10} {:>10} {:>10} {:>8}",
            runs.len(),
            "smallest",
            "median",
            "largest",
            "limit",
            "missed"
        );
        let mut metrics: Vec<(record::Metric, Vec<f64>, usize)> = Vec::new();
        for run in &runs {
            if let Some(error) = &run.error {
                failed = true;
                say!("  seed {} failed: {error}", run.seed);
            }
            for (metric, value, pass) in run.measured()? {
                let value = value.unwrap_or(f64::INFINITY);
                failed |= !pass;
                match metrics.iter_mut().find(|(known, ..)| known.name == metric.name) {
                    Some((_, values, missed)) => {
                        values.push(value);
                        *missed += usize::from(!pass);
                    }
                    None => metrics.push((metric, vec![value], usize::from(!pass))),
                }
            }
        }
        for (metric, mut values, missed) in metrics {
            values.sort_by(f64::total_cmp);
            let limit = metric.limit.map_or_else(|| String::from("–"), |limit| limit.to_string());
            let [low, high] = [values[0], values[values.len() - 1]];
            let median = stats::median(&values);
            say!(
                "  {:<44} {low:>10.4} {median:>10.4} {high:>10.4} {limit:>10} {missed:>8} {}",
                metric.name,
                metric.unit
            );
        }
        if failed {
            missed.push(scenario.to_owned());
        }
    }
    Ok(missed)
}
