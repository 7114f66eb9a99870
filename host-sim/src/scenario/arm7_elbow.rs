//! Null-space motion: the elbow swings while the hand keeps its pose (Arm7, section 2.2). The redundancy is
//! resolved by a directly driven shoulder yaw, or by the arm angle.

use rapier3d::na::Vector3;
use tesaki::kinematics::ElbowSetpoint;
use tesaki::task::impedance::ImpedanceSettings;

use super::arm::{
    ArmLog, ArmRig, ArmSample, ArmTrial, ELBOW_TRIALS, ElbowTrial, Machine, UPPER_ARM, motion, settings,
};
use super::common::{T, capitalized, largest};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-elbow",
    title: "The elbow swings, the hand stays",
    about: "the elbow swings by 30° in a second and back while the hand stays in place, by shoulder yaw and \
            by arm angle",
    robot: "arm7",
    kind: Kind::Arm7,
    files: &[],
    results: "docs/measurements.md#an-arm-under-impedance-control",
    duration: 15.0,
    shortest: None,
    laws: None,
    lead: &[
        "The tool of the seven-joint arm is under impedance control (M = 1.5 kg, B = 30 N·s/m, K = 300 N/m), \
         without contact. The elbow swings by 30° within a second, rests, and swings back, along a \
         minimum-jerk trajectory. How far does the hand move?",
        "Two ways to resolve the redundancy: as in the Arm7 paper, the shoulder yaw is driven directly, and the \
         other six joints keep the hand in place, with accelerations that compensate the yaw; or the arm \
         angle, of the plane through shoulder, elbow and wrist, is changed by a null-space motion of all \
         seven joints. The machine differs from the controller's model by up to 20 %.",
    ],
    run,
};

/// Angle of the swing [rad], its duration and the rest after it [s].
const SWING: f64 = std::f64::consts::PI / 6.0;
const TIME: f64 = 1.0;
const REST: f64 = 1.5;

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for trial in &ELBOW_TRIALS {
        let log = elbow_swing(setting, &mut rig, trial)?;
        add_metrics(&mut summary, trial, &log);
        figures.push(figure(trial, &log));
        tables.push((format!("{}.csv", trial.name), log.table()));
    }
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

fn elbow_swing(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    trial: &ElbowTrial,
) -> Result<ArmLog, ScenarioError> {
    let settings = ImpedanceSettings { redundancy: trial.redundancy, ..settings(30.0) };
    let mut arm_trial = ArmTrial::begin(setting, rig, trial.label, Machine::Mismatched, settings)?;
    arm_trial.wait(1.0)?;
    let (point, elbow) = arm_trial.start();
    for ends in [[0.0, SWING], [SWING, 0.0]] {
        arm_trial.follow_path(TIME, |time| {
            let [change, velocity, acceleration] = motion(ends, time, TIME).map(|value| value as f32);
            (point, ElbowSetpoint { angle: elbow.angle + change, velocity, acceleration })
        })?;
        arm_trial.wait(REST)?;
    }
    arm_trial.end()
}

/// The samples from the first swing on.
fn swings(log: &ArmLog) -> &[ArmSample] {
    log.0.get(100..).unwrap_or(&[])
}

/// Displacement [mm] and rotation [mrad] of the hand since before the first swing.
pub(super) fn hand_motion(samples: &[ArmSample]) -> Vec<(f64, f64)> {
    let Some(first) = samples.first() else { return Vec::new() };
    let (start, orientation) = (first.position(), first.orientation());
    let motion = |sample: &ArmSample| {
        ((sample.position() - start).norm() * 1e3, orientation.angle_to(&sample.orientation()) * 1e3)
    };
    samples.iter().map(motion).collect()
}

fn add_metrics(summary: &mut Summary, trial: &ElbowTrial, log: &ArmLog) {
    let label = capitalized(trial.label);
    let motion = hand_motion(swings(log));
    let mut insert = |name: &str, metric| summary.insert(format!("{}_{name}", trial.name), metric);
    insert(
        "hand_displacement",
        Metric::at_most(
            format!("{label}: largest displacement of the hand"),
            largest(motion.iter().map(|motion| motion.0)),
            1.0,
            "mm",
        ),
    );
    insert(
        "hand_rotation",
        Metric::reported(
            format!("{label}: largest rotation of the hand"),
            largest(motion.iter().map(|motion| motion.1)),
            "mrad",
        ),
    );
    let elbow = |sample: &ArmSample| Vector3::from(elbow_position(sample));
    let all = swings(log);
    let displacement = all
        .first()
        .map_or(f64::NAN, |first| largest(all.iter().map(|sample| (elbow(sample) - elbow(first)).norm())));
    let text = format!("{label}: largest displacement of the elbow");
    insert("elbow_displacement", Metric::at_least(text, 1e3 * displacement, 30.0, "mm"));
}

/// Position of the elbow relative to the shoulder [m].
pub(super) fn elbow_position(sample: &ArmSample) -> [f64; 3] {
    let (pitch, roll) = (sample.joints[0], sample.joints[1]);
    // Pitch rotates about −y, roll about −x.
    let down = Vector3::new(0.0, -UPPER_ARM * roll.sin(), -UPPER_ARM * roll.cos());
    [-down.z * pitch.sin(), down.y, down.z * pitch.cos()]
}

fn figure(trial: &ElbowTrial, log: &ArmLog) -> Figure {
    let caption = "Displacement of the hand since before the first swing, change of the elbow's set-point, \
                   and changes of the joint angles.";
    let samples = swings(log);
    let time: Vec<f64> = (0..samples.len()).map(|index| index as f64 * T).collect();
    let displacement = hand_motion(samples).into_iter().map(|motion| motion.0).collect();
    let hand = Panel::new("Displacement of the hand", "displacement", "mm")
        .rule(1.0, "limit 1 mm")
        .line(Line::solid("hand", Line::INK, time.clone(), displacement));
    let mut joints = Panel::new("Joint angles", "change", "rad");
    let first = samples.first().map_or(Vec::new(), |first| first.joints.clone());
    for (joint, start) in first.iter().enumerate() {
        let change = samples.iter().map(|sample| sample.joints[joint] - start).collect();
        joints = joints.line(Line::solid(format!("joint {}", joint + 1), joint, time.clone(), change));
    }
    let elbow = samples.first().map_or(f64::NAN, |first| first.elbow);
    let elbow = samples.iter().map(|sample| sample.elbow - elbow).collect();
    joints = joints.line(Line::dashed("elbow set-point", Line::INK, time, elbow));
    let [forward, back] = [0.0, TIME + REST];
    Figure::stacked(capitalized(trial.label), caption, "time", "s")
        .phase(forward, forward + TIME, "swing")
        .phase(forward + TIME, back, "at rest")
        .phase(back, back + TIME, "swing back")
        .phase(back + TIME, back + TIME + REST, "at rest")
        .panel(hand)
        .panel(joints)
}
