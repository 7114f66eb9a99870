//! Features behind the choice between circles, for the fit of its weights by
//! `tests/oracles/circle_choice.py`.

use super::error::VisionError;
use super::find::{CircleSearch, Scratch, choice};
use super::image::Image;
use super::judge::{FEATURES, KNOB_FEATURES};

/// A candidate with the features of its evaluation.
#[derive(Clone, Copy, Debug)]
pub struct Evidence {
    /// Centre of the evaluated ellipse [px].
    pub center: [f32; 2],
    /// Root of the product of its semi-axes [px].
    pub radius: f32,
    /// The same for the ellipse that is returned if this candidate is chosen [px].
    pub fine_center: [f32; 2],
    /// See `fine_center` [px].
    pub fine_radius: f32,
    /// Features of the rim, after a constant 1.
    pub features: [f32; FEATURES],
    /// Features of the end of a knob in front of it, and of the position of both along the axis, if both are
    /// known.
    pub behind: Option<[f32; KNOB_FEATURES]>,
    /// Logarithm of the likelihood ratio of this circle to no circle.
    pub log_odds: f32,
}

/// Calls `seen` with each candidate of a search, from which [`find_circle`](super::find_circle) chooses.
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
