//! Figure 7: the slave follows a human master; and the error over the damping, which the paper does not state.

use rapier3d::na::Vector3;
use tesaki::task::impedance::ImpedanceSettings;

use super::{NamedLaw, damping_key};
use crate::operator::{ElbowMotion, LinkValues, OperatorHandMotion};
use crate::report::{Column, Figure, Line, Metric, Panel, Summary, csv};
use crate::scenario::arm::{ArmRig, ArmTrial, Machine};
use crate::scenario::common::capitalized;
use crate::scenario::unilateral::{Operator, Trace, displacements, tool_pose};
use crate::scenario::{ScenarioError, Setting};

/// Times since the trial began: the hand begins and ends its motion [s].
const BEGIN: f64 = 1.0;
const END: f64 = 7.0;
/// Rest after the motion; the error at rest is the mean over its second half [s].
const REST: f64 = 2.0;

/// Whether the master's samples come over the law's link.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Path {
    Direct,
    Link,
}

impl Path {
    const ALL: [Self; 2] = [Self::Direct, Self::Link];

    const fn key(self) -> &'static str {
        match self {
            Self::Direct => "direct",
            Self::Link => "link",
        }
    }

    const fn label(self) -> &'static str {
        match self {
            Self::Direct => "directly",
            Self::Link => "over the link",
        }
    }

    fn link(self, law: &NamedLaw) -> LinkValues {
        match self {
            Self::Direct => LinkValues::default(),
            Self::Link => law.link(),
        }
    }
}

/// Errors of a trial along x [mm].
#[derive(Clone, Copy)]
struct Errors {
    reversals: f64,
    motion: f64,
    rest: f64,
}

impl Errors {
    fn of(trace: &Trace) -> Self {
        let (moving, rest) = (BEGIN..END, END + 0.5 * REST..END + REST);
        Self {
            reversals: trace.reversals(&moving),
            motion: trace.largest(&moving, |moment| moment.error().x.abs()),
            rest: trace.mean_error(&rest).x.abs(),
        }
    }
}

/// The errors over the damping.
struct Curve {
    dampings: Vec<f64>,
    errors: Vec<Errors>,
}

