//! Figures 11 to 13: the box is held with given forces, and weights are put on it.

use std::ops::Range;

use rapier3d::na::Vector3;

use super::{LAWS, Law, Metrics, compare, curve, hold_box, laws, mean, weights};
use crate::report::{Figure, Line, Panel, Summary};
use crate::scenario::common::T;
use crate::scenario::grasping::{GraspLog, GraspRig, GraspSample, table, xyz};
use crate::scenario::{Kind, Outcome, Scenario, ScenarioError, Setting, needs};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-paper-force",
    title: "Forces of the three-finger hand, as the Hand3 paper measured them",
    about: "figures 11 to 13 of the Hand3 paper under its laws and under ours: commanded forces, weights",
    robot: "hand3",
    kind: Kind::GraspingHand,
    files: needs::BOX,
    results: "docs/papers/hand3.md",
    duration: 150.0,
    shortest: None,
    laws: Some(LAWS),
    lead: &[
        "The hand grasps the paper's box with 2 N of fingers 1 and 2 and 4 N of finger 3 along the box's x axis, and \
         the support is removed. First nothing moves (section 6.1, figure 11). Then, in another grasp, weights of \
         50, 100, 200 and 300 g are put on the box, one in place of the other (section 6.2, figures 12 and 13). \
         Each experiment runs under each law on the same machine. Its joints have four times the Coulomb friction of \
         our other experiments (`friction.paper` in robots/hand3/plant.toml); a law says whether its controller is told.",
        "The paper's law for figure 11: the joint torques are those of the commanded forces, (D_F J_F)ᵀ f_c, and \
         nothing else: weight and friction of the fingers are not compensated, and the pose of the box is not \
         controlled. f_c is the internal force and a third of the box's weight for each finger: 2 N along the x axis \
         of a box with a pitch of 0.769 rad are (1.44, 0, −1.39) N; with 0.05 N along x and along z, against a third \
         of the weight of 23 g, they are the paper's (1.48, 0, −1.34) N. For figures 12 and 13: equations (19) and (20), with the load \
         of the force sensors and a fixed internal force.",
        "Sensed forces are those of the tared fingertip sensors, as the board reports them, in the hand's frame; \
         true ones are those of the simulated contacts.",
    ],
    run,
};

/// The paper's sensor reading of finger 1 [N].
const PAPER_FORCE: [f64; 3] = [0.75, -0.06, -0.47];
const PAPER_TEXTS: [&str; 3] = ["0.75 N", "−0.06 N", "−0.47 N"];
const PAPER_COMMANDED: [&str; 3] = ["1.48 N", "0 N", "−1.34 N"];
/// Time before the support is removed that the figure shows [s].
const BEFORE: f64 = 2.0;

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = GraspRig::load(setting)?;
    let laws = laws(setting, &rig.robot.model)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    let coulomb = rig.values.friction.paper;
    let mut held = Vec::new();
    for law in &laws {
        let log = hold(setting, &mut rig, law, coulomb)?;
        tables.push((format!("force-{}.csv", law.key), table(&log)));
        held.push(log);
    }
    for (law, log) in laws.iter().zip(&held) {
        add_metrics(&mut summary, law, log);
    }
    let errors: Vec<f64> = laws.iter().zip(&held).map(|(law, log)| force_error(law, log)).collect();
    compare(&mut summary, &laws, "force_error", "Error of the true force of finger 1", &errors);
    figures.push(figure(&laws, &held));
    figures.extend(curve::run(setting, &mut rig, &laws, &mut summary)?);
    weights::run(setting, &mut rig, &laws, &mut summary, &mut figures, &mut tables)?;
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

/// Holds the box under the law of figure 11.
pub(super) fn hold(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    law: &Law,
    coulomb: f64,
) -> Result<GraspLog, ScenarioError> {
    let experiment = &law.law.force;
    let label = format!("force, {}, {coulomb} N·m", law.name);
    let mut trial = hold_box(setting, rig, &label, (law, &experiment.law), coulomb)?;
    trial.wait(experiment.hold)?;
    trial.end()
}

