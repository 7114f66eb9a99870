//! Units of the model's parameters, and errors of the model with them.

use tesaki::model::{Field, ModelError, Problem};

/// Ends of the paths of parameters, with their units; the first that fits counts.
const UNITS: [(&str, &str); 45] = [
    ("gravity", "m/s²"),
    ("link.mass", "kg"),
    ("link.center_of_mass", "m"),
    ("link.inertia", "kg·m²"),
    ("inertial mass", "kg"),
    ("inertial origin xyz", "m"),
    ("inertial inertia", "kg·m²"),
    ("origin.translation", "m"),
    ("origin xyz", "m"),
    ("tip xyz", "m"),
    ("motor.rotor_inertia", "kg·m²"),
    ("motor.torque_constant", "N·m/A"),
    ("motor.current_limit", "A"),
    ("motor.current_resolution", "A"),
    ("motor.bandwidth", "Hz"),
    ("motor.delay", "s"),
    ("motor.resistance", "Ω"),
    ("motor.inductance", "H"),
    ("friction.coulomb", "N·m"),
    ("friction.viscous", "N·m·s/rad"),
    ("encoder.zero", "counts"),
    ("limits.lower", "rad"),
    ("limits.upper", "rad"),
    ("limits.velocity", "rad/s"),
    ("limits.torque", "N·m"),
    ("limits.torque_rate", "N·m/s"),
    ("limits.following_error", "rad"),
    ("servo.filter_time", "s"),
    ("servo.rest_error", "rad"),
    ("pid.proportional", "N·m/rad"),
    ("pid.integral", "N·m/(rad·s)"),
    ("pid.derivative", "N·m·s/rad"),
    ("pid.cutoff", "rad/s"),
    ("observer.inertia", "kg·m²"),
    ("observer.bandwidth", "rad/s"),
    ("observer.observer_bandwidth", "rad/s"),
    ("safety.command_timeout", "s"),
    ("safety.damping", "N·m·s/rad"),
    ("safety.supply_min", "V"),
    ("safety.supply_max", "V"),
    ("force_sensor.force_resolution", "N"),
    ("force_sensor.torque_resolution", "N·m"),
    ("force_sensor.force_limit", "N"),
    ("mass of the tip", "kg"),
    ("radius of the tip", "m"),
];

/// The unit of a parameter, after a space; empty for one that has none.
pub fn unit(path: &str) -> String {
    let ends = |end: &str| path == end || path.ends_with(&format!(".{end}"));
    UNITS.into_iter().find(|(end, _)| ends(end)).map_or_else(String::new, |(_, unit)| format!(" {unit}"))
}

/// The path of a field in `controller.toml`, below `joint`.
pub fn key(field: Field) -> &'static str {
    match field {
        Field::ServoInertia => "servo.inertia",
        field => field.path(),
    }
}

/// As [`invalid_value`], with gains per inertia as in `controller.toml`, for a joint with this `inertia`.
pub fn invalid_setting(error: &ModelError, inertia: f32) -> String {
    let unit = match error.field {
        Field::Proportional => "1/s²",
        Field::Integral => "1/s³",
        Field::Derivative => "1/s",
        field => return in_unit(error, key(field), &unit(field.path())),
    };
    // The quotient need not be exactly the number in the file.
    let per_inertia = |value: f32| format!("{:.5e}", value / inertia).parse().unwrap_or(value);
    let problem = match error.problem {
        Problem::Below(limit) => Problem::Below(per_inertia(limit)),
        Problem::Above(limit) => Problem::Above(per_inertia(limit)),
        problem => problem,
    };
    let error = ModelError { value: per_inertia(error.value), problem, ..*error };
    in_unit(&error, error.field.path(), &format!(" {unit}"))
}

/// A parameter of the model that is wrong: path and value, what is wrong with it, and the limit.
pub fn invalid_value(error: &ModelError) -> String {
    in_unit(error, error.field.path(), &unit(error.field.path()))
}

fn in_unit(error: &ModelError, path: &str, unit: &str) -> String {
    let of_limit = match error.problem {
        Problem::Below(_) | Problem::NotAbove(_) | Problem::Above(_) => unit,
        _ => "",
    };
    format!("{path} = {}{unit} {}{of_limit}", error.value, error.problem)
}
