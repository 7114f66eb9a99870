//! Bilateral control as the Arm7 paper announces it (section 4), and ours, side by side on the same machines.

use rapier3d::na::{Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use tesaki::kinematics::PosePoint;
use tesaki::task::impedance::ImpedanceSettings;
use tesaki::teleop::MatchedImpedance;
use tesaki_description::law::arm::{BilateralExperiment, ForceFeedback, NoiseTable, PushTable, StrokeTable};
use tesaki_rng::Rng;

use super::arm::{self, ArmRig, ArmSample, ArmTrial, Machine};
use super::arm7_bilateral::{self, BEGIN, LinkSample, wall_before};
use super::arm7_paper::NamedLaw;
use super::common::{T, capitalized};
use super::unilateral::tool_pose;
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::operator::{Link, LinkValues, MasterArm, MasterArmValues, OperatorHandMotion, Stroke};
use crate::plant::{Push, isometry};
use crate::purpose::Purpose;
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-paper-bilateral",
    title: "Arm7: bilateral control with matched impedances, and ours",
    about: "the operator presses the slave against a wall with force feedback: the matched impedances that the Arm7 \
            paper announces, and the reflected spring under passivity control",
    robot: "arm7",
    kind: Kind::Arm,
    files: &[],
    results: "docs/papers/arm7.md",
    duration: 64.3,
    shortest: None,
    laws: Some(&["paper", "matched", "tesaki"]),
    lead: &[
        "Section 4 of the paper announces bilateral control in which master and slave have the same impedance, so that \
         the operator feels the force on the slave exactly; it prints no equation and no result. Here, as said in \
         docs/equations.md: the impedance of equation (2) at both ends, each towards the pose of the other, moved by the \
         sum of the measured wrenches of operator and environment. The paper's \
         slave runs as printed; the same impedances with our slave run beside it. Ours reflects the force of the slave's \
         spring, without torques, and keeps the link passive.",
        "In robots/arm7/laws the operator moves the handle by 5 cm within 0.8 s and intends to stay; under the matched \
         law the hand also turns by 0.15 rad about z. A wall of 2000 N/m stands in the way after 2 cm. Then a push acts \
         on the slave's tool 10 cm beside its origin. M 3.5 kg, B 60 N·s/m, K 300 N/m; the slave differs from the controller's model by up to \
         20 %; the link delays each direction by 0, 20 or 50 ms. The handle's force sensor has a noise of 0.1 N and 5 \
         mN·m.",
    ],
    run,
};

/// A trial of the matched law, tick by tick.
struct Matched {
    run: arm7_bilateral::Run,
    /// Pose of the slave minus that of the master [m, rad].
    differences: Vec<Vector6<f64>>,
    /// Wrench of the operator's hand on the handle [N, N·m].
    operator: Vec<Vector6<f64>>,
}

impl Matched {
    /// Means over the last half second before the push, which begins in the tick `end`, or of the trial.
    fn mean(values: &[Vector6<f64>], end: Option<usize>) -> Vector6<f64> {
        let end = end.unwrap_or(values.len());
        let last = values.get(end.saturating_sub(tick(0.5))..end).unwrap_or(&[]);
        last.iter().sum::<Vector6<f64>>() / last.len() as f64
    }

    /// True wrench on the slave's tool [N, N·m].
    fn environment(&self) -> Vec<Vector6<f64>> {
        self.run.samples.iter().map(wrench).collect()
    }
}

fn tick(time: f64) -> usize {
    (time / T).round() as usize
}

/// The tick in which the operator has stayed long enough.
fn stayed(stroke: &StrokeTable) -> usize {
    tick(BEGIN + stroke.time + stroke.stay)
}