/// The evaluated time span [s].
fn evaluated(law: &Law, log: &GraspLog) -> Range<f64> {
    let end = log.held + law.law.force.hold;
    end - law.law.force.evaluated..end
}

/// Mean sensed force of finger 1 [N].
pub(super) fn sensed(law: &Law, log: &GraspLog) -> Vector3<f64> {
    mean_of(law, log, |sample| sample.estimates.sensed_forces[0])
}

fn mean_of(law: &Law, log: &GraspLog, vector: impl Fn(&GraspSample) -> Vector3<f64>) -> Vector3<f64> {
    let span = evaluated(law, log);
    Vector3::from_fn(|axis, _| mean(log, &span, |sample| vector(sample)[axis]))
}

/// Error of the true force of finger 1, over the commanded one [%].
fn force_error(law: &Law, log: &GraspLog) -> f64 {
    let commanded = mean_of(law, log, |sample| sample.estimates.target_forces[0]).norm();
    100.0 * (mean_of(law, log, |sample| sample.force(0)).norm() / commanded - 1.0).abs()
}

fn add_metrics(summary: &mut Summary, law: &Law, log: &GraspLog) {
    let mut metrics = Metrics::new(summary, law, "force", log);
    let commanded = mean_of(law, log, |sample| sample.estimates.target_forces[0]);
    let (sensed, truth) = (sensed(law, log), mean_of(law, log, |sample| sample.force(0)));
    for (axis, name) in xyz() {
        let text = format!("commanded force of finger 1 along {name}");
        metrics.add(&format!("commanded_{name}"), &text, commanded[axis], "N", PAPER_COMMANDED[axis]);
    }
    for (axis, name) in xyz() {
        let text = format!("sensed force of finger 1 along {name}");
        metrics.add(&format!("sensed_{name}"), &text, sensed[axis], "N", PAPER_TEXTS[axis]);
    }
    metrics.add("sensed_force", "sensed force of finger 1, 2 N commanded", sensed.norm(), "N", "0.89 N");
    metrics.add("true_force", "true force of finger 1", truth.norm(), "N", "");
    let text = "error of the true force of finger 1 against the commanded one";
    metrics.add("force_error", text, force_error(law, log), "%", "56 %");
}

fn figure(laws: &[Law], held: &[GraspLog]) -> Figure {
    let caption = "Force of finger 1 on the box by its tared sensor, in the hand's frame, x, y and z, and the commanded \
                   force (dashed), under each law on the same machine. Horizontal lines: the sensor's reading in \
                   figure 11 of the Hand3 paper, (0.75, −0.06, −0.47) N, for the command (1.48, 0, −1.34) N. The \
                   metrics are means over the shaded time.";
    let mut figure = Figure::stacked("Hand3 figure 11: force of finger 1", caption, "time", "s");
    let mut is_marked = false;
    for (law, log) in laws.iter().zip(held) {
        let experiment = &law.law.force;
        let span = log.held - BEFORE..log.held + experiment.hold - T;
        if !std::mem::replace(&mut is_marked, true) {
            let end = BEFORE + experiment.hold;
            figure =
                figure.event(BEFORE, "support removed").phase(end - experiment.evaluated, end, "evaluated");
        }
        let samples = log.during(&span);
        let time: Vec<f64> = samples.iter().map(|sample| sample.time - span.start).collect();
        let mut panel = Panel::new(law.law.title.as_str(), "force", "N");
        for (axis, name) in xyz() {
            let values = samples.iter().map(|sample| sample.estimates.sensed_forces[0][axis]).collect();
            panel = panel.line(Line::solid(name, axis, time.clone(), values));
        }
        for (axis, name) in xyz() {
            let values = samples.iter().map(|sample| sample.estimates.target_forces[0][axis]).collect();
            panel = panel.line(Line::dashed(format!("{name} commanded"), axis, time.clone(), values));
            panel = panel.rule(PAPER_FORCE[axis], format!("paper {name}"));
        }
        figure = figure.panel(panel);
    }
    figure
}
