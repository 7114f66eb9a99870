//! `controller.toml`: what the URDF does not say. `[joint]` holds the values of every joint, `[joints.NAME]` what is
//! different for one.

use std::collections::BTreeMap;

use serde::Deserialize;
use tesaki::model::{Encoder, Motor, PidGains, Safety};
use toml::{Table, Value};

use crate::finding::Report;

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
    // Known here, put together by `joints`.
    #[serde(default, rename = "joint")]
    _joint: Table,
    #[serde(default, rename = "joints")]
    _joints: BTreeMap<String, Table>,
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
    /// Reads the text of a `controller.toml` for the joints `names`; `None` when something is wrong with it.
    pub(crate) fn parse(text: &str, names: &[&str], report: &mut Report) -> Option<Self> {
        let before = report.findings.len();
        let file = toml::from_str::<File>(text).map_err(|error| {
            let line =
                error.span().map(|span| text.get(..span.start).unwrap_or(text).matches('\n').count() + 1);
            report.dynamics(
                line,
                error.message(),
                "docs/bring-your-own-hand.md shows a whole controller.toml",
            );
        });
        // The joints can be looked at all the same.
        let table = toml::from_str::<Table>(text).ok()?;
        let joints = joints(&table, text, names, report);
        let file = file.ok().filter(|_| report.findings.len() == before)?;
        Some(Self { gravity: file.gravity, safety: file.safety.into(), joints })
    }
}

impl From<SafetySettings> for Safety {
    fn from(settings: SafetySettings) -> Self {
        Self {
            command_timeout: settings.command_timeout,
            reaction: match settings.reaction {
                Reaction::Off => tesaki::model::Reaction::Off,
                Reaction::Damp => tesaki::model::Reaction::Damp,
                Reaction::Hold => tesaki::model::Reaction::Hold,
            },
            damping: settings.damping,
            supply_min: settings.supply_min,
            supply_max: settings.supply_max,
        }
    }
}

/// `[joint]` and `[joints.NAME]` put together for every name; what several joints have wrong is told once.
fn joints(file: &Table, text: &str, names: &[&str], report: &mut Report) -> BTreeMap<String, JointSettings> {
    let table = |key: &str| file.get(key).and_then(Value::as_table).cloned().unwrap_or_default();
    let (common, own) = (table("joint"), table("joints"));
    for stranger in own.keys().filter(|name| !names.contains(&name.as_str())) {
        let message = format!("[joints.{stranger}] belongs to no joint of the URDF");
        let advice = format!("correct or remove it; the joints that move are {}", names.join(", "));
        report.dynamics(line_of(text, &format!("joints.{stranger}")), message, advice);
    }
    let mut wrong: Vec<(String, Vec<&str>)> = Vec::new();
    let mut joints = BTreeMap::new();
    for &name in names {
        let mut table = common.clone();
        if let Some(own) = own.get(name).and_then(Value::as_table) {
            merge(&mut table, own);
        }
        let message = if table.is_empty() {
            "nothing is said about it".to_owned()
        } else {
            match Value::Table(table).try_into::<JointSettings>() {
                Ok(settings) => {
                    joints.insert(name.to_owned(), settings);
                    continue;
                }
                Err(error) => error.to_string().trim().replace('\n', " "),
            }
        };
        match wrong.iter_mut().find(|(known, _)| *known == message) {
            Some((_, names)) => names.push(name),
            None => wrong.push((message, vec![name])),
        }
    }
    for (message, names) in wrong {
        let line = quoted(&message).and_then(|key| line_of(text, key));
        let (plural, list) = (if names.len() > 1 { "s" } else { "" }, names.join(", "));
        let advice = "mend it in [joint], which holds for every joint, or in [joints.NAME] for one";
        report.dynamics(line, format!("joint{plural} {list}: {message}"), advice);
    }
    joints
}

/// The last word between backticks, which is the key that the message is about.
fn quoted(message: &str) -> Option<&str> {
    if message.contains("missing field") {
        return None;
    }
    if let Some((_, keys)) = message.rsplit_once("in `") {
        return keys.split('`').next();
    }
    message.split('`').nth(1)
}

/// The line where `key` (with its tables, or their end) has its value or starts a table.
pub fn line_of(text: &str, key: &str) -> Option<usize> {
    let mut header = String::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line: String = line.chars().filter(|c| !c.is_whitespace() && !"\"'".contains(*c)).collect();
        let here = match line.strip_prefix('[').and_then(|line| line.split(']').next()) {
            Some(name) => {
                header = format!(".{name}");
                header.clone()
            }
            None => match line.split_once('=') {
                Some((name, _)) if !name.starts_with('#') => format!("{header}.{name}"),
                _ => continue,
            },
        };
        if here.ends_with(&format!(".{key}")) || here.contains(&format!(".{key}.")) {
            return Some(number);
        }
    }
    None
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
