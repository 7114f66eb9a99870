//! Masses that a body can have.

use nalgebra::{Matrix3, Vector3};

use super::four;
use super::source::{Part, Source};
use crate::finding::{Finding, Matter, Report, Severity};

/// Largest mass of a link [kg].
const LARGEST_MASS: f64 = 1000.0;
/// Largest radius of gyration of a link [m].
const LARGEST_RADIUS: f64 = 2.0;
/// Largest distance of a centre of mass from its link's origin [m].
const FARTHEST_CENTER: f64 = 5.0;
/// Largest component of an inertia that is looked at more closely [kg·m²].
const LARGEST_INERTIA: f64 = 1e6;

const UNITS: &str = "inertias are in kg·m²: 1 kg·mm² is 1e-6, 1 g·mm² is 1e-9";

const ACCEPT: &str = "or accept the nearest possible inertia: its name in accept_inertia of controller.toml \
    (`tesaki model init --accept-inertia`)";

/// Reports masses that no body has; of the `accepted` links only what cannot be replaced.
pub fn check(source: &Source<'_>, accepted: &[String], report: &mut Report) {
    for link in &source.links {
        let accepted = accepted.iter().any(|name| name == link.name());
        match link.child("inertial") {
            Some(inertial) => {
                let before = report.findings.len();
                body(link, &inertial, accepted, report);
                if !moves(link, source) {
                    of_fixed(report.findings.get_mut(before..).unwrap_or_default());
                }
            }
            None if accepted => {
                let message = format!("{}: accepted without mass: a gram is used", link.title());
                report.warning(Some(link.line()), message, "give it an <inertial> when its mass is known");
            }
            None => {}
        }
    }
}

/// Whether a moving joint is between a link and the base.
fn moves(link: &Part<'_>, source: &Source<'_>) -> bool {
    let mut here = link.name();
    // No path has more joints than the robot, unless it is a loop.
    for _ in &source.joints {
        let Some(joint) = source.joints.iter().find(|joint| joint.link("child") == Some(here)) else { break };
        if joint.moves() {
            return true;
        }
        here = joint.link("parent").unwrap_or_default();
    }
    false
}

/// Masses of links that stand still enter no equation: what is wrong with them prevents nothing.
fn of_fixed(findings: &mut [Finding]) {
    for finding in findings.iter_mut().filter(|finding| finding.is_error()) {
        if finding.matter == Matter::Dynamics {
            finding.severity = Severity::Warning;
            let advice = "no joint moves it, so it enters no equation; correct it when the base is to move";
            finding.advice = advice.to_owned();
        }
    }
}

/// The links with errors that accepting them removes.
pub fn impossible(source: &Source<'_>) -> Vec<String> {
    let errors = |link: &Part<'_>, accepted| {
        let mut report = Report::new(std::path::Path::new(""));
        if let Some(inertial) = link.child("inertial") {
            body(link, &inertial, accepted, &mut report);
        }
        report.findings.iter().filter(|finding| finding.is_error()).count()
    };
    let removed = |link: &&Part<'_>| moves(link, source) && errors(link, false) > errors(link, true);
    source.links.iter().filter(removed).map(|link| link.name().to_owned()).collect()
}

fn body(link: &Part<'_>, inertial: &Part<'_>, accepted: bool, report: &mut Report) {
    let [Some(mass), Some(inertia)] = ["mass", "inertia"].map(|tag| inertial.child(tag)) else {
        let message = format!("{}: <inertial> needs <mass> and <inertia>", link.title());
        let advice = "add them, or remove <inertial> of a link that is only a frame";
        report.kinematics(Some(inertial.line()), message, advice);
        return;
    };
    let line = Some(mass.line());
    let Some(mass) = mass.number("value") else { return };
    let six = ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"].map(|name| inertia.number(name));
    let [Some(ixx), Some(iyy), Some(izz), Some(ixy), Some(ixz), Some(iyz)] = six else { return };
    let tensor = Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
    if mass < 0.0 {
        report.dynamics(line, format!("{}: mass = {mass} kg is below 0", link.title()), "masses are in kg");
    } else if mass > LARGEST_MASS {
        let message = format!("{}: mass = {mass} kg, more than {LARGEST_MASS} kg: grams?", link.title());
        report.dynamics(line, message, format!("masses are in kg: {mass} g are {}", mass / 1000.0));
    } else if mass == 0.0 && tensor.iter().any(|value| *value != 0.0) && !accepted {
        let message = format!("{}: mass = 0 kg, but its inertia is not 0", link.title());
        report.dynamics(line, message, "give the mass, or set the inertia to 0");
    }
    if accepted {
        let message = format!("{}: accepted: the nearest inertia that a body can have is used", link.title());
        report.warning(Some(inertia.line()), message, "correct it when the true one is known");
    } else {
        tensor_of(link, &inertia, &tensor, mass, report);
    }
    center(link, inertial, report);
}

fn tensor_of(link: &Part<'_>, part: &Part<'_>, tensor: &Matrix3<f64>, mass: f64, report: &mut Report) {
    let line = Some(part.line());
    if tensor.amax() > LARGEST_INERTIA {
        let message = format!(
            "{}: an inertia of {:e} kg·m², more than {LARGEST_INERTIA:e}",
            link.title(),
            tensor.amax()
        );
        report.dynamics(line, message, UNITS);
        return;
    }
    let [small, middle, large] = sorted(tensor.symmetric_eigenvalues());
    let listed = format!("principal moments {small:.3e}, {middle:.3e}, {large:.3e} kg·m²");
    // The same margin as the board's: digits are cut when files are exported.
    let tolerance = 1e-3 * tensor.trace().abs() + 1e-12;
    if small < -tolerance {
        let message = format!("{}: physically impossible inertia: {listed}, one is negative", link.title());
        let advice = format!("check its diagonal, and the signs of ixy, ixz, iyz; {ACCEPT}");
        report.dynamics(line, message, advice);
    } else if (tensor.trace() / 2.0 - large) < -tolerance {
        let message = format!(
            "{}: physically impossible inertia: {listed}, one exceeds the sum of the others",
            link.title()
        );
        let advice =
            format!("check the units (kg·m²) and export the inertia about the centre of mass; {ACCEPT}");
        report.dynamics(line, message, advice);
    } else if mass > 0.0 && (large / mass).sqrt() > LARGEST_RADIUS {
        let message = format!(
            "{}: radius of gyration {:.3} m, more than {LARGEST_RADIUS} m: {listed} for {mass} kg",
            link.title(),
            (large / mass).sqrt()
        );
        report.dynamics(line, message, UNITS);
    }
}

fn sorted(moments: Vector3<f64>) -> [f64; 3] {
    let mut moments: [f64; 3] = moments.into();
    moments.sort_by(f64::total_cmp);
    moments
}

fn center(link: &Part<'_>, inertial: &Part<'_>, report: &mut Report) {
    let Some(origin) = inertial.child("origin") else { return };
    let distance = origin.vector("xyz").map_or(0.0, |xyz| Vector3::from(xyz).norm());
    if distance > FARTHEST_CENTER {
        let message = format!(
            "{}: centre of mass {} m from the link's origin, more than {FARTHEST_CENTER} m: millimetres?",
            link.title(),
            four(distance)
        );
        let advice = format!("lengths are in m: {} mm are {}", four(distance), four(distance / 1000.0));
        report.dynamics(Some(origin.line()), message, advice);
    }
}
