//! Equation (2) of the Arm7 paper with full matrices: forces push the tool, under laws side by side on the
//! same machines.

use rapier3d::na::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};
use tesaki::control::{Impedance, ImpedanceAxes};
use tesaki_description::law::arm::PushExperiment;

use super::arm::{ArmRig, ArmSample, ArmTrial, Machine};
use super::arm7_paper::{NamedLaw, Recorded, compare};
use super::common::{T, capitalized, largest};
use super::unilateral::tool_pose;
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::plant::Push;
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-paper-matrices",
    title: "Arm7: impedances with full matrices",
    about: "equation (2) of the Arm7 paper with symmetric matrices in the axes of the base or of the tool: the tool is \
            pushed, and yields as K⁻¹F says",
    robot: "arm7",
    kind: Kind::Arm,
    files: &[],
    results: "docs/papers/arm7.md",
    duration: 103.0,
    shortest: None,
    laws: Some(&["paper-coupled", "coupled", "tool-axes"]),
    lead: &[
        "M, B and K of equation (2) are symmetric matrices. Coupled: soft, 200 N/m, along the diagonal between x and y of \
         the base, and four times as stiff across it. In the axes of the tool: soft along its z axis, which is level at \
         first, and with a centre of compliance 10 cm ahead of its origin, so that a force also turns it.",
        "Forces of 6 N push the tool in eight directions of the level plane, one after the other. The theory is the exact \
         motion of equation (2) under these forces; at rest it is K⁻¹F. On a machine that matches the model, with a \
         friction equivalent to 0.1 N at the tool; and on one that differs from it by up to 20 % and has the friction \
         that the paper's errors imply.",
    ],
    run,
};

/// Time before the first force [s].
const BEFORE: f64 = 0.5;
/// Steps of the theory in a control period.
const STEPS: usize = 20;

/// M, B and K along the axes of the base.
struct Theory {
    mass: Matrix6<f64>,
    damping: Matrix6<f64>,
    stiffness: Matrix6<f64>,
}

impl Theory {
    /// With the matrices of `impedance` for a tool with this orientation.
    fn new(impedance: &Impedance, tool: &Isometry3<f64>) -> Self {
        let turn = match impedance.axes {
            ImpedanceAxes::Base => Matrix3::identity(),
            ImpedanceAxes::Tool => *tool.rotation.to_rotation_matrix().matrix(),
        };
        let mut both = Matrix6::zeros();
        both.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        let none = [0.0; 15];
        let coupling = impedance.coupling.as_ref();
        let matrix = |diagonal: &[f32; 6], below: Option<&[f32; 15]>| {
            let mut matrix = Matrix6::from_diagonal(&Vector6::from(*diagonal).map(f64::from));
            let places = (1..6).flat_map(|row| (0..row).map(move |column| (row, column)));
            for ((row, column), &value) in places.zip(below.unwrap_or(&none)) {
                (matrix[(row, column)], matrix[(column, row)]) = (value.into(), value.into());
            }
            both * matrix * both.transpose()
        };
        Self {
            mass: matrix(&impedance.mass, coupling.map(|coupling| &coupling.mass)),
            damping: matrix(&impedance.damping, coupling.map(|coupling| &coupling.damping)),
            stiffness: matrix(&impedance.stiffness, coupling.map(|coupling| &coupling.stiffness)),
        }
    }

    /// Displacement at rest under a force, `K⁻¹F` [m, rad]; `None` where a direction has no spring.
    fn rest(&self, force: &Vector3<f64>) -> Option<Vector6<f64>> {
        Some(self.stiffness.cholesky()?.solve(&wrench(force)))
    }

