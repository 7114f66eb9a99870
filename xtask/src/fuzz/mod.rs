//! `cargo xtask fuzz`: libFuzzer on the targets in `tests/fuzz`.

mod coverage;
mod record;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use clap::builder::PossibleValuesParser;
use tesaki_output::say;

use crate::commit::{FUZZER, commit, require_committed};
use crate::{firmware, test, tools};
use coverage::Share;
use record::{FILE, Record, Run, Session};

const EXAMPLES: &str = "Examples:
  cargo xtask fuzz                           every target for a minute
  cargo xtask fuzz node --seconds 600        one for ten
  cargo xtask fuzz node --record             keep its inputs in tests/fuzz/corpus, the result in docs/fuzzing.json

A recorded run goes on from what those before have kept, and its time is added to theirs: six runs of ten minutes are
an hour.

Needs a C++ compiler, for libFuzzer; the stable Rust toolchain is enough. The whole corpus of all runs stays in
target/xtask/fuzz.";

/// Folder of libFuzzer's targets.
const CRATE: &str = "tests/fuzz";
/// Flags that count edges, as set by `cargo fuzz`; only the sanitizers, which safe code hardly needs, would
/// require a nightly toolchain. Comparisons are not traced, because that takes more than half of the time.
/// The mangling of names allows reading them back completely.
const INSTRUMENTATION: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
     -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
     -Csymbol-mangling-version=v0";
/// The targets in `tests/fuzz`, which the program lists as well.
const TARGETS: [&str; 5] = ["codec", "node", "robot", "files", "recording"];
/// Longest time for one input [s].
const TIMEOUT: u32 = 10;

/// Options of `cargo xtask fuzz`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Options {
    /// Targets; without one, all
    #[arg(value_parser = PossibleValuesParser::new(TARGETS))]
    targets: Vec<String>,
    /// Time for each target
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..))]
    seconds: u32,
    /// Keep the smallest corpus with the same edges, and add time and executions to the recorded ones
    #[arg(long)]
    record: bool,
}

/// Runs `cargo xtask fuzz`.
pub fn run(options: &Options) -> Result<()> {
    if options.record {
        require_committed(&commit(FUZZER)?)?;
    }
    let fuzzer = Fuzzer::build()?;
    let known = fuzzer.targets()?;
    let names: Vec<&String> = known.iter().map(|target| &target.name).collect();
    ensure!(names == TARGETS, "the program has the targets {names:?}, cargo xtask fuzz {TARGETS:?}");
    let chosen = |target: &&Target| options.targets.is_empty() || options.targets.contains(&target.name);
    let mut crashed = Vec::new();
    for target in known.iter().filter(chosen) {
        let run = fuzzer.run(target, options)?;
        say!("{}: {run}", target.name);
        if run.crashes > 0 {
            crashed.push(target.name.as_str());
        } else if options.record {
            std::fs::copy(out(target).join("packed.bin"), corpus(target))?;
            Record::load()?.with(&target.name, run).save()?;
            say!("kept in {} and {FILE}", corpus(target).display());
        }
    }
    ensure!(
        crashed.is_empty(),
        "crashes of {}. Copy the input to {CRATE}/crashes/TARGET/what-happens: then `cargo test -p tesaki-fuzz` shows it, \
         and keeps showing it",
        crashed.join(", ")
    );
    Ok(())
}

/// Checks that the table in the document matches the record.
pub fn check_table() -> Result<()> {
    Record::load()?.check()
}

/// A target, with the modules that it tests.
struct Target {
    name: String,
    modules: Vec<String>,
}

/// Working files of a target.
fn out(target: &Target) -> PathBuf {
    test::out("fuzz").join(&target.name)
}

/// Its kept inputs.
fn corpus(target: &Target) -> PathBuf {
    Path::new(CRATE).join("corpus").join(&target.name).with_extension("bin")
}

/// The instrumented program.
struct Fuzzer {
    path: PathBuf,
    /// The commit from which it was built.
    commit: String,
}

