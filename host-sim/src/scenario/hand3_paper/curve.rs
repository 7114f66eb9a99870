//! The force of figure 11 over the friction of the joints: at which friction the paper's loss comes out.

use super::force::{hold, sensed};
use super::{Law, ScenarioError, Setting, Summary};
use crate::report::{Figure, Line, Metric, Panel};
use crate::scenario::grasping::GraspRig;

/// The paper's force of finger 1 [N].
pub(super) const PAPER_FORCE: f64 = 0.89;

/// Holds the box on machines that differ in the friction of their joints only, under each law that lists
/// frictions.
pub(super) fn run(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    laws: &[Law],
    summary: &mut Summary,
) -> Result<Option<Figure>, ScenarioError> {
    let mut panel = Panel::new("Sensed force of finger 1", "force", "N")
        .rule(PAPER_FORCE, format!("paper {PAPER_FORCE} N"));
    let mut is_empty = true;
    for (number, law) in laws.iter().enumerate() {
        let mut points = Vec::new();
        for &coulomb in &law.law.force.coulomb {
            let log = hold(setting, rig, law, coulomb)?;
            let force = sensed(law, &log).norm();
            points.push([coulomb, force]);
            let text = format!("{}: sensed force of finger 1, joint friction {coulomb} N·m", law.name);
            if force.is_finite() {
                let key = format!("{}_sensed_force_at_{:.0}mNm", law.key, 1e3 * coulomb);
                summary.insert(key, Metric::reported(text, force, "N"));
            }
        }
        if points.is_empty() {
            continue;
        }
        is_empty = false;
        if let Some(friction) = crossing(&points) {
            let text = format!("{}: joint friction at which the force is the paper's 0.89 N", law.name);
            let key = format!("{}_friction_of_paper_force", law.key);
            summary.insert(key, Metric::reported(text, 1e3 * friction, "mN·m"));
        }
        let (x, y) = points.iter().map(|&[coulomb, force]| (1e3 * coulomb, force)).unzip();
        panel = panel.line(Line::solid(law.law.title.as_str(), number, x, y));
    }
    let caption = "Force of finger 1 on the box by its tared sensor when 2 N are commanded, over the Coulomb friction \
                   of all joints of the machine. The Hand3 paper reads 0.89 N (figure 11) and names the friction of \
                   the joints as the first cause; it does not give the friction.";
    let title = "Hand3 figure 11: force over the friction of the joints";
    let figure = Figure::stacked(title, caption, "Coulomb friction of a joint", "mN·m").panel(panel);
    Ok((!is_empty).then_some(figure))
}

/// Where the force first falls to the paper's, interpolated [N·m].
fn crossing(points: &[[f64; 2]]) -> Option<f64> {
    points.windows(2).find_map(|pair| {
        let [[low, before], [high, after]] = *pair else { return None };
        let falls = before >= PAPER_FORCE && after < PAPER_FORCE;
        falls.then(|| low + (high - low) * (before - PAPER_FORCE) / (before - after))
    })
}

#[cfg(test)]
mod tests {
    use super::crossing;

    #[test]
    fn the_crossing_is_interpolated() {
        // 1.09 at 0.04 and 0.69 at 0.08: 0.89 half-way.
        assert!(
            (crossing(&[[0.0, 2.0], [0.04, 1.09], [0.08, 0.69]]).unwrap_or(f64::NAN) - 0.06).abs() < 1e-12
        );
        assert_eq!(crossing(&[[0.0, 2.0], [0.04, 1.09]]), None);
    }
}
