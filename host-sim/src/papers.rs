//! The figures of the papers, drawn anew from the scenarios, for the pages in `docs/papers/`.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use clap::ValueEnum;
use rayon::prelude::*;

use crate::controller::{Native, Watched};
use crate::law::{LawError, LawFile};
use crate::report::{Figure, Summary};
use crate::scenario::{Scenario, ScenarioError, Setting};

/// A paper with a page of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Paper {
    /// The three-finger hand that grasps and turns a box
    Hand3,
    /// The arm with seven joints under impedance control
    Arm7,
    /// The five-finger hand that reproduces an operator's fingertips
    Hand5,
    /// The arm that finds a door knob with the camera in its hand
    Knob,
}

/// A figure of a paper, and what is drawn in its place.
#[derive(Clone, Copy, Debug)]
struct PaperFigure {
    /// The paper.
    paper: Paper,
    /// Its file in `docs/papers/`.
    file: &'static str,
    /// The scenario that draws it.
    scenario: &'static str,
    /// The title of the scenario's figure.
    title: &'static str,
}

const HAND3_FORCE: &str = "hand3-paper-force";
const HAND3_MOTION: &str = "hand3-paper-motion";
const HAND3_CURVES: &str = "hand3-paper-curves";
const ARM7: &str = "arm7-paper";

/// All figures, in the order of the pages.
const FIGURES: &[PaperFigure] = &[
    figure(Paper::Hand3, "hand3-servo.svg", HAND3_MOTION, "Hand3 figure 6: joint servo"),
    figure(Paper::Hand3, "hand3-force.svg", HAND3_FORCE, "Hand3 figure 11: force of finger 1"),
    figure(
        Paper::Hand3,
        "hand3-friction.svg",
        HAND3_FORCE,
        "Hand3 figure 11: force over the friction of the joints",
    ),
    figure(
        Paper::Hand3,
        "hand3-efficiency.svg",
        HAND3_CURVES,
        "Hand3 figure 11: force over the efficiency of the joints",
    ),
    figure(
        Paper::Hand3,
        "hand3-weights.svg",
        HAND3_FORCE,
        "Hand3 figure 12: load on the box and internal force",
    ),
    figure(
        Paper::Hand3,
        "hand3-weights-force.svg",
        HAND3_FORCE,
        "Hand3 figure 13: force of finger 1 under weights",
    ),
    figure(Paper::Hand3, "hand3-turn.svg", HAND3_MOTION, "Hand3 figures 14 and 15: attitude of the box"),
    figure(Paper::Hand3, "hand3-shift.svg", HAND3_MOTION, "Hand3 figures 14 and 15: position of the box"),
    figure(
        Paper::Hand3,
        "hand3-integral.svg",
        HAND3_CURVES,
        "Hand3 figure 15: errors over the integral gain",
    ),
    figure(Paper::Hand3, "hand3-joint-turn.svg", HAND3_MOTION, "Hand3 section 5.5: attitude of the box"),
    figure(Paper::Arm7, "arm7-release.svg", ARM7, "Released along x: the matched machine"),
    figure(
        Paper::Arm7,
        "arm7-elbow.svg",
        "arm7-paper-elbow",
        "The elbow moves, the hand is held: the matched machine",
    ),
    figure(Paper::Arm7, "arm7-follow.svg", ARM7, "The slave follows the master along x, directly"),
    figure(Paper::Arm7, "arm7-damping.svg", ARM7, "Error over the damping, directly"),
    figure(Paper::Arm7, "arm7-bilateral.svg", "arm7-paper-bilateral", "Force felt and force on the wall"),
    figure(Paper::Arm7, "arm7-matrices.svg", "arm7-paper-matrices", "Pushed: the matched machine"),
    figure(
        Paper::Arm7,
        "arm7-matrices-mismatched.svg",
        "arm7-paper-matrices",
        "Pushed: the mismatched machine",
    ),
    figure(Paper::Hand5, "hand5-calibrate-paths.svg", "hand5-calibrate", "Five markers: paths"),
    figure(
        Paper::Hand5,
        "hand5-calibrate-vector.svg",
        "hand5-calibrate",
        "Five markers: vector to the index finger",
    ),
    figure(Paper::Hand5, "hand5-reach-paths.svg", "hand5-reach", "Own hand: paths"),
    figure(Paper::Hand5, "hand5-reach-errors.svg", "hand5-reach", "Own hand: errors"),
    figure(Paper::Knob, "knob-find-film.svg", "knob-find", "Film strip: from far"),
    figure(Paper::Knob, "knob-grasp-begin.svg", "knob-grasp", "Film strip: the begin"),
    figure(Paper::Knob, "knob-grasp-end.svg", "knob-grasp", "Film strip: the end"),
    figure(Paper::Knob, "knob-grasp-way.svg", "knob-grasp", "The way of the hand"),
];