impl Fuzzer {
    fn build() -> Result<Self> {
        ensure!(
            cfg!(target_os = "linux"),
            "fuzzing needs Linux: the tables of covered edges are found by GNU ld"
        );
        let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".to_owned());
        ensure!(
            tools::succeeds(Command::new(&compiler).arg("--version")),
            "there is no C++ compiler {compiler:?}, which libFuzzer needs: install g++ or clang, or name one in CXX"
        );
        let version = tools::output(Command::new("rustc").arg("-vV"))?;
        let host = version.lines().find_map(|line| line.strip_prefix("host: "));
        let host = host.context("rustc does not tell its host")?;
        let folder = firmware::target().join("fuzz");
        let mut cargo = Command::new("cargo");
        cargo.args(["build", "--quiet", "--locked", "-p", "tesaki-fuzz", "--features", "libfuzzer"]);
        // If a target is named, build scripts and macros are not instrumented.
        cargo.args(["--profile", "fuzz", "--target", host, "--target-dir"]).arg(&folder);
        tools::run(cargo.env("RUSTFLAGS", INSTRUMENTATION))?;
        let path = std::path::absolute(folder.join(host).join("fuzz").join("tesaki-fuzz"))?;
        Ok(Self { path, commit: commit(FUZZER)? })
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.path);
        command.args(arguments);
        command
    }

    fn targets(&self) -> Result<Vec<Target>> {
        let text = tools::output(&mut self.command(&["list"]))?;
        let words = text.lines().map(|line| line.split(' ').map(str::to_owned));
        Ok(words
            .filter_map(|mut words| Some(Target { name: words.next()?, modules: words.collect() }))
            .collect())
    }

    /// Runs a target, and measures the coverage of its corpus afterwards.
    fn run(&self, target: &Target, options: &Options) -> Result<Run> {
        let out = out(target);
        let (corpus, crashes) = (out.join("corpus"), out.join("crashes"));
        // libFuzzer names an input by its hash, so a known one would be overwritten.
        std::fs::create_dir_all(&out)?;
        let session = tempfile::Builder::new().prefix("session-").tempdir_in(&out)?;
        tools::run(self.command(&["unpack", &target.name]).arg(&out))?;
        let log = out.join("log");
        say!("{} for {} s; {} tells how it goes on", target.name, options.seconds, log.display());
        let mut command = self.command(&["run", &target.name]);
        command.arg(format!("-max_total_time={}", options.seconds)).arg(format!("-timeout={TIMEOUT}"));
        command.arg(format!("-artifact_prefix={}/", session.path().display()));
        let words = out.join("words");
        if words.exists() {
            command.arg(format!("-dict={}", words.display()));
        }
        command
            .args(["-print_final_stats=1", "-rss_limit_mb=900", "-reload=0", "-len_control=0"])
            .arg(&corpus);
        let before = tools::cpu_time()?;
        let status =
            command.stderr(std::fs::File::create(&log)?).status().context("cannot start the fuzzer")?;
        let seconds = (tools::cpu_time()? - before).as_secs();
        let text = String::from_utf8_lossy(&std::fs::read(&log)?).into_owned();
        let found = move_files(session.path(), &crashes)?;
        if !status.success() {
            let head = text.find("panicked at").or_else(|| text.find("ERROR: libFuzzer"));
            let tail = head.and_then(|head| text.get(head..)).unwrap_or(&text);
            say!("{}", tail.lines().take(12).collect::<Vec<_>>().join("\n"));
            if found == 0 {
                bail!("{} ended with {status} and left no input; see {}", target.name, log.display());
            }
            say!("its input is in {}", crashes.display());
        }
        let session = Session { commit: self.commit.clone(), seconds, executions: executions(&text) };
        let mut run = Run { sessions: vec![session], crashes: found, ..Run::default() };
        if found == 0 {
            let kept = tools::output(&mut self.command(&["pack", &target.name, &out.display().to_string()]))?;
            let numbers: Vec<u64> = kept.split_whitespace().filter_map(|word| word.parse().ok()).collect();
            let [inputs, bytes] = *numbers else { bail!("{kept:?} are not two numbers") };
            let Share { edges, functions, of_target } = coverage::measure(&self.path, &out, &target.modules)?;
            run = Run { inputs, bytes, edges, functions, of_target, ..run };
        }
        Ok(run)
    }
}

/// Moves all files of a folder to another one, replacing those with the same names. Returns their number.
fn move_files(from: &Path, to: &Path) -> Result<u64> {
    std::fs::create_dir_all(to)?;
    let mut moved = 0;
    for file in std::fs::read_dir(from)? {
        let file = file?;
        std::fs::rename(file.path(), to.join(file.file_name()))?;
        moved += 1;
    }
    Ok(moved)
}

/// Returns the number of executed inputs from libFuzzer's final statistics.
fn executions(log: &str) -> u64 {
    let total = log.lines().find_map(|line| line.strip_prefix("stat::number_of_executed_units:"));
    total.and_then(|number| number.trim().parse().ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn a_known_crash_that_is_found_again_counts() {
        let folder = tempfile::tempdir().unwrap();
        let (session, crashes) = (folder.path().join("session"), folder.path().join("crashes"));
        std::fs::create_dir(&session).unwrap();
        assert_eq!(move_files(&session, &crashes).unwrap(), 0);
        for others in [0, 1] {
            std::fs::write(session.join("crash-1"), "same").unwrap();
            (0..others).for_each(|_| std::fs::write(session.join("crash-2"), "new").unwrap());
            assert_eq!(move_files(&session, &crashes).unwrap(), 1 + others);
        }
        assert_eq!(std::fs::read_dir(&session).unwrap().count(), 0);
        assert_eq!(std::fs::read_dir(&crashes).unwrap().count(), 2);
    }
}