    /// Displacement from rest in each control period [m, rad], `M ẍ + B ẋ + K x = F(t)` (classical
    /// Runge–Kutta).
    fn motion(&self, force: impl Fn(f64) -> Vector3<f64>, ticks: usize) -> Option<Vec<Vector6<f64>>> {
        let mass = self.mass.cholesky()?;
        let rate = |time: f64, [x, v]: [Vector6<f64>; 2]| {
            [v, mass.solve(&(wrench(&force(time)) - self.damping * v - self.stiffness * x))]
        };
        let step = T / STEPS as f64;
        let after = |[x, v]: [Vector6<f64>; 2], [dx, dv]: [Vector6<f64>; 2], h: f64| [x + h * dx, v + h * dv];
        let mut state = [Vector6::zeros(); 2];
        let mut motion = Vec::new();
        for tick in 0..ticks {
            motion.push(state[0]);
            for part in 0..STEPS {
                let time = (tick * STEPS + part) as f64 * step;
                let first = rate(time, state);
                let second = rate(time + 0.5 * step, after(state, first, 0.5 * step));
                let third = rate(time + 0.5 * step, after(state, second, 0.5 * step));
                let fourth = rate(time + step, after(state, third, step));
                let mean = [0, 1].map(|i| (first[i] + 2.0 * (second[i] + third[i]) + fourth[i]) / 6.0);
                state = after(state, mean, step);
            }
        }
        Some(motion)
    }
}

fn wrench(force: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(force.x, force.y, force.z, 0.0, 0.0, 0.0)
}

/// Time from the begin of a force to that of the next, in whole control periods [s].
fn interval(experiment: &PushExperiment) -> f64 {
    ((experiment.ramp + experiment.time) / T).round() * T
}

/// Force since the first one began: each passes over into the next within the ramp [N].
fn force(experiment: &PushExperiment, time: f64) -> Vector3<f64> {
    let share = |begin: f64, end: f64| {
        let ramp = |since: f64| if since <= 0.0 { 0.0 } else { (since / experiment.ramp.max(1e-9)).min(1.0) };
        ramp(time - begin) - ramp(time - end)
    };
    let begins = (0..).map(|number| f64::from(number) * interval(experiment));
    let forces = experiment.forces.iter().map(|&force| Vector3::from(force));
    forces.zip(begins).map(|(force, begin)| force * share(begin, begin + interval(experiment))).sum()
}

/// A trial from the first force on.
struct PushTrace<'a> {
    law: &'a NamedLaw,
    /// Displacement of the tool, and that of the theory [m, rad].
    measured: Vec<Vector6<f64>>,
    exact: Vec<Vector6<f64>>,
    /// For each force: mean displacement at its end, and `K⁻¹F`.
    rests: Vec<[Vector6<f64>; 2]>,
}

impl PushTrace<'_> {
    /// Largest distance from the theory in motion [mm].
    fn deviation(&self) -> f64 {
        let pairs = self.measured.iter().zip(&self.exact);
        largest(pairs.map(|(measured, exact)| 1e3 * translation(&(measured - exact)).norm()))
    }

    /// Largest distance from `K⁻¹F` at rest [mm].
    fn error(&self) -> f64 {
        largest(self.rests.iter().map(|[rest, theory]| 1e3 * translation(&(rest - theory)).norm()))
    }

    /// Largest angle between the displacement at rest and that of `K⁻¹F` [°].
    fn angle(&self) -> f64 {
        let angles = self.rests.iter().map(|[rest, theory]| translation(rest).angle(&translation(theory)));
        largest(angles.map(f64::to_degrees))
    }

    /// Largest difference of the rotation at rest from `K⁻¹F` [mrad].
    fn turn_error(&self) -> f64 {
        largest(self.rests.iter().map(|[rest, theory]| 1e3 * (rest - theory).fixed_rows::<3>(3).norm()))
    }
}

fn translation(displacement: &Vector6<f64>) -> Vector3<f64> {
    displacement.fixed_rows::<3>(0).into_owned()
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let rig = ArmRig::load(setting)?;
    let laws = NamedLaw::load_all(setting, &rig)?;
    compare(setting, rig, &laws, push, add_metrics, |traces, name| {
        vec![plane(traces, name), timeline(traces, name)]
    })
}