const fn figure(
    paper: Paper,
    file: &'static str,
    scenario: &'static str,
    title: &'static str,
) -> PaperFigure {
    PaperFigure { paper, file, scenario, title }
}

/// A run, and the figures that show it.
#[derive(Debug)]
pub struct Drawn {
    /// The run.
    pub run: Summary,
    /// Names of files and SVG documents.
    pub files: Vec<(String, String)>,
}

/// Why the figures could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum PapersError {
    /// There is no such scenario.
    #[error("{file}: there is no scenario {scenario}")]
    NoScenario {
        /// The figure's file.
        file: &'static str,
        /// What it should be drawn from.
        scenario: &'static str,
    },
    /// The scenario has no such figure.
    #[error("{file}: {scenario} has no figure {title:?}; its figures: {known}")]
    NoFigure {
        /// The figure's file.
        file: &'static str,
        /// What it should be drawn from.
        scenario: &'static str,
        /// The figure's title.
        title: &'static str,
        /// The titles there are.
        known: String,
    },
    /// A law of a robot is missing.
    #[error(transparent)]
    Law(#[from] LawError),
    /// A run did not come to its end.
    #[error("{scenario}, seed {seed}: {reason}")]
    Run {
        /// The scenario.
        scenario: &'static str,
        /// The machine.
        seed: u64,
        /// Why.
        reason: Box<ScenarioError>,
    },
}

/// The scenarios that the figures of `papers` are drawn from, each once.
fn scenarios(papers: &[Paper]) -> Result<Vec<&'static Scenario>, PapersError> {
    let mut scenarios: Vec<&Scenario> = Vec::new();
    for PaperFigure { file, scenario, .. } in FIGURES.iter().filter(|figure| papers.contains(&figure.paper)) {
        let found = Scenario::find(scenario).ok_or(PapersError::NoScenario { file, scenario })?;
        if scenarios.iter().all(|other| other.name != found.name) {
            scenarios.push(found);
        }
    }
    Ok(scenarios)
}

/// Runs the scenarios of `papers` on machine `seed`, on all processors, and draws their figures.
/// `progress` is called with the fraction that is done, from all of them.
///
/// # Errors
/// When a run does not come to its end, or has not the figure that a page shows.
pub fn draw(
    papers: &[Paper],
    robots: &Path,
    seed: u64,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Vec<Drawn>, PapersError> {
    let scenarios = scenarios(papers)?;
    let total: f64 = scenarios.iter().map(|scenario| scenario.duration).sum();
    let done = Mutex::new(vec![0.0; scenarios.len()]);
    let advance = |index: usize, seconds: f64| {
        let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
        done[index] = seconds;
        progress(done.iter().sum::<f64>() / total);
    };
    let runs: Vec<(Summary, Vec<Figure>)> = scenarios
        .par_iter()
        .enumerate()
        .map(|(index, scenario)| {
            let result =
                run(scenario, robots, seed, &|fraction| advance(index, fraction * scenario.duration));
            advance(index, scenario.duration);
            result
        })
        .collect::<Result<_, _>>()?;
    let drawn = runs.into_iter().map(|(run, figures)| {
        let mut files = Vec::new();
        for &PaperFigure { file, scenario, title, .. } in FIGURES {
            if scenario != run.scenario {
                continue;
            }
            let Some(figure) = figures.iter().find(|figure| figure.title == title) else {
                let known = figures.iter().map(|figure| format!("{:?}", figure.title));
                let known = known.collect::<Vec<_>>().join(", ");
                return Err(PapersError::NoFigure { file, scenario, title, known });
            };
            files.push((file.to_owned(), figure.svg()));
        }
        Ok(Drawn { run, files })
    });
    drawn.collect()
}

/// A run with the control core in this process.
fn run(
    scenario: &'static Scenario,
    robots: &Path,
    seed: u64,
    progress: &dyn Fn(f64),
) -> Result<(Summary, Vec<Figure>), PapersError> {
    let robot = robots.join(scenario.robot);
    let laws = LawFile::find(scenario, &robot, &[])?;
    let mut native = Native::default();
    let mut controller = Watched::new(&mut native, false);
    let plain = Setting::plain(&robot, &mut controller, seed, scenario.duration);
    let mut setting = Setting { laws: &laws, progress, ..plain };
    let outcome = scenario.run(&mut setting).map_err(|reason| PapersError::Run {
        scenario: scenario.name,
        seed,
        reason: Box::new(reason),
    })?;
    Ok((outcome.summary, outcome.figures))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn each_figure_has_a_scenario_and_a_file_of_its_own() {
        for paper in Paper::value_variants() {
            assert!(!scenarios(&[*paper]).unwrap().is_empty(), "{paper:?}");
        }
        let mut files: Vec<&str> = FIGURES.iter().map(|figure| figure.file).collect();
        files.sort_unstable();
        files.dedup();
        assert_eq!(files.len(), FIGURES.len());
    }
}
