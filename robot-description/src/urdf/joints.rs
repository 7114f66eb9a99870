//! Joints have an axis, limits and lengths that make sense, and mimic joints follow others.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use super::four;
use super::source::{Part, Source};
use super::structure::names;
use crate::finding::Report;

/// Longest distance between the origins of two links [m].
const LONGEST_LINK: f64 = 5.0;
/// Longest path from the base to a tip [m].
const LONGEST_PATH: f64 = 20.0;
/// Largest angle in a file [rad].
pub const LARGEST_ANGLE: f64 = 4.0 * PI;
/// What is beyond it is not meant in degrees either: so says who knows no limit.
const NO_LIMIT: f64 = 1e4;

pub fn check(source: &Source<'_>, report: &mut Report) {
    for joint in &source.joints {
        origin(joint, report);
        if matches!(joint.attribute("type"), Some("revolute" | "continuous" | "prismatic")) {
            axis(joint, report);
            signs(joint, report);
        }
        if joint.attribute("type") == Some("revolute") {
            limits(joint, report);
        }
        if joint.child("mimic").is_some() {
            mimic(joint, source, report);
        }
    }
    whole_length(source, report);
}

/// Distance and turn from the parent link's frame.
fn origin(joint: &Part<'_>, report: &mut Report) {
    let Some(origin) = joint.child("origin") else { return };
    let line = Some(origin.line());
    let length = distance(joint);
    if length > LONGEST_LINK {
        let message = format!(
            "{}: {} m from the parent link's origin, more than {LONGEST_LINK} m: millimetres?",
            joint.title(),
            four(length)
        );
        report.kinematics(
            line,
            message,
            format!("lengths are in m: {} mm are {}", four(length), four(length / 1000.0)),
        );
    }
    let largest = origin.vector("rpy").map_or(0.0, |rpy| rpy.iter().fold(0.0, |a: f64, b| a.max(b.abs())));
    if largest > LARGEST_ANGLE {
        let message = format!("{}: rpy of {largest} rad, beyond ±4π: degrees?", joint.title());
        report.kinematics(line, message, degrees(largest));
    }
}

fn degrees(value: f64) -> String {
    format!("angles are in rad: {value}° are {:.4}", value.to_radians())
}

fn distance(joint: &Part<'_>) -> f64 {
    let xyz = joint.child("origin").and_then(|origin| origin.vector("xyz")).unwrap_or_default();
    xyz.iter().map(|value| value * value).sum::<f64>().sqrt()
}

fn axis(joint: &Part<'_>, report: &mut Report) {
    let Some(axis) = joint.child("axis") else {
        let message = format!("{} has no <axis>: the default is x", joint.title());
        report.warning(Some(joint.line()), message, "say so: <axis xyz=\"1 0 0\"/>");
        return;
    };
    if let Some(xyz) = axis.vector("xyz")
        && xyz.iter().all(|value| value.abs() < 1e-6)
    {
        let message = format!("{}: its axis {xyz:?} is not a direction", joint.title());
        report.kinematics(Some(axis.line()), message, "use for example <axis xyz=\"0 0 1\"/>");
    }
}

/// Magnitudes that cannot be below 0.
fn signs(joint: &Part<'_>, report: &mut Report) {
    for (tag, attribute) in
        [("limit", "effort"), ("limit", "velocity"), ("dynamics", "damping"), ("dynamics", "friction")]
    {
        let Some(part) = joint.child(tag) else { continue };
        if let Some(value) = part.number(attribute).filter(|value| *value < 0.0) {
            let message = format!("{}: {attribute} = {value} is below 0", joint.title());
            report.dynamics(Some(part.line()), message, "it is a magnitude, without a sign");
        }
    }
}

