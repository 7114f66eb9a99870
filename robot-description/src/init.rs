//! A robot folder for a URDF: settings from the URDF, from the values of a motor, and computed from both.

mod coupling;
mod motor;
mod servo;
mod write;

use std::path::Path;

use tesaki::kinematics::Chain;
use tesaki::model::Coupling;

pub use motor::{GENERIC, MotorPreset, PRESETS};

use crate::finding::{Finding, Report};
use crate::load::CoupledChains;
use crate::robot::tree::{SerialChain, SerialJoint, SerialMimic, serial_chains};
use crate::urdf::{self, Urdf};
use motor::{EFFORT_OVER_GRAVITY, LARGEST_EFFORT};
use servo::JointPlan;

/// Gravity of an upright base [m/s²].
const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
/// Of the gravity torque that a motor has where the URDF gives no effort: friction and dynamics need as much
/// again, and some more.
const GRAVITY_FACTOR: f32 = 2.5;
/// The least torque of such a motor [N·m].
const LEAST_TORQUE: f32 = 0.2;
/// Stands for every link whose inertia no body can have.
const ALL: &str = "all";

/// What the URDF does not say.
#[derive(Clone, Debug, Default)]
pub struct InitOptions {
    /// Names of motors, of one joint or of all others.
    pub motors: Vec<MotorChoice>,
    /// Links whose inertia is replaced by the nearest that a body can have; `all` for all that need it.
    pub accept_inertia: Vec<String>,
}

/// The motor of a joint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MotorChoice {
    /// The joint; `None` for every joint without a choice of its own.
    pub joint: Option<String>,
    /// Name of the preset.
    pub motor: String,
}

/// The texts of a robot folder.
#[derive(Clone, Debug)]
pub struct RobotTexts {
    /// Name of the robot.
    pub name: String,
    /// `robot.urdf`.
    pub urdf: String,
    /// `controller.toml`.
    pub controller: String,
    /// `plant.toml`.
    pub plant: String,
    /// The motor of each joint, and why it was chosen.
    pub joints: Vec<JointMotor>,
    /// What was corrected.
    pub notes: Vec<String>,
}

/// The motor of a joint.
#[derive(Clone, Debug, PartialEq)]
pub struct JointMotor {
    /// The joint.
    pub joint: String,
    /// Name of the motor.
    pub motor: &'static str,
    /// Torque limit [N·m].
    pub torque: f32,
    /// Why this motor.
    pub reason: String,
}

/// Why no folder can be written.
#[derive(Debug, thiserror::Error)]
pub enum InitError {
    /// What is wrong in the URDF: every error that can be found.
    #[error("{}", urdf::list(.0))]
    Wrong(Vec<Finding>),
    /// There is no such motor.
    #[error("--motor: there is no motor {choice:?}; the motors are {}", MotorPreset::names().join(", "))]
    Motor {
        /// The name.
        choice: String,
    },
    /// There is no such joint.
    #[error("--motor {joint}=…: the URDF has no moving joint {joint:?}; its joints are {joints}")]
    Joint {
        /// The name.
        joint: String,
        /// The joints.
        joints: String,
    },
    /// There is no such link.
    #[error("--accept-inertia {0}: the URDF has no such link; `all` accepts every one that needs it")]
    Link(String),
}

/// Makes the texts of a robot folder for `text`, the content of the URDF `path`.
///
/// # Errors
/// What is wrong in the URDF, or with the options.
pub fn robot_texts(path: &Path, text: &str, options: &InitOptions) -> Result<RobotTexts, InitError> {
    let accepted = accepted(path, text, options)?;
    let mut report = Report::new(path);
    let (urdf, findings) = Urdf::check_accepting(path, text, &accepted);
    report.findings = findings;
    let chains = urdf.as_ref().map(|urdf| serial_chains(urdf, &mut report));
    report.sort();
    report.findings.retain(Finding::is_error);
    let (Some(urdf), Some(chains)) = (urdf, chains.filter(|_| report.findings.is_empty())) else {
        return Err(InitError::Wrong(report.findings));
    };
    check_joints(options, &chains)?;
    let joints = plan(&chains, options)?;
    Ok(write::texts(path, text, &urdf, &accepted, &joints))
}

/// The links whose inertia is accepted, without repetition.
fn accepted(path: &Path, text: &str, options: &InitOptions) -> Result<Vec<String>, InitError> {
    let mut accepted = Vec::new();
    for name in &options.accept_inertia {
        if name == ALL {
            accepted.extend(Urdf::impossible_inertias(path, text));
        } else {
            accepted.push(name.clone());
        }
    }
    if let (Some(urdf), _) = Urdf::check(path, text)
        && let Some(stranger) = accepted.iter().find(|name| !urdf.has_link(name))
    {
        return Err(InitError::Link(stranger.clone()));
    }
    accepted.sort();
    accepted.dedup();
    Ok(accepted)
}

/// Every joint that is named exists.
fn check_joints(options: &InitOptions, chains: &[SerialChain]) -> Result<(), InitError> {
    let names: Vec<&str> =
        chains.iter().flat_map(|chain| &chain.joints).map(|joint| joint.name.as_str()).collect();
    for joint in options.motors.iter().filter_map(|choice| choice.joint.as_ref()) {
        if !names.contains(&joint.as_str()) {
            return Err(InitError::Joint { joint: joint.clone(), joints: names.join(", ") });
        }
    }
    Ok(())
}

