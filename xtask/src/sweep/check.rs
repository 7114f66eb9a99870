//! Comparison of recorded sweeps with the present simulator.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::Deserialize;

use super::merge::Run;
use super::record::{FOLDER, Metric, Sweep};
use super::set::Set;
use crate::firmware::sha256;

/// Returns the machine of a sweep that is run again, a different one for each scenario.
pub fn chosen(sweep: &Sweep, scenario: usize) -> Option<u64> {
    // 7 is coprime to the sizes of both sets, so that the scenarios' machines are spread over them.
    let index = (7 * scenario).checked_rem(sweep.machines.len())?;
    Some(sweep.machines[index].seed)
}

/// Checks that a run has the recorded result of its machine.
///
/// # Errors
/// When it differs: the error names scenario, seed, the difference, and what to do.
pub fn compare(sweep: &Sweep, run: &Run) -> Result<()> {
    let difference = difference(sweep, run)?;
    let (scenario, seed, set) = (&sweep.scenario, run.seed, sweep.set.name());
    let flag = if set == "evaluation" { "--evaluation " } else { "" };
    ensure!(
        difference.is_empty(),
        "{scenario}, seed {seed}: {difference} than recorded of commit {}. If that is meant, record it anew: \
         `cargo xtask sweep {flag}--record {scenario}`, then `cargo xtask sweep tables`",
        sweep.commit
    );
    Ok(())
}

/// Folder where `cargo sim papers` stores the papers' figures, with the results of the runs that they show in
/// `runs`.
const PAPERS: &str = "docs/papers";

/// A run that figures show, as `cargo sim papers` stores it.
#[derive(Deserialize)]
struct Shown {
    #[serde(flatten)]
    run: Run,
    /// SHA-256 of the files that show it.
    figures: BTreeMap<String, String>,
}

/// Checks that the figures of the papers show the recorded results of their machines.
///
/// # Errors
/// When one does not, or was drawn from a scenario that is not recorded: the error names it, and says what to
/// do.
pub fn figures() -> Result<()> {
    let runs = Path::new(PAPERS).join("runs");
    let mut digests = BTreeMap::new();
    for entry in std::fs::read_dir(&runs).with_context(|| runs.display().to_string())? {
        let path = entry?.path();
        let file = path.display();
        let Shown { run, figures } =
            serde_json::from_str(&std::fs::read_to_string(&path)?).with_context(|| file.to_string())?;
        digests.extend(figures);
        let sweep = Sweep::load(Path::new(FOLDER), &run.scenario, Set::Development)?;
        let sweep = sweep.with_context(|| format!("{file}: no sweep of {} is recorded", run.scenario))?;
        let difference = difference(&sweep, &run)?;
        ensure!(
            difference.is_empty(),
            "{file}: {difference} than recorded of commit {}: draw the figures anew with `cargo sim papers`",
            sweep.commit
        );
    }
    drawn(Path::new(PAPERS), &digests)
}

/// Checks that the figures in `folder` are those with these digests, by the names of their files.
fn drawn(folder: &Path, digests: &BTreeMap<String, String>) -> Result<()> {
    for (name, digest) in digests {
        let file = folder.join(name);
        ensure!(
            sha256(&file).with_context(|| file.display().to_string())? == *digest,
            "{} was not drawn with the run that it shows: draw the figures anew with `cargo sim papers`",
            file.display()
        );
    }
    for entry in std::fs::read_dir(folder)? {
        let file = entry?.path();
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        ensure!(
            !name.ends_with(".svg") || digests.contains_key(&*name),
            "{} belongs to no run: delete it",
            file.display()
        );
    }
    Ok(())
}

