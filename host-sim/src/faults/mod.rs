//! Seeded schedules of faults, and an oracle of safety that judges the runs.
//!
//! A seed draws a [`Schedule`]: a scenario, or a board that is served to a client, with one to four faults at
//! random times. The rig runs it: every request passes through a faulty link, the frames between board and
//! plant are corrupted by the faults, and the oracle compares the board's behaviour with the plant's true
//! state. `docs/fault-schedules.md` has the rules.

mod link;
mod oracle;
mod rig;
mod rules;
mod sample;
mod schedule;
mod sensors;
mod served;
mod shared_rig;
mod shrink;
mod strangers;
#[cfg(test)]
mod tests;

pub use rules::{Rule, Violation};
pub use schedule::{Family, Fault, Kind, Schedule};

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use serde::{Deserialize, Serialize};
use tesaki_description::robot::RobotFolder;

use crate::controller::Watched;
use crate::scenario::{Scenario, ScenarioError, Setting};
use schedule::SERVED;
use shared_rig::SharedRig;

/// Result of a schedule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The seed of the schedule.
    pub seed: u64,
    /// Scenario in which it ran.
    pub scenario: String,
    /// Families of its faults.
    pub families: Vec<Family>,
    /// Digest of all the board's answers.
    pub frames_sha256: String,
    /// Ticks that were run, and ticks planned.
    pub ticks: [u32; 2],
    /// Broken rules.
    pub violations: Vec<Violation>,
    /// The fault log of the board at the end.
    pub faults: Vec<String>,
    /// Why the run ended early, if it did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// Runs a schedule. The robots are in the folder `robots`.
///
/// # Errors
/// The scenario cannot be run at all, or no fault of the schedule acts in it.
pub fn run(schedule: &Schedule, robots: &Path) -> Result<Report, ScenarioError> {
    run_traced(schedule, robots, None).map(|(report, _)| report)
}

/// Runs a schedule as [`run`] does, with a trace: for each tick the mode, outputs, faults, kinetic energy,
/// and speed and force of the tools; and for each joint its commanded and actual torque, the torque of its
/// weight, and its angle.
///
/// # Errors
/// As [`run`].
pub fn run_traced(
    schedule: &Schedule,
    robots: &Path,
    trace: Option<Vec<String>>,
) -> Result<(Report, Vec<String>), ScenarioError> {
    let folder = robots.join(&schedule.robot);
    let robot = RobotFolder::load(&folder)?;
    let scenario = Scenario::find(&schedule.scenario);
    if scenario.is_none() && schedule.scenario != SERVED {
        return Err(ScenarioError::Unknown(schedule.scenario.clone()));
    }
    let unjudged = |reason: String| ScenarioError::Unjudged { scenario: schedule.scenario.clone(), reason };
    if let Some(own) = scenario.map(|scenario| scenario.robot).filter(|own| *own != schedule.robot) {
        return Err(unjudged(format!("its robot is {own}, not {}", schedule.robot)));
    }
    schedule.check(&robot.model).map_err(unjudged)?;
    let rig = SharedRig::new(schedule, &robot.model);
    rig.lock().trace = trace;
    let result = catch_unwind(AssertUnwindSafe(|| {
        let Some(scenario) = scenario else { return served::run(&rig, &robot, schedule.machine()) };
        let mut board = rig.clone();
        let mut controller = Watched::new(&mut board, false);
        let plain = Setting::plain(&folder, &mut controller, schedule.machine(), scenario.duration);
        let mut setting = Setting { intervention: Some(rig.intervention()), ..plain };
        scenario.run(&mut setting).map(|_| ())
    }));
    let mut rig = rig.lock();
    let trace = rig.trace.take().unwrap_or_default();
    if let Some(reason) = rig.unjudged() {
        return Err(unjudged(reason));
    }
    let mut violations = rig.violations();
    let error = match result {
        Ok(_) if rig.is_over() => None,
        Ok(Ok(())) => Some("the scenario ended".to_owned()),
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => {
            let text = "the scenario panicked".to_owned();
            violations.push(Violation { rule: Rule::Panic, tick: rig.ticks(), text: text.clone() });
            Some(text)
        }
    };
    let report = Report {
        seed: schedule.seed,
        scenario: format!("{} ({}), trial {}", schedule.scenario, schedule.robot, schedule.trial),
        families: schedule.families(),
        frames_sha256: rig.digest(),
        ticks: [rig.ticks(), schedule.end],
        violations,
        faults: rig.faults(),
        error,
    };
    Ok((report, trace))
}

/// Returns the smallest schedule found that breaks the same rule as `violation`, and ends with it.
pub fn shrink(schedule: &Schedule, violation: &Violation, robots: &Path) -> Schedule {
    let breaks = |candidate: &Schedule| {
        let report = run(candidate, robots);
        report.is_ok_and(|report| report.violations.iter().any(|found| found.rule == violation.rule))
    };
    let cut = Schedule { end: violation.tick + 1, ..schedule.clone() };
    shrink::shrink(&cut, breaks)
}
