//! What a robot folder can hold, but no machine is likely to have.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use tesaki::kinematics::Chain;
use tesaki::model::{ChainJoint, JointModel, Motor, RobotModel};

use super::RobotFolder;
use super::limits::{ImplausibleLimit, at_least, implausible_limits};
use crate::finding::{Finding, Report};
use crate::load::{CoupledChains, JointLoad};
use crate::plant::PlantValues;
use crate::urdf::{RigidBody, Urdf, four};

/// The shortest time in which a full torque can bring a bare rotor to the velocity limit [s]. The mechanical
/// time constants of servo motors are 2 to 50 ms; a velocity limit may be a tenth of what the motor reaches.
const FASTEST_ROTOR: f32 = 2e-4;
/// Factor between the torque of the largest current and the torque limit from which one of them has another
/// unit: mA, mN·m/A and N·mm are all off by 1000.
const OTHER_UNIT: f32 = 3.0;
/// Distance of a tip from the axis of its last joint below which the joint does not move it [m].
const ON_AXIS: f32 = 1e-4;
/// Joints of an arm, whose last one turns the tool about its own axis.
const ARM_JOINTS: usize = 6;
/// Coulomb friction above this fraction of the motor's torque is suspicious.
const MUCH_FRICTION: f32 = 0.5;
/// Distance from its target at which the position loop would overcome Coulomb friction [rad]: above this, the
/// joint hunts about its target for seconds.
const MUCH_STICKING: f32 = 0.5;
/// A radius of gyration above this multiple of the link's size is suspicious.
const WIDE: f64 = 3.0;
/// Density of lead [kg/m³].
const LEAD: f64 = 11_340.0;
/// Masses above this one may be meant in grams [kg].
const HEAVY: f64 = 1.0;
/// Sizes of links below this one are not trusted [m].
const SMALL_LINK: f64 = 0.05;
/// Velocity of the trajectory filter after a step, per step and filter time: 1/e.
const FILTER_PEAK: f32 = 0.367_879;

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
        of_joints: Vec::new(),
        heaviest: heaviest(&folder.urdf),
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
    for chains in groups(model) {
        of_chains(&chains, model, start.as_ref(), &mut reports);
    }
    for index in 0..model.chains.len() {
        tip_on_axis(model, index, &folder.urdf, &mut reports.urdf);
    }
    for limit in implausible_limits(&folder.model) {
        of_limit(&folder.model, limit, &mut reports);
    }
    links(&folder.urdf, &mut reports.urdf);
    dense(&folder.urdf, &mut reports.urdf);
    if plant.is_some() {
        bodies(&folder.urdf, known, &mut reports.urdf);
    }
    reports.report_joints();
    let Reports { mut urdf, mut settings, mut plant, .. } = reports;
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
    /// What is said of joints in `controller.toml`, with the names of those of which the same is said.
    of_joints: Vec<(JointFinding, Vec<String>)>,
    /// The heaviest link with its line, in brackets; nothing without any mass.
    heaviest: String,
    /// Whether the masses are right enough to compute weights.
    has_weights: bool,
}

/// Something that is said of a joint.
#[derive(PartialEq, Eq)]
struct JointFinding {
    is_error: bool,
    line: Option<usize>,
    message: String,
    advice: String,
}

impl Reports {
    /// Something about a joint that does not work.
    fn error(&mut self, joint: &JointModel, line: Option<usize>, message: String, advice: impl Into<String>) {
        self.add(joint, JointFinding { is_error: true, line, message, advice: advice.into() });
    }

    /// Something about a joint that deserves attention.
    fn warning(
        &mut self,
        joint: &JointModel,
        line: Option<usize>,
        message: String,
        advice: impl Into<String>,
    ) {
        self.add(joint, JointFinding { is_error: false, line, message, advice: advice.into() });
    }

    fn add(&mut self, joint: &JointModel, finding: JointFinding) {
        let name = joint.name.to_string();
        match self.of_joints.iter_mut().find(|(known, _)| *known == finding) {
            Some((_, names)) => names.push(name),
            None => self.of_joints.push((finding, vec![name])),
        }
    }