/// Plans the joints of all chains, in their order.
fn plan(chains: &[SerialChain], options: &InitOptions) -> Result<Vec<JointPlan>, InitError> {
    let joints: Vec<&SerialJoint> = chains.iter().flat_map(|chain| &chain.joints).collect();
    let mut plans = Vec::new();
    for mut group in CoupledChains::groups(chains.iter().filter_map(|chain| coupled(chain, &joints))) {
        let own: Vec<&SerialJoint> =
            group.motors.iter().filter_map(|motor| joints.get(*motor)).copied().collect();
        let limits: Vec<(f32, f32)> =
            own.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
        let loads = group.joint_loads(&GRAVITY, &limits);
        let heaviest = loads.iter().map(|load| load.gravity).fold(0.0, f32::max);
        let largest_effort = LARGEST_EFFORT.max(EFFORT_OVER_GRAVITY * heaviest);
        let motors =
            own.iter().zip(&loads).map(|(joint, load)| choose_motor(joint, load, largest_effort, options));
        let motors = motors.collect::<Result<Vec<_>, _>>()?;
        group.rotors = motors.iter().map(|(motor, _)| motor.rotor_inertia).collect();
        let inertias = group.joint_inertias(&limits);
        let plan = |index: usize, below: f32| {
            let (joint, load, inertia, motor) = (own[index], &loads[index], inertias[index], &motors[index]);
            JointPlan::new(joint, load.clone(), inertia, motor.clone(), below)
        };
        let mut of_group: Vec<JointPlan> = (0..own.len()).map(|index| plan(index, f32::INFINITY)).collect();
        coupling::slow_down(&group, &limits, &mut of_group, |index, old| {
            let slower = plan(index, old.bandwidth);
            (slower.bandwidth < old.bandwidth).then_some(slower)
        });
        plans.extend(group.motors.iter().copied().zip(of_group));
    }
    plans.sort_by_key(|(joint, _)| *joint);
    Ok(plans.into_iter().map(|(_, plan)| plan).collect())
}

/// A chain, and what moves each of its joints, of which those with a motor are `joints`. `None` where a mimic
/// joint follows none of these, which has been reported.
fn coupled(chain: &SerialChain, joints: &[&SerialJoint]) -> Option<(Chain, Vec<Coupling>)> {
    let all = chain.all();
    let links = all.iter().map(|(joint, _)| (&joint.origin, &joint.axis, &joint.link));
    let coupling = |(joint, mimic): &(&SerialJoint, Option<&SerialMimic>)| {
        let (name, multiplier, offset) =
            mimic.map_or((&joint.name, 1.0, 0.0), |mimic| (&mimic.follows, mimic.multiplier, mimic.offset));
        let actuated = joints.iter().position(|joint| joint.name == *name)?;
        Some(Coupling { actuated: u8::try_from(actuated).ok()?, multiplier, offset })
    };
    let couplings = all.iter().map(coupling).collect::<Option<_>>()?;
    // Chains with more joints than are supported have been reported, too.
    Some((Chain::from_links(links, &chain.pose).ok()?, couplings))
}

/// The motor of a joint, and why. The URDF's effort is believed up to `largest_effort` [N·m].
fn choose_motor(
    joint: &SerialJoint,
    load: &crate::load::JointLoad,
    largest_effort: f32,
    options: &InitOptions,
) -> Result<(MotorPreset, String), InitError> {
    let own = options.motors.iter().rev().find(|choice| choice.joint.as_ref() == Some(&joint.name));
    let common = options.motors.iter().rev().find(|choice| choice.joint.is_none());
    let effort = joint.limits.torque;
    let speed = if joint.limits.velocity > 0.0 { joint.limits.velocity.min(40.0) } else { 6.0 };
    let needed = (GRAVITY_FACTOR * load.gravity).max(LEAST_TORQUE);
    let believed = effort > 0.0 && effort <= largest_effort;
    let torque = if believed { effort } else { needed };
    match own.or(common).map(|choice| choice.motor.as_str()) {
        Some(GENERIC) => Ok((MotorPreset::generic(torque, speed), "as chosen".to_owned())),
        Some(name) => match MotorPreset::find(name) {
            Some(preset) => Ok((preset.clone(), "as chosen".to_owned())),
            None => Err(InitError::Motor { choice: name.to_owned() }),
        },
        None => {
            let motor = MotorPreset::for_torque(torque, speed);
            let reason = if believed {
                format!("for the URDF's effort of {effort} N·m")
            } else {
                let why = if torque > LEAST_TORQUE {
                    format!("{GRAVITY_FACTOR} times the gravity torque")
                } else {
                    "the least".to_owned()
                };
                let effort = if effort > largest_effort {
                    format!("the URDF's effort, {effort} N·m, is not believed, it may be in mN·m")
                } else {
                    "the URDF has no effort".to_owned()
                };
                format!("for {torque:.2} N·m, {why}: {effort}")
            };
            Ok((motor, reason))
        }
    }
}
