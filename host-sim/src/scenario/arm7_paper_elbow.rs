//! The elbow moves while the operator holds the hand (Arm7, sections 2.2 and 3.2), through master, link and
//! elbow sensor, under laws side by side on the same machines.

use rapier3d::na::Vector3;
use tesaki::task::impedance::Redundancy;
use tesaki_description::law::arm::ElbowExperiment;

use super::arm::{ArmRig, ArmSample, ArmTrial, Machine};
use super::arm7_elbow::{elbow_position, hand_motion};
use super::arm7_paper::{NamedLaw, Recorded, compare, link};
use super::common::{T, capitalized, largest};
use super::unilateral::{Operator, tool_pose};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::operator::{ElbowMotion, ElbowSwing, OperatorHandMotion};
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-paper-elbow",
    title: "Arm7: the elbow moves, the pseudo-inverse, the paper's law and ours",
    about: "the operator's elbow moves with the hand held, under the pseudo-inverse that the Arm7 paper discards, \
            its step 4 as printed and corrected, and ours",
    robot: "arm7",
    kind: Kind::Arm7,
    files: &[],
    results: "docs/papers/arm7.md",
    duration: 60.1,
    shortest: None,
    laws: Some(&["pseudo-inverse", "paper", "corrected", "tesaki"]),
    lead: &[
        "The operator holds the hand and swings the elbow by 30° within a second, rests, and swings back. The \
         master arm measures the hand, a tilt sensor the elbow; both are sent over a link of 20 to 23 ms that \
         loses 2 %. The paper: with the pseudo-inverse of equation (3) the elbow of the slave cannot follow; with \
         6 degrees of freedom under impedance control and the shoulder yaw under PD control it does.",
        "Step 4 as printed leaves out the acceleration of the shoulder yaw: the other six joints then do not make \
         up for it, and the hand moves; the corrected law has that term. The pseudo-inverse holds nothing in the null \
         space: with little friction the elbow drifts. On a machine that matches the model, \
         with a friction equivalent to 0.1 N at the tool, and on one that differs from it by up to 20 % and has \
         the friction that the paper's errors imply.",
    ],
    run,
};

/// Time before the swing [s].
const BEFORE: f64 = 1.5;
/// Time before the swing that figures show [s].
const SHOWN: f64 = 0.2;

/// A trial from just before the swing on.
struct ElbowTrace<'a> {
    law: &'a NamedLaw,
    experiment: ElbowExperiment,
    samples: Vec<ArmSample>,
    /// Change of the operator's elbow [mrad].
    operator: Vec<f64>,
}

impl ElbowTrace<'_> {
    fn times(&self) -> Vec<f64> {
        (0..self.samples.len()).map(|index| index as f64 * T).collect()
    }

    /// Displacement of the hand [mm].
    fn hand(&self) -> Vec<f64> {
        hand_motion(&self.samples).into_iter().map(|(displacement, _)| displacement).collect()
    }

    /// Turn of the elbow about the line from tool to shoulder [mrad].
    fn turn(&self) -> Vec<f64> {
        let start = self.samples.first().map_or(f64::NAN, elbow_angle);
        self.samples.iter().map(|sample| 1e3 * (elbow_angle(sample) - start)).collect()
    }

    /// Mean of a series over the last half second before the elbow swings back.
    fn at_rest(&self, series: &[f64]) -> f64 {
        let ElbowExperiment { time, rest, .. } = self.experiment;
        let end = ((SHOWN + time + rest) / T).round() as usize;
        let rest = series.get(end.saturating_sub(50)..end).unwrap_or(&[]);
        rest.iter().sum::<f64>() / rest.len() as f64
    }

    /// Displacement of the elbow [mm].
    fn elbow(&self) -> Vec<f64> {
        let position = |sample: &ArmSample| Vector3::from(elbow_position(sample));
        let start = self.samples.first().map(position).unwrap_or_default();
        self.samples.iter().map(|sample| 1e3 * (position(sample) - start).norm()).collect()
    }
}

/// Angle of the elbow about the line from tool to shoulder, from the vertical plane through it [rad].
fn elbow_angle(sample: &ArmSample) -> f64 {
    // The shoulder is the origin.
    let (elbow, axis) = (Vector3::from(elbow_position(sample)), -sample.position().normalize());
    let across = |vector: Vector3<f64>| vector - axis * axis.dot(&vector);
    let (elbow, down) = (across(elbow), across(-Vector3::z()));
    axis.dot(&down.cross(&elbow)).atan2(down.dot(&elbow))
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let rig = ArmRig::load(setting)?;
    let laws = NamedLaw::load_all(setting, &rig)?;
    compare(setting, rig, &laws, swing, add_metrics, |traces, name| vec![figure(traces, name)])
}

