//! Every number of links and joints is one, and finite; nothing that is needed is missing, or there twice.

use super::source::{Part, Source};
use crate::finding::Report;

/// Attributes that hold numbers, and how many: element, attribute, count. An empty element means any.
pub const NUMBERS: &[(&str, &str, usize)] = &[
    ("", "xyz", 3),
    ("", "rpy", 3),
    ("", "quat_xyzw", 4),
    ("color", "rgba", 4),
    ("box", "size", 3),
    ("mesh", "scale", 3),
    ("sphere", "radius", 1),
    ("cylinder", "radius", 1),
    ("cylinder", "length", 1),
    ("capsule", "radius", 1),
    ("capsule", "length", 1),
    ("mass", "value", 1),
    ("inertia", "ixx", 1),
    ("inertia", "iyy", 1),
    ("inertia", "izz", 1),
    ("inertia", "ixy", 1),
    ("inertia", "ixz", 1),
    ("inertia", "iyz", 1),
    ("limit", "lower", 1),
    ("limit", "upper", 1),
    ("limit", "effort", 1),
    ("limit", "velocity", 1),
    ("dynamics", "damping", 1),
    ("dynamics", "friction", 1),
    ("mimic", "multiplier", 1),
    ("mimic", "offset", 1),
    ("calibration", "rising", 1),
    ("calibration", "falling", 1),
    ("safety_controller", "soft_lower_limit", 1),
    ("safety_controller", "soft_upper_limit", 1),
    ("safety_controller", "k_position", 1),
    ("safety_controller", "k_velocity", 1),
];

/// Attributes without which an element cannot be read: element, attributes.
const NEEDED: &[(&str, &[&str])] = &[
    ("axis", &["xyz"]),
    ("mass", &["value"]),
    ("inertia", &["ixx", "iyy", "izz", "ixy", "ixz", "iyz"]),
    ("mimic", &["joint"]),
    ("box", &["size"]),
    ("sphere", &["radius"]),
    ("cylinder", &["radius", "length"]),
    ("capsule", &["radius", "length"]),
    ("mesh", &["filename"]),
];

/// Elements of which there can be one at most in another.
const SINGLE: &[&str] = &[
    "inertial",
    "origin",
    "mass",
    "inertia",
    "geometry",
    "parent",
    "child",
    "axis",
    "limit",
    "dynamics",
    "mimic",
    "calibration",
    "safety_controller",
];

pub fn check(source: &Source<'_>, report: &mut Report) {
    for owner in source.links.iter().chain(&source.joints) {
        for part in shapeless(owner) {
            let message = format!("{}: its <{}> has no shape", owner.title(), part.tag());
            report.warning(Some(part.line()), message, "it is ignored; add a shape, or remove it");
        }
        let ignored: Vec<_> = shapeless(owner).map(|part| part.node.range()).collect();
        for part in owner.descendants() {
            let start = part.node.range().start;
            if ignored.iter().any(|range| range.contains(&start)) {
                continue;
            }
            for attribute in part.node.attributes() {
                number(owner, &part, attribute.name(), attribute.value(), report);
            }
            needed(owner, &part, report);
            single(owner, &part, report);
        }
        negative(owner, report);
    }
    for material in source.root.children("material") {
        for part in material.descendants() {
            for attribute in part.node.attributes() {
                number(&material, &part, attribute.name(), attribute.value(), report);
            }
        }
    }
    for joint in &source.joints {
        // Since URDF 1.2 everything in <limit> may be left out.
        let limit = joint.child("limit").filter(|_| source.root.attribute("version").is_none());
        if let Some(limit) = limit.filter(|limit| limit.attribute("velocity").is_none()) {
            let message = format!("{}: <limit> has no velocity", joint.title());
            report.kinematics(
                Some(limit.line()),
                message,
                "add velocity=\"…\" in rad/s (m/s for a prismatic joint)",
            );
        }
    }
}

/// Shapes that can be read.
const SHAPES: [&str; 5] = ["box", "cylinder", "capsule", "sphere", "mesh"];

/// What is to be seen or touched of a link, but has no shape: no geometry, an empty one, or `<mesh/>` without
/// a file. Exporters write such for links without a surface.
pub fn shapeless<'a>(link: &Part<'a>) -> impl Iterator<Item = Part<'a>> + use<'a> {
    let parts = link.children("visual").chain(link.children("collision"));
    parts.filter(|part| {
        let shape = |geometry: Part<'_>| geometry.descendants().nth(1).is_some_and(|shape| is_shape(&shape));
        !part.child("geometry").is_some_and(shape)
    })
}

fn is_shape(part: &Part<'_>) -> bool {
    let is_empty_mesh = || part.attribute("filename").is_none_or(|name| name.trim().is_empty());
    SHAPES.contains(&part.tag()) && !(part.tag() == "mesh" && is_empty_mesh())
}

fn number(owner: &Part<'_>, part: &Part<'_>, name: &str, value: &str, report: &mut Report) {
    let known = |(tag, attribute, _): &&(&str, &str, usize)| {
        *attribute == name && (tag.is_empty() || *tag == part.tag())
    };
    let Some(&(_, _, count)) = NUMBERS.iter().find(known) else { return };
    let words: Vec<&str> = value.split_whitespace().collect();
    let stranger = words.iter().find(|word| !word.parse().is_ok_and(f64::is_finite));
    let message = match stranger {
        Some(word) => format!("{word:?} is not a finite number"),
        None if words.len() != count => format!("{} numbers, {count} expected", words.len()),
        None => return,
    };
    let message = format!("{}: <{} {name}={value:?}>: {message}", owner.title(), part.tag());
    let advice = if value.contains("${") || value.contains("$(") {
        "a xacro expression: `xacro FILE.xacro > robot.urdf` computes it"
    } else {
        "write numbers such as 0.05 or 1e-6, with a point, separated by spaces"
    };
    report.kinematics(Some(part.line()), message, advice);
}

/// The first shape of a link with a length below 0: that to be seen is mostly that to be touched.
fn negative(owner: &Part<'_>, report: &mut Report) {
    let sizes = owner.descendants().filter(|part| SHAPES.contains(&part.tag())).flat_map(|part| {
        ["radius", "length"].into_iter().filter_map(move |name| Some((part, name, part.number(name)?)))
    });
    let first = sizes.into_iter().find(|(_, _, value)| *value < 0.0);
    if let Some((part, name, value)) = first {
        let message = format!("{}: <{}> has a {name} of {value} m, below 0", owner.title(), part.tag());
        report.dynamics(Some(part.line()), message, "it is a length, without a sign");
    }
}

fn needed(owner: &Part<'_>, part: &Part<'_>, report: &mut Report) {
    let Some((_, names)) = NEEDED.iter().find(|(tag, _)| *tag == part.tag()) else { return };
    for name in names.iter().filter(|name| part.attribute(name).is_none()) {
        let message = format!("{}: <{}> has no {name}", owner.title(), part.tag());
        report.kinematics(Some(part.line()), message, format!("add {name}=\"…\""));
    }
}

fn single(owner: &Part<'_>, part: &Part<'_>, report: &mut Report) {
    for tag in SINGLE {
        if let Some(second) = part.children(tag).nth(1) {
            let message = format!("{}: a second <{tag}>", owner.title());
            report.kinematics(Some(second.line()), message, "remove one");
        }
    }
}
