//! Seeded schedules of faults, and an oracle of safety that judges the runs.
//!
//! A seed draws a [`Schedule`]: a scenario, or a board that is served to a client, and one to four faults at
//! random times. The rig runs it: every request passes a link, every frame between board and plant passes the
//! faults, and the oracle compares what the board does with the plant's truth. `docs/fault-schedules.md` has
//! the rules.

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

/// What a schedule came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The seed of the schedule.
    pub seed: u64,
    /// Where it ran.
    pub scenario: String,
    /// Families of its faults.
    pub families: Vec<Family>,
    /// Digest of all that the board answered.
    pub frames_sha256: String,
    /// Ticks that were run of those planned.
    pub ticks: [u32; 2],
    /// Broken rules.
    pub violations: Vec<Violation>,
    /// The fault log of the board at the end.
    pub faults: Vec<String>,
    /// Why the run ended before its time, if it did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// Runs a schedule. The robots are in the folder `robots`.
///
/// # Errors
/// The scenario cannot be run at all.
pub fn run(schedule: &Schedule, robots: &Path) -> Result<Report, ScenarioError> {
    run_traced(schedule, robots, None).map(|(report, _)| report)
}

/// [`run`] with a trace: for each tick mode, outputs, faults, kinetic energy, speed and force of the tools,
/// and for each joint torque as commanded and as made, torque of the weight, and angle.
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
    let rig = SharedRig::new(schedule, &robot.model);
    rig.lock().trace = trace;
    let result = catch_unwind(AssertUnwindSafe(|| {
        if schedule.scenario == SERVED {
            return served::run(&rig, &robot, schedule.machine());
        }
        let Some(scenario) = Scenario::find(&schedule.scenario) else { return Ok(()) };
        let mut board = rig.clone();
        let mut controller = Watched::new(&mut board, false);
        let plain = Setting::plain(&folder, &mut controller, schedule.machine(), scenario.duration);
        let mut setting = Setting { intervention: Some(rig.intervention()), ..plain };
        scenario.run(&mut setting).map(|_| ())
    }));
    let mut rig = rig.lock();
    let trace = rig.trace.take().unwrap_or_default();
    let error = match result {
        Ok(_) if rig.is_over() => None,
        Ok(Ok(())) => Some("the scenario ended".to_owned()),
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("the scenario panicked".to_owned()),
    };
    let report = Report {
        seed: schedule.seed,
        scenario: format!("{} ({}), trial {}", schedule.scenario, schedule.robot, schedule.trial + 1),
        families: schedule.families(),
        frames_sha256: rig.digest(),
        ticks: [rig.ticks(), schedule.end],
        violations: rig.violations(),
        faults: rig.faults(),
        error,
    };
    Ok((report, trace))
}

/// The smallest schedule found that breaks the same rule as `violation`.
pub fn shrink(schedule: &Schedule, violation: &Violation, robots: &Path) -> Schedule {
    let breaks = |candidate: &Schedule| {
        let report = run(candidate, robots);
        report.is_ok_and(|report| report.violations.iter().any(|found| found.rule == violation.rule))
    };
    let cut = Schedule { end: violation.tick + 1, ..schedule.clone() };
    shrink::shrink(&cut, breaks)
}
