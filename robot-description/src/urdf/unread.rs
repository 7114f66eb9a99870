//! What `urdf-rs` does not read and tells without a line: the element is found by leaving others out.

use std::ops::Range;

use super::numbers;
use super::source::{Part, Source};
use crate::finding::Report;

const ADVICE: &str =
    "correct it, or remove it if nothing needs it: http://wiki.ros.org/urdf/XML says what it may hold";

/// The robot in `text`, without what `urdf-rs` does not read and nothing needs: elements that have no shape,
/// and textures without a file. If it cannot be read, what is wrong.
pub fn read(text: &str, source: &Source<'_>, report: &mut Report) -> Option<urdf_rs::Robot> {
    let shapeless = source.links.iter().flat_map(numbers::shapeless);
    let textures = source.root.descendants().filter(|part| part.tag() == "texture");
    let empty = textures.filter(|texture| texture.attribute("filename").is_none());
    let mut unneeded: Vec<_> = shapeless.chain(empty).map(|part| part.node.range()).collect();
    unneeded.sort_by_key(|range| range.start);
    let error = match urdf_rs::read_from_string(&without(text, 0..text.len(), &unneeded)) {
        Ok(robot) => return Some(robot),
        Err(error) => error,
    };
    for part in source.root.parts() {
        tell(text, source, &part, &unneeded, report);
    }
    if report.has_no_kinematics() {
        let (message, advice) = in_words(&error.to_string());
        report.kinematics(Some(source.root.line()), message, advice);
    }
    None
}

/// Tells of a link, a joint or another child of `<robot>` that cannot be read by itself, unless something in
/// its lines has been told already.
fn tell(text: &str, source: &Source<'_>, part: &Part<'_>, unneeded: &[Range<usize>], report: &mut Report) {
    let range = part.node.range();
    let head = text.get(source.root.head()).unwrap_or_default();
    let alone = |left_out: &[Range<usize>]| {
        let element = without(text, range.clone(), left_out);
        urdf_rs::read_from_string(&format!("{head}{element}</robot>"))
    };
    let Err(error) = alone(unneeded) else { return };
    if report.has_kinematics_in(part.lines()) {
        return;
    }
    // The innermost element without which the rest can be read.
    let culprits = part.descendants().skip(1).filter(|inner| {
        let mut left_out = unneeded.to_vec();
        left_out.push(inner.node.range());
        left_out.sort_by_key(|range| range.start);
        alone(&left_out).is_ok()
    });
    let culprit = culprits.last().unwrap_or(*part);
    let inner = if culprit.node == part.node { String::new() } else { format!(": <{}>", culprit.tag()) };
    let (words, advice) = in_words(&error.to_string());
    let message = format!("{}{inner}: {words}", part.title().trim());
    report.kinematics(Some(culprit.line()), message.trim(), advice);
}

/// What `urdf-rs` says, and what to do about it.
fn in_words(error: &str) -> (String, String) {
    let error = error.trim();
    let error = error.strip_prefix("custom: ").unwrap_or(error);
    match error.strip_prefix("missing field `").and_then(|rest| rest.split('`').next()) {
        Some(field) => {
            let field = field.trim_start_matches('@');
            let element = if field == "name" { String::new() } else { format!(" or <{field} …/>") };
            let advice = format!("add {field}=\"…\"{element}, or remove the element");
            (format!("it has no {field}"), advice)
        }
        None => (error.to_owned(), ADVICE.to_owned()),
    }
}

/// The part `window` of `text` without the ranges, which are in order; one may be within another.
fn without(text: &str, window: Range<usize>, ranges: &[Range<usize>]) -> String {
    let mut kept = String::with_capacity(window.len());
    let mut end = window.start;
    for range in ranges.iter().filter(|range| window.start <= range.start && range.end <= window.end) {
        kept.push_str(text.get(end..range.start).unwrap_or_default());
        end = end.max(range.end);
    }
    kept.push_str(text.get(end..window.end).unwrap_or_default());
    kept
}
