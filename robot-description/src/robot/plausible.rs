//! What a robot folder can hold, but no machine is likely to have.

mod links;
mod motors;

pub(crate) use links::LEAD;

use std::collections::BTreeMap;

use nalgebra::Vector3;
use tesaki::model::{ChainJoint, ForceSensor, JointModel, RobotModel};

use super::RobotFolder;
use super::chain::chain_length;
use super::doubtful::doubtful_values;
use super::limits::{ImplausibleValue, implausible_values};
use super::of_joints::OfJoints;
use crate::finding::{Finding, Report};
use crate::load::{CoupledChains, JointLoad};
use crate::plant::{ForceSensorValues, PlantValues};
use crate::urdf::{Urdf, four};

/// Distance of a tip from the axis of its last joint below which the joint does not move it [m].
const ON_AXIS: f32 = 1e-4;
/// Joints of an arm, whose last one turns the tool about its own axis.
const ARM_JOINTS: usize = 6;
/// Factor between two bandwidths of current loops, from which one is wrong.
const OTHER_BANDWIDTH: f64 = 3.0;

/// Largest difference of a count in both files, as a share of it: more than rounding.
const SAME_COUNT: f32 = 1e-5;
/// A tip nearer to its last joint than this has no link of its own [m].
const NO_LINK: f32 = 1e-3;

/// Whether the model is right enough to compute with.
pub fn is_checkable(model: &RobotModel) -> bool {
    let good = |joint: &JointModel| {
        let limits = &joint.limits;
        let values = [limits.lower, limits.upper, limits.velocity, limits.torque, joint.servo.filter_time];
        values.iter().all(|value| value.is_finite())
            && limits.lower < limits.upper
            && limits.velocity > 0.0
            && limits.torque > 0.0
            && joint.servo.filter_time > 0.0
    };
    model.joints.iter().all(good)
}

/// What is not plausible in `folder`, whose `controller.toml` is `settings` and whose `plant.toml` is `plant`
/// if there is one. Also everything that is wrong in `plant.toml`. What follows from values that are wrong by
/// `known` is left out.
pub fn check(folder: &RobotFolder, settings: &str, plant: Option<&str>, known: &[Finding]) -> Vec<Finding> {
    let mut reports = Reports {
        urdf: Report::new(&folder.path.join("robot.urdf")),
        settings: Report::of_toml(&folder.path.join("controller.toml"), settings),
        plant: Report::of_toml(&folder.path.join("plant.toml"), plant.unwrap_or_default()),
        of_joints: OfJoints::default(),
        heaviest: links::heaviest(&folder.urdf),
        has_weights: !known.iter().any(|finding| {
            finding.is_error() && finding.message.starts_with("link ") && finding.message.contains("mass")
        }),
    };
    let path = folder.path.join("plant.toml");
    let mut start = None;
    if let Some(text) = plant {
        let (values, findings) = PlantValues::check(&path, text);
        reports.plant.findings = findings;
        if let Some(values) = values {
            against_plant(&folder.model, &values, known, &mut reports.plant);
            start = Some(values.posture);
        }
    }
    let model = &folder.model;
    for chains in CoupledChains::of_model(model) {
        of_chains(&chains, model, start.as_ref(), &mut reports);
    }
    for index in 0..model.chains.len() {
        tip_on_axis(model, index, &folder.urdf, &mut reports.urdf);
        tip_radius(model, index, &folder.urdf, &mut reports.urdf);
    }
    let mut wrong = Vec::new();
    // What uses a value that is wrong says nothing.
    let is_told = |value: &ImplausibleValue| {
        let key = format!("{} = ", value.key);
        let joint = value.joint.and_then(|joint| model.joints.get(joint)).map(|joint| joint.name.as_str());
        known.iter().filter(|finding| finding.is_error()).any(|finding| {
            let (before, found) =
                finding.message.split_once(&key).map_or(("", false), |(before, _)| (before, true));
            let mut names = before.split([' ', ',', ':']);
            found && joint.is_none_or(|joint| names.any(|name| name == joint))
        })
    };
    for value in implausible_values(model).into_iter().filter(|value| !is_told(value)) {
        wrong.push((value.joint, value.key));
        of_model(model, value, true, &mut reports);
    }
    // What is wrong has been told; the unit of a current may explain it.
    let (valid, mut doubtful) = (model.validate().is_ok(), doubtful_values(model));
    doubtful.retain(|value| {
        let follows = !valid && value.key != "motor.current_limit"
            || !reports.has_weights && value.key == "servo.inertia";
        !follows && !wrong.contains(&(value.joint, value.key))
    });
    for value in doubtful {
        of_model(model, value, false, &mut reports);
    }
    links::gyration(&folder.urdf, &mut reports.urdf);
    links::dense(&folder.urdf, &mut reports.urdf);
    if plant.is_some() {
        links::bodies(&folder.urdf, known, &mut reports.urdf);
    }
    let Reports { mut urdf, mut settings, mut plant, of_joints, .. } = reports;
    of_joints.report(&mut settings);
    urdf.sort();
    settings.sort();
    plant.sort();
    urdf.findings.into_iter().chain(settings.findings).chain(plant.findings).collect()
}