    /// Each finding once, with all joints of which it is true.
    fn report_joints(&mut self) {
        for (JointFinding { is_error, line, message, advice }, names) in std::mem::take(&mut self.of_joints) {
            let plural = if names.len() > 1 { "s" } else { "" };
            let message = format!("joint{plural} {}: {message}", names.join(", "));
            if is_error {
                self.settings.dynamics(line, message, advice);
            } else {
                self.settings.warning(line, message, advice);
            }
        }
    }

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
    for chains in groups(model) {
        let joints = chains.motors.iter().filter_map(|&motor| Some((motor, model.joints.get(motor)?)));
        let (motors, joints): (Vec<usize>, Vec<&JointModel>) = joints.unzip();
        let limits: Vec<(f32, f32)> =
            joints.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
        let loads = chains.joint_loads(&model.gravity, &limits);
        for ((&joint, model), JointLoad { gravity, .. }) in motors.iter().zip(joints).zip(loads) {
            let torque = torque_limit(model);
            if gravity > torque {
                found.push(Overload { joint, gravity, torque });
            }
        }
    }
    found
}

/// The chains of a model in groups that do not depend on each other.
fn groups(model: &RobotModel) -> Vec<CoupledChains> {
    let couplings = |index| model.joints_of(index).map(ChainJoint::coupling).collect();
    CoupledChains::groups(
        (0..model.chains.len()).map(|index| (Chain::of_model(model, index), couplings(index))),
    )
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
        rotor(joint, reports);
        units(joint, reports);
        motor(joint, &joints, load, reports);
        speed(joint, reports);
        sticking(joint, reports);
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
        } else if reports.has_weights && torque.abs() > torque_limit(joint) {
            let message = format!(
                "joint {}: gravity needs {:.3} N·m in the start posture; the motor has {:.3} N·m",
                joint.name,
                torque.abs(),
                torque_limit(joint)
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

fn torque_limit(joint: &JointModel) -> f32 {
    joint.limits.torque.min(joint.motor.current_limit * joint.motor.torque_constant)
}

/// A limit that protects nothing, or is a fault at once.
fn of_limit(model: &RobotModel, limit: ImplausibleLimit, reports: &mut Reports) {
    let ImplausibleLimit { joint, key, message, advice } = limit;
    match joint.and_then(|joint| model.joints.get(joint)) {
        Some(joint) => reports.error(joint, reports.line(joint, key), message, advice),
        None => reports.settings.dynamics(reports.settings.line_of(key), message, advice),
    }
}

/// A rotor that accelerates faster than any.
fn rotor(joint: &JointModel, reports: &mut Reports) {
    let (inertia, torque) = (joint.motor.rotor_inertia, torque_limit(joint));
    let least = torque * FASTEST_ROTOR / joint.limits.velocity;
    let line = reports.line(joint, "motor.rotor_inertia");
    if inertia < 0.0 {
        // Told already.
        return;
    }
    if inertia <= 0.0 {
        let message = "motor.rotor_inertia = 0: every motor has a rotor".to_owned();
        let advice = "that of the motor's data sheet times the square of the gear ratio [kg·m²]";
        reports.error(joint, line, message, advice);
    } else if inertia < least {
        let message = format!(
            "motor.rotor_inertia = {inertia:e} kg·m²: {torque} N·m would bring the rotor to {} rad/s in \
             {:.3} ms; no motor takes less than 0.2 ms",
            joint.limits.velocity,
            1e3 * inertia * joint.limits.velocity / torque
        );
        let advice =
            format!("at least {least:.1e}: multiply that of the data sheet by the square of the gear ratio");
        reports.warning(joint, line, message, advice);
    }
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
    let advice = "give the fixed joint of the tip the <origin> of the fingertip in the last link";
    report.warning(urdf.line_of_joint(name), message, advice);
}

/// A motor whose largest current makes quite another torque than the limit.
fn units(joint: &JointModel, reports: &mut Reports) {
    let Motor { current_limit, torque_constant, .. } = joint.motor;
    let (torque, limit) = (current_limit * torque_constant, joint.limits.torque);
    if torque <= 0.0 || (limit / OTHER_UNIT..=limit * OTHER_UNIT).contains(&torque) {
        return;
    }
    let message = format!(
        "motor.current_limit {current_limit} A times motor.torque_constant {torque_constant} N·m/A is \
         {torque:.4} N·m; the torque limit is {limit} N·m"
    );
    let advice = "check the units: A, N·m/A at the joint (through the gear), N·m in effort of the URDF or in \
        limits.torque";
    reports.warning(joint, reports.line(joint, "motor.current_limit"), message, advice);
}

/// A motor too weak for friction and gravity.
fn motor(joint: &JointModel, joints: &[&JointModel], load: &JointLoad, reports: &mut Reports) {
    let (torque, coulomb) = (torque_limit(joint), joint.friction.coulomb);
    let viscous = joint.friction.viscous * joint.limits.velocity;
    let own = reports
        .settings
        .line_of(&format!("joints.{}.friction", joint.name))
        .or_else(|| reports.settings.line_of("joint.friction"));
    let hint = "give the true friction in [joints.NAME.friction], or check torque_constant, current_limit and \
        effort";
    let line = own.or_else(|| reports.line(joint, "motor.current_limit"));
    if coulomb >= torque {
        let message = format!(
            "Coulomb friction {coulomb} N·m is not below the motor's torque {torque:.3} N·m: it cannot move",
        );
        reports.error(joint, line, message, hint);
    } else if coulomb > MUCH_FRICTION * torque {
        let message = format!(
            "Coulomb friction {coulomb} N·m takes {:.0} % of the motor's torque {torque:.3} N·m",
            100.0 * coulomb / torque
        );
        reports.warning(joint, line, message, hint);
    }
    if viscous > torque {
        let message = format!(
            "viscous friction takes {viscous:.3} N·m at the velocity limit of {} rad/s; the motor has \
             {torque:.3} N·m",
            joint.limits.velocity
        );
        reports.warning(joint, line, message, hint);
    }
    if !reports.has_weights {
        return;
    }
    let line = reports.line(joint, "motor.current_limit");
    if load.gravity > torque {
        let angles: Vec<String> = joints
            .iter()
            .zip(&load.posture)
            .map(|(joint, angle)| format!("{}={angle:.2}", joint.name))
            .collect();
        let message = format!(
            "gravity needs up to {:.3} N·m, at {}; the motor has {torque:.3} N·m",
            load.gravity,
            angles.join(" ")
        );
        let advice = format!(
            "check masses{}, gravity, torque_constant and current_limit; or narrow the limits of the joints",
            reports.heaviest
        );
        reports.error(joint, line, message, advice);
    } else if load.gravity + coulomb > torque {
        let message = format!(
            "gravity ({:.3} N·m) and friction ({coulomb} N·m) need more than the motor's {torque:.3} N·m: \
             it cannot lift everywhere",
            load.gravity
        );
        reports.warning(joint, line, message, "check masses, friction, torque_constant and current_limit");
    }
}

/// A trajectory filter that is faster than the joint.
fn speed(joint: &JointModel, reports: &mut Reports) {
    let half = 0.5 * (joint.limits.upper - joint.limits.lower);
    let peak = FILTER_PEAK * half / joint.servo.filter_time;
    if peak > joint.limits.velocity {
        let line = reports.line(joint, "servo.filter_time");
        let message = format!(
            "a move over half of its range reaches {peak:.2} rad/s, above its limit of {} rad/s: a fault",
            joint.limits.velocity
        );
        let least = FILTER_PEAK * half / joint.limits.velocity;
        let advice = format!("servo.filter_time = {} or more", at_least(least));
        reports.warning(joint, line, message, advice);
    }
}

/// A position loop that friction overcomes.
fn sticking(joint: &JointModel, reports: &mut Reports) {
    let gains = &joint.servo.observer;
    let distance = joint.friction.coulomb / (gains.inertia * gains.bandwidth * gains.bandwidth);
    if distance > MUCH_STICKING && joint.friction.coulomb < torque_limit(joint) {
        let message = format!(
            "Coulomb friction {} N·m is much for a servo of {:.3} N·m/rad ({:.1e} kg·m², {} rad/s): it \
             stops short and hunts about its target for seconds",
            joint.friction.coulomb,
            joint.friction.coulomb / distance,
            gains.inertia,
            gains.bandwidth
        );
        let advice =
            "check friction and motor.rotor_inertia (through the gear); else raise servo.observer.bandwidth";
        reports.warning(joint, reports.line(joint, "servo.observer.bandwidth"), message, advice);
    }
}

/// Controller and plant must fit.
fn against_plant(model: &RobotModel, plant: &PlantValues, known: &[Finding], report: &mut Report) {
    // A joint that is wrong is not in the model.
    let is_told = |name: &str| known.iter().any(|finding| finding.is_error() && finding.is_about_joint(name));
    for name in plant.posture.keys().filter(|name| !is_told(name)) {
        if !model.joints.iter().any(|joint| joint.name == name.as_str()) {
            let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
            let message = format!("[posture]: the URDF has no joint {name}");
            let advice = format!("correct or remove it; the moving joints are {}", names.join(", "));
            report.dynamics(report.line_of(&format!("posture.{name}")), message, advice);
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

/// Links that would be denser than lead: of a mass, a ball of lead has the least moment of inertia.
fn dense(urdf: &Urdf, report: &mut Report) {
    for link in urdf.robot.links.iter().filter(|link| link.name != urdf.base()) {
        let (i, mass) = (&link.inertial.inertia, link.inertial.mass.value);
        let largest = i.ixx.max(i.iyy).max(i.izz);
        let radius = libm::cbrt(mass / (4.0 / 3.0 * core::f64::consts::PI * LEAD));
        // No moment at all is a finding of its own.
        if mass >= HEAVY && largest > 0.0 && largest < 0.4 * mass * radius * radius {
            let message = format!(
                "link {}: {mass} kg with an inertia of at most {largest:.1e} kg·m² is denser than lead: grams?",
                link.name
            );
            let advice = format!("masses are in kg: {mass} g are {}", four(mass / 1000.0));
            report.warning(urdf.line_of_link(&link.name), message, advice);
        }
    }
}

/// Links whose mass would lie far outside of them.
fn links(urdf: &Urdf, report: &mut Report) {
    for joint in &urdf.robot.joints {
        let Some(link) = urdf.robot.links.iter().find(|link| link.name == joint.child.link) else { continue };
        let i = &link.inertial.inertia;
        let mass = link.inertial.mass.value;
        if mass <= 0.0 || joint.joint_type == urdf_rs::JointType::Fixed {
            continue;
        }
        let largest = i.ixx.max(i.iyy).max(i.izz);
        let radius = libm::sqrt(largest.max(0.0) / mass);
        let size = size(urdf, link).max(SMALL_LINK);
        if radius > WIDE * size {
            let message = format!(
                "link {}: an inertia of {largest:.1e} kg·m² for {mass} kg is a radius of gyration of {radius:.3} m; \
                 the link is about {size:.3} m long: a placeholder?",
                link.name
            );
            report.warning(
                urdf.line_of_link(&link.name),
                message,
                "compute it by the CAD program, or from the link's shape",
            );
        }
    }
}

/// The link of the largest mass that a joint moves, and its line.
fn heaviest(urdf: &Urdf) -> String {
    let moved = urdf.robot.links.iter().filter(|link| link.name != urdf.base());
    let heaviest = moved.max_by(|a, b| a.inertial.mass.value.total_cmp(&b.inertial.mass.value));
    let Some(link) = heaviest.filter(|link| link.inertial.mass.value > 0.0) else { return String::new() };
    let line = urdf.line_of_link(&link.name).map_or_else(String::new, |line| format!(", robot.urdf:{line}"));
    format!(" (the heaviest link is {} with {} kg{line})", link.name, link.inertial.mass.value)
}

/// Bodies that cannot be simulated, without those of whose links something is wrong.
fn bodies(urdf: &Urdf, known: &[Finding], report: &mut Report) {
    let is_wrong = |link: &str| known.iter().any(|known| known.is_error() && known.is_about_link(link));
    for (joint, link) in urdf.bodies_without_inertia() {
        if RigidBody::new(&urdf.robot, &link).links.iter().any(|(link, _)| is_wrong(&link.name)) {
            continue;
        }
        let message =
            format!("link {link}, moved by joint {joint}: without mass or inertia it cannot be simulated");
        let advice = "give it an <inertial>; or accept a gram: its name in accept_inertia of controller.toml \
            (`tesaki model init --accept-inertia`)";
        report.dynamics(urdf.line_of_link(&link), message, advice);
    }
}

/// About the size of a link [m]: the distance of what is joined to it, or of its centre of mass.
fn size(urdf: &Urdf, link: &urdf_rs::Link) -> f64 {
    let body = RigidBody::new(&urdf.robot, &link.name);
    let norm = |pose: &urdf_rs::Pose| Vector3::from(pose.xyz.0).norm();
    let links =
        body.links.iter().map(|(link, place)| place.translation.vector.norm() + norm(&link.inertial.origin));
    let joints =
        body.joints.iter().map(|(joint, place)| place.translation.vector.norm() + norm(&joint.origin));
    let shapes = link.collision.iter().map(|shape| extent(&shape.geometry) + norm(&shape.origin));
    links.chain(joints).chain(shapes).fold(0.0, f64::max)
}

/// Half of the largest extent of a shape [m]; 0 for a mesh.
fn extent(geometry: &urdf_rs::Geometry) -> f64 {
    match geometry {
        urdf_rs::Geometry::Box { size } => 0.5 * Vector3::from(size.0).norm(),
        urdf_rs::Geometry::Cylinder { radius, length } | urdf_rs::Geometry::Capsule { radius, length } => {
            0.5 * length + radius
        }
        urdf_rs::Geometry::Sphere { radius } => *radius,
        urdf_rs::Geometry::Mesh { .. } => 0.0,
    }
}
