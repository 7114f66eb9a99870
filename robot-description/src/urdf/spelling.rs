//! Names that are nearly those of a URDF: what `urdf-rs` does not know it ignores, and uses its default.

use super::numbers::NUMBERS;
use super::source::Source;
use crate::finding::Report;
use crate::spelling::meant;

/// Attributes that hold words: element, attributes. Those that hold numbers are [`NUMBERS`].
const WORDS: &[(&str, &[&str])] = &[("link", &["name"]), ("joint", &["name", "type"]), ("mimic", &["joint"])];

/// What is looked at: elements, and the elements in them.
const ELEMENTS: &[(&str, &[&str])] = &[
    ("link", &["inertial", "visual", "collision"]),
    ("inertial", &["origin", "mass", "inertia"]),
    ("mass", &[]),
    ("inertia", &[]),
    (
        "joint",
        &[
            "origin",
            "parent",
            "child",
            "axis",
            "limit",
            "dynamics",
            "mimic",
            "calibration",
            "safety_controller",
        ],
    ),
    ("origin", &[]),
    ("axis", &[]),
    ("limit", &[]),
    ("dynamics", &[]),
    ("mimic", &[]),
];

pub fn check(source: &Source<'_>, report: &mut Report) {
    for part in source.links.iter().chain(&source.joints) {
        for element in part.descendants() {
            let Some((tag, elements)) = ELEMENTS.iter().find(|(tag, _)| *tag == element.tag()) else {
                continue;
            };
            let place =
                if element.node == part.node { part.title() } else { format!("{}: <{tag}>", part.title()) };
            let numbers = NUMBERS.iter().filter(|(of, ..)| of.is_empty() || of == tag);
            let words = WORDS.iter().filter(|(of, _)| of == tag).flat_map(|(_, attributes)| *attributes);
            let known: Vec<&str> = numbers.map(|(_, name, _)| *name).chain(words.copied()).collect();
            for attribute in element.node.attributes() {
                if let Some(meant) = meant(attribute.name(), &known) {
                    let message = format!("{place}: unknown attribute {}", attribute.name());
                    report.warning(Some(element.line()), message, advice(meant));
                }
            }
            for inner in element.parts() {
                if let Some(meant) = meant(inner.tag(), elements) {
                    let message = format!("{place}: unknown element <{}>", inner.tag());
                    report.warning(Some(inner.line()), message, advice(meant));
                }
            }
        }
    }
}

fn advice(meant: &str) -> String {
    format!("it is ignored: write {meant}, or remove it")
}