/// One report a file.
struct Reports {
    urdf: Report,
    settings: Report,
    plant: Report,
    /// What is said of joints in `controller.toml`.
    of_joints: OfJoints,
    /// The heaviest link with its line, in brackets; nothing without any mass.
    heaviest: String,
    /// Whether the masses are right enough to compute weights.
    has_weights: bool,
}

impl Reports {
    /// The line of a setting of a joint.
    fn line(&self, joint: &JointModel, key: &str) -> Option<usize> {
        self.settings
            .line_of(&format!("joints.{}.{key}", joint.name))
            .or_else(|| self.settings.line_of(&format!("joint.{key}")))
    }
}

/// A joint whose motor cannot bear its links everywhere.
#[derive(Clone, Debug, PartialEq)]
pub struct Overload {
    /// Its index.
    pub joint: usize,
    /// The largest gravity torque [N·m].
    pub gravity: f32,
    /// The torque that the motor has [N·m].
    pub torque: f32,
}

/// The joints of a valid model whose motors cannot bear their links everywhere.
pub fn overloaded(model: &RobotModel) -> Vec<Overload> {
    let mut found = Vec::new();
    for chains in CoupledChains::of_model(model) {
        let joints = chains.motors.iter().filter_map(|&motor| Some((motor, model.joints.get(motor)?)));
        let (motors, joints): (Vec<usize>, Vec<&JointModel>) = joints.unzip();
        let limits: Vec<(f32, f32)> =
            joints.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
        let loads = chains.joint_loads(&model.gravity, &limits);
        for ((&joint, model), JointLoad { gravity, .. }) in motors.iter().zip(joints).zip(loads) {
            let torque = model.torque_limit();
            if gravity > torque {
                found.push(Overload { joint, gravity, torque });
            }
        }
    }
    found
}

fn of_chains(
    chains: &CoupledChains,
    model: &RobotModel,
    start: Option<&BTreeMap<String, f64>>,
    reports: &mut Reports,
) {
    let gravity = &model.gravity;
    let joints: Vec<&JointModel> =
        chains.motors.iter().filter_map(|motor| model.joints.get(*motor)).collect();
    let limits: Vec<(f32, f32)> =
        joints.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
    let loads = chains.joint_loads(gravity, &limits);
    for (&joint, load) in joints.iter().zip(&loads) {
        motors::check(joint, &joints, load, reports);
    }
    let Some(posture) = start else { return };
    #[expect(clippy::cast_possible_truncation, reason = "the controller works in single precision")]
    let angle = |joint: &JointModel| posture.get(joint.name.as_str()).copied().unwrap_or(0.0) as f32;
    let angles: Vec<f32> = joints.iter().map(|joint| angle(joint)).collect();
    for ((&joint, &angle), torque) in joints.iter().zip(&angles).zip(chains.gravity_torques(gravity, &angles))
    {
        let own = reports.plant.line_of(&format!("posture.{}", joint.name));
        let line = own.or_else(|| reports.plant.line_of("posture"));
        let (lower, upper) = (joint.limits.lower, joint.limits.upper);
        if angle < lower || angle > upper {
            let named = if posture.contains_key(joint.name.as_str()) {
                ""
            } else {
                ", which it has because [posture] does not name it"
            };
            let message = format!(
                "joint {}: starts at {angle} rad{named}, outside its limits {lower} to {upper} rad",
                joint.name
            );
            let advice = format!(
                "for example {} = {:.3}",
                key(joint),
                angle.clamp(lower, upper).midpoint(0.5 * (lower + upper))
            );
            reports.plant.dynamics(line, message, advice);
        } else if reports.has_weights && torque.abs() > joint.torque_limit() {
            let message = format!(
                "joint {}: gravity needs {:.3} N·m in the start posture; the motor has {:.3} N·m",
                joint.name,
                torque.abs(),
                joint.torque_limit()
            );
            reports.plant.dynamics(
                line,
                message,
                "start in a posture that the motor can hold, or check gravity, masses and motor",
            );
        }
    }
}

