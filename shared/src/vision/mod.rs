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
//! 2. *Refit*. At full resolution, rays from the centre look for the edge next to the candidate; an ellipse
//!    is fitted to them, with outliers rejected.
//!
//! The answer is the circle with the longest rim that is supported by edges: of concentric circles, the
//! outermost. Where the end of the knob hides the rose, no rim is expected, and that of the knob does not
//! count. When it is known where the axis of the knob vanishes, the rose is looked for along it, behind each
//! circle that may be the knob's end. A prior of the radius, from the arm's own pose, and a window about the
//! last result exclude other circles.
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

mod edges;
mod ellipse;
mod error;
mod find;
mod hand_eye;
mod hough;
mod image;
mod knob;
mod refit;
mod starts;
#[cfg(test)]
mod tests;

pub use edges::{EdgePoint, MAX_EDGES, row_len};
pub use error::VisionError;
pub use find::{Buffers, CameraBuffers, Circle, CircleSearch, Scratch, Window, find_circle};
pub use hand_eye::{HandEyeError, HandEyeRow, HandEyeTable, MAX_HAND_EYE_ROWS};
pub use hough::accumulator_len;
pub use image::{Image, MAX_SIDE, MIN_SIDE};
