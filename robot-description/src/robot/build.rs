//! The controller's model of a robot's two files.

use tesaki::kinematics::Chain;
use tesaki::model::{
    ChainJoint, ChainModel, Coupling, Field, ForceSensor, Friction, Gauges, JointModel, MimicJoint,
    ModelError, ObserverGains, PidGains, Pose, Problem, RobotModel, ServoGains,
};

use super::of_joints::OfJoints;
use super::settings::{JointSettings, Settings};
use super::tree::{SerialChain, SerialJoint, SerialMimic};
use super::unit::{invalid_setting, invalid_value, key};
use crate::finding::{Finding, Report};
use crate::urdf::Urdf;

/// The model, not validated; `None` when something does not fit, which has been reported.
pub fn model(urdf: &Urdf, chains: &[SerialChain], settings: &Settings) -> Option<RobotModel> {
    let mut model = RobotModel {
        name: urdf.robot.name.as_str().try_into().ok()?,
        gravity: settings.gravity,
        chains: heapless::Vec::new(),
        joints: heapless::Vec::new(),
        mimics: heapless::Vec::new(),
        // One matrix is that of one sensor: `validate` reports more.
        gauges: settings.force_sensor.as_ref().and_then(|sensor| sensor.gauges).map(Gauges::from),
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
        };
        model.chains.push(tip).ok()?;
        for joint in &chain.joints {
            let own = settings.joints.get(&joint.name)?;
            model.joints.push(joint_model(joint, own)?).ok()?;
        }
        for mimic in &chain.mimics {
            model.mimics.push(mimic_joint(mimic, model.chains.len() - 1, chains)?).ok()?;
        }
    }
    complete_gains(&mut model, settings);
    add_mimics(&mut model, chains, settings);
    Some(model)
}

fn mimic_joint(mimic: &SerialMimic, chain: usize, chains: &[SerialChain]) -> Option<MimicJoint> {
    let mut joints = chains.iter().flat_map(|chain| &chain.joints);
    let SerialJoint { origin, axis, link, .. } = mimic.joint;
    Some(MimicJoint {
        chain: u8::try_from(chain).ok()?,
        place: u8::try_from(mimic.place).ok()?,
        joint: u8::try_from(joints.position(|joint| joint.name == mimic.follows)?).ok()?,
        multiplier: mimic.multiplier,
        offset: mimic.offset,
        origin,
        axis,
        link,
    })
}

/// The torques of all joints of a chain for 1 rad/s² at the one of them at `place`, all joints with a motor
/// in the middle of their ranges: a column of the mass matrix. `None` where the chain has more joints than
/// the control core knows.
fn inertia_column(model: &RobotModel, chain: usize, place: usize) -> Option<Vec<f32>> {
    let middle = |joint: &JointModel| 0.5 * (joint.limits.lower + joint.limits.upper);
    let middle: Vec<f32> = model.joints.iter().map(middle).collect();
    let angles = model.chain_angles(chain, &middle);
    let (rest, mut torques) = (vec![0.0; angles.len()], vec![0.0; angles.len()]);
    let mut acceleration = rest.clone();
    *acceleration.get_mut(place)? = 1.0;
    let gravity = nalgebra::Vector3::zeros();
    Chain::of_model(model, chain).inverse_dynamics(&gravity, &angles, &rest, &acceleration, &mut torques);
    Some(torques)
}

/// Adds the friction and the inertia of mimic joints to the joints that drive them.
fn add_mimics(model: &mut RobotModel, chains: &[SerialChain], settings: &Settings) {
    for (index, serial) in chains.iter().enumerate() {
        for of in &serial.mimics {
            let place = of.place;
            let Some(column) = inertia_column(model, index, place) else { continue };
            let ratios = model.joints_of(index).map(|joint| {
                let Coupling { actuated, multiplier, .. } = joint.coupling();
                (usize::from(actuated), multiplier, matches!(joint, ChainJoint::Driven(..)))
            });
            let ratios: Vec<(usize, f32, bool)> = ratios.collect();
            let Some(&(leader, ratio, _)) = ratios.get(place) else { continue };
            // Of the joints of this chain that move with it; the leader has no such column of its own and
            // counts twice.
            let moving = ratios.iter().zip(&column).filter(|((joint, ..), _)| *joint == leader);
            let added: f32 = moving
                .map(|(&(_, other, is_leader), torque)| {
                    ratio * other * if is_leader { 2.0 * torque } else { *torque }
                })
                .sum();
            let Some(driving) = model.joints.get_mut(leader) else { continue };
            driving.friction.coulomb += ratio.abs() * of.joint.friction.coulomb;
            driving.friction.viscous += ratio * ratio * of.joint.friction.viscous;
            let own = settings.joints.get(driving.name.as_str()).and_then(|own| own.servo.inertia);
            let before = driving.servo.observer.inertia;
            if own.is_none() && before > 0.0 {
                let inertia = before + added;
                let PidGains { proportional, integral, derivative, .. } = &mut driving.servo.pid;
                for gain in [proportional, integral, derivative] {
                    *gain *= inertia / before;
                }
                driving.servo.observer.inertia = inertia;
            }
        }
    }
}

