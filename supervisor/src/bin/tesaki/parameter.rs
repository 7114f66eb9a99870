//! `read` and `set`: joint states, and parameters of the model on the board.

use std::fmt::Write as _;

use serde_json::{Value, json};
use tesaki::model::{Field, JointModel, ModelError, RobotModel};
use tesaki::protocol::{NodeStatus, Tips};
use tesaki_description::in_words;
use tesaki_description::robot::{
    Overload, doubtful_values, implausible_values, invalid_value, overloaded, unit,
};
use tesaki_supervisor::Board;

use crate::args::Options;
use crate::board_session::{BoardSession, notice_unhomed, notice_untared};
use crate::failure::Failure;
use crate::joints::outside;
use crate::output;

pub fn read(options: &Options, path: Option<&str>) -> Result<(), Failure> {
    let mut session = BoardSession::open(options)?;
    let model = session.model()?;
    let Some(path) = path else {
        return state(options, &mut session, &model);
    };
    let tree = tree(&model);
    let path = if path == "model" { "" } else { path };
    let mut found = Vec::new();
    for name in expand(&tree, &on_board(path))? {
        leaves(&name, at(&tree, &name)?, &mut found);
    }
    let value: serde_json::Map<String, Value> = found.iter().cloned().collect();
    output::result(options, &value, || {
        let mut text = String::new();
        for (name, value) in &found {
            let _ = writeln!(text, "{name} = {}{}", typed(name, value), unit(name));
        }
        text
    })
}

fn state(options: &Options, session: &mut BoardSession, model: &RobotModel) -> Result<(), Failure> {
    let homed = session.board.status()?.node.homed;
    let (telemetry, Tips { tips, .. }) = session.joints_and_tips()?;
    let mut value = output::telemetry(&telemetry, Some(model), homed);
    let is_placed = |chain| model.joints_of(chain).all(|joint| homed >> joint.coupling().actuated & 1 != 0);
    value["tips"] = model
        .chains
        .iter()
        .zip(&tips)
        .enumerate()
        .map(|(index, (chain, tip))| {
            let mut value = output::exact(tip);
            if !is_placed(index) {
                value["position"] = Value::Null;
            }
            if chain.force_sensor.is_none() {
                value["force"] = Value::Null;
            }
            (chain.name.to_string(), value)
        })
        .collect();
    output::result(options, &value, || {
        let mut text = format!(
            "{:<20} {:>10} {:>10} {:>10} {:>10}\n",
            "joint", "angle", "velocity", "reference", "torque"
        );
        let _ = writeln!(text, "{:<20} {:>10} {:>10} {:>10} {:>10}", "", "rad", "rad/s", "rad", "N·m");
        for (index, (joint, state)) in model.joints.iter().zip(&telemetry.joints).enumerate() {
            let is_homed = homed >> index & 1 != 0;
            // What is counted from an unknown zero is no angle.
            let angle = |angle: f32| if is_homed { format!("{angle:.4}") } else { "–".to_owned() };
            let _ = writeln!(
                text,
                "{:<20} {:>10} {:>10.3} {:>10} {:>10.4}{}",
                joint.name,
                angle(state.position),
                state.velocity,
                angle(state.reference),
                state.torque,
                if is_homed { "" } else { "  not homed" }
            );
        }
        let _ = writeln!(text, "\n{:<20} {:>10} {:>10} {:>10}", "tip", "x / m", "y / m", "z / m");
        for (index, (chain, tip)) in model.chains.iter().zip(&tips).enumerate() {
            let [x, y, z] = tip
                .position
                .map(|value| if is_placed(index) { format!("{value:.4}") } else { "–".to_owned() });
            let _ = write!(text, "{:<20} {x:>10} {y:>10} {z:>10}", chain.name);
            if chain.force_sensor.is_some() {
                let [x, y, z] = tip.force;
                let tared = if tip.tared { "" } else { ", not tared" };
                let _ = write!(text, "   force {x:.2}, {y:.2}, {z:.2} N{tared}");
            }
            text.push('\n');
        }
        let _ = write!(
            text,
            "\nThe board is {}; these are the values of tick {}.",
            telemetry.mode, telemetry.tick
        );
        text
    })
}