fn wrench(sample: &ArmSample) -> Vector6<f64> {
    let ([x, y, z], [a, b, c]) = (sample.tool.force, sample.tool.torque);
    Vector6::new(x, y, z, a, b, c)
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let laws = NamedLaw::load_all(setting, &rig)?;
    let mut summary = Summary::default();
    let (mut runs, mut tables) = (Vec::new(), Vec::new());
    for law in &laws {
        let experiment = law.need(&law.law.bilateral, "[bilateral]")?;
        let settings = law.law.with_bilateral(experiment);
        for &delay in &experiment.delays {
            let trial = trial(setting, &mut rig, law, experiment, settings, delay);
            let Some((run, matched)) = law.survives(setting, trial)? else { continue };
            add_metrics(&mut summary, (law, experiment), delay, &run, matched.as_ref());
            let milliseconds = (1e3 * delay).round();
            tables.push((format!("{}_delay_{milliseconds}.csv", law.key), run.table()));
            runs.push((law, run));
        }
        law.add_faults(&mut summary);
    }
    Ok(Outcome { summary, figures: vec![figure(&runs)], tables, motion: rig.motion })
}

/// A trial: what both couplings record, and what only the matched one does.
type Trial = (arm7_bilateral::Run, Option<Matched>);

fn trial(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    law: &NamedLaw,
    experiment: &BilateralExperiment,
    settings: ImpedanceSettings,
    delay: f64,
) -> Result<Trial, ScenarioError> {
    let label = format!("{}, delay {:.0} ms", law.law.title, 1e3 * delay);
    match experiment.coupling {
        ForceFeedback::Reflected => {
            let press = (experiment.stroke, experiment.wall);
            let run = arm7_bilateral::press_wall(setting, rig, settings, press, delay, true)?;
            Ok((run, None))
        }
        ForceFeedback::Matched => {
            let matched = press_matched(setting, rig, &label, settings, (experiment, delay))?;
            Ok((matched.run.clone(), Some(matched)))
        }
    }
}

/// Message to the slave: pose of the handle, wrench of the operator.
type Forward = (Isometry3<f64>, Vector6<f32>);
/// Message to the master: pose of the tool, measured wrench on it.
type Backward = (Isometry3<f64>, Vector6<f32>);

