//! Names are unique, and the joints make one tree of the links.

use std::collections::{BTreeMap, BTreeSet};

use super::source::{Part, Source};
use crate::finding::Report;

const TYPES: [&str; 7] = ["revolute", "continuous", "fixed", "prismatic", "floating", "planar", "spherical"];

/// The base, when the links form a tree.
pub fn check(source: &Source<'_>, report: &mut Report) -> Option<String> {
    let before = report.findings.len();
    unique(&source.links, report);
    unique(&source.joints, report);
    if source.links.is_empty() {
        let line = Some(source.root.line());
        report.kinematics(line, "no links", "a URDF has <link name=\"…\"> for every rigid body");
    }
    for joint in &source.joints {
        kind(joint, report);
        ends(joint, &source.links, report);
    }
    parents(&source.joints, report);
    // What follows would only repeat it.
    if report.findings.len() > before { None } else { base(source, report) }
}

fn unique(parts: &[Part<'_>], report: &mut Report) {
    let mut seen = BTreeMap::new();
    for part in parts {
        if part.name().is_empty() {
            let message = format!("a {} without a name", part.tag());
            report.kinematics(Some(part.line()), message, "add name=\"…\"");
        } else if part.name().contains(char::is_control) || part.name() == "*" {
            // Files and command lines have names, and `*` stands for all joints.
            let message = format!("a {} with the name {:?}", part.tag(), part.name());
            report.kinematics(Some(part.line()), message, "give a name of letters, digits, _ and -");
        } else if let Some(first) = seen.insert(part.name(), part.line()) {
            let message = format!("{} exists twice, first in line {first}", part.title());
            report.kinematics(Some(part.line()), message, "names must be unique");
        }
    }
}

fn kind(joint: &Part<'_>, report: &mut Report) {
    let kind = joint.attribute("type").unwrap_or_default();
    if !TYPES.contains(&kind) {
        let message = format!("{}: unknown joint type {kind:?}", joint.title());
        report.kinematics(Some(joint.line()), message, format!("types are {}", TYPES.join(", ")));
    }
}

/// The joint hangs between two links that exist.
fn ends(joint: &Part<'_>, links: &[Part<'_>], report: &mut Report) {
    for tag in ["parent", "child"] {
        let line = joint.child(tag).unwrap_or(*joint).line();
        match joint.link(tag) {
            None => {
                let message = format!("{} has no {tag}", joint.title());
                report.kinematics(Some(line), message, format!("add <{tag} link=\"…\"/>"));
            }
            Some(name) if !links.iter().any(|link| link.name() == name) => {
                let message = format!("{}: the {tag} link {name:?} does not exist", joint.title());
                let advice = format!("add <link name={name:?}/>, or take one of: {}", names(links));
                report.kinematics(Some(line), message, advice);
            }
            Some(_) => {}
        }
    }
}

fn parents(joints: &[Part<'_>], report: &mut Report) {
    let mut seen: BTreeMap<&str, &Part<'_>> = BTreeMap::new();
    for joint in joints {
        let Some(child) = joint.link("child") else { continue };
        if let Some(first) = seen.insert(child, joint) {
            let message = format!(
                "the link {child:?} is the child of two joints, {} (line {}) and {}: a loop",
                first.name(),
                first.line(),
                joint.name()
            );
            let advice =
                "only trees are supported: remove the joint that closes the loop, or use a mimic joint";
            report.kinematics(Some(joint.line()), message, advice);
        }
    }
}

/// The one link that hangs on nothing, when all others hang on it.
fn base(source: &Source<'_>, report: &mut Report) -> Option<String> {
    let parent: BTreeMap<&str, &Part<'_>> =
        source.joints.iter().filter_map(|joint| Some((joint.link("child")?, joint))).collect();
    let roots: Vec<&Part<'_>> =
        source.links.iter().filter(|link| !parent.contains_key(link.name())).collect();
    if let [first, others @ ..] = &*roots {
        for other in others {
            let message = format!(
                "two bases: neither {:?} (line {}) nor {:?} is the child of a joint",
                first.name(),
                first.line(),
                other.name()
            );
            report.kinematics(Some(other.line()), message, "add the joint between them");
        }
    }
    let looped = loops(&source.links, &parent, report);
    match *roots {
        [base] if !looped => Some(base.name().to_owned()),
        _ => None,
    }
}

/// Tells of every loop once.
fn loops(links: &[Part<'_>], parent: &BTreeMap<&str, &Part<'_>>, report: &mut Report) -> bool {
    let mut settled = BTreeSet::new();
    let mut found = false;
    for link in links {
        let (mut here, mut path) = (link.name(), Vec::new());
        while settled.insert(here) {
            let Some(joint) = parent.get(here) else { break };
            path.push((here, *joint));
            here = joint.link("parent").unwrap_or_default();
        }
        // The path came back to a link: the joints since then form a loop.
        if let Some(start) = path.iter().position(|(link, _)| *link == here) {
            let joints: Vec<&str> = path.iter().skip(start).map(|(_, joint)| joint.name()).collect();
            let line = path.get(start).map(|(_, joint)| joint.line());
            let message = format!("the joints form a loop: {}", joints.join(", "));
            report.kinematics(line, message, "one of them must be attached to the base instead");
            found = true;
        }
    }
    found
}

/// Up to a dozen names.
pub fn names(parts: &[Part<'_>]) -> String {
    let mut names: Vec<&str> = parts.iter().map(Part::name).take(12).collect();
    if parts.len() > names.len() {
        names.push("…");
    }
    names.join(", ")
}