pub fn set(options: &Options, path: &str, value: &str) -> Result<(), Failure> {
    let mut session = BoardSession::command(options)?;
    let model = session.model()?;
    if on_board(path) != path {
        return Err(Failure::Usage(format!(
            "{path} is a value of controller.toml, with which the gains of servo.pid were multiplied: set {} and those \
             gains, or push the robot folder",
            on_board(path)
        )));
    }
    let mut tree = tree(&model);
    let (names, mut values) = (expand(&tree, path)?, Vec::new());
    let other = with_other_values(&tree, &names);
    for name in &names {
        let old = at_mut(&mut tree, name)?;
        if old.is_array() && !value.trim_start().starts_with('[') {
            return Err(Failure::Usage(not_a_list(name, old)));
        }
        if old.is_object() {
            let group = if name.is_empty() { "model" } else { name };
            return Err(Failure::Usage(format!(
                "{group} is a group of parameters: `tesaki read {group}` lists them"
            )));
        }
        *old = match (old.as_f64(), percentage(value)) {
            #[expect(clippy::cast_possible_truncation, reason = "the model has single precision")]
            (Some(number), Some(percentage)) => output::exact(&((0.01 * percentage * number) as f32)),
            _ => parse(name, old, value),
        };
        values.push(old.clone());
        // To the board a model without a name is none.
        if is_name(name) && old.as_str().is_some_and(|text| text.trim().is_empty()) {
            return Err(Failure::Usage(format!("{name} is empty: give a name")));
        }
    }
    let changed: RobotModel = from_tree(tree).map_err(|problem| {
        let problem = as_typed(&problem.to_string());
        Failure::Usage(format!("{path} = {value}: {problem}; `tesaki read {path}` shows the current value"))
    })?;
    changed.validate().map_err(|error| Failure::Usage(invalid(&model, path, &changed, &error)))?;
    check_stops(&model, &changed)?;
    check_values(&model, &changed)?;
    let tared = session.tared(&model)?;
    let NodeStatus { homed, supply, .. } = session.board.status()?.node;
    check_supply(&model, &changed, supply)?;
    let mut warnings = doubtful(&model, &changed, other.as_ref(), &names);
    if names.iter().any(|name| name.ends_with("limits.lower") || name.ends_with("limits.upper")) {
        warnings.extend(standing_outside(&mut session, &changed, homed)?);
    }
    let node = session.board.push_model_and_sense(&changed)?;
    let unhomed = (0..)
        .zip(&changed.joints)
        .filter(|(index, joint)| joint.encoder.relative && homed & !node.homed & 1 << index != 0);
    let unhomed: Vec<String> = unhomed.map(|(_, joint)| joint.name.to_string()).collect();
    let done = json!({
        "set": names, "values": values, "no_longer_tared": tared, "no_longer_homed": unhomed, "warnings": warnings,
    });
    output::result(options, &done, || {
        let unit = unit(path);
        let set = match percentage(value) {
            Some(_) => {
                names.iter().zip(&values).map(|(name, value)| format!("{name} = {value}{unit}")).collect()
            }
            None => vec![format!("{} = {value}{unit}", names.join(", "))],
        };
        format!("{} (until the next reset or push)", set.join(", "))
    })?;
    for warning in warnings {
        output::notice(options, &format!("warning: {warning}"));
    }
    notice_unhomed(options, &unhomed);
    notice_untared(options, "this pushed the model again", &tared);
    Ok(())
}

/// The path on the board of a parameter that has another one in `controller.toml`.
fn on_board(path: &str) -> String {
    match path.strip_suffix(".servo.inertia").filter(|joint| joint.starts_with("joints.")) {
        Some(joint) => format!("{joint}.servo.observer.inertia"),
        None => path.to_owned(),
    }
}

/// The number of a value as `30%`, of the present one.
fn percentage(value: &str) -> Option<f64> {
    let number = value.trim().strip_suffix('%')?.trim().parse::<f64>().ok()?;
    (number.abs() <= 1e6).then_some(number)
}