fn push<'a>(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    law: &'a NamedLaw,
    machine: Machine,
    name: &str,
) -> Result<Recorded<PushTrace<'a>>, ScenarioError> {
    let experiment = &law.law.push;
    let label = format!("{}, {name}", law.law.title);
    let mut arm_trial = ArmTrial::begin(setting, rig, &label, machine, law.law.settings)?;
    arm_trial.wait(BEFORE)?;
    let theory = Theory::new(&law.law.settings.impedance, &tool_pose(&arm_trial));
    let begin = arm_trial.log.0.len();
    let ticks = |time: f64| (time / T).round() as usize;
    let (interval, evaluated) = (ticks(interval(experiment)), ticks(experiment.evaluated));
    for force in &experiment.forces {
        // It falls while the next one rises.
        let (ramp, duration) = (experiment.ramp, self::interval(experiment));
        let push = Push { force: *force, point: [0.0; 3], ramp, hold: duration - ramp };
        arm_trial.plant.push_tip(0, push)?;
        arm_trial.wait(duration)?;
    }
    let log = arm_trial.end()?;
    let table = log.table();
    let samples = log.0.get(begin..).unwrap_or(&[]);
    let measured: Vec<Vector6<f64>> =
        samples.iter().map(|sample| displacement(sample, &samples[0])).collect();
    let springless = || ScenarioError::LawWithoutSpring { law: law.name.clone() };
    let exact = theory.motion(|time| force(experiment, time), measured.len()).ok_or_else(springless)?;
    let rests = experiment.forces.iter().enumerate().map(|(number, force)| {
        let end = (number + 1) * interval;
        let rest = &measured[end - evaluated..end];
        let mean = rest.iter().sum::<Vector6<f64>>() / rest.len() as f64;
        Some([mean, theory.rest(&Vector3::from(*force))?])
    });
    let rests = rests.collect::<Option<_>>().ok_or_else(springless)?;
    Ok((PushTrace { law, measured, exact, rests }, table))
}

