//! `controller.toml`: what the URDF does not say. `[joint]` holds the values of every joint, `[joints.NAME]` what is
//! different for one.

use std::collections::BTreeMap;

use serde::Deserialize;
use tesaki::model::{Encoder, Motor, PidGains, Safety};
use toml::{Table, Value};

/// A checked `controller.toml`.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Gravity in the base frame [m/s²].
    pub gravity: [f32; 3],
    /// What is watched, and the reaction.
    pub safety: Safety,
    /// By joint name.
    pub joints: BTreeMap<String, JointSettings>,
}

/// The settings of one joint.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointSettings {
    /// The drive.
    pub motor: Motor,
    /// The angle sensor.
    pub encoder: Encoder,
    /// The limits that the URDF has no place for.
    pub limits: LimitSettings,
    /// The servo.
    pub servo: ServoSettings,
}

/// See [`tesaki::model::JointLimits`].
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitSettings {
    /// Fastest change of torque [N·m/s].
    pub torque_rate: f32,
    /// Largest distance between reference and joint [rad].
    pub following_error: f32,
}

/// See [`tesaki::model::ServoGains`].
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoSettings {
    /// Time constant of the trajectory filter [s].
    pub filter_time: f32,
    /// Error at rest that is left alone [rad].
    pub rest_error: f32,
    /// Inertia that the gains are multiplied with [kg·m²]; computed from the URDF when left out.
    pub inertia: Option<f32>,
    /// Gains per inertia: proportional [1/s²], integral [1/s³], derivative [1/s]; cut-off [rad/s].
    pub pid: PidGains,
    /// The observer mode.
    pub observer: ObserverSettings,
}

/// See [`tesaki::model::ObserverGains`].
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObserverSettings {
    /// Of the position loop [rad/s].
    pub bandwidth: f32,
    /// Of the observer [rad/s].
    pub observer_bandwidth: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    gravity: [f32; 3],
    safety: SafetySettings,
    #[serde(default)]
    joint: Table,
    #[serde(default)]
    joints: BTreeMap<String, Table>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SafetySettings {
    /// There is always one; a file that names none gets 100 ms.
    #[serde(default = "command_timeout")]
    command_timeout: f32,
    #[serde(default)]
    reaction: Reaction,
    damping: f32,
    supply_min: f32,
    supply_max: f32,
}

const fn command_timeout() -> f32 {
    0.1
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Reaction {
    Off,
    Damp,
    #[default]
    Hold,
}

impl Settings {
    /// Reads the text of a `controller.toml` for the joints `names`.
    pub fn parse(text: &str, names: &[&str]) -> Result<Self, String> {
        let file: File = toml::from_str(text).map_err(|error| error.to_string())?;
        if let Some(stranger) = file.joints.keys().find(|name| !names.contains(&name.as_str())) {
            return Err(format!(
                "[joints.{stranger}] belongs to no joint of the URDF; its joints are {}",
                names.join(", ")
            ));
        }
        let joints = names.iter().map(|&name| {
            let mut table = file.joint.clone();
            if let Some(own) = file.joints.get(name) {
                merge(&mut table, own);
            }
            let settings = Value::Table(table).try_into::<JointSettings>().map_err(|error| {
                format!("joint {name}: {} (looked in [joint] and [joints.{name}])", error.message())
            })?;
            Ok((name.to_owned(), settings))
        });
        Ok(Self {
            gravity: file.gravity,
            safety: Safety {
                command_timeout: file.safety.command_timeout,
                reaction: match file.safety.reaction {
                    Reaction::Off => tesaki::model::Reaction::Off,
                    Reaction::Damp => tesaki::model::Reaction::Damp,
                    Reaction::Hold => tesaki::model::Reaction::Hold,
                },
                damping: file.safety.damping,
                supply_min: file.safety.supply_min,
                supply_max: file.safety.supply_max,
            },
            joints: joints.collect::<Result<_, String>>()?,
        })
    }
}

/// Puts the values of `own` over those of `table`, table by table.
fn merge(table: &mut Table, own: &Table) {
    for (key, value) in own {
        match (table.get_mut(key), value) {
            (Some(Value::Table(inner)), Value::Table(own)) => merge(inner, own),
            _ => {
                table.insert(key.clone(), value.clone());
            }
        }
    }
}