/// A supply that would be a fault at once is not set.
fn check_supply(model: &RobotModel, changed: &RobotModel, supply: f32) -> Result<(), Failure> {
    let is_outside =
        |model: &RobotModel| supply < model.safety.supply_min || supply > model.safety.supply_max;
    // Without sensor readings it is 0.
    if supply <= 0.0 || is_outside(model) || !is_outside(changed) {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "the supply is {supply:.1} V, outside {} to {} V: a fault at once",
        changed.safety.supply_min, changed.safety.supply_max
    )))
}

/// What is to be said of joints that stand outside the limits of the changed model, of those that are
/// `homed`.
fn standing_outside(
    session: &mut BoardSession,
    changed: &RobotModel,
    homed: u16,
) -> Result<Vec<String>, Failure> {
    let telemetry = match session.telemetry_now() {
        Ok(telemetry) => telemetry,
        // A board without sensor readings cannot be enabled anyway.
        Err(Failure::Late(_)) => return Ok(Vec::new()),
        Err(failure) => return Err(failure),
    };
    let joints = changed.joints.iter().zip(&telemetry.joints).enumerate();
    let found = joints.filter_map(|(index, (joint, state))| {
        let text = outside(joint, state.position, 0.0).filter(|_| homed >> index & 1 != 0)?;
        Some(format!("{text}; more than limits.following_error outside, it cannot be enabled"))
    });
    Ok(found.collect())
}

/// What is wrong with a value that is to become a list.
fn not_a_list(name: &str, old: &Value) -> String {
    format!(
        "{name} is a list{}: write it in brackets, as in `tesaki set {name} \"{old}\"`",
        match unit(name).as_str() {
            "" => String::new(),
            unit => format!(" in{unit}"),
        }
    )
}

/// What is wrong with the model after `path` was set.
fn invalid(model: &RobotModel, path: &str, changed: &RobotModel, error: &ModelError) -> String {
    let joint =
        error.joint.map_or_else(String::new, |joint| format!("{}: ", model.joint_name(usize::from(joint))));
    // The model names the upper limit, whichever of the two was set.
    if path.ends_with("supply_min") && error.field == Field::SupplyMax {
        let safety = &changed.safety;
        return format!(
            "safety.supply_min = {} V must be below safety.supply_max, {} V",
            safety.supply_min, safety.supply_max
        );
    }
    joint + &invalid_value(error)
}

/// The model with other numbers in the parameters `names`: what is said of it alike does not depend on them.
/// `None` where they hold no number that could be another.
fn with_other_values(tree: &Value, names: &[String]) -> Option<RobotModel> {
    let mut tree = tree.clone();
    for name in names {
        let value = at_mut(&mut tree, name).ok()?;
        let numbers = match value {
            Value::Array(numbers) => numbers.iter_mut().collect(),
            value => vec![value],
        };
        for number in numbers {
            *number = number.as_u64().map_or_else(
                || number.as_f64().map_or(Value::Null, |real| (1.5 * real + 1.0).into()),
                |count| (2 * count + 1).into(),
            );
        }
    }
    from_tree(tree).ok()
}