/// The name of a joint as a key in TOML.
fn key(joint: &JointModel) -> String {
    let bare = joint.name.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c));
    if bare { joint.name.to_string() } else { format!("{:?}", joint.name.as_str()) }
}

/// A value of the model that is not plausible.
fn of_model(model: &RobotModel, value: ImplausibleValue, is_error: bool, reports: &mut Reports) {
    let ImplausibleValue { joint, key, message, advice } = value;
    let Some(joint) = joint.and_then(|joint| model.joints.get(joint)) else {
        let line = reports.settings.line_of(key);
        let report = if is_error { Report::dynamics } else { Report::warning };
        return report(&mut reports.settings, line, message, advice);
    };
    let line = reports.line(joint, key);
    let report = if is_error { OfJoints::error } else { OfJoints::warning };
    report(&mut reports.of_joints, &joint.name, line, message, advice);
}

/// A tip that its last joint turns and never moves: of a finger, whose origin was forgotten.
fn tip_on_axis(model: &RobotModel, index: usize, urdf: &Urdf, report: &mut Report) {
    let Some((chain, last)) = model.chains.get(index).zip(model.joints_of(index).last()) else { return };
    let (axis, name) = match last {
        ChainJoint::Driven(_, joint) => (joint.axis, joint.name.as_str()),
        // The model has no names of mimic joints.
        ChainJoint::Mimic(_) => return,
    };
    let (axis, tip) = (Vector3::from(axis), Vector3::from(chain.tip.translation));
    if model.joints_of(index).count() >= ARM_JOINTS || axis.cross(&tip).norm() > ON_AXIS {
        return;
    }
    let message = format!(
        "joint {name}: the tip {} lies on its axis: it turns the tip, and never moves it",
        chain.name
    );
    let advice =
        "the tip needs a link of its own: a fixed joint in the last link, with the fingertip's <origin>";
    report.warning(urdf.line_of_joint(name), message, advice);
}

/// A tip that is rounder than its link is long.
fn tip_radius(model: &RobotModel, index: usize, urdf: &Urdf, report: &mut Report) {
    let Some(chain) = model.chains.get(index) else { return };
    let last = Vector3::from(chain.tip.translation).norm();
    let (length, of) =
        if last > NO_LINK { (last, "the last link") } else { (chain_length(model, index), "its chain") };
    let radius = chain.tip_radius;
    if radius > length {
        let message = format!(
            "link {}: its <sphere> has a radius of {radius} m, {of} is {length:.3} m long: millimetres?",
            chain.name
        );
        let radius = f64::from(radius);
        let advice = format!("lengths are in m: {} mm are {}", four(radius), four(radius / 1000.0));
        report.warning(urdf.line_of_link(&chain.name), message, advice);
    }
}

/// The force sensors of controller and plant must be the same; values of `controller.toml` that are wrong are
/// told there.
fn sensors_fit(own: &ForceSensor, plant: &ForceSensorValues, report: &mut Report) {
    #[expect(clippy::cast_possible_truncation, reason = "the controller works in single precision")]
    let single = |value: f64| value as f32;
    for (key, of_controller, count, resolution, unit) in [
        ("force_sensor.force_count", "force_resolution", plant.force_count, own.force_resolution, "N"),
        ("force_sensor.torque_count", "torque_resolution", plant.torque_count, own.torque_resolution, "N·m"),
    ] {
        let difference = (single(count) - resolution).abs();
        if resolution > 0.0 && difference > SAME_COUNT * resolution {
            let message = format!(
                "{key} = {count} {unit}; force_sensor.{of_controller} of controller.toml is {resolution} {unit}"
            );
            let advice = "the controller would measure other forces than there are: give both the same value";
            report.dynamics(report.line_of(key), message, advice);
        }
    }
    if own.force_limit > 0.0 && single(plant.force_range) < own.force_limit {
        let message = format!(
            "force_sensor.force_range = {} N is below force_sensor.force_limit of controller.toml, {} N: the limit is \
             never reached",
            plant.force_range, own.force_limit
        );
        let advice = format!("{} N or more, or lower force_limit", own.force_limit);
        report.dynamics(report.line_of("force_sensor.force_range"), message, advice);
    }
}