impl Curve {
    fn values(&self, value: impl Fn(&Errors) -> f64) -> Vec<f64> {
        self.errors.iter().map(value).collect()
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
    for path in Path::ALL {
        let mut traces = Vec::new();
        for law in laws {
            let trial = follow(setting, rig, law, path, law.law.follow.damping);
            let Some(trace) = law.survives(setting, trial)? else { continue };
            add_metrics(summary, law, path, &Errors::of(&trace));
            tables.push((format!("follow_{}_{}.csv", path.key(), law.key), trace.table()));
            traces.push((law, trace));
        }
        figures.push(figure(path, &traces));
    }
    for path in Path::ALL {
        let mut curves = Vec::new();
        for law in laws {
            let mut curve = Curve { dampings: Vec::new(), errors: Vec::new() };
            for &damping in &law.law.follow.curve {
                let trial = follow(setting, rig, law, path, damping);
                let Some(trace) = law.survives(setting, trial)? else { continue };
                let errors = Errors::of(&trace);
                add_curve_metric(summary, law, path, damping, &errors);
                curve.dampings.push(damping.into());
                curve.errors.push(errors);
            }
            tables.push((format!("curve_{}_{}.csv", path.key(), law.key), table(&curve)));
            curves.push(curve);
        }
        figures.push(curve_figure(laws, path, &curves));
    }
    Ok(())
}

fn follow(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    law: &NamedLaw,
    path: Path,
    damping: f32,
) -> Result<Trace, ScenarioError> {
    let (seed, experiment) = (setting.seed, &law.law.follow);
    let settings: ImpedanceSettings = law.law.with_damping(damping);
    let label = format!("{}, {}, B {damping} N·s/m", law.law.title, path.label());
    let mut arm_trial = ArmTrial::begin(setting, rig, &label, Machine::KnownPaperFriction, settings)?;
    arm_trial.wait(0.5)?;
    let (start, target) = (tool_pose(&arm_trial), arm_trial.start());
    let along = Vector3::new(experiment.amplitude, 0.0, 0.0);
    let motion = OperatorHandMotion::sine(start, along, experiment.frequency, [BEGIN, END])
        .with_tremor(experiment.tremor, seed);
    let elbow = ElbowMotion { start: target.1.angle.into(), swings: Vec::new() };
    let mut operator = Operator::new(motion, elbow, path.link(law), seed, &start);
    let mut trace = Trace::new(arm_trial.log.now());
    law.lead(&mut arm_trial, target, &mut operator, END + REST, |operator, time, point| {
        trace.push(&operator.motion.at(time), &operator.elbow.at(time), point);
    })?;
    trace.add_arm_log(arm_trial.end()?);
    Ok(trace)
}

fn add_metrics(summary: &mut Summary, law: &NamedLaw, path: Path, errors: &Errors) {
    let label = format!("{}, {}, B {}", capitalized(&law.law.title), path.label(), law.law.follow.damping);
    let mut insert = |what: &str, metric| {
        summary.insert(format!("{}_follow_{}_{what}", law.key, path.key()), metric);
    };
    let metric = |text: &str, value| Metric::reported(format!("{label}: {text}"), value, "mm");
    insert("reversals", metric("largest error along x at the reversals", errors.reversals).paper("7 mm"));
    insert("rest", metric("error along x at rest", errors.rest).paper("3 mm"));
    insert("motion", metric("largest error along x in motion", errors.motion));
}

fn add_curve_metric(summary: &mut Summary, law: &NamedLaw, path: Path, damping: f32, errors: &Errors) {
    let text = format!(
        "{}, {}, B {damping}: largest error along x at the reversals",
        capitalized(&law.law.title),
        path.label()
    );
    let key = format!("{}_curve_{}_{}_reversals", law.key, path.key(), damping_key(damping));
    summary.insert(key, Metric::reported(text, errors.reversals, "mm"));
}

/// In the paper's layout: positions of master and slave over the time; below, what their difference is.
fn figure(path: Path, traces: &[(&NamedLaw, Trace)]) -> Figure {
    let caption = format!(
        "The paper's figure 7, {}: positions of the master's hand and of the slave's tool along x from their common \
         start, under each law; below, tool minus hand at the same time. The paper reads 7 mm at the reversals and \
         3 mm at rest from its figure.",
        path.label()
    );
    let title = capitalized(&format!("the slave follows the master along x, {}", path.label()));
    let mut position = Panel::new("Position along x", "position", "mm");
    let mut error = Panel::new("Error along x", "tool minus hand", "mm").band(7.0, "paper ±7 mm");
    for (law, trace) in traces {
        let [_, tool] = displacements(trace, 0);
        position = position.line(Line::solid(&law.law.title, law.colour, trace.times(), tool));
        error = error.line(Line::solid(&law.law.title, law.colour, trace.times(), trace.errors(0)));
    }
    if let Some((_, trace)) = traces.first() {
        let [hand, _] = displacements(trace, 0);
        position = position.line(Line::dashed("master's hand", Line::INK, trace.times(), hand));
    }
    Figure::stacked(title, caption, "time", "s")
        .phase(BEGIN, END, "hand moves")
        .phase(END, END + REST, "at rest")
        .panel(position)
        .panel(error)
}

fn curve_figure(laws: &[NamedLaw], path: Path, curves: &[Curve]) -> Figure {
    let caption = format!(
        "Errors of the master-slave experiment, {}, over the damping B, which the paper does not state: largest error \
         along x at the reversals of the hand, and error along x at rest, under each law.",
        path.label()
    );
    let title = capitalized(&format!("error over the damping, {}", path.label()));
    let mut reversals =
        Panel::new("At the reversals", "largest error along x", "mm").rule(7.0, "paper: 7 mm");
    let mut rest = Panel::new("At rest", "error along x", "mm").rule(3.0, "paper: 3 mm");
    for (law, curve) in laws.iter().zip(curves) {
        let line = |values| Line::solid(&law.law.title, law.colour, curve.dampings.clone(), values);
        reversals = reversals.line(line(curve.values(|errors| errors.reversals)));
        rest = rest.line(line(curve.values(|errors| errors.rest)));
    }
    Figure::stacked(title, caption, "damping", "N·s/m").panel(reversals).panel(rest)
}

fn table(curve: &Curve) -> String {
    csv(&[
        Column::new("damping", "N·s/m", &curve.dampings),
        Column::new("error at reversals", "mm", &curve.values(|errors| errors.reversals)),
        Column::new("error in motion", "mm", &curve.values(|errors| errors.motion)),
        Column::new("error at rest", "mm", &curve.values(|errors| errors.rest)),
    ])
}
