//! Roses that the end of a knob hides in part.

use super::ellipse::Ellipse;
use super::find::{CircleSearch, SAME_RIM, Window};
use super::image::Image;
use super::refit::{Fit, Rims, glance};
use super::starts::{MAX_CANDIDATES, Start, Starts};
use crate::math;

/// Least evidence for the end of a knob that hides others, where nothing else is known.
const FRONT_EVIDENCE: f32 = 0.72;
/// Least evidence for the end of a knob behind which a rose is looked for along the axis, for that rose, and
/// for the rose and half of the knob together.
const KNOB_EVIDENCE: f32 = 0.45;
const ROSE_EVIDENCE: f32 = 0.5;
const PAIR_EVIDENCE: f32 = 0.95;
/// What is lost in evidence without the rim of the knob.
const LOSS: f32 = 0.05;
/// Least number of open rays on which a circle is judged.
const MIN_RAYS: u32 = 20;
/// Ends of knobs behind which a rose is looked for.
const MAX_KNOBS: usize = 3;
/// Radius of a rose over that of its knob, both on the door.
const ROSE_RADIUS: [f32; 2] = [1.05, 2.2];
/// Length of a knob over the distance of the camera from its foot, at most.
const MAX_LENGTH: f32 = 0.6;
/// Steps of the centre along the axis and of the radius [px], and at least, over the radius.
const CENTER_STEP: (f32, f32) = (2.0, 0.08);
const RADIUS_STEP: (f32, f32) = (1.5, 0.06);
/// Least glance at a candidate.
const MIN_GLANCE: f32 = 0.15;
/// Steps of the fit to a candidate, each of 1 px.
const BAND: (usize, f32) = (3, 1.0);

/// The rose behind the best of the circles that may be the end of a knob. The rose is farther along the axis,
/// and so nearer to where the axis vanishes, in proportion to its depth.
pub(super) fn behind_knob(
    image: &Image<'_>,
    search: &CircleSearch,
    axis: &Window,
    noise: f32,
    fits: &[Option<Fit>],
) -> Option<Fit> {
    let mut best = None::<(Fit, f32)>;
    let mut knobs = [None::<&Fit>; MAX_KNOBS];
    let may_be_knob = |fit: &&Fit| fit.evidence() >= KNOB_EVIDENCE;
    for knob in fits.iter().flatten().filter(may_be_knob) {
        let is_same = |known: &&Fit| known.distance(knob) < 0.05 * knob.ellipse.radius;
        if knobs.iter().flatten().any(is_same) {
            continue;
        }
        let Some(place) = knobs.iter_mut().find(|place| place.is_none()) else { break };
        *place = Some(knob);
        let starts = candidates(image, search, axis, noise, &knob.ellipse);
        let rims = Rims { image, noise, front: Some(&knob.ellipse) };
        let is_rose = |fit: &Fit| {
            search.allows(&fit.ellipse)
                && fit.open().count_ones() >= MIN_RAYS
                && fit.ellipse.radius > 0.9 * knob.ellipse.radius
                && fit.distance(knob) > SAME_RIM * fit.ellipse.radius
                && fit.evidence() > ROSE_EVIDENCE
        };
        for rose in rims.fit_all(&starts.list).filter(is_rose) {
            let evidence = rose.evidence() + 0.5 * knob.evidence();
            if evidence > best.as_ref().map_or(PAIR_EVIDENCE, |(_, evidence)| *evidence) {
                best = Some((rose, evidence));
            }
        }
    }
    best.map(|(rose, _)| rose)
}

/// Roses behind the end of a knob on which a glance finds an edge.
fn candidates(image: &Image<'_>, search: &CircleSearch, axis: &Window, noise: f32, knob: &Ellipse) -> Starts {
    let mut starts = Starts::NONE;
    let [dx, dy] = [0, 1].map(|index| knob.center[index] - axis.center[index]);
    let length = math::sqrt(dx * dx + dy * dy);
    if length < 1.0 {
        return starts;
    }
    let [u, v] = [dx / length, dy / length];
    let most = math::clamp(1.2 * knob.radius, 0.0, MAX_LENGTH * length);
    let mut away = 1.0;
    while away < most {
        // Depth of the knob's end over that of the rose.
        let depth = 1.0 - away / length;
        let [from, to] = ROSE_RADIUS.map(|ratio| ratio * depth * knob.radius);
        // The axis is not known exactly.
        let spread = 0.5 + axis.reach * (1.0 - depth);
        for aside in [-spread, 0.0, spread] {
            let center = [knob.center[0] - away * u - aside * v, knob.center[1] - away * v + aside * u];
            let mut radius = from.max(search.radius[0]);
            while radius <= to.min(search.radius[1]) {
                let ellipse = Ellipse::circle(center, radius);
                let score = glance(image, &ellipse, knob, noise);
                if score > MIN_GLANCE {
                    starts.insert(Start { ellipse, score, side: 1.0 });
                }
                radius += RADIUS_STEP.0.max(RADIUS_STEP.1 * radius);
            }
        }
        away += CENTER_STEP.0.max(CENTER_STEP.1 * knob.radius);
    }
    starts
}

/// Fits circles anew that the end of a knob hides in part: its rim is not theirs.
pub(super) fn uncover(image: &Image<'_>, noise: f32, fits: &mut [Option<Fit>; MAX_CANDIDATES]) {
    let found = *fits;
    for fit in fits.iter_mut().flatten() {
        for front in found.iter().flatten() {
            if !is_in_front(front, fit) || fit.hidden_by(&front.ellipse) & fit.visible == 0 {
                continue;
            }
            let open = Rims { image, noise, front: Some(&front.ellipse) }.refit(&fit.ellipse, BAND);
            if let Some(open) = open
                && open.open().count_ones() >= MIN_RAYS
                && open.evidence() > fit.evidence() - LOSS
            {
                *fit = open;
            }
        }
    }
}

/// Whether one circle is the end of a cylinder that stands on the other: seen nearly all around, not much
/// larger, and at another place.
fn is_in_front(front: &Fit, fit: &Fit) -> bool {
    front.ellipse.radius < 1.1 * fit.ellipse.radius
        && front.distance(fit) > SAME_RIM * fit.ellipse.radius
        && front.evidence() > FRONT_EVIDENCE
}
