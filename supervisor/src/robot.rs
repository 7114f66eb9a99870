//! A robot as users lay it out: a folder with `robot.urdf` (kinematics, inertias, limits, friction) and
//! `controller.toml` (motors, encoders, gains, safety, keyed by the URDF's joint names).

mod settings;
mod tree;

use std::path::{Path, PathBuf};

use tesaki::kinematics::Chain;
use tesaki::model::{
    ChainModel, JointModel, ModelError, ObserverGains, PidGains, Pose, RobotModel, ServoGains,
};

pub use settings::{JointSettings, Settings};
use tree::SerialJoint;

/// What is wrong with a robot folder.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}; a robot folder holds robot.urdf and controller.toml")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The URDF is not one.
    #[error("{path}: {message}")]
    Urdf {
        /// The file.
        path: PathBuf,
        /// What is wrong, and with which joint or link.
        message: String,
    },
    /// The TOML is not what it should be.
    #[error("{path}: {message}")]
    Settings {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line or joint.
        message: String,
    },
    /// The robot is complete but a value makes no sense.
    #[error("{}: {}{} = {} {}", path.display(), joint.as_ref().map_or(String::new(), |name| format!("joint {name}: ")), error.field.path(), error.value, error.problem)]
    Model {
        /// The folder.
        path: PathBuf,
        /// The joint's name.
        joint: Option<String>,
        /// What is wrong.
        error: ModelError,
    },
}

/// A robot folder, read and checked.
#[derive(Clone, Debug)]
pub struct RobotFolder {
    /// Where it lies.
    pub path: PathBuf,
    /// The URDF as it stands there.
    pub urdf: urdf_rs::Robot,
    /// The model for the controller, validated.
    pub model: RobotModel,
}

impl RobotFolder {
    /// Reads the folder at `path`.
    ///
    /// # Errors
    /// What is missing or wrong, where, and what to do.
    pub fn load(path: &Path) -> Result<Self, RobotError> {
        let read = |name: &str| {
            let path = path.join(name);
            std::fs::read_to_string(&path).map_err(|source| RobotError::Read { path, source })
        };
        Self::parse(path, &read("robot.urdf")?, &read("controller.toml")?)
    }

    /// Makes a robot of the texts of both files; `path` is named in errors.
    ///
    /// # Errors
    /// As [`RobotFolder::load`].
    pub fn parse(path: &Path, urdf: &str, settings: &str) -> Result<Self, RobotError> {
        let urdf_error = |message| RobotError::Urdf { path: path.join("robot.urdf"), message };
        let settings_error = |message| RobotError::Settings { path: path.join("controller.toml"), message };
        let urdf = urdf_rs::read_from_string(urdf).map_err(|error| urdf_error(error.to_string()))?;
        let chains = tree::serial_chains(&urdf).map_err(urdf_error)?;
        let names: Vec<&str> =
            chains.iter().flat_map(|chain| &chain.joints).map(|joint| joint.name.as_str()).collect();
        let settings = Settings::parse(settings, &names).map_err(settings_error)?;

        let too_long = |name: &str| urdf_error(format!("the name {name:?} is longer than 32 bytes"));
        let mut model = RobotModel {
            name: urdf.name.as_str().try_into().map_err(|_| too_long(&urdf.name))?,
            gravity: settings.gravity,
            chains: heapless::Vec::new(),
            joints: heapless::Vec::new(),
            safety: settings.safety,
        };
        for chain in &chains {
            let tip = ChainModel {
                name: chain.tip.as_str().try_into().map_err(|_| too_long(&chain.tip))?,
                joints: u8::try_from(chain.joints.len()).unwrap_or(u8::MAX),
                tip: chain.pose,
            };
            model.chains.push(tip).map_err(|_| {
                urdf_error(format!(
                    "{} chains leave the base, at most {} fit",
                    chains.len(),
                    model.chains.capacity()
                ))
            })?;
            let first = model.joints.len();
            for joint in &chain.joints {
                let own =
                    settings.joints.get(&joint.name).ok_or_else(|| settings_error(joint.name.clone()))?;
                let joint = joint_model(joint, own).map_err(urdf_error)?;
                model.joints.push(joint).map_err(|_| {
                    urdf_error(format!("{} joints, at most {} fit", names.len(), model.joints.capacity()))
                })?;
            }
            complete_gains(&mut model.joints[first..], &chain.pose, &settings);
        }
        model.validate().map_err(|error| RobotError::Model {
            path: path.to_owned(),
            joint: error.joint.map(|joint| model.joint_name(usize::from(joint)).to_owned()),
            error,
        })?;
        Ok(Self { path: path.to_owned(), urdf, model })
    }
}

/// The joint with everything but its gains, which need the whole chain.
fn joint_model(joint: &SerialJoint, settings: &JointSettings) -> Result<JointModel, String> {
    let name = joint
        .name
        .as_str()
        .try_into()
        .map_err(|_| format!("the name {:?} is longer than 32 bytes", joint.name))?;
    Ok(JointModel {
        name,
        origin: joint.origin,
        axis: joint.axis,
        link: joint.link,
        motor: settings.motor,
        friction: joint.friction,
        encoder: settings.encoder,
        limits: tesaki::model::JointLimits {
            torque_rate: settings.limits.torque_rate,
            following_error: settings.limits.following_error,
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

/// Gains are given per inertia: fills in the inertia that each joint of the chain feels in the middle of its range.
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
