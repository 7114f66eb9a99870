//! Commanded fingertip forces on a held box (Hand3, section 5.3 and figure 11): paper's law, feed-forward,
//! and force feedback.

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki::task::grasping::{GraspPlan, InternalForce};
use tesaki_description::law::hand::ObjectLaw;

use super::common::{T, capitalized, largest};
use super::grasping::{GraspLog, GraspRig, GraspTrial, GraspedObject, calibrate, components, table};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::report::{Figure, Line, Metric, Panel, Summary};
use tesaki_supervisor::identify::Identification;

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-force",
    title: "Fingertip forces of the three-finger hand",
    about: "a box is held with 2, 2 and 4 N: the paper's law, feed-forward, force feedback, feed-forward \
            after identification",
    robot: "hand3",
    kind: Kind::GraspingHand,
    files: &["grasps/box.toml", "objects/box.toml", "laws/paper-corrected.toml"],
    results: "docs/measurements.md#forces",
    duration: 170.0,
    shortest: None,
    laws: None,
    lead: &[
        "The hand locates a box that stands up to 5 mm away from its nominal position, and grasps it with \
         fingertip forces of 2, 2 and 4 N along the box's x axis. The support is removed. Then nothing \
         moves, and the true contact forces over the last two of four seconds are compared with the \
         commanded ones.",
        "Four controllers are compared. The Hand3 paper's law: object pose control gives a wrench, which is \
         converted to joint torques together with the internal force; the fingers' weight and friction are \
         not compensated, and the joints have four times the nominal friction, as the paper's loss of force \
         implies. Feed-forward: joint servos with the forces fed forward, gravity and friction compensated. \
         Force feedback: the same, with the internal forces corrected by the force sensors. Feed-forward \
         after identification: torque constants and friction were identified beforehand from this machine's \
         telemetry. Forces that are only fed forward are dithered before they are evaluated, so that joint \
         friction takes little of them. The paper commanded 2 N and measured 0.89 N on finger 1.",
    ],
    run,
};

/// Time from removing the support to the end of the hold [s].
const HOLD: f64 = 4.0;
/// Time at the end of the hold that is evaluated [s].
const EVALUATED: f64 = 2.0;
/// Commanded forces: fingers 1 and 2 half that of finger 3 [N].
const COMMANDED: [f64; 3] = [2.0, 2.0, 4.0];

struct Trial {
    name: &'static str,
    label: &'static str,
    paper_law: bool,
    feedback: bool,
    /// Whether the joints are identified before the trial.
    identified: bool,
    /// Limit of the force error [%].
    limit: Option<f64>,
}

const TRIALS: [Trial; 4] = [
    Trial {
        name: "paper",
        label: "the paper's law",
        paper_law: true,
        feedback: false,
        identified: false,
        limit: None,
    },
    Trial {
        name: "feed_forward",
        label: "feed-forward only",
        paper_law: false,
        feedback: false,
        identified: false,
        limit: Some(15.0),
    },
    Trial {
        name: "feedback",
        label: "force feedback",
        paper_law: false,
        feedback: true,
        identified: false,
        limit: Some(2.0),
    },
    Trial {
        name: "identified",
        label: "feed-forward after identification",
        paper_law: false,
        feedback: false,
        identified: true,
        limit: Some(5.0),
    },
];

impl Trial {
    fn configure(&self, plan: &mut GraspPlan, paper: &ObjectLaw) {
        if self.paper_law {
            paper.apply(plan);
        }
        plan.internal = InternalForce::Normal { strength: COMMANDED[2] as f32 };
        plan.feedback = self.feedback;
    }
}

/// Forces of a finger over the evaluated time.
struct FingerForce {
    /// Mean magnitude of the true force [N].
    force: f64,
    /// Mean magnitude of the controller's target [N].
    target: f64,
    /// The largest deviation of the true force's magnitude from its mean [N].
    ripple: f64,
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = GraspRig::load(setting)?;
    let paper = rig.paper_law()?;
    let mut summary = Summary::default();
    let mut figure = Figure::stacked("Force of finger 1 on the box", CAPTION, "time", "s")
        .event(BEFORE, "support removed")
        .phase(BEFORE + HOLD - EVALUATED, BEFORE + HOLD, "evaluated");
    let mut tables = Vec::new();
    for trial in &TRIALS {
        let held = GraspedObject {
            change: &|grasp| trial.configure(&mut grasp.plan, &paper),
            coulomb: trial.paper_law.then_some(rig.values.friction.paper),
            ..GraspedObject::new(trial.label, "box")
        };
        if trial.identified {
            let held = GraspedObject { label: "identification", ..held };
            let found = calibrate(setting, &mut rig, &held)?;
            add_identification(&mut summary, &rig, &held, &found)?;
        }
        let mut grasp_trial = GraspTrial::without_support(setting, &mut rig, &held)?;
        grasp_trial.wait(HOLD)?;
        let log = grasp_trial.end()?;
        add_metrics(&mut summary, trial, &log);
        figure = figure.panel(panel(trial, &log));
        tables.push((format!("{}.csv", trial.name), table(&log)));
    }
    Ok(Outcome { summary, figures: vec![figure], tables, motion: rig.motion })
}

/// The evaluated time span [s].
fn evaluated(log: &GraspLog) -> Range<f64> {
    let end = log.held + HOLD;
    end - EVALUATED..end
}