fn swing<'a>(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    law: &'a NamedLaw,
    machine: Machine,
    name: &str,
) -> Result<Recorded<ElbowTrace<'a>>, ScenarioError> {
    let (seed, experiment, follow) = (setting.seed, *law.need(&law.law.elbow, "[elbow]")?, law.follow()?);
    let label = format!("{}, {name}", law.law.title);
    let mut arm_trial = ArmTrial::begin(setting, rig, &label, machine, law.law.settings)?;
    arm_trial.wait(0.5)?;
    let (start, target) = (tool_pose(&arm_trial), arm_trial.start());
    let swing = |begin, angle| ElbowSwing { begin, duration: experiment.time, angle };
    let back = BEFORE + experiment.time + experiment.rest;
    let elbow = ElbowMotion {
        start: target.1.angle.into(),
        swings: vec![swing(BEFORE, experiment.angle), swing(back, -experiment.angle)],
    };
    let motion = OperatorHandMotion::strokes(start, Vec::new()).with_tremor(follow.tremor, seed);
    let mut operator = Operator::new(motion, elbow, link(&follow.link), seed, &start);
    let begin = arm_trial.log.0.len();
    let mut angles = Vec::new();
    law.lead(
        &mut arm_trial,
        target,
        &mut operator,
        back + experiment.time + experiment.rest,
        |operator, time, _| {
            angles.push(operator.elbow.at(time)[0]);
        },
    )?;
    let log = arm_trial.end()?;
    let table = log.table();
    let from = ((BEFORE - SHOWN) / T).round() as usize;
    let samples = log.0.into_iter().skip(begin + from).collect();
    let start = angles[from];
    let operator = angles.into_iter().skip(from).map(|angle| 1e3 * (angle - start)).collect();
    Ok((ElbowTrace { law, experiment, samples, operator }, table))
}

fn add_metrics(summary: &mut Summary, trace: &ElbowTrace<'_>, key: &str, machine: &str) {
    let law = trace.law;
    let label = format!("{} on {machine}", capitalized(&law.law.title));
    let mut insert = |what: &str, metric| summary.insert(format!("{}_{key}_{what}", law.key), metric);
    let text = format!("{label}: largest displacement of the hand");
    insert("hand_displacement", Metric::reported(text, largest(trace.hand()), "mm"));
    let paper = match law.law.settings.redundancy {
        Redundancy::None => "cannot follow",
        _ => "follows",
    };
    let text = format!("{label}: largest displacement of the elbow");
    insert("elbow_displacement", Metric::reported(text, largest(trace.elbow()), "mm"));
    let text =
        format!("{label}: turn of the elbow about the line from hand to shoulder, after the first swing");
    let note = format!("the operator's elbow: {:.0} mrad", trace.at_rest(&trace.operator));
    insert(
        "elbow_turn",
        Metric::reported(text, trace.at_rest(&trace.turn()), "mrad").paper(paper).note(note),
    );
}

fn figure(traces: &[ElbowTrace<'_>], machine: &str) -> Figure {
    let caption = format!(
        "The operator holds the hand and swings the elbow, on {machine}: turn of the slave's elbow about the line from \
         hand to shoulder, and displacement of its hand, under each law; dashed, the change of the operator's elbow \
         angle. Under the pseudo-inverse the elbow does not follow; without the acceleration of the shoulder yaw in \
         step 4 the hand moves."
    );
    let mut hand = Panel::new("Displacement of the hand", "displacement", "mm");
    let mut elbow = Panel::new("Turn of the elbow", "turn", "mrad");
    for trace in traces {
        let line = |values| Line::solid(&trace.law.law.title, trace.law.colour, trace.times(), values);
        hand = hand.line(line(trace.hand()));
        elbow = elbow.line(line(trace.turn()));
    }
    if let Some(trace) = traces.first() {
        elbow = elbow.line(Line::dashed("operator", Line::INK, trace.times(), trace.operator.clone()));
    }
    let title = capitalized(&format!("the elbow moves, the hand is held: {machine}"));
    Figure::stacked(title, caption, "time", "s").panel(elbow).panel(hand)
}