/// Controller and plant must fit.
fn against_plant(model: &RobotModel, plant: &PlantValues, known: &[Finding], report: &mut Report) {
    // A joint that is wrong is not in the model.
    let is_told = |name: &str| known.iter().any(|finding| finding.is_error() && finding.is_about_joint(name));
    let sections = [("posture", &plant.posture), ("elasticity", &plant.elasticity)];
    let named =
        sections.into_iter().flat_map(|(section, values)| values.keys().map(move |name| (section, name)));
    for (section, name) in named.filter(|(_, name)| !is_told(name)) {
        if !model.joints.iter().any(|joint| joint.name == name.as_str()) {
            let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
            let message = format!("[{section}]: the URDF has no joint {name}");
            let advice = format!("correct or remove it; the moving joints are {}", names.join(", "));
            report.dynamics(report.line_of(&format!("{section}.{name}")), message, advice);
        }
    }
    let time = |joint: &JointModel| f64::from(joint.motor.rotor_inertia / joint.friction.viscous.max(1e-9));
    let joints = model.joints.iter().filter(|joint| joint.motor.rotor_inertia >= 0.0);
    let fastest = joints.min_by(|one, other| time(one).total_cmp(&time(other)));
    if let Some(joint) = fastest.filter(|joint| plant.integration.step > time(joint)) {
        let message = format!(
            "integration.step = {} s is too long for joint {}: its rotor ({:.1e} kg·m²) comes to rest by viscous \
             friction ({} N·m·s/rad) within {:.1e} s",
            plant.integration.step,
            joint.name,
            joint.motor.rotor_inertia,
            joint.friction.viscous,
            time(joint)
        );
        let advice = "check friction and motor.rotor_inertia; else give a step of a quarter of this time";
        report.dynamics(report.line_of("integration.step"), message, advice);
    }
    let bandwidth = plant.inner_loop.bandwidth;
    let fits = |joint: &JointModel| {
        let own = f64::from(joint.motor.bandwidth);
        (own / OTHER_BANDWIDTH..=own * OTHER_BANDWIDTH).contains(&bandwidth)
    };
    if !model.joints.is_empty() && !model.joints.iter().any(fits) {
        let message = format!(
            "inner_loop.bandwidth = {bandwidth} Hz; no joint of controller.toml has a motor.bandwidth like that, the first \
             {} Hz",
            model.joints.first().map_or(0.0, |joint| joint.motor.bandwidth)
        );
        report.warning(
            report.line_of("inner_loop.bandwidth"),
            message,
            "the controller would take the drives for faster or slower than they are: correct one of them",
        );
    }
    let (voltage, safety) = (plant.supply.voltage, &model.safety);
    if voltage < f64::from(safety.supply_min) || voltage > f64::from(safety.supply_max) {
        let message = format!(
            "supply.voltage = {voltage} V, outside safety.supply_min and supply_max of controller.toml, {} to {} V",
            safety.supply_min, safety.supply_max
        );
        report.dynamics(
            report.line_of("supply.voltage"),
            message,
            "it would be a fault at once: correct one of them",
        );
    }
    let sensors = model.chains.iter().any(|chain| chain.force_sensor.is_some());
    if sensors != plant.force_sensor.is_some() {
        let (has, lacks) =
            if sensors { ("controller.toml", "plant.toml") } else { ("plant.toml", "controller.toml") };
        let message = format!("{has} has [force_sensor], {lacks} has none");
        report.dynamics(report.line_of("force_sensor"), message, "give both or none");
    }
    let own = model.chains.iter().find_map(|chain| chain.force_sensor.as_ref());
    if let Some((own, plant)) = own.zip(plant.force_sensor.as_ref()) {
        sensors_fit(own, plant, report);
    }
    let gravity = Vector3::from(model.gravity.map(f64::from));
    let difference = (gravity - Vector3::from(plant.gravity)).norm();
    if difference > 0.1 {
        let message = format!("gravity = {:?} m/s²; controller.toml has {:?}", plant.gravity, model.gravity);
        report.warning(
            report.line_of("gravity"),
            message,
            "the controller would compensate the wrong weight",
        );
    }
}
