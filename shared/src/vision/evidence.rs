//! What the choice between circles rests on: for the fit of its weights, `tests/oracles/circle_choice.py`.

use super::error::VisionError;
use super::find::{CircleSearch, Scratch, choice};
use super::image::Image;
use super::judge::{FEATURES, KNOB_FEATURES};

/// A candidate, and what its judgement rests on.
#[derive(Clone, Copy, Debug)]
pub struct Evidence {
    /// Centre of the ellipse that is judged [px].
    pub center: [f32; 2],
    /// Root of the product of its semi-axes [px].
    pub radius: f32,
    /// The same of the ellipse that is returned if this one is chosen [px].
    pub fine_center: [f32; 2],
    /// See `fine_center` [px].
    pub fine_radius: f32,
    /// What the picture shows along the rim, 1 first.
    pub features: [f32; FEATURES],
    /// The same of the end of a knob before it, and how both lie on the axis, where both are known.
    pub behind: Option<[f32; KNOB_FEATURES]>,
    /// Logarithm of how likely it is, over there being no circle.
    pub log_odds: f32,
}

/// Calls `seen` with each candidate of a search: those of which [`find_circle`](super::find_circle) chooses
/// one.
///
/// # Errors
/// As [`find_circle`](super::find_circle).
pub fn evidence(
    image: &Image<'_>,
    search: &CircleSearch,
    scratch: &mut Scratch<'_>,
    seen: impl FnMut(Evidence),
) -> Result<(), VisionError> {
    choice(image, search, scratch)?.evidence().for_each(seen);
    Ok(())
}