/// Reports what is wrong with the values, joint by joint: one finding each.
pub fn validate(model: &RobotModel, urdf: &Urdf, of_urdf: &mut Report, of_settings: &mut Report) {
    if model.gauges.is_some() && model.chains.len() > 1 {
        let message = format!("force_sensor.gauges: one calibration matrix for {} tips", model.chains.len());
        let advice = "a matrix is that of one sensor: only a robot with a single tip can have gauges";
        of_settings.dynamics(of_settings.line_of("force_sensor.gauges"), message, advice);
    }
    // What is wrong with the URDF's own values has been told by line.
    let told = of_urdf.findings.iter().any(Finding::is_error);
    let mut found: Vec<(Option<&JointModel>, ModelError)> = Vec::new();
    for joint in &model.joints {
        let mut alone = model.clone();
        alone.joints.clear();
        alone.chains.truncate(1);
        let Some(chain) = alone.chains.first_mut() else { return };
        (chain.joints, chain.tip, chain.tip_radius, chain.force_sensor) = (1, Pose::IDENTITY, 0.0, None);
        alone.mimics.clear();
        alone.gauges = None;
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
        // A sensor is said to be of the last joint before it, whose settings do not hold it.
        let joint = error.joint.filter(|_| !error.field.path().starts_with("force_sensor"));
        found.push((joint.and_then(|joint| model.joints.get(usize::from(joint))), error));
    }
    let mut of_joints = OfJoints::default();
    for (joint, error) in found {
        let error = joint.map_or(error, |joint| of_inertia(joint, error));
        let name = joint.map_or("", |joint| joint.name.as_str());
        let key = key(error.field);
        let message = joint.map_or_else(
            || invalid_value(&error),
            |joint| invalid_setting(&error, joint.servo.observer.inertia),
        );
        let place = if name.is_empty() { String::new() } else { format!("joint {name}: ") };
        // The settings may have it in place of the URDF.
        let own = of_settings
            .line_of(&format!("joints.{name}.{key}"))
            .or_else(|| of_settings.line_of(&format!("joint.{key}")));
        match in_urdf(error.field).filter(|_| own.is_none()) {
            Some(_) if told => {}
            Some(advice) => of_urdf.dynamics(urdf.line_of_joint(name), place + &message, advice),
            None => {
                let line = own.or_else(|| of_settings.line_of(key));
                match joint {
                    Some(joint) if error.field == Field::ServoInertia && own.is_some() => {
                        let advice =
                            "mend the value, or leave it out: it is then computed from links and rotor";
                        of_joints.error(&joint.name, line, message, advice);
                    }
                    Some(joint) => {
                        of_joints.error(&joint.name, line, message, in_settings(error.field, true));
                    }
                    None => of_settings.dynamics(line, message, in_settings(error.field, false)),
                }
            }
        }
    }
    of_joints.report(of_settings);
}

/// The error that is the cause of another: gains are multiplied with the inertia of the servo.
fn of_inertia(joint: &JointModel, error: ModelError) -> ModelError {
    let inertia = joint.servo.observer.inertia;
    let is_gain = matches!(error.field, Field::Proportional | Field::Integral | Field::Derivative);
    match (is_gain, inertia) {
        (true, value) if value < 0.0 => {
            ModelError { field: Field::ServoInertia, value, problem: Problem::NotAbove(0.0), ..error }
        }
        (true, value) if !value.is_finite() => ModelError { field: Field::ServoInertia, value, ..error },
        _ => error,
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
        Field::MimicJoint
        | Field::MimicMultiplier
        | Field::MimicOffset
        | Field::MimicChain
        | Field::MimicPlace => {
            "mend <mimic joint=\"…\" multiplier=\"…\" offset=\"…\"/> in the chain of the joint"
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

/// What to do about a field of `controller.toml`, of a joint or of the robot.
const fn in_settings(field: Field, of_joint: bool) -> &'static str {
    match field {
        Field::MimicForceSensor => "remove [force_sensor]: a chain with a mimic joint cannot have one",
        Field::CalibrationMatrix => {
            "mend the matrix: rows are Fx, Fy, Fz, Mx, My, Mz, columns the gauges, none of them zero or twice there"
        }
        Field::GaugeRange => {
            "the matrix is for counts of the converter, of 24 bits: one for volts or for mV/V needs a factor"
        }
        Field::GaugeGains => "give six gains, each a power of two up to 128",
        Field::CurrentLimit => {
            "check motor.current_limit [A] and motor.current_resolution [A a count]: a reading has up to 26 214 counts"
        }
        Field::ServoInertia => "the links have no mass: give motor.rotor_inertia, or servo.inertia",
        _ if of_joint => "mend the value; [joints.NAME] holds what is different for one joint",
        _ => "mend the value",
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

/// Gains are given per inertia: fills in the inertia that each joint feels in the middle of the ranges,
/// without that of mimic joints which move with it.
fn complete_gains(model: &mut RobotModel, settings: &Settings) {
    let mut inertias = Vec::new();
    for chain in 0..model.chains.len() {
        for (place, joint) in model.joints_of(chain).enumerate() {
            if let ChainJoint::Driven(index, _) = joint {
                let inertia =
                    inertia_column(model, chain, place).and_then(|column| column.get(place).copied());
                inertias.extend(inertia.map(|inertia| (index, inertia)));
            }
        }
    }
    for (index, inertia) in inertias {
        let joint = &mut model.joints[index];
        let own = settings.joints.get(joint.name.as_str()).and_then(|own| own.servo.inertia);
        let inertia = own.unwrap_or(inertia + joint.motor.rotor_inertia);
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
