//! What the choice between circles and the fit to a rim are based on, for the fit of their weights by
//! `tests/oracles/circle_choice.py` and `tests/oracles/rim_offset.py`.

use super::error::VisionError;
use super::find::{CircleSearch, Scratch, choice};
use super::image::Image;
use super::judge::{FEATURES, KNOB_FEATURES};
use super::offset::{INPUTS, Profiles};

/// A candidate with the features of its evaluation.
#[derive(Clone, Copy, Debug)]
pub struct Evidence {
    /// Centre of the evaluated ellipse [px].
    pub center: [f32; 2],
    /// Root of the product of its semi-axes [px].
    pub radius: f32,
    /// The same for this ellipse after its fit to the edge, before the network refines it [px].
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

/// A ray from the centre of the circle that is chosen.
#[derive(Clone, Copy, Debug)]
pub struct RimRay {
    /// Centre of the ellipse [px].
    pub center: [f32; 2],
    /// Direction, a unit vector.
    pub direction: [f32; 2],
    /// Distance of the ellipse from its centre along the ray [px].
    pub polar_radius: f32,
    /// Inputs of the network that estimates the distance of the rim from the ellipse.
    pub inputs: [f32; INPUTS],
}

/// Calls `seen` with each ray on which the rim of the likeliest circle can be seen. Returns the confidence of
/// that circle.
///
/// # Errors
/// As [`find_circle`](super::find_circle).
pub fn rim_rays(
    image: &Image<'_>,
    search: &CircleSearch,
    scratch: &mut Scratch<'_>,
    mut seen: impl FnMut(RimRay),
) -> Result<Option<f32>, VisionError> {
    let choice = choice(image, search, scratch)?;
    let Some((best, confidence)) = choice.best() else { return Ok(None) };
    let (ellipse, front) = (choice.closest(best), choice.front(best.knob));
    for (direction, inputs) in Profiles::new(image, &ellipse, front.as_ref()).rays() {
        let polar_radius = ellipse.polar_radius(ellipse.root(), direction);
        seen(RimRay { center: ellipse.center, direction, polar_radius, inputs });
    }
    Ok(Some(confidence))
}
