//! Circle finding in a grey image (Knob §4.4): the rose of a door knob, seen by a camera on the hand.
//!
//! In the paper every point above a threshold votes with its squared gradient for the centres and radii along
//! ± its gradient (a Hough transform), and the maximum is taken. [`find_circle`] works in four steps, without
//! a three-dimensional accumulator:
//!
//! 1. *Centres*. The image is reduced by factors of 2, 4, 8 … (a pyramid), so that the radii at each level
//!    are some 6 to 25 cells. Edge points vote for centres with a limited squared gradient, so that a
//!    specular streak has no more weight than a rim. Around each maximum of the accumulator, the sectors with
//!    edge points that point at it are counted for each radius.
//! 2. *Fits*. At full resolution, the edge next to the candidate is searched along rays from the centre, and
//!    an ellipse is fitted to the edge points, with outliers rejected. A clear circle may be the end of the
//!    knob, so circles that it partly hides are fitted as well: along the axis of the knob if its vanishing
//!    point is known, otherwise among the other candidates.
//! 3. *Choice*. Features of each ellipse are measured along its rim: contrast, sharpness, distance of the
//!    edge from the ellipse, and shading beside it (the rose darkens the door at its foot, the outline of a
//!    shadow does not); also those of the knob's end, and the position of both relative to the axis. A
//!    logistic model, fitted to rendered door knobs, weighs the features. Either one of the candidates is
//!    right or there is no circle; the probability of the best one is the confidence.
//! 4. *Refit* of the likeliest: to the strongest edge in steps of half a pixel, then to the rim as a small
//!    neural network finds it along each ray, between the edges of a bevel and of a shadow.
//!
//! A prior of the radius, from the arm's pose, and a window about the last result exclude other circles.
//!
//! The front rim of the rose is an ellipse in the image because the camera views it obliquely.
//! [`Circle::center`] is the ellipse's centre, [`Circle::radius`] the root of the product of its semi-axes.
//! The centre of the pixel in the corner is at (0, 0).
//!
//! [`HandEyeTable`] converts a circle to the position of the rose in front of the hand.
//!
//! The caller provides all buffers: [`Buffers`], whose sizes follow from the size of the image
//! ([`accumulator_len`], [`row_len`]).
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "coordinates and grey levels are small"
)]

mod choice;
mod edges;
mod ellipse;
mod error;
#[cfg(feature = "test-support")]
mod evidence;
mod find;
mod hand_eye;
mod hough;
mod image;
mod judge;
mod knob;
mod offset;
mod offset_weights;
mod refit;
mod ring;
mod starts;
#[cfg(test)]
mod tests;

pub use edges::{EdgePoint, MAX_EDGES, row_len};
pub use error::VisionError;
#[cfg(feature = "test-support")]
pub use evidence::{Evidence, RimRay, evidence, rim_rays};
pub use find::{Buffers, CameraBuffers, Circle, CircleSearch, Scratch, Window, find_circle, radius_limits};
pub use hand_eye::{HandEyeError, HandEyeRow, HandEyeTable, MAX_HAND_EYE_ROWS};
pub use hough::accumulator_len;
pub use image::{Image, MAX_SIDE, MIN_SIDE};
