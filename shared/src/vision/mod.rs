//! Circle finding in a grey image (Knob §4.4): the rose of a door knob, seen by a camera on the hand.
//!
//! The paper lets every point over a threshold vote with its squared gradient for the centres and radii along
//! ± its gradient (a Hough transform) and takes the maximum. [`find_circle`] does so in two steps that need
//! no three-dimensional accumulator:
//!
//! 1. *Centres*. The image is reduced 2, 4, 8 … times (a pyramid), so that the radii at each level are some 6
//!    to 25 cells. Edge points vote for centres, with a limited squared gradient: a specular streak weighs no
//!    more than a rim. Around each maximum of the accumulator, the sectors in which edge points point at it
//!    are counted radius by radius.
//! 2. *Fits*. At full resolution, rays from the centre look for the edge next to the candidate; an ellipse
//!    is fitted to them, with outliers rejected. Behind each clear circle, which may be the end of the knob,
//!    circles are fitted that it hides in part: when it is known where the axis of the knob vanishes, along
//!    that axis; otherwise those of the others.
//! 3. *Choice*. Of each ellipse is measured what the image shows along its rim: how much contrast, how sharp,
//!    how near to the ellipse, what lies beside it (the rose darkens the door at its foot, which a shadow's
//!    own outline does not), and the same of the knob's end, with how both lie on the axis. A logistic model,
//!    fitted to rendered door knobs, weighs it. One of the candidates is right, or there is no circle: its
//!    probability is the confidence.
//! 4. *Refit* of the likeliest, in steps of half a pixel.
//!
//! A prior of the radius, from the arm's own pose, and a window about the last result exclude other circles.
//!
//! The front rim of the rose is an ellipse in the image, because the camera looks at it obliquely.
//! [`Circle::center`] is the ellipse's centre, [`Circle::radius`] the root of the product of its semi-axes.
//! The centre of the pixel in the corner is at (0, 0).
//!
//! [`HandEyeTable`] turns a circle into the place of the rose before the hand.
//!
//! All buffers are lent by the caller: [`Buffers`], whose sizes follow from the size of the image
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
mod refit;
mod ring;
mod starts;
#[cfg(test)]
mod tests;

pub use edges::{EdgePoint, MAX_EDGES, row_len};
pub use error::VisionError;
#[cfg(feature = "test-support")]
pub use evidence::{Evidence, evidence};
pub use find::{Buffers, CameraBuffers, Circle, CircleSearch, Scratch, Window, find_circle};
pub use hand_eye::{HandEyeError, HandEyeRow, HandEyeTable, MAX_HAND_EYE_ROWS};
pub use hough::accumulator_len;
pub use image::{Image, MAX_SIDE, MIN_SIDE};