fn limits(joint: &Part<'_>, report: &mut Report) {
    let limit = joint.child("limit");
    let line = Some(limit.unwrap_or(*joint).line());
    let bound = |name| match limit.and_then(|limit| limit.attribute(name).map(|_| limit)) {
        Some(limit) => limit.number(name),
        None => Some(0.0),
    };
    // What is no number has been told.
    let (Some(lower), Some(upper)) = (bound("lower"), bound("upper")) else { return };
    if let Some(soft) = joint.child("safety_controller") {
        let bounds = ["soft_lower_limit", "soft_upper_limit"].map(|name| soft.number(name).unwrap_or(0.0));
        if bounds[0] < bounds[1] && (bounds[0] > lower || bounds[1] < upper) {
            let message = format!(
                "{}: the soft limits of <safety_controller>, {} to {} rad, are not used",
                joint.title(),
                bounds[0],
                bounds[1]
            );
            report.warning(Some(soft.line()), message, "narrow <limit> to them if the joint shall keep them");
        }
    }
    if lower == 0.0 && upper == 0.0 {
        let message = format!("{}: lower = upper = 0: limits are missing", joint.title());
        let advice = "add <limit lower=\"…\" upper=\"…\" effort=\"…\" velocity=\"…\"/> in rad, N·m, rad/s";
        report.limits(line, message, advice);
    } else if lower >= upper {
        let message = format!("{}: lower = {lower} is not below upper = {upper}", joint.title());
        report.limits(line, message, "swap or correct them");
    } else if lower.abs().max(upper.abs()) > NO_LIMIT {
        let message = format!("{}: limits {lower:e} to {upper:e} rad are no limits at all", joint.title());
        let advice = "give real limits in rad: where its stops, its cables or its links end the motion";
        report.limits(line, message, advice);
    } else if let Some(value) = [lower, upper].into_iter().find(|value| value.abs() > LARGEST_ANGLE) {
        let message = format!("{}: limits {lower} to {upper} rad, beyond ±4π: degrees?", joint.title());
        report.limits(line, message, degrees(value));
    }
}

/// The joint follows one that exists and, in the end, one that follows none.
fn mimic(joint: &Part<'_>, source: &Source<'_>, report: &mut Report) {
    let mut here = *joint;
    let line = joint.child("mimic").map(|mimic| mimic.line());
    for _ in &source.joints {
        let Some(mimic) = here.child("mimic") else { return };
        let Some(next) = mimic.attribute("joint") else { return };
        if next == joint.name() {
            let what = if here.name() == next { "itself" } else { "itself indirectly" };
            let message = format!("{} mimics {what}", joint.title());
            report.kinematics(line, message, "name the joint that has the motor");
            return;
        }
        match source.joint(next) {
            Some(joint) => here = joint,
            None => {
                if here.name() == joint.name() {
                    let message = format!("{} mimics {next:?}, which does not exist", joint.title());
                    report.kinematics(line, message, format!("joints are {}", names(&source.joints)));
                }
                return;
            }
        }
    }
}

/// The length of the path from the base to any link; reports nothing if a single joint is already too long.
fn whole_length(source: &Source<'_>, report: &mut Report) {
    if source.joints.iter().any(|joint| distance(joint) > LONGEST_LINK) {
        return;
    }
    let parent: BTreeMap<&str, &Part<'_>> =
        source.joints.iter().filter_map(|joint| Some((joint.link("child")?, joint))).collect();
    let carries =
        |link: &Part<'_>| source.joints.iter().any(|joint| joint.link("parent") == Some(link.name()));
    for link in source.links.iter().filter(|link| !carries(link)) {
        let (mut length, mut here) = (0.0, link.name());
        // No path has more joints than the robot, unless it is a loop.
        for _ in &source.joints {
            let Some(joint) = parent.get(here) else { break };
            length += distance(joint);
            here = joint.link("parent").unwrap_or_default();
        }
        if length > LONGEST_PATH {
            let message = format!(
                "{}: {length} m from the base along the joints, more than {LONGEST_PATH} m: millimetres?",
                link.title()
            );
            report.kinematics(Some(link.line()), message, "lengths are in m: divide every xyz by 1000");
        }
    }
}