fn press_matched(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    label: &str,
    settings: ImpedanceSettings,
    (experiment, delay): (&BilateralExperiment, f64),
) -> Result<Matched, ScenarioError> {
    let seed = setting.seed;
    let BilateralExperiment { stroke, wall, push, noise, .. } = experiment;
    let impedance = settings.impedance;
    // Checked with the law.
    let Ok(law) = MatchedImpedance::try_new(&impedance) else {
        return Err(ScenarioError::LawWithout { law: label.to_owned(), section: "matched impedance" });
    };
    let mut arm_trial = ArmTrial::begin(setting, rig, label, Machine::Mismatched, settings)?;
    let (point, elbow) = arm_trial.start();
    let start = arm::pose(&point);
    arm_trial.plant.insert_wall(wall_before(&start.translation.vector, wall))?;
    let motion = Stroke {
        begin: BEGIN,
        duration: stroke.time,
        shift: Vector3::new(stroke.shift, 0.0, 0.0),
        turn: Vector3::new(0.0, 0.0, stroke.turn),
    };
    let motion = OperatorHandMotion::strokes(start, vec![motion]);
    // The handle has the mass of the impedance.
    let mut values = MasterArmValues::default();
    let own = Vector6::from(impedance.mass).map(f64::from);
    (values.impedance.mass, values.rotation.mass) =
        (values.impedance.mass + own[0], values.rotation.mass + own[3]);
    let mut master = MasterArm::new(values, &start, seed);
    let link = LinkValues { delay, ..LinkValues::default() };
    let mut forward = Link::<Forward>::new(link, seed);
    let mut backward = Link::<Backward>::new(link, seed.wrapping_add(1000));
    let mut sensor = Purpose::HandleSensor.rng(seed);
    let (mut handle, mut motors) = (start, Vector6::zeros());
    let (mut tool, mut tool_wrench) = (start, Vector6::zeros());
    let (mut target, mut before) = ((start, Vector6::zeros()), Vector6::zeros());
    let mut matched = Matched {
        run: arm7_bilateral::Run::new(*stroke, wall.stiffness, delay),
        differences: Vec::new(),
        operator: Vec::new(),
    };
    for number in 1..=stayed(stroke) + tick(push.time) {
        let time = number as f64 * T;
        if number == stayed(stroke) {
            let PushTable { force, point, ramp, .. } = *push;
            arm_trial.plant.push_tip(0, Push { force, point, ramp, hold: f64::INFINITY })?;
        }
        // The master: pose and velocity of the handle, mean wrench of the operator over the last period.
        if let Some((_, measured)) = master.run(&motion, time).last() {
            handle = isometry(measured.position, measured.orientation);
        }
        let state = master.handle(&motion);
        let velocity = six(&state.velocity, &state.angular_velocity);
        let acceleration = (velocity - before) / T;
        before = velocity;
        let true_operator = own.component_mul(&acceleration) - motors;
        let operator = measured(&true_operator, noise, &mut sensor).map(|part| part as f32);
        forward.send(time, (handle, operator));
        for packet in forward.receive(time) {
            target = packet.message;
        }
        // The slave.
        let arm = arm_trial.telemetry()?;
        let (pose, wrench) = (tool_pose(&arm_trial), Vector6::from(arm.wrench));
        let displacement = law.setpoint_displacement(&target.1).map(f64::from);
        let setpoint = displaced(&target.0, &displacement);
        arm_trial.follow(pose_point(&setpoint), elbow)?;
        backward.send(time, (pose, wrench));
        for packet in backward.receive(time) {
            (tool, tool_wrench) = packet.message;
        }
        let error = difference(&handle, &tool).map(|part| part as f32);
        let velocity = velocity.map(|part| part as f32);
        motors = law.master_wrench(&error, &velocity, &tool_wrench).map(f64::from);
        let force = master.reflect([motors[0], motors[1], motors[2]]);
        let torque = master.reflect_torque([motors[3], motors[4], motors[5]]);
        motors = six(&force.into(), &torque.into());
        matched.run.ticks.push(LinkSample {
            handle: state.pose.translation.x - start.translation.x,
            force: -true_operator[0],
            energy: f64::NAN,
        });
        matched.differences.push(difference(&pose, &state.pose));
        matched.operator.push(true_operator);
    }
    matched.run.samples = arm_trial.end_without_start()?;
    Ok(matched)
}

