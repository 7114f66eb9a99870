//! `cargo xtask sweep`: every scenario over many seeds, its results kept with the commit that they belong to.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use crate::tools;

const FOLDER: &str = "docs/sweeps";

/// Options of `cargo xtask sweep`.
#[derive(clap::Args)]
pub struct Options {
    /// Scenarios, see `cargo sim list`; without one, all
    scenarios: Vec<String>,
    /// Seeds, each a machine of its own
    #[arg(long, default_value = "1-20")]
    seeds: String,
    /// Keep the results in docs/sweeps
    #[arg(long)]
    record: bool,
}

fn simulator(arguments: &[&str]) -> Command {
    let mut command = Command::new("cargo");
    command.args(["run", "--release", "--quiet", "-p", "tesaki-sim", "--"]).args(arguments);
    command
}

/// The scenarios that the simulator lists, by the first word of each line.
fn all() -> Result<Vec<String>> {
    let text = tools::output(&mut simulator(&["list"]))?;
    let lines = text.lines().filter_map(|line| line.strip_prefix("  "));
    Ok(lines.filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect())
}

/// Runs the sweep; fails when a seed misses a limit.
pub fn run(options: &Options) -> Result<()> {
    let scenarios = if options.scenarios.is_empty() { all()? } else { options.scenarios.clone() };
    ensure!(!scenarios.is_empty(), "the simulator lists no scenarios");
    let git = |arguments: &[&str]| {
        tools::output(Command::new("git").args(arguments)).map(|text| text.trim().to_owned())
    };
    let commit = git(&["describe", "--always", "--dirty", "--abbrev=12"])?;
    let mut missed = Vec::new();
    for scenario in &scenarios {
        let run = ["run", scenario, "--seed", &options.seeds, "--json", "--out", "target/xtask/sweep"];
        // A missed limit makes it fail, but its results are still to be seen.
        let output = simulator(&run).output().context("cannot start the simulator")?;
        let text = String::from_utf8_lossy(&output.stdout);
        let results: Vec<Value> = text
            .lines()
            .map(serde_json::from_str)
            .collect::<Result<_, _>>()
            .with_context(|| format!("{scenario}: {text}{}", String::from_utf8_lossy(&output.stderr)))?;
        // It stops at the first seed that cannot be run to its end.
        let (first, last) = options.seeds.split_once('-').unwrap_or((&options.seeds, &options.seeds));
        let seeds = 1 + last.parse::<usize>()? - first.parse::<usize>()?;
        let (done, stderr) = (results.len(), String::from_utf8_lossy(&output.stderr));
        ensure!(done == seeds, "{scenario}: {done} of {seeds} seeds ran to their end: {stderr}");
        if !output.status.success() {
            missed.push(scenario.as_str());
        }
        print(scenario, &results);
        if options.record {
            let kept = json!({ "commit": commit, "seeds": options.seeds, "results": results });
            std::fs::create_dir_all(FOLDER)?;
            let path = PathBuf::from(FOLDER).join(format!("{scenario}.json"));
            std::fs::write(&path, serde_json::to_string(&kept)? + "\n")?;
            println!("kept in {}", path.display());
        }
    }
    ensure!(missed.is_empty(), "limits missed in {}", missed.join(", "));
    Ok(())
}

/// Median and worst of each metric.
fn print(scenario: &str, results: &[Value]) {
    println!("\n{scenario}, {} seeds {:>41} {:>10} {:>8}", results.len(), "median", "largest", "limit");
    let names = results.first().and_then(|result| result["metrics"].as_object());
    for name in names.into_iter().flat_map(serde_json::Map::keys) {
        let metric = |result: &Value| result["metrics"][name]["value"].as_f64().unwrap_or(f64::NAN);
        let mut values: Vec<f64> = results.iter().map(metric).collect();
        values.sort_by(f64::total_cmp);
        let middle = values.len() / 2;
        let median = if values.len().is_multiple_of(2) {
            0.5 * (values[middle - 1] + values[middle])
        } else {
            values[middle]
        };
        let first = &results[0]["metrics"][name];
        let limit = first["limit"].as_f64().map_or_else(|| String::from("–"), |limit| limit.to_string());
        let unit = first["unit"].as_str().unwrap_or("");
        println!("  {name:<44} {median:>10.4} {:>10.4} {limit:>8} {unit}", values[values.len() - 1]);
    }
}
