//! `host-sim faults`.

use std::error::Error;
use std::ops::RangeInclusive;

use clap::Args;
use tesaki_output::{note, say};
use tesaki_sim::faults::{self, Report, Schedule, Violation};

use super::{seeds, workspace};

#[derive(Args)]
pub struct Faults {
    /// Seed of a schedule; a range such as 1-200 runs all of them in turn
    #[arg(
        long,
        visible_alias = "seed",
        default_value = "1",
        value_parser = seeds,
        allow_hyphen_values = true,
        conflicts_with = "schedule"
    )]
    seeds: RangeInclusive<u64>,
    /// A schedule as JSON, as a failing one prints it
    #[arg(long)]
    schedule: Option<String>,
    /// Print a line for each tick
    #[arg(long)]
    trace: bool,
    /// Do not look for the smallest schedule that fails
    #[arg(long)]
    no_shrink: bool,
    /// Print one JSON object per seed
    #[arg(long)]
    json: bool,
}

/// The schedule in JSON.
fn parse(text: &str) -> Result<Schedule, String> {
    let schedule: Schedule = serde_json::from_str(text).map_err(|error| {
        format!(
            "--schedule: {error}: give the JSON text itself, as a seed that fails prints it behind `repeat:`, in quotes"
        )
    })?;
    schedule.validate().map_err(|error| format!("--schedule: {error}"))?;
    Ok(schedule)
}

/// Runs schedules of faults; `false` if a rule was broken.
pub fn run(options: &Faults) -> Result<bool, Box<dyn Error>> {
    let robots = workspace().join("robots");
    let schedules: Box<dyn Iterator<Item = Schedule>> = match &options.schedule {
        Some(text) => Box::new(std::iter::once(parse(text)?)),
        None => Box::new(options.seeds.clone().map(Schedule::draw)),
    };
    let mut passed = true;
    for schedule in schedules {
        let (report, trace) = faults::run_traced(&schedule, &robots, options.trace.then(Vec::new))?;
        trace.iter().for_each(|line| if options.json { note!("{line}") } else { say!("{line}") });
        passed &= report.violations.is_empty();
        if options.json {
            say!("{}", serde_json::to_string(&report)?);
        } else {
            let families: Vec<String> = report.families.iter().map(ToString::to_string).collect();
            let state = if report.violations.is_empty() { "safe" } else { "UNSAFE" };
            let Report { seed, scenario, ticks: [ran, planned], .. } = &report;
            say!("seed {seed}: {scenario}: {}: {ran} of {planned} ticks: {state}", families.join(", "));
        }
        let [ran, planned] = report.ticks;
        if !options.json && (options.schedule.is_some() || !report.violations.is_empty() || ran < planned) {
            report.faults.iter().for_each(|fault| say!("  log: {fault}"));
            report.error.iter().for_each(|error| say!("  ended: {error}"));
        }
        for violation in &report.violations {
            let Violation { rule, tick, text } = violation;
            note!("seed {}, tick {tick}: {rule} is broken: {text}", schedule.seed);
            if options.no_shrink || options.schedule.is_some() {
                note!("  repeat: {}", schedule.command());
            } else {
                note!("  repeat: {}", faults::shrink(&schedule, violation, &robots).command());
            }
        }
    }
    Ok(passed)
}