/// What is not likely in the changed model, and was not so before or depends on the parameters `names`, which
/// have other values in `other`.
pub fn doubtful(
    model: &RobotModel,
    changed: &RobotModel,
    other: Option<&RobotModel>,
    names: &[String],
) -> Vec<String> {
    let mut told = Vec::new();
    let product: f32 = model.gravity.iter().zip(changed.gravity).map(|(old, new)| old * new).sum();
    if product < 0.0 {
        told.push(format!(
            "gravity {:?} m/s² is upside down against {:?} m/s² before: the joints are pushed the wrong way",
            changed.gravity, model.gravity
        ));
    }
    let motor = |joint: &JointModel| joint.motor.torque_constant * joint.motor.current_limit;
    let sets_torque = |joint: &JointModel| names.contains(&format!("joints.{}.limits.torque", joint.name));
    for joint in changed.joints.iter().filter(|joint| sets_torque(joint)) {
        // A round number that is the product, or a current that is made smaller, is nobody's error.
        if joint.limits.torque > 1.01 * motor(joint) {
            told.push(format!(
                "{}: limits.torque = {} N·m limits nothing: with motor.current_limit the motor gives at most {:.3} N·m",
                joint.name,
                joint.limits.torque,
                motor(joint)
            ));
        }
    }
    let (before, independent) = (doubtful_values(model), other.map(doubtful_values));
    // A torque limit may be as low as one likes; one that is too high is told of above.
    let is_meant = |joint: Option<usize>, key: &str| {
        let joint = joint.and_then(|joint| changed.joints.get(joint));
        key == "motor.current_limit" && joint.is_some_and(sets_torque)
    };
    let mut of_joints: Vec<(String, Vec<&str>)> = Vec::new();
    for value in doubtful_values(changed) {
        let is_old = before.contains(&value) && independent.as_ref().is_none_or(|all| all.contains(&value));
        if is_old || is_meant(value.joint, value.key) {
            continue;
        }
        let text = format!("{}; {}", value.message, value.advice);
        let Some(joint) = value.joint else {
            told.push(text);
            continue;
        };
        let name = changed.joint_name(joint);
        match of_joints.iter_mut().find(|(known, _)| *known == text) {
            Some((_, names)) => names.push(name),
            None => of_joints.push((text, vec![name])),
        }
    }
    told.extend(of_joints.into_iter().map(|(text, names)| format!("{}: {text}", names.join(", "))));
    let (before, independent) = (overloaded(model), other.map(overloaded));
    for load in overloaded(changed) {
        let excess = |load: &Overload| load.gravity - load.torque;
        let is_old = before.iter().find(|old| old.joint == load.joint).is_some_and(|old| {
            excess(&load) < excess(old) || independent.as_ref().is_none_or(|all| all.contains(&load))
        });
        if is_old {
            continue;
        }
        let is_lowered = model.joints.get(load.joint).is_some_and(|joint| load.torque < joint.torque_limit());
        let (joint, gravity, torque) = (changed.joint_name(load.joint), load.gravity, load.torque);
        told.push(if is_lowered {
            format!(
                "{joint}: a torque of at most {torque:.3} N·m is below gravity, up to {gravity:.3} N·m: the joint cannot be \
                 held everywhere"
            )
        } else {
            format!(
                "{joint}: gravity needs up to {gravity:.3} N·m; the motor has {torque:.3} N·m: check masses and gravity"
            )
        });
    }
    told
}

/// Values that protect nothing, are a fault at once, or hold a joint fast, are not set. Those of the present
/// model are not judged.
pub fn check_values(model: &RobotModel, changed: &RobotModel) -> Result<(), Failure> {
    let before = implausible_values(model);
    let Some(found) = implausible_values(changed).into_iter().find(|found| !before.contains(found)) else {
        return Ok(());
    };
    let joint = found.joint.map_or_else(String::new, |joint| format!("{}: ", model.joint_name(joint)));
    Err(Failure::Usage(format!("{joint}{}; give {}", found.message, found.advice)))
}

/// The limits of an angle are those of the mechanism: they may be narrowed here, not widened.
fn check_stops(model: &RobotModel, changed: &RobotModel) -> Result<(), Failure> {
    for (old, new) in model.joints.iter().zip(&changed.joints) {
        let (old, limits) = (old.limits, new.limits);
        for (field, value, is_beyond) in [
            ("lower", limits.lower, limits.lower < old.lower),
            ("upper", limits.upper, limits.upper > old.upper),
        ] {
            if is_beyond {
                return Err(Failure::Usage(format!(
                    "joints.{}.limits.{field} = {value} is beyond the limits on the board, {} to {} rad: `set` \
                     only narrows them. To widen them, change robot.urdf and push the robot folder",
                    new.name, old.lower, old.upper
                )));
            }
        }
    }
    Ok(())
}

/// A value as it is typed: names of variants in small letters, as `set` and the robot folder have them.
fn typed(path: &str, value: &Value) -> Value {
    let small = Value::String(value.as_str().unwrap_or_default().to_lowercase());
    let is_same = parse(path, value, small.as_str().unwrap_or_default()) == *value;
    if !is_name(path) && is_same { small } else { value.clone() }
}

/// An error of the decoder in words, and with the names of variants as they are typed.
fn as_typed(problem: &str) -> String {
    if problem.starts_with("unknown variant") {
        return problem.to_lowercase();
    }
    in_words(problem)
}

