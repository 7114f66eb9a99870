//! The controller's model of a robot's two files.

use tesaki::kinematics::Chain;
use tesaki::model::{
    ChainModel, Field, ForceSensor, Friction, JointModel, MimicJoint, ModelError, ObserverGains, PidGains,
    Pose, RobotModel, ServoGains,
};

use super::settings::{JointSettings, Settings};
use super::tree::{SerialChain, SerialJoint, SerialMimic};
use crate::finding::{Finding, Report};
use crate::line::line_of;
use crate::urdf::Urdf;

/// The model, not validated; `None` when something does not fit, which has been reported.
pub fn model(urdf: &Urdf, chains: &[SerialChain], settings: &Settings) -> Option<RobotModel> {
    let mut model = RobotModel {
        name: urdf.robot.name.as_str().try_into().ok()?,
        gravity: settings.gravity,
        chains: heapless::Vec::new(),
        joints: heapless::Vec::new(),
        safety: settings.safety,
    };
    for chain in chains {
        let tip = ChainModel {
            name: chain.tip.as_str().try_into().ok()?,
            joints: u8::try_from(chain.joints.len()).ok()?,
            tip: chain.pose,
            tip_radius: chain.radius,
            force_sensor: settings.force_sensor.as_ref().map(|sensor| ForceSensor {
                force_resolution: sensor.force_resolution,
                torque_resolution: sensor.torque_resolution,
                saturation: sensor.saturation,
                force_limit: sensor.force_limit,
                mass: chain.mass,
                center_of_mass: chain.center_of_mass,
            }),
            mimic: match &chain.mimic {
                Some(mimic) => Some(mimic_joint(mimic, chains)?),
                None => None,
            },
        };
        model.chains.push(tip).ok()?;
        let first = model.joints.len();
        for joint in &chain.joints {
            let own = settings.joints.get(&joint.name)?;
            model.joints.push(joint_model(joint, own)?).ok()?;
        }
        complete_gains(&mut model.joints[first..], &chain.pose, settings);
    }
    add_mimics(&mut model, chains, settings);
    Some(model)
}

fn mimic_joint(mimic: &SerialMimic, chains: &[SerialChain]) -> Option<MimicJoint> {
    let mut joints = chains.iter().flat_map(|chain| &chain.joints);
    let SerialJoint { origin, axis, link, .. } = mimic.joint;
    Some(MimicJoint {
        joint: u8::try_from(joints.position(|joint| joint.name == mimic.follows)?).ok()?,
        multiplier: mimic.multiplier,
        offset: mimic.offset,
        origin,
        axis,
        link,
    })
}

/// Adds the friction and the inertia of mimic joints to the joints that drive them.
fn add_mimics(model: &mut RobotModel, chains: &[SerialChain], settings: &Settings) {
    let chain_models = model.chains.clone();
    let ranges: Vec<_> = model.chain_ranges().collect();
    for ((serial, chain), range) in chains.iter().zip(&chain_models).zip(ranges) {
        let (Some(of), Some(mimic)) = (&serial.mimic, &chain.mimic) else { continue };
        let joints = &model.joints[range];
        let shape = Chain::of_model(chain, joints);
        let limits = |joint: &JointModel| 0.5 * (joint.limits.lower + joint.limits.upper);
        let middle: Vec<f32> = std::iter::once(0.0).chain(joints.iter().map(limits)).collect();
        let (rest, mut torques) = (vec![0.0; middle.len()], vec![0.0; middle.len()]);
        let mut acceleration = rest.clone();
        acceleration[0] = 1.0;
        shape.inverse_dynamics(&nalgebra::Vector3::zeros(), &middle, &rest, &acceleration, &mut torques);
        let Some(driving) = model.joints.get_mut(usize::from(mimic.joint)) else { continue };
        let ratio = mimic.multiplier;
        driving.friction.coulomb += ratio.abs() * of.joint.friction.coulomb;
        driving.friction.viscous += ratio * ratio * of.joint.friction.viscous;
        let own = settings.joints.get(driving.name.as_str()).and_then(|own| own.servo.inertia);
        let before = driving.servo.observer.inertia;
        if own.is_none() && before > 0.0 {
            let inertia = before + ratio * ratio * torques[0];
            let PidGains { proportional, integral, derivative, .. } = &mut driving.servo.pid;
            for gain in [proportional, integral, derivative] {
                *gain *= inertia / before;
            }
            driving.servo.observer.inertia = inertia;
        }
    }
}

/// Reports what is wrong with the values, joint by joint: one finding each.
pub fn validate(model: &RobotModel, urdf: &Urdf, text: &str, of_urdf: &mut Report, of_settings: &mut Report) {
    // What is wrong with the URDF's own values has been told by line.
    let told = of_urdf.findings.iter().any(Finding::is_error);
    let mut found: Vec<(Option<&JointModel>, ModelError)> = Vec::new();
    for joint in &model.joints {
        let mut alone = model.clone();
        alone.joints.clear();
        alone.chains.truncate(1);
        let Some(chain) = alone.chains.first_mut() else { return };
        (chain.joints, chain.tip, chain.force_sensor, chain.mimic) = (1, Pose::IDENTITY, None, None);
        let _ = alone.joints.push(joint.clone());
        match alone.validate() {
            Err(error) if error.joint.is_some() => found.push((Some(joint), error)),
            Err(error) => {
                found = vec![(None, error)];
                break;
            }
            Ok(()) => {}
        }
    }
    if found.is_empty()
        && let Err(error) = model.validate()
    {
        found.push((error.joint.and_then(|joint| model.joints.get(usize::from(joint))), error));
    }
    for (joint, error) in found {
        let name = joint.map_or("", |joint| joint.name.as_str());
        let place = if name.is_empty() { String::new() } else { format!("joint {name}: ") };
        let message = format!("{place}{} = {} {}", error.field.path(), error.value, error.problem);
        match in_urdf(error.field) {
            Some(_) if told => {}
            Some(advice) => of_urdf.dynamics(urdf.line_of_joint(name), message, advice),
            None => {
                let key = error.field.path();
                let line = line_of(text, &format!("joints.{name}.{key}"))
                    .or_else(|| line_of(text, &format!("joint.{key}")))
                    .or_else(|| line_of(text, key));
                of_settings.dynamics(line, message, in_settings(error.field));
            }
        }
    }
}