fn six(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

/// What the sensor in the handle reads.
fn measured(wrench: &Vector6<f64>, noise: &NoiseTable, rng: &mut Rng) -> Vector6<f64> {
    let NoiseTable { force, torque } = *noise;
    Vector6::from_fn(|row, _| wrench[row] + if row < 3 { force } else { torque } * rng.normal())
}

/// Displacement and rotation vector from `other` to `pose`.
fn difference(pose: &Isometry3<f64>, other: &Isometry3<f64>) -> Vector6<f64> {
    let turn = (pose.rotation * other.rotation.inverse()).scaled_axis();
    six(&(pose.translation.vector - other.translation.vector), &turn)
}

fn displaced(pose: &Isometry3<f64>, displacement: &Vector6<f64>) -> Isometry3<f64> {
    let [shift, turn] = [0, 3].map(|row| displacement.fixed_rows::<3>(row).into_owned());
    let rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
    Isometry3::from_parts(Translation3::from(pose.translation.vector + shift), rotation)
}

fn pose_point(pose: &Isometry3<f64>) -> PosePoint {
    PosePoint {
        position: pose.translation.vector.map(|part| part as f32).into(),
        rotation: pose.rotation.coords.map(|part| part as f32).into(),
        velocity: [0.0; 6],
        acceleration: [0.0; 6],
    }
}

fn add_metrics(
    summary: &mut Summary,
    (law, experiment): (&NamedLaw, &BilateralExperiment),
    delay: f64,
    run: &arm7_bilateral::Run,
    matched: Option<&Matched>,
) {
    let milliseconds = (1e3 * delay).round();
    let label = format!("{}, {milliseconds} ms", capitalized(&law.law.title));
    let mut insert = |what: &str, text: &str, value: f64, unit: &str| {
        let key = format!("{}_delay_{milliseconds}_{what}", law.key);
        summary.insert(key, Metric::reported(format!("{label}: {text}"), value, unit));
    };
    let end = stayed(&experiment.stroke);
    let rest = end - tick(0.5)..end;
    let mean = |value: &dyn Fn(usize) -> f64| rest.clone().map(value).sum::<f64>() / rest.len() as f64;
    let felt = mean(&|index| -run.ticks[index].force);
    let wall = mean(&|index| -run.samples[index].tool.wall_force[0]);
    insert("settling_time", "settling time of the handle", run.settling_time(), "s");
    insert("wall_force", "force on the wall at rest", wall, "N");
    insert("force_error", "force that the operator feels at rest, minus that on the wall", felt - wall, "N");
    let apart = mean(&|index| {
        run.samples[index].tool.position[0] - run.samples[0].tool.position[0] - run.ticks[index].handle
    });
    insert("distance", "slave from master along x at rest", 1e3 * apart.abs(), "mm");
    insert(
        "energy_generated",
        "largest energy the wall received beyond the operator's input",
        1e3 * run.energy_generated(),
        "mJ",
    );
    if let Some(matched) = matched {
        let turned = Matched::mean(&matched.differences, Some(end)).fixed_rows::<3>(3).norm();
        insert("rotation", "rotation of the slave from the master at rest", 1e3 * turned, "mrad");
        let [felt, acting] =
            [&matched.operator, &matched.environment()].map(|values| Matched::mean(values, None));
        let torque = (felt + acting).fixed_rows::<3>(3).norm();
        let text = format!(
            "torque that the operator feels under the push, minus that on the tool, of {:.3} N·m",
            acting.fixed_rows::<3>(3).norm()
        );
        insert("torque_error", &text, torque, "N·m");
    }
}

fn figure(runs: &[(&NamedLaw, arm7_bilateral::Run)]) -> Figure {
    let caption = "The operator moves the handle against a wall, under each law: force that the operator \
                   feels (solid) and true force on the wall (dashed), a panel for each delay of the link.";
    let mut figure = Figure::stacked("Force felt and force on the wall", caption, "time", "s");
    if let Some((_, run)) = runs.first() {
        let end = BEGIN + run.stroke.time;
        figure =
            figure.phase(BEGIN, end, "operator moves").phase(end, end + run.stroke.stay, "operator stays");
    }
    let mut delays: Vec<f64> = Vec::new();
    for (_, run) in runs {
        if !delays.iter().any(|delay| delay.total_cmp(&run.delay).is_eq()) {
            delays.push(run.delay);
        }
    }
    for delay in delays {
        let mut panel = Panel::new(format!("Delay {} ms", (1e3 * delay).round()), "force", "N");
        for (law, run) in runs.iter().filter(|(_, run)| run.delay.total_cmp(&delay).is_eq()) {
            let end = stayed(&run.stroke).min(run.ticks.len());
            let times = || run.times()[..end].to_vec();
            let felt = run.ticks[..end].iter().map(|tick| -tick.force).collect();
            let wall = run.samples[..end].iter().map(|sample| -sample.tool.wall_force[0]).collect();
            panel = panel
                .line(Line::solid(format!("{}: felt", law.law.title), law.colour, times(), felt))
                .line(Line::dashed(format!("{}: wall", law.law.title), law.colour, times(), wall));
        }
        figure = figure.panel(panel);
    }
    figure
}