/// Whether a parameter is the name of a robot, joint or tip, which has small letters and capitals.
fn is_name(path: &str) -> bool {
    path.rsplit('.').next() == Some("name")
}

/// A value from the command line; names of variants are capitalised as in the model.
fn parse(path: &str, old: &Value, text: &str) -> Value {
    let text = match serde_json::from_str(text) {
        // As `read` prints it, and as it stands in a file.
        Ok(Value::String(quoted)) => quoted,
        Ok(value) => return value,
        Err(_) => text.to_owned(),
    };
    let mut letters = text.chars();
    match letters.next() {
        Some(first) if old.is_string() && !is_name(path) => {
            Value::String(first.to_uppercase().chain(letters.flat_map(char::to_lowercase)).collect())
        }
        _ => Value::String(text),
    }
}

/// The model as a tree, with joints by name.
fn tree(model: &RobotModel) -> Value {
    let mut tree = output::exact(model);
    if let Some(joints) = tree.get_mut("joints")
        && let Value::Array(list) = joints.take()
    {
        let named = list.into_iter().map(|joint| {
            let name = joint.get("name").and_then(Value::as_str).unwrap_or_default().to_owned();
            (name, joint)
        });
        *joints = Value::Object(named.collect());
    }
    tree
}

/// The inverse of [`tree`].
fn from_tree(mut tree: Value) -> Result<RobotModel, serde_json::Error> {
    if let Some(joints) = tree.get_mut("joints")
        && let Value::Object(named) = joints.take()
    {
        *joints = Value::Array(named.into_iter().map(|(_, joint)| joint).collect());
    }
    serde_json::from_value(tree)
}

/// The paths that match `path`: each `*` stands for every joint, or every member of another group.
fn expand(tree: &Value, path: &str) -> Result<Vec<String>, Failure> {
    let Some((before, after)) = path.split_once('*') else {
        let path = path.strip_suffix('.').unwrap_or(path);
        at(tree, path)?;
        return Ok(vec![path.to_owned()]);
    };
    let group = at(tree, before.strip_suffix('.').unwrap_or(before))?;
    let Value::Object(members) = group else {
        let single = before.trim_end_matches('.');
        return Err(Failure::Usage(format!(
            "{path}: {single} is a single parameter and has no members for `*`"
        )));
    };
    let mut paths = Vec::new();
    for name in members.keys() {
        paths.extend(expand(tree, &format!("{before}{name}{after}"))?);
    }
    if paths.is_empty() {
        return Err(Failure::Usage(format!("{path} names no parameter: the group is empty")));
    }
    Ok(paths)
}

/// The member of a group that `path` begins with, and the rest of the path. A name may contain points.
fn step<'p>(value: &Value, path: &'p str) -> Option<(&'p str, &'p str)> {
    let names = value.as_object()?.keys();
    let begins = names.filter_map(|name| {
        let rest = path.strip_prefix(name.as_str())?;
        (rest.is_empty() || rest.starts_with('.')).then_some(name.len())
    });
    let (name, rest) = path.split_at_checked(begins.max()?)?;
    Some((name, rest.strip_prefix('.').unwrap_or(rest)))
}

/// What `path` names, if it exists.
fn member<'a>(value: &'a Value, path: &str) -> Option<&'a Value> {
    if path.is_empty() {
        return Some(value);
    }
    let (name, rest) = step(value, path)?;
    member(value.get(name)?, rest)
}

fn at<'a>(tree: &'a Value, path: &str) -> Result<&'a Value, Failure> {
    let (mut value, mut rest) = (tree, path);
    while !rest.is_empty() {
        let (name, behind) = step(value, rest).ok_or_else(|| unknown(tree, value, path, rest))?;
        (value, rest) = (value.get(name).unwrap_or(&Value::Null), behind);
    }
    Ok(value)
}

fn at_mut<'a>(tree: &'a mut Value, path: &str) -> Result<&'a mut Value, Failure> {
    at(tree, path)?;
    let (mut value, mut rest) = (tree, path);
    while let Some((name, behind)) = step(value, rest) {
        (value, rest) = (&mut value[name], behind);
    }
    Ok(value)
}