/// What to do about a field that comes from the URDF.
const fn in_urdf(field: Field) -> Option<&'static str> {
    Some(match field {
        Field::Joints | Field::Chains => "a controller needs chains of 1 to 7 revolute joints",
        Field::Name | Field::ChainName => "give it a name of its own",
        Field::OriginTranslation | Field::OriginRotation | Field::TipTranslation | Field::TipRotation => {
            "correct the <origin> of the joint"
        }
        Field::Axis => "mend its <axis>",
        Field::MimicJoint | Field::MimicMultiplier | Field::MimicOffset => {
            "mend <mimic joint=\"…\" multiplier=\"…\" offset=\"…\"/> of the first joint of the chain"
        }
        Field::TipRadius => "mend the <sphere> of the tip",
        Field::TipMass | Field::TipCenterOfMass => "mend <inertial> of the tip",
        Field::Mass | Field::CenterOfMass | Field::Inertia => "mend <inertial> of the links behind it",
        Field::Coulomb => "mend <dynamics friction=\"…\"/> (N·m)",
        Field::Viscous => "mend <dynamics damping=\"…\"/> (N·m·s/rad)",
        Field::LimitLower | Field::LimitUpper => "mend <limit lower=\"…\" upper=\"…\"/> (rad)",
        Field::LimitVelocity => "mend <limit velocity=\"…\"/> (rad/s)",
        Field::LimitTorque => "mend <limit effort=\"…\"/> (N·m)",
        _ => return None,
    })
}

const fn in_settings(field: Field) -> &'static str {
    match field {
        Field::MimicForceSensor => "remove [force_sensor]: a chain with a mimic joint cannot have one",
        Field::ServoInertia => "the links have no mass: give motor.rotor_inertia, or servo.inertia",
        _ => "mend the value; [joints.NAME] holds what is different for one joint",
    }
}

/// The joint with everything but its gains, which need the whole chain.
fn joint_model(joint: &SerialJoint, settings: &JointSettings) -> Option<JointModel> {
    Some(JointModel {
        name: joint.name.as_str().try_into().ok()?,
        origin: joint.origin,
        axis: joint.axis,
        link: joint.link,
        motor: settings.motor,
        friction: Friction {
            coulomb: settings.friction.coulomb.unwrap_or(joint.friction.coulomb),
            viscous: settings.friction.viscous.unwrap_or(joint.friction.viscous),
        },
        encoder: settings.encoder,
        limits: tesaki::model::JointLimits {
            torque_rate: settings.limits.torque_rate,
            following_error: settings.limits.following_error,
            velocity: settings.limits.velocity.unwrap_or(joint.limits.velocity),
            torque: settings.limits.torque.unwrap_or(joint.limits.torque),
            ..joint.limits
        },
        servo: ServoGains {
            filter_time: settings.servo.filter_time,
            rest_error: settings.servo.rest_error,
            pid: settings.servo.pid,
            observer: ObserverGains {
                inertia: 0.0,
                bandwidth: settings.servo.observer.bandwidth,
                observer_bandwidth: settings.servo.observer.observer_bandwidth,
            },
        },
    })
}

/// Puts friction and limits of the settings in place of the URDF's.
pub fn correct(urdf: &mut Urdf, settings: &Settings) {
    for joint in &mut urdf.robot.joints {
        let Some(own) = settings.joints.get(&joint.name) else { continue };
        let replace = |place: &mut f64, value: Option<f32>| *place = value.map_or(*place, f64::from);
        replace(&mut joint.limit.velocity, own.limits.velocity);
        replace(&mut joint.limit.effort, own.limits.torque);
        if own.friction.coulomb.is_some() || own.friction.viscous.is_some() {
            let dynamics = joint.dynamics.get_or_insert_default();
            replace(&mut dynamics.friction, own.friction.coulomb);
            replace(&mut dynamics.damping, own.friction.viscous);
        }
    }
}

/// Gains are given per inertia: fills in the inertia that each joint of the chain feels in the middle of its
/// range.
fn complete_gains(joints: &mut [JointModel], tip: &Pose, settings: &Settings) {
    let chain = Chain::new(joints, tip);
    let middle: Vec<f32> =
        joints.iter().map(|joint| 0.5 * (joint.limits.lower + joint.limits.upper)).collect();
    let rest = vec![0.0; joints.len()];
    for index in 0..joints.len() {
        let (mut acceleration, mut torques) = (rest.clone(), rest.clone());
        acceleration[index] = 1.0;
        chain.inverse_dynamics(&nalgebra::Vector3::zeros(), &middle, &rest, &acceleration, &mut torques);
        let joint = &mut joints[index];
        let own = settings.joints.get(joint.name.as_str()).and_then(|own| own.servo.inertia);
        let inertia = own.unwrap_or(torques[index] + joint.motor.rotor_inertia);
        let PidGains { proportional, integral, derivative, cutoff } = joint.servo.pid;
        joint.servo.pid = PidGains {
            proportional: proportional * inertia,
            integral: integral * inertia,
            derivative: derivative * inertia,
            cutoff,
        };
        joint.servo.observer.inertia = inertia;
    }
}
