//! `cargo xtask bench`: executed instructions on the emulated Cortex-M4F (exact and repeatable), and the
//! speed of the simulation on this machine (not repeatable, so never a test). Recorded results are kept in
//! `docs/benchmarks.jsonl`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use tesaki_output::say;

use crate::firmware;
use crate::sweep::Simulator;
use crate::tools::{self, ArmCompiler};

const HISTORY: &str = "docs/benchmarks.jsonl";

/// Most executed instructions of a call, by benchmark.
const LIMITS: &[(&str, f64)] = &[
    ("pid", 38.0),
    ("trajectory_filter", 15.0),
    ("sin_cos", 60.0),
    // Of the 4200 cycles of a period at 40 kHz.
    ("current_loop_3", 1000.0),
    ("codec_largest_telemetry", 6000.0),
    // 1497 with rustc 1.95, 1554 with Debian's 1.96.
    ("forward_and_jacobian_7", 1600.0),
    ("bias_acceleration_7", 1500.0),
    ("inverse_dynamics_7_wrench", 3500.0),
    ("mass_matrix_7", 4000.0),
    ("finger_nearest", 450.0),
    ("least_grip_3_warm", 25_000.0),
    ("least_grip_3_infeasible", 60_000.0),
    ("least_grip_3_too_heavy", 60_000.0),
    ("least_grip_3_slice_cold", 25_000.0),
    ("least_grip_3_slice_infeasible", 25_000.0),
    ("least_grip_3_slice_worst", 25_000.0),
    ("least_grip_6_slice_worst", 25_000.0),
    ("retarget", 100_000.0),
    ("retarget_longest", 100_000.0),
    ("retarget_unreachable_longest", 100_000.0),
    ("retarget_directions_longest", 100_000.0),
    ("retarget_directions_unreachable_longest", 100_000.0),
    ("retarget_first_unreachable_longest", 100_000.0),
    ("retarget_first_directions_unreachable_longest", 100_000.0),
    ("retarget_mimics_longest", 100_000.0),
    ("retarget_mimics_unreachable_longest", 100_000.0),
    // As the tick of the five-finger hand in tests/tests/image.rs; of the 1 680 000 of a period.
    ("node_tick_mimics_following_longest", 130_000.0),
    // 100 ms at 168 MHz and 1.5 cycles each are 11 200 000 instructions: enough for the window.
    ("find_circle", 18_600_000.0),
    ("find_circle_window", 11_200_000.0),
    // The compiler's choices vary with the path of the checkout, here by some tens.
    ("node_tick_9_pid", 6200.0),
    ("node_tick_9_observer", 6200.0),
];

/// Options of `cargo xtask bench`.
#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object instead of a table
    #[arg(long)]
    json: bool,
    /// Add the results to docs/benchmarks.jsonl
    #[arg(long)]
    record: bool,
}

/// One run of all benchmarks.
#[derive(Debug, Serialize, Deserialize)]
struct Results {
    commit: String,
    date: String,
    compiler: String,
    /// Executed instructions a call.
    instructions: BTreeMap<String, f64>,
    /// Simulated seconds of hand3-servo per second of CPU time.
    simulated_seconds_per_cpu_second: Option<f64>,
}