/// `rest` of `path` names nothing in the group `value` of the tree.
fn unknown(tree: &Value, value: &Value, path: &str, rest: &str) -> Failure {
    let group = path.strip_suffix(rest).unwrap_or_default().trim_end_matches('.');
    let Value::Object(members) = value else {
        return Failure::Usage(format!("{group} is a single parameter, it has no {rest:?}"));
    };
    let known = members.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
    Failure::Usage(if let Some(meant) = meant(tree, path).filter(|_| group.is_empty()) {
        format!("there is no parameter {rest:?}; did you mean {meant}?")
    } else if group.is_empty() {
        format!("there is no parameter {rest:?}; the groups of parameters are {known}")
    } else {
        format!("there is no parameter {rest:?} in {group}, which has {known}")
    })
}

/// What may be meant by a path that begins with the name of a joint or of a chain, or without a joint's.
fn meant(tree: &Value, path: &str) -> Option<String> {
    let joints = tree.get("joints")?;
    if step(joints, path).is_some() {
        return Some(on_board(&format!("joints.{path}")));
    }
    let any = joints.as_object()?.keys().next()?;
    if member(tree, &on_board(&format!("joints.{any}.{path}"))).is_some() {
        return Some(on_board(&format!("joints.NAME.{path}")));
    }
    let names = tree.get("chains")?.as_array()?.iter().filter_map(|chain| chain.get("name")?.as_str());
    let begins =
        |name: &str| path.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
    names.into_iter().any(begins).then(|| "chains, the list of all chains".to_owned())
}

fn leaves(path: &str, value: &Value, found: &mut Vec<(String, Value)>) {
    match value {
        Value::Object(group) => {
            for (name, value) in group {
                let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                leaves(&path, value, found);
            }
        }
        value => found.push((path.to_owned(), value.clone())),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_number_of_a_model_has_a_unit_or_is_known_to_have_none() {
        const NONE: [&str; 3] = ["axis", "origin.rotation", "encoder.counts_per_turn"];
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
        let model = tesaki_description::robot::RobotFolder::load(&folder).unwrap().model;
        let mut found = Vec::new();
        leaves("", &tree(&model), &mut found);
        let numbers = found.iter().filter(|(path, value)| {
            path != "chains" && path != "mimics" && (value.is_number() || value.is_array())
        });
        let bare: Vec<_> = numbers
            .filter(|(path, _)| unit(path).is_empty() && !NONE.iter().any(|name| path.ends_with(name)))
            .collect();
        assert!(bare.is_empty() && found.len() > 100, "no unit: {bare:?}");
    }

    #[test]
    fn each_star_stands_for_all_members_of_its_group() {
        let joint = json!({ "name": "a", "limits": { "lower": -1.0, "upper": 1.0 } });
        let tree = json!({ "joints": { "left.a": joint, "right.a": joint }, "none": {}, "chains": [{ "name": "tip" }] });
        let paths = |path: &str| expand(&tree, path).unwrap();
        assert_eq!(
            paths("joints.*.limits.upper"),
            ["joints.left.a.limits.upper", "joints.right.a.limits.upper"]
        );
        assert_eq!(
            paths("joints.*.limits.*"),
            [
                "joints.left.a.limits.lower",
                "joints.left.a.limits.upper",
                "joints.right.a.limits.lower",
                "joints.right.a.limits.upper",
            ]
        );
        for (path, words) in [
            ("joints.*.name.*", "joints.left.a.name is a single parameter"),
            ("none.*", "none.* names no parameter"),
            ("joints.*.torque", "there is no parameter \"torque\" in joints.left.a"),
            ("right.a.limits.upper", "did you mean joints.right.a.limits.upper?"),
            ("tip.name", "did you mean chains, the list of all chains?"),
            ("limits.upper", "did you mean joints.NAME.limits.upper?"),
            ("colour", "the groups of parameters are joints, none, chains"),
        ] {
            let error = expand(&tree, path).unwrap_err();
            assert!(matches!(&error, Failure::Usage(text) if text.contains(words)), "{path}: {error}");
        }
    }
}