fn finger_force(log: &GraspLog, finger: usize) -> FingerForce {
    let samples = log.during(&evaluated(log));
    let mean =
        |value: &dyn Fn(usize) -> f64| (0..samples.len()).map(value).sum::<f64>() / samples.len() as f64;
    let magnitude = |index: usize| samples[index].force(finger).norm();
    let force = mean(&magnitude);
    let ripple = largest((0..samples.len()).map(|index| (magnitude(index) - force).abs()));
    FingerForce {
        force,
        target: mean(&|index| samples[index].estimates.target_forces[finger].norm()),
        ripple,
    }
}

fn add_metrics(summary: &mut Summary, trial: &Trial, log: &GraspLog) {
    let label = capitalized(trial.label);
    let fingers = [0, 1, 2].map(|finger| finger_force(log, finger));
    let lost = log.lost.clone();
    let mut insert = |name: &str, metric: Metric| {
        let metric = match &lost {
            Some(lost) => metric.note(format!("the box was lost {lost}")),
            None => metric,
        };
        summary.insert(format!("{}_{name}", trial.name), metric);
    };
    let [first, ..] = &fingers;
    let text = format!("{label}: force of finger 1, 2 N commanded");
    insert(
        "finger1_force",
        Metric::reported(text, first.force, "N").paper(if trial.paper_law { "0.89 N" } else { "" }),
    );
    if trial.paper_law {
        let text = format!("{label}: force of finger 1 minus the paper's");
        let metric = Metric::within(text, first.force - PAPER_FORCE, PAPER_BAND, "N");
        insert("finger1_force_minus_paper", metric.note("the limit is ± a third of the paper's force"));
    }
    let worst = |target: &dyn Fn(usize) -> f64| {
        let errors = fingers.iter().enumerate();
        largest(errors.map(|(finger, measured)| 100.0 * (measured.force / target(finger) - 1.0).abs()))
    };
    let error = worst(&|finger| COMMANDED[finger]);
    let text = format!("{label}: force error, worst finger");
    let metric = match trial.limit {
        None => Metric::reported(text, error, "%"),
        Some(limit) => Metric::at_most(text, error, limit, "%"),
    };
    insert("force_error", metric);
    let text = format!("{label}: force error against the controller's own target");
    insert("force_error_to_target", Metric::reported(text, worst(&|finger| fingers[finger].target), "%"));
    let ripple = fingers.iter().enumerate();
    let ripple = largest(ripple.map(|(finger, measured)| 100.0 * measured.ripple / COMMANDED[finger]));
    let text = format!("{label}: largest deviation of a force from its mean");
    insert("force_ripple", Metric::reported(text, ripple, "%"));
}

/// Errors of the identified values against the machine's.
fn add_identification(
    summary: &mut Summary,
    rig: &GraspRig,
    held: &GraspedObject<'_>,
    found: &Identification,
) -> Result<(), ScenarioError> {
    let (_, plant) = rig.set_up(held)?;
    let (mut gains, mut frictions) = (Vec::new(), Vec::new());
    for ((fit, factors), joint) in found.fits.iter().zip(plant.factors()).zip(&rig.robot.model.joints) {
        let Ok(found) = fit.gain else { continue };
        gains.push(100.0 * (found.value / factors.torque_constant - 1.0).abs());
        let dynamics = rig.robot.urdf.robot.joints.iter().find(|other| other.name == joint.name.as_str());
        let nominal = dynamics.and_then(|joint| joint.dynamics.as_ref()).map_or(f64::NAN, |d| d.friction);
        if let Ok([found, _]) = fit.friction {
            frictions.push(1e3 * (found.value - nominal * factors.coulomb).abs());
        }
    }
    let known = Metric::reported("Identified torque constants, of nine", gains.len() as f64, "");
    summary.insert(
        "identified_torque_constants",
        known.note("the identification rejects the others because they carry too little load"),
    );
    let failed: Vec<String> = found.failed.iter().map(ToString::to_string).collect();
    let text = "Identification: grasps that failed";
    summary.insert(
        "identification_failed_grasps",
        Metric::reported(text, failed.len() as f64, "").note(failed.join("; ")),
    );
    let text = "Identified torque constants: largest error";
    summary.insert("identified_torque_constant_error", Metric::reported(text, largest(gains), "%"));
    let text = "Identified Coulomb friction: largest error";
    summary.insert("identified_coulomb_friction_error", Metric::reported(text, largest(frictions), "mN·m"));
    Ok(())
}

/// The paper's force of finger 1, and the largest deviation from it [N].
const PAPER_FORCE: f64 = 0.89;
const PAPER_BAND: f64 = 0.30;

/// Time before the support is removed that the figure shows [s].
const BEFORE: f64 = 2.0;

const CAPTION: &str = "True contact force of finger 1 on the box, in the hand's frame, and the commanded \
                       force (dashed). The metrics are taken over the last two seconds (shaded). The paper's \
                       figure 11 commands (1.48, 0, −1.34) N, along the x axis of a box that was pitched by \
                       33 mrad less, and shows 0.89 N.";

fn panel(trial: &Trial, log: &GraspLog) -> Panel {
    let span = log.held - BEFORE..log.held + HOLD;
    let panel = Panel::new(capitalized(trial.label), "force", "N");
    let mut panel = components(panel, log, &span, |sample| sample.force(0));
    // The commanded force acts along the normal, into the box.
    let normal = log.at(log.held).and_then(|sample| sample.contacts.first().map(|contact| contact.normal));
    let normal = normal.map_or(Vector3::repeat(f64::NAN), |normal| -Vector3::from(normal));
    let ends = vec![0.0, BEFORE + HOLD - T];
    for axis in 0..3 {
        let value = normal[axis] * COMMANDED[0];
        panel = panel.line(Line::dashed("commanded", Line::INK, ends.clone(), vec![value; 2]));
    }
    panel
}
