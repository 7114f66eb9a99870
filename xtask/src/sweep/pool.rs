//! Runs the simulator on all cores.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, ensure};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Deserialize;
use serde_json::Value;

use super::merge::Run;
use crate::{firmware, tools};

/// The program that runs scenarios.
pub struct Simulator {
    path: PathBuf,
    /// Folder for the recordings of its runs.
    recordings: Option<PathBuf>,
}

/// A line of `host-sim limits --json`.
#[derive(Deserialize)]
struct Told {
    seed: u64,
    impossible: Option<serde_json::Map<String, Value>>,
}

impl Simulator {
    /// Builds it with the same features as in the host suite, so that nothing is built twice.
    ///
    /// # Errors
    /// When it cannot be built.
    pub fn build() -> Result<Self> {
        tools::run(Command::new("cargo").args(["build", "--release", "--quiet", "--bin", "host-sim"]))?;
        Ok(Self::built())
    }

    /// Returns the one that the host suite has built.
    pub fn built() -> Self {
        Self { path: firmware::target().join("release").join("host-sim"), recordings: None }
    }

    /// Uses another program in its place.
    #[cfg(test)]
    pub fn at(path: &std::path::Path) -> Self {
        Self { path: path.to_owned(), recordings: None }
    }

    /// Keeps the recording of each run in `folder`, by the name of its scenario.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn recording(self, folder: PathBuf) -> Result<Self> {
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(Self { recordings: Some(folder), ..self })
    }

    /// A command that runs it.
    pub fn command(&self) -> Command {
        Command::new(&self.path)
    }

    /// Returns all scenarios: the first word of each listed line.
    ///
    /// # Errors
    /// When it cannot be run, or lists none.
    pub fn scenarios(&self) -> Result<Vec<String>> {
        let text = tools::output(self.command().arg("list"))?;
        let lines = text.lines().filter_map(|line| line.strip_prefix("  "));
        let names: Vec<String> =
            lines.filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect();
        ensure!(!names.is_empty(), "the simulator lists no scenarios:\n{text}");
        Ok(names)
    }

    /// Returns the metrics of a scenario whose limits are not demanded of the machine of each seed.
    ///
    /// # Errors
    /// When the simulator cannot compute them.
    pub fn impossible(&self, scenario: &str, seeds: &[u64]) -> Result<Vec<(u64, Vec<String>)>> {
        let (Some(first), Some(last)) = (seeds.first(), seeds.last()) else { return Ok(Vec::new()) };
        let mut command = self.command();
        command.args(["limits", scenario, "--json", "--seed", &format!("{first}-{last}")]);
        let text = tools::output(&mut command)?;
        let told = |line: &str| -> Result<(u64, Vec<String>)> {
            let Told { seed, impossible } = serde_json::from_str(line).with_context(|| line.to_owned())?;
            Ok((seed, impossible.unwrap_or_default().into_iter().map(|(metric, _)| metric).collect()))
        };
        text.lines().map(told).collect()
    }

    /// Runs one machine. A failed run is also a result.
    fn run(&self, scenario: &str, seed: u64) -> Result<Run> {
        // Other machines run at the same time.
        let out = tempfile::tempdir()?;
        let mut command = self.command();
        command.args(["run", scenario, "--seed", &seed.to_string(), "--json", "--out"]).arg(out.path());
        let output = command.stdin(Stdio::null()).output().context("cannot start the simulator")?;
        let text = String::from_utf8_lossy(&output.stdout);
        if text.trim().is_empty() {
            // Only an error of the scenario is a result of the machine, not an invalid command line or a
            // signal.
            let error = String::from_utf8_lossy(&output.stderr).trim().to_owned();
            let told = error.strip_prefix("host-sim: ");
            let told = told.with_context(|| format!("{scenario}, seed {seed}: {} {error}", output.status))?;
            return Ok(Run::failed(scenario, seed, told.to_owned()));
        }
        if let Some(folder) = &self.recordings {
            let (from, to) =
                (out.path().join(scenario).join("frames.log"), folder.join(format!("{scenario}.log")));
            std::fs::copy(&from, &to).with_context(|| from.display().to_string())?;
        }
        let line: Value = serde_json::from_str(&text).with_context(|| text.clone().into_owned())?;
        serde_json::from_value(line).with_context(|| format!("{scenario}, seed {seed}: {text}"))
    }

    /// Runs all `(scenario, seed)` on `jobs` cores; `done` is called with each result as it arrives, in any
    /// order.
    ///
    /// # Errors
    /// When the simulator cannot be run, or `done` fails. Runs that have started finish first.
    pub fn run_all(
        &self,
        runs: &[(String, u64)],
        jobs: usize,
        done: impl FnMut(Run) -> Result<()> + Send,
    ) -> Result<()> {
        let bar = progress(runs.len());
        let run = |(scenario, seed): &(String, u64)| self.run(scenario, *seed);
        let mut done = done;
        for_each(runs, jobs, run, |run| {
            done(run)?;
            bar.inc(1);
            Ok(())
        })?;
        bar.finish_and_clear();
        Ok(())
    }
}

/// Calls `work` with each item in one of `jobs` threads, and `done` with each result as it arrives, in any
/// order.
///
/// # Errors
/// When `work` or `done` fails. Then no other item is started, and those that were started finish first.
pub fn for_each<T: Sync, R>(
    items: &[T],
    jobs: usize,
    work: impl Fn(&T) -> Result<R> + Sync,
    done: impl FnMut(R) -> Result<()> + Send,
) -> Result<()> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(done));
    let worker = || -> Result<()> {
        while let Some(item) = items.get(next.fetch_add(1, Ordering::Relaxed)) {
            let told = work(item).and_then(|result| {
                let mut done = done.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                done(result)
            });
            if told.is_err() {
                next.store(items.len(), Ordering::Relaxed);
            }
            told?;
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().try_for_each(|worker| worker.join().expect("a worker does not panic"))
    })
}

fn progress(length: usize) -> ProgressBar {
    let bar = ProgressBar::new(length as u64);
    let style = ProgressStyle::with_template("{wide_bar} {pos} of {len} machines, {elapsed}, {eta} left");
    if let Ok(style) = style {
        bar.set_style(style);
    }
    bar.enable_steady_tick(std::time::Duration::from_secs(1));
    bar
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use anyhow::bail;

    use super::*;

    #[test]
    fn every_item_is_done_once() {
        let items: Vec<u32> = (0..100).collect();
        let mut results = Vec::new();
        let collect = |square| {
            results.push(square);
            Ok(())
        };
        for_each(&items, 4, |item| Ok(item * item), collect).unwrap();
        results.sort_unstable();
        assert_eq!(results, items.iter().map(|item| item * item).collect::<Vec<_>>());
    }

    #[test]
    fn after_an_error_no_other_item_is_begun() {
        let items: Vec<u32> = (0..100).collect();
        let (failed, begun) = (AtomicBool::new(false), AtomicUsize::new(0));
        let work = |item: &u32| {
            if *item == 0 {
                failed.store(true, Ordering::Relaxed);
                bail!("the first one")
            }
            while !failed.load(Ordering::Relaxed) {
                std::thread::yield_now();
            }
            begun.fetch_add(1, Ordering::Relaxed);
            // Time for the other thread to finish.
            std::thread::sleep(Duration::from_millis(20));
            Ok(())
        };
        let error = for_each(&items, 2, work, |()| Ok(())).unwrap_err();
        assert_eq!(error.to_string(), "the first one");
        assert!(begun.into_inner() < items.len() / 2);
    }
}