/// Displacement of the tool and its rotation vector since `start` [m, rad].
fn displacement(sample: &ArmSample, start: &ArmSample) -> Vector6<f64> {
    let shift = sample.position() - start.position();
    let turn = (sample.orientation() * start.orientation().inverse()).scaled_axis();
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

fn add_metrics(summary: &mut Summary, trace: &PushTrace<'_>, key: &str, machine: &str) {
    let law = trace.law;
    let label = format!("{} on {machine}", capitalized(&law.law.title));
    let mut insert = |what: &str, text: &str, value: f64, unit: &str| {
        let metric = Metric::reported(format!("{label}: {text}"), value, unit);
        summary.insert(format!("{}_{key}_{what}", law.key), metric);
    };
    insert("rest_error", "displacement at rest from K⁻¹F, worst force", trace.error(), "mm");
    insert("direction_error", "angle between displacement and K⁻¹F, worst force", trace.angle(), "°");
    insert("turn_error", "rotation at rest from K⁻¹F, worst force", trace.turn_error(), "mrad");
    insert("deviation", "largest distance from the theory in motion", trace.deviation(), "mm");
}

/// Where the forces leave the tool, in the plane of x and y.
fn plane(traces: &[PushTrace<'_>], machine: &str) -> Figure {
    let caption = format!(
        "Displacement of the tool at rest under forces of the same size in different directions, on {machine}; dashed, \
         K⁻¹F. Of all directions these are an ellipse, whose long axis is the soft one."
    );
    let title = capitalized(&format!("pushed: {machine}"));
    let mut figure = Figure::paths(title, caption, "x", "mm");
    for trace in traces {
        let closed = |which: usize, axis: usize| {
            let points = trace.rests.iter().chain(trace.rests.first());
            points.map(|rest| 1e3 * rest[which][axis]).collect::<Vec<f64>>()
        };
        let panel = Panel::new(&trace.law.law.title, "y", "mm")
            .line(Line::solid("measured", trace.law.colour, closed(0, 0), closed(0, 1)))
            .line(Line::dashed("K⁻¹F", Line::INK, closed(1, 0), closed(1, 1)));
        figure = figure.panel(panel);
    }
    figure
}

/// Displacement over the time.
fn timeline(traces: &[PushTrace<'_>], machine: &str) -> Figure {
    let caption = format!(
        "Displacement of the tool along x and y, and its rotation about z, while forces push it, on {machine}; dashed, \
         the exact motion of equation (2)."
    );
    let title = capitalized(&format!("pushed, over the time: {machine}"));
    let mut figure = Figure::stacked(title, caption, "time", "s");
    for trace in traces {
        let time: Vec<f64> = (0..trace.measured.len()).map(|tick| tick as f64 * T).collect();
        let series =
            |values: &[Vector6<f64>], axis: usize| values.iter().map(|value| 1e3 * value[axis]).collect();
        let mut panel = Panel::new(&trace.law.law.title, "displacement", "mm, mrad");
        for (colour, (axis, name)) in [(0, "x"), (1, "y"), (5, "about z")].into_iter().enumerate() {
            panel = panel.line(Line::solid(name, colour, time.clone(), series(&trace.measured, axis)));
        }
        for axis in [0, 1, 5] {
            let name = if axis == 0 { "theory" } else { "" };
            panel = panel.line(Line::dashed(name, Line::INK, time.clone(), series(&trace.exact, axis)));
        }
        figure = figure.panel(panel);
    }
    figure
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use crate::scenario::common::tests::with_setting;

    /// Displacements [m, rad], from `tests/oracles/tool_push.py` (NumPy; matrices from soft directions and a
    /// centre of compliance, motion by SciPy).
    const PUSHED: &[[[f64; 6]; 6]] = include!("../../../tests/oracles/data/tool_push.in");

    fn experiment() -> PushExperiment {
        PushExperiment { forces: vec![[6.0, 0.0, 0.0]], ..PushExperiment::default() }
    }

    #[test]
    fn the_theory_of_the_shipped_laws_is_that_of_their_springs() {
        let laws = with_setting("arm7", 1, &["coupled", "tool-axes"], |setting| {
            NamedLaw::load_all(setting, &ArmRig::load(setting).unwrap()).unwrap()
        });
        let turned = Isometry3::rotation(Vector3::new(0.0, -std::f64::consts::FRAC_PI_2, 0.0));
        for (law, expected) in laws.iter().zip(PUSHED) {
            let theory = Theory::new(&law.law.settings.impedance, &turned);
            let motion = theory.motion(|time| force(&experiment(), time), 81).unwrap();
            let rests = [Vector3::x(), Vector3::y()].map(|axis| theory.rest(&(6.0 * axis)).unwrap());
            let found = rests.iter().chain([10, 20, 40, 80].map(|tick| &motion[tick]));
            for (row, (found, expected)) in found.zip(expected).enumerate() {
                // The matrices of the laws are in single precision.
                let difference = found - Vector6::from(*expected);
                assert!(difference.amax() < 1e-7, "{}, {row}: {found}", law.key);
            }
        }
    }

    /// The arm yields along the soft direction, whatever the direction of the force: 6 N along x displace it
    /// by 18.75 mm along x and 11.25 mm along y. Without the elements off the diagonal it would be 12 mm
    /// along x.
    #[test]
    fn a_coupled_spring_yields_where_it_is_soft() {
        for (name, expected) in [("coupled", [18.75, 11.25, 0.0]), ("tool-axes", [30.0, 0.0, 0.0])] {
            with_setting("arm7", 3, &[name], |setting| {
                let mut rig = ArmRig::load(setting).unwrap();
                let mut laws = NamedLaw::load_all(setting, &rig).unwrap();
                laws[0].law.push = experiment();
                let (trace, _) = push(setting, &mut rig, &laws[0], Machine::Matched, "").unwrap();
                let rest = 1e3 * translation(&trace.rests[0][0]);
                assert!((rest - Vector3::from(expected)).amax() < 0.9, "{name}: {rest} mm");
            });
        }
    }
}