/// Runs an on-target program that talks through semihosting; fails when it says so.
pub fn semihosted(program: &Path, arguments: &[String]) -> Result<String> {
    let mut config = String::from("enable=on,target=native");
    for argument in arguments {
        config += &format!(",arg={argument}");
    }
    let mut qemu = Command::new("qemu-system-arm");
    qemu.args(["-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "null"]);
    qemu.args(["-icount", "shift=0,sleep=off", "-semihosting-config", &config, "-kernel"]).arg(program);
    tools::output(&mut qemu)
}

fn instructions(compiler: ArmCompiler) -> Result<BTreeMap<String, f64>> {
    let programs = firmware::build_on_target(compiler)?;
    let mut text = String::new();
    for program in ["bench", "vision"] {
        text += &semihosted(&programs.join(program), &[])?;
    }
    let counts = text.lines().filter_map(|line| {
        let (name, count) = line.split_once(' ')?;
        Some((name.to_owned(), count.trim().parse().ok()?))
    });
    let counts: BTreeMap<_, _> = counts.collect();
    ensure!(!counts.is_empty(), "the benchmark printed no results:\n{text}");
    Ok(counts)
}

/// Fails when a benchmark is over its limit.
pub fn check(compiler: ArmCompiler) -> Result<()> {
    let counts = instructions(compiler)?;
    print_table(&counts, None);
    check_limits(&counts)
}

/// Fails when a benchmark is over its limit, or missing; names all of them.
fn check_limits(counts: &BTreeMap<String, f64>) -> Result<()> {
    let wrong = LIMITS.iter().filter_map(|&(name, limit)| match counts.get(name) {
        None => Some(format!("the benchmark {name} is missing")),
        Some(count) if *count <= limit => None,
        Some(count) => Some(format!("{name} takes {count} instructions, more than {limit}")),
    });
    let wrong: Vec<String> = wrong.collect();
    ensure!(wrong.is_empty(), "{}", wrong.join("\n"));
    Ok(())
}

/// `cargo xtask bench`. Fails when a benchmark is over its limit, and records nothing then.
pub fn run(options: &Options) -> Result<()> {
    tools::provide_qemu()?;
    let compiler = ArmCompiler::provide()?;
    let git = |arguments: &[&str]| {
        tools::output(Command::new("git").args(arguments)).map(|text| text.trim().to_owned())
    };
    let results = Results {
        commit: git(&["describe", "--always", "--dirty", "--abbrev=12"])?,
        date: git(&["log", "-1", "--format=%cs"])?,
        compiler: compiler.version()?,
        instructions: instructions(compiler)?,
        simulated_seconds_per_cpu_second: Some(simulation_speed()?),
    };
    let last = std::fs::read_to_string(HISTORY).unwrap_or_default();
    let last: Option<Results> = last.lines().last().map(serde_json::from_str).transpose().context(HISTORY)?;
    if options.json {
        say!("{}", serde_json::to_string(&results)?);
    } else {
        print_table(&results.instructions, last.as_ref());
        let speed = results.simulated_seconds_per_cpu_second.unwrap_or(f64::NAN);
        say!("\nhand3-servo: {speed:.1} simulated seconds per CPU second");
    }
    check_limits(&results.instructions)?;
    if options.record {
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(HISTORY)?;
        writeln!(file, "{}", serde_json::to_string(&results)?)?;
    }
    Ok(())
}

fn print_table(counts: &BTreeMap<String, f64>, last: Option<&Results>) {
    say!("{:<28} {:>12} {:>8} {:>14}", "executed instructions", "a call", "limit", "last recorded");
    for (name, count) in counts {
        let limit = LIMITS.iter().find(|(limited, _)| limited == name);
        let limit = limit.map_or(String::from("–"), |(_, limit)| limit.to_string());
        let last = last.and_then(|last| last.instructions.get(name));
        let last = last.map_or(String::from("–"), |last| format!("{last:.1}"));
        say!("{name:<28} {count:>12.1} {limit:>8} {last:>14}");
    }
}

/// Simulated seconds per CPU second of hand3-servo with its control, on this machine.
fn simulation_speed() -> Result<f64> {
    let mut host_sim = Simulator::build()?.command();
    let before = tools::cpu_time()?;
    host_sim.args(["run", "hand3-servo", "--seed", "1-5", "--json", "--out"]).arg(crate::test::out("bench"));
    let text = tools::output(&mut host_sim)?;
    let mut ticks = 0.0;
    for line in text.lines() {
        let summary: serde_json::Value = serde_json::from_str(line)?;
        ticks += summary["ticks"].as_f64().context("host-sim printed no number of ticks")?;
    }
    Ok(ticks * 0.01 / (tools::cpu_time()? - before).as_secs_f64())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn every_benchmark_over_its_limit_or_missing_is_named() {
        let mut counts: BTreeMap<String, f64> =
            LIMITS.iter().map(|(name, limit)| ((*name).to_owned(), *limit)).collect();
        // One that has no limit.
        counts.insert("reported".to_owned(), 1e9);
        check_limits(&counts).unwrap();
        *counts.get_mut("pid").unwrap() += 0.1;
        *counts.get_mut("find_circle").unwrap() += 1.0;
        counts.remove("retarget").unwrap();
        let error = check_limits(&counts).unwrap_err().to_string();
        let lines: Vec<&str> = error.lines().collect();
        assert_eq!(
            lines,
            [
                "pid takes 38.1 instructions, more than 38",
                "the benchmark retarget is missing",
                "find_circle takes 18600001 instructions, more than 18600000",
            ]
        );
    }
}