/// Returns the difference, as the beginning of "… than recorded"; empty if there is none.
fn difference(sweep: &Sweep, run: &Run) -> Result<String> {
    let Some(machine) = sweep.machines.iter().find(|machine| machine.seed == run.seed) else {
        return Ok("another machine".to_owned());
    };
    if machine.error != run.error {
        return Ok("another end of the run".to_owned());
    }
    if machine.frames_sha256 != run.frames_sha256 {
        return Ok("the control core answers with other frames".to_owned());
    }
    let measured = run.measured()?;
    for (metric, value, pass) in &measured {
        let name = &metric.name;
        let Ok((index, known)) = sweep.metric(name) else { return Ok(format!("{name}: more metrics")) };
        let exempt = machine.exempt.contains(name);
        let demanded = if exempt { Metric { limit: None, ..known.clone() } } else { known.clone() };
        if demanded != *metric {
            return Ok(format!("{name}: another unit, limit or paper's figure"));
        }
        if machine.values[index].is_some() != value.is_some()
            || machine.missed.contains(name) == *pass
            || machine.values[index].zip(*value).is_some_and(|(old, new)| !alike(old, new))
        {
            return Ok(format!("{name}: another value"));
        }
    }
    let values = machine.values.iter().filter(|value| value.is_some()).count();
    let fewer = values > measured.iter().filter(|(_, value, _)| value.is_some()).count();
    Ok(if fewer { "fewer metrics".to_owned() } else { String::new() })
}

/// Returns whether two values rounded to six digits may be the same, computed with different C libraries.
fn alike(old: f64, new: f64) -> bool {
    (old - new).abs() <= 1e-4 * old.abs().max(new.abs()).max(1e-6)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::sweep::merge::{self, fixtures::run};

    fn recorded(runs: Vec<Run>) -> Sweep {
        let folder = tempfile::tempdir().unwrap();
        merge::merge(folder.path(), runs, Some("one")).unwrap();
        Sweep::load(folder.path(), "arm", Set::Development).unwrap().unwrap()
    }

    #[test]
    fn the_same_run_is_not_stale() {
        let sweep = recorded(vec![run(4, "a", 0.123_456_7), run(5, "b", 1.5)]);
        compare(&sweep, &run(4, "a", 0.123_456_7)).unwrap();
        compare(&sweep, &run(5, "b", 1.5)).unwrap();
    }

    #[test]
    fn a_stale_sweep_is_named_with_its_remedy() {
        let sweep = recorded(vec![run(4, "a", 0.5)]);
        let told = compare(&sweep, &run(4, "b", 0.5)).unwrap_err().to_string();
        assert!(told.starts_with("arm, seed 4: the control core answers with other frames"), "{told}");
        assert!(told.contains("`cargo xtask sweep --record arm`"), "{told}");
        // The same frames, but the scenario evaluates them differently.
        let told = compare(&sweep, &run(4, "a", 0.6)).unwrap_err().to_string();
        assert!(told.contains("error: another value"), "{told}");
        let failed = Run::failed("arm", 4, "the board is gone".into());
        assert!(compare(&sweep, &failed).unwrap_err().to_string().contains("another end"));
        let sweep = recorded(vec![failed.clone()]);
        compare(&sweep, &failed).unwrap();
        let other = Run::failed("arm", 4, "the joint is at its end".into());
        assert!(compare(&sweep, &other).unwrap_err().to_string().contains("another end"));
        assert!(compare(&sweep, &run(5, "a", 0.5)).is_err());
    }

    #[test]
    fn a_figure_that_was_not_drawn_with_its_run_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("way.svg");
        std::fs::write(&file, "<svg/>").unwrap();
        let digests = BTreeMap::from([("way.svg".to_owned(), sha256(&file).unwrap())]);
        drawn(folder.path(), &digests).unwrap();
        let told = |digests: &BTreeMap<_, _>| drawn(folder.path(), digests).unwrap_err().to_string();
        assert!(told(&BTreeMap::new()).ends_with("way.svg belongs to no run: delete it"));
        std::fs::write(&file, "<svg> </svg>").unwrap();
        assert!(told(&digests).contains("way.svg was not drawn with the run that it shows"));
        std::fs::remove_file(&file).unwrap();
        assert!(told(&digests).ends_with("way.svg"));
    }

    #[test]
    fn each_scenario_has_another_machine_run_again() {
        let sweep = recorded((1..=20).map(|seed| run(seed, "a", 0.5)).collect());
        let seeds: Vec<Option<u64>> = (0..4).map(|scenario| chosen(&sweep, scenario)).collect();
        assert_eq!(seeds, [Some(1), Some(8), Some(15), Some(2)]);
        assert_eq!(chosen(&Sweep { machines: Vec::new(), ..sweep }, 3), None);
    }
}
