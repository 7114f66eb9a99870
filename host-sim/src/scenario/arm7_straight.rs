//! The set-point moves beyond the arm's reach and back, through the singular configuration in which the elbow
//! is straight.

use rapier3d::na::Vector3;
use tesaki::task::impedance::ImpedanceSettings;

use super::arm::{
    ArmLog, ArmRig, ArmSample, ArmTrial, ELBOW_TRIALS, ElbowTrial, FOREARM, HAND, Machine, UPPER_ARM, motion,
    settings, shift,
};
use super::common::{T, capitalized, largest};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-straight",
    title: "The arm through its straight-elbow singularity",
    about: "the set-point moves 3 cm beyond the arm's reach and back: into a singular configuration and out \
            of it",
    robot: "arm7",
    kind: Kind::Arm7,
    files: &[],
    results: "docs/measurements.md#an-arm-under-impedance-control",
    duration: 15.0,
    shortest: None,
    laws: None,
    lead: &[
        "The set-point of the seven-joint arm's tool moves outwards within 1.5 s, along the line from the \
         shoulder to the wrist, to 3 cm beyond the arm's reach. It stays for a second and returns. The \
         elbow becomes straight: in this singular configuration no joint motion moves the tool along \
         that line, and an undamped solution would need unbounded accelerations.",
        "Near singular configurations the inverse is damped, depending on the smallest singular value of the \
         Jacobian. The tool stays behind where it cannot reach; torques and speeds remain normal; and it \
         follows again as soon as it can. The machine differs from the controller's model by up to 20 %. \
         (The wrist's other singular configuration, folded by 90°, is outside its limits.)",
    ],
    run,
};

/// Distance from shoulder to wrist with a straight elbow, and distance of the set-point beyond it [m].
const REACH: f64 = UPPER_ARM + FOREARM;
const BEYOND: f64 = 0.03;
/// Time of each motion, and rest after it [s].
const TIME: f64 = 1.5;
const REST: f64 = 1.0;

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for trial in &ELBOW_TRIALS {
        let log = move_beyond_reach(setting, &mut rig, trial)?;
        add_metrics(&mut summary, trial, &log);
        figures.push(figure(trial, &log));
        tables.push((format!("{}.csv", trial.name), log.table()));
    }
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

fn move_beyond_reach(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    trial: &ElbowTrial,
) -> Result<ArmLog, ScenarioError> {
    let settings = ImpedanceSettings { redundancy: trial.redundancy, ..settings(30.0) };
    let mut arm_trial = ArmTrial::begin(setting, rig, trial.label, Machine::Mismatched, settings)?;
    arm_trial.wait(1.0)?;
    let (start, elbow) = arm_trial.start();
    // The hand points along x throughout.
    let wrist = Vector3::from(start.position).map(f64::from) - Vector3::x() * HAND;
    let outwards = wrist.normalize() * (REACH + BEYOND - wrist.norm());
    for ends in [[Vector3::zeros(), outwards], [outwards, Vector3::zeros()]] {
        arm_trial.follow_path(TIME, |time| {
            let mut setpoint = start;
            for axis in 0..3 {
                shift(&mut setpoint, axis, motion(ends.map(|end| end[axis]), time, TIME));
            }
            (setpoint, elbow)
        })?;
        arm_trial.wait(REST)?;
    }
    arm_trial.end()
}

/// Largest rate of change of a value of any joint from one control period to the next [1/s].
fn largest_rate(log: &ArmLog, values: impl Fn(&ArmSample) -> &[f64]) -> f64 {
    let changes = log.0.windows(2).flat_map(|pair| {
        values(&pair[0]).iter().zip(values(&pair[1])).map(|(before, after)| (after - before).abs() / T)
    });
    largest(changes)
}

fn add_metrics(summary: &mut Summary, trial: &ElbowTrial, log: &ArmLog) {
    let label = capitalized(trial.label);
    let mut insert = |name: &str, metric| summary.insert(format!("{}_{name}", trial.name), metric);
    let all = 0.0..log.now();
    let straight = -log.largest(&all, |sample| -sample.joints[3].abs());
    let text = format!("{label}: smallest elbow angle");
    insert("elbow_angle_min", Metric::at_most(text, 1e3 * straight, 100.0, "mrad"));
    let text = format!("{label}: largest joint speed; the elbow is rated at 5 rad/s");
    insert(
        "joint_speed_peak",
        Metric::at_most(text, largest_rate(log, |sample| &sample.joints), 4.0, "rad/s"),
    );
    let text = format!("{label}: largest torque; the shoulder is rated at 60 N·m");
    let torque = |sample: &ArmSample| largest(sample.torques.iter().map(|torque| torque.abs()));
    insert("torque_peak", Metric::at_most(text, log.largest(&all, torque), 20.0, "N·m"));
    let text = format!("{label}: largest rate of a torque");
    insert(
        "torque_rate_peak",
        Metric::at_most(text, largest_rate(log, |sample| &sample.torques), 1000.0, "N·m/s"),
    );
    let text = format!("{label}: largest rotation of the hand");
    let rotation = log.0.first().map_or(f64::NAN, |first| {
        log.largest(&all, |sample| 1e3 * first.orientation().angle_to(&sample.orientation()))
    });
    insert("hand_rotation", Metric::reported(text, rotation, "mrad"));
    let back = log.0.last().map_or(f64::NAN, position_error);
    let text = format!("{label}: position error after the return");
    insert("error_after_return", Metric::at_most(text, back, 1.0, "mm"));
}

/// Distance of the tool from its set-point [mm].
fn position_error(sample: &ArmSample) -> f64 {
    1e3 * (sample.position() - sample.target).norm()
}

fn figure(trial: &ElbowTrial, log: &ArmLog) -> Figure {
    let caption = "Displacement of the tool from its start and that of the set-point (dashed), position \
                   error, elbow angle, and motor torques.";
    let series = |value: &dyn Fn(&ArmSample) -> f64| log.0.iter().map(value).collect::<Vec<f64>>();
    let time = series(&|sample| sample.time);
    let start = log.0.first().map_or(Vector3::repeat(f64::NAN), |first| first.target);
    let tool = Panel::new("Tool", "displacement", "mm")
        .line(Line::solid(
            "tool",
            0,
            time.clone(),
            series(&|sample| 1e3 * (sample.position() - start).norm()),
        ))
        .line(Line::dashed(
            "set-point",
            Line::INK,
            time.clone(),
            series(&|sample| 1e3 * (sample.target - start).norm()),
        ));
    let error = Panel::new("Position error", "error", "mm").line(Line::solid(
        "error",
        1,
        time.clone(),
        series(&position_error),
    ));
    let elbow = series(&|sample| sample.joints[3]);
    let elbow = Panel::new("Elbow", "angle", "rad").line(Line::solid("elbow", 3, time.clone(), elbow));
    let mut torques = Panel::new("Torques", "torque", "N·m");
    for joint in 0..log.0.first().map_or(0, |first| first.torques.len()) {
        let values = series(&|sample| sample.torques[joint]);
        torques = torques.line(Line::solid(format!("joint {}", joint + 1), joint, time.clone(), values));
    }
    let [out, back] = [1.0, 1.0 + TIME + REST];
    Figure::stacked(capitalized(trial.label), caption, "time", "s")
        .phase(out, out + TIME, "set-point outwards")
        .phase(out + TIME, back, "beyond reach")
        .phase(back, back + TIME, "set-point back")
        .panel(tool)
        .panel(error)
        .panel(elbow)
        .panel(torques)
}
