//! How likely a circle is the rose: a logistic model of what the picture says for it.

use super::ellipse::Ellipse;
use super::find::{CircleSearch, Window};
use super::ring::Rim;
use crate::math;

/// Numbers that say what the picture shows of a circle, and of the end of a knob before it.
pub(super) const FEATURES: usize = 16;
pub(super) const KNOB_FEATURES: usize = 12;

// The weights were fitted so that, over many pictures, the right circles are as likely as possible: see
// docs/find-circle.md.
/// Weights of [`features`] where no knob is known, or not its axis.
const ALONE: [f32; FEATURES] = [
    -0.317, 1.557, 0.843, 1.138, -0.681, 0.390, 0.033, 7.678, -0.513, -0.122, 0.324, -5.852, 0.809, -4.751,
    5.836, -14.997,
];
/// Weights of [`features`] behind the end of a knob, along its axis.
const BEHIND: [f32; FEATURES] = [
    0.344, -0.174, 0.531, 1.877, -0.049, 0.587, 0.197, 6.763, 0.154, -1.397, 1.903, -5.405, -0.512, -3.797,
    4.425, -8.117,
];
/// Weights of [`knob_features`].
const KNOB: [f32; KNOB_FEATURES] =
    [0.254, 0.961, -0.051, 0.001, 3.900, -1.629, 0.008, 1.409, -3.185, -8.277, 2.259, -1.538];

/// A circle with its rim: it may be the end of a knob.
#[derive(Clone, Copy, Debug)]
pub(super) struct Knob {
    pub ellipse: Ellipse,
    pub rim: Rim,
}

/// Logarithm of how likely a circle is, behind the end of a knob, over there being none.
pub(super) fn log_odds(search: &CircleSearch, circle: &Ellipse, rim: &Rim, knob: Option<&Knob>) -> f32 {
    let behind = behind(search, circle, knob);
    weigh(&features(search, circle, rim), behind.as_ref())
}

/// [`knob_features`], where a knob and its axis are known.
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
