//! How likely a circle is the rose: a logistic model of what the picture says for it.

use super::ellipse::Ellipse;
use super::find::{CircleSearch, Window};
use super::ring::Rim;
use crate::math;

/// Numbers that say what the picture shows of a circle, and of the end of a knob before it.
pub(super) const FEATURES: usize = 17;
pub(super) const KNOB_FEATURES: usize = 12;

// The weights were fitted by `tests/oracles/fit_rose.py` so that, over many pictures, the right circles are
// as likely as possible: see docs/find-circle.md.
/// Weights of [`features`] where no knob is known.
const ALONE: [f32; FEATURES] = [
    -0.727, -0.374, 0.552, 1.142, -0.065, 0.120, 0.605, -0.025, 4.035, 0.218, -0.548, 0.870, -6.259,
    -1.210, -3.584, 4.935, -9.803,
];
/// Weights of [`features`] behind the end of a knob.
const BEHIND: [f32; FEATURES] = [
    0.365, -0.477, 0.534, 1.468, -0.167, 0.452, 0.227, 0.070, 6.011, 0.119, -1.166, 1.367, -4.928, 1.764,
    -4.529, 2.593, -5.945,
];
/// Weights of [`knob_features`].
const KNOB: [f32; KNOB_FEATURES] = [
    0.270, 0.316, -0.190, 0.006, 4.769, -1.419, -1.018, -0.498, -2.968, -9.493, 1.328, -1.531,
];

/// A circle with its rim: it may be the end of a knob.
#[derive(Clone, Copy, Debug)]
pub(super) struct Knob {
    pub ellipse: Ellipse,
    pub rim: Rim,
}

/// Logarithm of how likely the circle is, over there being none.
pub(super) fn log_odds(
    features: &[f32; FEATURES],
    knob_features: Option<&[f32; KNOB_FEATURES]>,
) -> f32 {
    match knob_features {
        None => weighted(&ALONE, features),
        Some(knob) => weighted(&BEHIND, features) + weighted(&KNOB, knob),
    }
}

fn weighted(weights: &[f32], features: &[f32]) -> f32 {
    weights.iter().zip(features).fold(0.0, |sum, (weight, feature)| sum + weight * feature)
}

/// Of a circle.
pub(super) fn features(search: &CircleSearch, rose: &Ellipse, rim: &Rim) -> [f32; FEATURES] {
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
        rim.inside,
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

/// Of the end of the knob before it, and whether both lie on the axis as they should.
pub(super) fn knob_features(rose: &Ellipse, knob: &Knob, axis: &Window) -> [f32; KNOB_FEATURES] {
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
