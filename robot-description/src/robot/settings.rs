//! `controller.toml`: what the URDF does not say. `[joint]` holds the values of every joint, `[joints.NAME]`
//! what is different for one.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tesaki::model::{Encoder, GAUGES, Gauges, Motor, PidGains, Safety};
use toml::{Table, Value};

use super::of_joints::OfJoints;
use crate::file::{MAX_TOML, check_length, in_words, parse_short};
use crate::finding::Report;

/// A checked `controller.toml`.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Gravity in the base frame [m/s²].
    pub gravity: [f32; 3],
    /// What is watched, and the reaction.
    pub safety: Safety,
    /// The force sensors of the tips, all alike; `None` when they have none.
    pub force_sensor: Option<ForceSensorSettings>,
    /// By joint name.
    pub joints: BTreeMap<String, JointSettings>,
}

/// See [`tesaki::model::ForceSensor`].
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceSensorSettings {
    /// Force for one count [N].
    pub force_resolution: f32,
    /// Torque for one count [N·m].
    pub torque_resolution: f32,
    /// Count at the end of the range.
    pub saturation: u32,
    /// Largest force on a tip [N].
    pub force_limit: f32,
    /// Its strain gauges, for a board that converts them itself; only with a single tip.
    pub gauges: Option<GaugeSettings>,
}

/// See [`tesaki::model::Gauges`].
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaugeSettings {
    /// Rows: force along x, y, z [N] and torque [N·m] for a count of each gauge.
    pub calibration_matrix: [[f32; GAUGES]; 6],
    /// Gain of each gauge's converter.
    pub gains: [u8; GAUGES],
}

impl From<GaugeSettings> for Gauges {
    /// Of the only chain.
    fn from(settings: GaugeSettings) -> Self {
        let GaugeSettings { calibration_matrix, gains } = settings;
        Self { chain: 0, calibration_matrix, gains }
    }
}

/// The settings of one joint.
#[derive(Clone, Debug)]
pub struct JointSettings {
    /// The drive.
    pub motor: Motor,
    /// The angle sensor.
    pub encoder: Encoder,
    /// The limits that the URDF has no place for.
    pub limits: LimitSettings,
    /// Friction in place of the URDF's.
    pub friction: FrictionSettings,
    /// The servo.
    pub servo: ServoSettings,
}

/// See [`tesaki::model::JointLimits`].
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitSettings {
    /// Fastest change of torque [N·m/s].
    pub torque_rate: f32,
    /// Largest distance between reference and joint [rad].
    pub following_error: f32,
    /// Largest speed [rad/s] in place of the URDF's.
    pub velocity: Option<f32>,
    /// Largest torque [N·m] in place of the URDF's.
    pub torque: Option<f32>,
}

/// See [`tesaki::model::Friction`]. Values that are left out are those of the URDF.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrictionSettings {
    /// Coulomb friction [N·m].
    pub coulomb: Option<f32>,
    /// Viscous friction [N·m·s/rad].
    pub viscous: Option<f32>,
}

/// See [`tesaki::model::ServoGains`].
#[derive(Clone, Debug, Serialize, Deserialize)]
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
#[derive(Clone, Debug, Serialize, Deserialize)]
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
    force_sensor: Option<ForceSensorSettings>,
    // Known here, read by `accepted_inertias`.
    #[serde(default, rename = "accept_inertia")]
    _accept_inertia: Vec<String>,
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
        if !check_length(text, MAX_TOML, report) {
            return None;
        }
        let advice =
            "docs/bring-your-own-hand.md has a complete controller.toml; `tesaki model init` writes one";
        let file = parse_short::<File>(text, advice, report);
        // The joints can be looked at all the same.
        let table = toml::from_str::<Table>(text).ok()?;
        let joints = joints(&table, names, report);
        let file = file.filter(|_| report.findings.len() == before)?;
        Some(Self {
            gravity: file.gravity,
            safety: file.safety.into(),
            force_sensor: file.force_sensor,
            joints,
        })
    }
}

