//! Figure 5: the tool is displaced by 3 cm and released.

use super::{MACHINES, NamedLaw, damping_key};
use crate::report::{Figure, Line, Metric, Panel, Summary};
use crate::scenario::arm::ArmRig;
use crate::scenario::arm7_release::{AXES, Release, ReleaseTrial, release};
use crate::scenario::common::{capitalized, largest};
use crate::scenario::{ScenarioError, Setting};

/// Releases along x, y and z of a law with one of its dampings.
struct Releases<'a> {
    law: &'a NamedLaw,
    damping: f32,
    releases: Vec<Release>,
}

impl Releases<'_> {
    /// Along x, as in the figure.
    fn along_x(&self) -> Option<&Release> {
        self.releases.iter().find(|release| release.axis == 0)
    }

    /// Largest displacement along x beyond the set-point [mm], of the tool and by the theory.
    fn overshoot(&self) -> Option<[f64; 2]> {
        let [_, measured, exact] = self.along_x()?.curves();
        let beyond = |values: Vec<f64>| values.into_iter().map(|value| -value);
        let overshoot = |values| 1e3 * largest([0.0].into_iter().chain(beyond(values)));
        Some([measured, exact].map(overshoot))
    }
}

pub fn run(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    laws: &[NamedLaw],
    summary: &mut Summary,
    figures: &mut Vec<Figure>,
    tables: &mut Vec<(String, String)>,
) -> Result<(), ScenarioError> {
    for (machine_key, name, machine) in MACHINES {
        let mut all = Vec::new();
        for law in laws {
            let experiment = law.need(&law.law.release, "[release]")?;
            for &damping in &experiment.damping {
                let label = format!("{}, {name}", law.law.title);
                let trial = ReleaseTrial {
                    label: &label,
                    machine,
                    settings: law.law.with_damping(damping),
                    displacement: experiment.displacement,
                    before: None,
                    observed: experiment.observed,
                };
                let mut releases = Vec::new();
                for (axis, name) in AXES.into_iter().enumerate() {
                    let result = release(setting, rig, &trial, axis);
                    let Some(release) = law.survives(setting, result)? else { continue };
                    let damping = damping_key(damping);
                    let file = format!("release_{machine_key}_{}_{damping}_{name}.csv", law.key);
                    tables.push((file, release.log.table()));
                    releases.push(release);
                }
                all.push(Releases { law, damping, releases });
            }
        }
        all.iter().for_each(|releases| add_metrics(summary, releases, machine_key, name));
        figures.push(figure(&all, name));
    }
    Ok(())
}

fn add_metrics(summary: &mut Summary, releases: &Releases<'_>, machine_key: &str, machine: &str) {
    let Releases { law, damping, .. } = releases;
    let label = format!("{}, B {damping} on {machine}", capitalized(&law.law.title));
    let mut insert = |what: &str, metric| {
        let key = format!("{}_release_{machine_key}_{}_{what}", law.key, damping_key(*damping));
        summary.insert(key, metric);
    };
    if let Some([overshoot, of_theory]) = releases.overshoot() {
        // As the paper says of its figure.
        let paper = if *damping < 10.0 { "overshoots" } else { "no overshoot" };
        let text = format!("{label}: overshoot along x");
        let note = format!("theory: {of_theory:.1} mm");
        insert("overshoot", Metric::reported(text, overshoot, "mm").paper(paper).note(note));
    }
    // A release that a fault ended has no deviation, and the largest of the others is not that of all.
    let is_complete = releases.releases.len() == AXES.len();
    let worst = if is_complete { largest(releases.releases.iter().map(Release::error)) } else { f64::NAN };
    let text = format!("{label}: largest deviation from the theory, of x, y and z");
    insert("error_peak", Metric::reported(text, worst, "mm").paper("“difficult to bring near”"));
}

/// In the paper's layout: above the small damping, below the large one; theory and measurement over the time.
fn figure(all: &[Releases<'_>], machine: &str) -> Figure {
    let caption = format!(
        "The paper's figure 5 on {machine}: displacement of the tool along x after its release at 3 cm, under each \
         law, and the theory (dashed): a mass of 1.5 kg on 300 N/m and the damper in the title of the panel."
    );
    let title = capitalized(&format!("released along x: {machine}"));
    let mut figure = Figure::stacked(title, caption, "time", "s").event(0.0, "released");
    let mut dampings: Vec<f32> = Vec::new();
    for releases in all {
        if dampings.contains(&releases.damping) {
            continue;
        }
        dampings.push(releases.damping);
        let millimetres = |values: Vec<f64>| values.into_iter().map(|value| 1e3 * value).collect();
        let mut panel = Panel::new(format!("B {} N·s/m", releases.damping), "displacement", "mm");
        for other in all.iter().filter(|other| other.damping.total_cmp(&releases.damping).is_eq()) {
            let Some(release) = other.along_x() else { continue };
            let [time, measured, exact] = release.curves();
            let (title, colour) = (&other.law.law.title, other.law.colour);
            if panel.lines.is_empty() {
                panel = panel.line(Line::dashed("theory", Line::INK, time.clone(), millimetres(exact)));
            }
            panel = panel.line(Line::solid(title, colour, time, millimetres(measured)));
        }
        figure = figure.panel(panel);
    }
    figure
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::super::PRINTED;
    use super::*;
    use crate::scenario::arm::Machine;
    use crate::scenario::common::tests::with_setting;

    /// With little friction the printed law overshoots as a held acceleration does, which is more than the
    /// impedance would: at B 7.5 exp(−πζ/√(1 − ζ²)) = 0.5688 of the displacement, with ζ = 0.1768.
    #[test]
    fn the_printed_law_overshoots_by_what_holding_its_acceleration_adds() {
        with_setting("arm7", 3, &["paper"], |setting| {
            let mut rig = ArmRig::load(setting).unwrap();
            let laws = NamedLaw::load_all(setting, &rig).unwrap();
            for &[damping, expected, _] in &PRINTED[..2] {
                let damping = damping as f32;
                let trial = ReleaseTrial {
                    label: "",
                    machine: Machine::Matched,
                    settings: laws[0].law.with_damping(damping),
                    displacement: 0.03,
                    before: None,
                    observed: 1.0,
                };
                let release = release(setting, &mut rig, &trial, 0).unwrap();
                // What holds the tool yields a little.
                let start = 1e3 * release.curves()[1][0];
                let expected = expected * start / 30.0;
                assert!((start - 30.0).abs() < 1.0, "{start}");
                let releases = Releases { law: &laws[0], damping, releases: vec![release] };
                let [overshoot, theory] = releases.overshoot().unwrap();
                // Friction of 0.1 N at the tool is 0.3 mm.
                assert!((overshoot - expected).abs() < 0.5, "B {damping}: {overshoot} mm, not {expected}");
                if damping > 7.0 {
                    assert!((theory - 0.5688 * start).abs() < 0.05, "{theory}");
                }
            }
        });
    }
}
