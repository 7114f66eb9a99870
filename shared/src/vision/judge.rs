//! Probability that a circle is the rose: a logistic model of image features.

use super::ellipse::Ellipse;
use super::find::{CircleSearch, Window};
use super::ring::RimFeatures;
use crate::math;

/// Number of features of a circle, and of the end of a knob in front of it.
pub(super) const FEATURES: usize = 16;
pub(super) const KNOB_FEATURES: usize = 12;

// The weights maximise the likelihood of the right circles over many pictures: see docs/find-circle.md.
/// Weights of [`features`] if no knob or no axis is known.
const ALONE: [f32; FEATURES] = [
    0.082, 1.613, 0.832, 0.900, -0.725, 0.390, 0.067, 7.445, -0.476, -0.135, 0.285, -6.230, 1.963, -4.628,
    5.712, -14.747,
];
/// Weights of [`features`] behind the end of a knob, along its axis.
const BEHIND: [f32; FEATURES] = [
    0.461, -0.090, 0.487, 1.840, -0.090, 0.615, 0.209, 6.370, 0.128, -1.384, 1.886, -5.766, 0.204, -3.736,
    4.309, -8.025,
];
/// Weights of [`knob_features`].
const KNOB: [f32; KNOB_FEATURES] =
    [0.257, 1.091, -0.067, -0.004, 4.457, -1.643, 0.393, 0.728, -3.203, -8.230, 2.321, -1.399];

/// A circle with its rim: it may be the end of a knob.
#[derive(Clone, Copy, Debug)]
pub(super) struct Knob {
    pub ellipse: Ellipse,
    pub rim: RimFeatures,
}

/// Logarithm of the likelihood ratio of a circle, behind the end of a knob if given, to no circle.
pub(super) fn log_odds(
    search: &CircleSearch,
    circle: &Ellipse,
    rim: &RimFeatures,
    knob: Option<&Knob>,
) -> f32 {
    let behind = behind(search, circle, knob);
    weigh(&features(search, circle, rim), behind.as_ref())
}

/// [`knob_features`], if a knob and its axis are known.
pub(super) fn behind(
    search: &CircleSearch,
    circle: &Ellipse,
    knob: Option<&Knob>,
) -> Option<[f32; KNOB_FEATURES]> {
    Some(knob_features(circle, knob?, search.axis.as_ref()?))
}

/// Logarithm of the odds that [`features`] and [`knob_features`] give.
pub(super) fn weigh(features: &[f32; FEATURES], behind: Option<&[f32; KNOB_FEATURES]>) -> f32 {
    match behind {
        Some(knob) => weighted(&BEHIND, features) + weighted(&KNOB, knob),
        None => weighted(&ALONE, features),
    }
}

fn weighted(weights: &[f32], features: &[f32]) -> f32 {
    weights.iter().zip(features).fold(0.0, |sum, (weight, feature)| sum + weight * feature)
}

/// Features of a circle.
pub(super) fn features(search: &CircleSearch, rose: &Ellipse, rim: &RimFeatures) -> [f32; FEATURES] {
    let [from, to] = search.radius;
    let place = (rose.radius - math::sqrt(from * to)) / (to - from);
    let [p, q] = rose.flattening;
    [
        1.0,
        rim.open,
        rim.contrast,
        rim.common,
        rim.near_in,
        rim.near_out,
        rim.far_in,
        rim.sharp,
        rim.shade_in,
        rim.shade,
        rim.shade_out,
        rim.jitter,
        rim.gap,
        100.0 * (p * p + q * q),
        place,
        place * place,
    ]
}

/// Features of the end of the knob in front of it, and of the position of both along the axis.
fn knob_features(rose: &Ellipse, knob: &Knob, axis: &Window) -> [f32; KNOB_FEATURES] {
    /// Usual radius of a knob over that of its rose, and distance of the rose over that of the knob's end.
    const USUAL_SIZE: f32 = 0.63;
    const USUAL_DEPTH: f32 = 1.3;
    let Knob { ellipse, rim } = knob;
    let [dx, dy] = [0, 1].map(|index| rose.center[index] - axis.center[index]);
    let length = math::sqrt(dx * dx + dy * dy).max(1.0);
    let [ex, ey] = [0, 1].map(|index| ellipse.center[index] - rose.center[index]);
    let along = (ex * dx + ey * dy) / length;
    let aside = math::abs(ex * dy - ey * dx) / (length * rose.radius);
    let depth = 1.0 + along / length.max(axis.reach);
    let size = math::clamp(ellipse.radius / (rose.radius * depth), 0.2, 1.2) - USUAL_SIZE;
    let depth = depth - USUAL_DEPTH;
    [
        rim.contrast,
        rim.common,
        rim.near_in,
        rim.near_out,
        rim.sharp,
        rim.jitter,
        rim.gap,
        size,
        (25.0 * size * size).min(1.0),
        aside.min(0.3),
        depth,
        (10.0 * depth * depth).min(2.0),
    ]
}