/// The links whose inertia a `controller.toml` accepts although no body can have it; none when the text is
/// wrong, which [`Settings::parse`] reports.
pub(crate) fn accepted_inertias(text: &str) -> Vec<String> {
    let table = if text.len() > MAX_TOML { Table::new() } else { toml::from_str(text).unwrap_or_default() };
    let list = table.get("accept_inertia").and_then(Value::as_array);
    list.into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect()
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
fn joints(file: &Table, names: &[&str], report: &mut Report) -> BTreeMap<String, JointSettings> {
    let table = |key: &str| file.get(key).and_then(Value::as_table).cloned().unwrap_or_default();
    let (common, own) = (table("joint"), table("joints"));
    // Of a URDF without joints, or that cannot be read, its own finding says enough.
    let is_stranger = |name: &&String| !names.is_empty() && !names.contains(&name.as_str());
    let strangers: Vec<&String> = own.keys().filter(is_stranger).collect();
    for stranger in &strangers {
        let message = format!("[joints.{stranger}]: the URDF has no such joint");
        let advice = format!("correct or remove it; the moving joints are {}", names.join(", "));
        report.dynamics(report.line_of(&format!("joints.{stranger}")), message, advice);
    }
    let mut of_joints = OfJoints::default();
    let mut joints = BTreeMap::new();
    for &name in names {
        let mut table = common.clone();
        if let Some(own) = own.get(name).and_then(Value::as_table) {
            merge(&mut table, own);
        }
        let mut errors = Vec::new();
        joints.extend(JointSettings::read(&table, &mut errors).map(|settings| (name.to_owned(), settings)));
        // A table for a joint that is not there may hold what this one lacks.
        for Wrong { key, message, .. } in
            errors.into_iter().filter(|error| strangers.is_empty() || !error.is_missing)
        {
            let own = report.line_of(&format!("joints.{name}.{key}"));
            let line = own.or_else(|| report.line_of(&format!("joint.{key}")));
            let advice = "correct it in [joint…], which applies to all joints, or in [joints.NAME…] for a single joint";
            of_joints.error(name, line, message, advice);
        }
    }
    of_joints.report(report);
    joints
}

/// What is wrong with a joint's settings, and where to look.
struct Wrong {
    key: String,
    message: String,
    /// Whether it is not there, rather than wrong.
    is_missing: bool,
}

impl JointSettings {
    /// Reads each section, to find what is wrong in any of them.
    fn read(table: &Table, errors: &mut Vec<Wrong>) -> Option<Self> {
        let sections = ["motor", "encoder", "limits", "friction", "servo"];
        for key in table.keys().filter(|key| !sections.contains(&key.as_str())) {
            let message = format!("unknown section {key:?}, expected one of {}", sections.join(", "));
            errors.push(Wrong { key: key.clone(), message, is_missing: false });
        }
        if table.is_empty() {
            let message = "no settings given".to_owned();
            errors.push(Wrong { key: "joint".to_owned(), message, is_missing: true });
            return None;
        }
        let (motor, encoder) = (section(table, "motor", errors), section(table, "encoder", errors));
        let (limits, servo) = (section(table, "limits", errors), section(table, "servo", errors));
        let friction = match table.get("friction") {
            Some(_) => section(table, "friction", errors),
            None => Some(FrictionSettings::default()),
        };
        Some(Self { motor: motor?, encoder: encoder?, limits: limits?, friction: friction?, servo: servo? })
    }
}

fn section<T>(table: &Table, name: &str, errors: &mut Vec<Wrong>) -> Option<T>
where
    T: DeserializeOwned + Serialize,
{
    let Some(value) = table.get(name) else {
        let message = format!("section {name} is missing");
        errors.push(Wrong { key: name.to_owned(), message, is_missing: true });
        return None;
    };
    match value.clone().try_into() {
        Ok(section) => {
            // Not every part of the model refuses keys that it does not know.
            let known = Value::try_from(&section).unwrap_or(Value::Boolean(false));
            let Some(key) = stranger(value, &known, name) else { return Some(section) };
            errors.push(Wrong { message: format!("unknown key {key}"), key, is_missing: false });
            None
        }
        Err(error) => {
            let message = in_words(&error.to_string()).trim().replace('\n', " ");
            let key = match quoted(&message) {
                Some(key) => format!("{name}.{key}"),
                None => name.to_owned(),
            };
            let is_missing = message.contains("missing field");
            errors.push(Wrong { key, message: format!("{name}: {message}"), is_missing });
            None
        }
    }
}

/// The first key, under `name`, that is not among the known ones.
fn stranger(value: &Value, known: &Value, name: &str) -> Option<String> {
    let (Value::Table(table), Value::Table(known)) = (value, known) else { return None };
    table.iter().find_map(|(key, value)| {
        let name = format!("{name}.{key}");
        match known.get(key) {
            None => Some(name),
            Some(known) => stranger(value, known, &name),
        }
    })
}

/// The key that a message is about: the last one between backticks, unless it is missing.
fn quoted(message: &str) -> Option<&str> {
    if message.contains("missing field") {
        return None;
    }
    let start = message.rfind("in `").map_or(0, |at| at + 3);
    message.get(start..)?.split('`').nth(1)
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
