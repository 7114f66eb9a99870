use core::fmt;

use super::find::MIN_RADIUS;
use super::image::{MAX_SIDE, MIN_SIDE};

/// Why an image or a search is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum VisionError {
    /// The image is too small or too large.
    Size {
        /// Its width [px].
        width: usize,
        /// Its height [px].
        height: usize,
    },
    /// The number of pixels is not width × height.
    Pixels {
        /// Their number.
        pixels: usize,
        /// Width × height.
        expected: usize,
    },
    /// The expected radii are not a range within the limits.
    Radius {
        /// Minimum [px].
        from: f32,
        /// Maximum [px].
        to: f32,
        /// Largest radius in this image [px].
        limit: f32,
    },
    /// The window is not finite, or outside the image.
    Window {
        /// Its centre [px].
        center: [f32; 2],
        /// Its reach [px].
        reach: f32,
    },
    /// The vanishing point of the axis is not finite.
    Axis {
        /// Its centre [px].
        center: [f32; 2],
        /// Its reach [px].
        reach: f32,
    },
    /// A buffer is too short.
    Buffer {
        /// Its name.
        name: &'static str,
        /// Its length.
        length: usize,
        /// The length that is needed.
        needed: usize,
    },
}

impl fmt::Display for VisionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Size { width, height } => write!(
                f,
                "an image of {width} × {height} pixels: each side must be {MIN_SIDE} to {MAX_SIDE} pixels"
            ),
            Self::Pixels { pixels, expected } => {
                write!(f, "{pixels} grey values for an image of {expected} pixels: one is needed for each")
            }
            Self::Radius { from, to, limit } => write!(
                f,
                "expected radius of {from} to {to} pixels: the limits are {MIN_RADIUS} to {limit} pixels in this image"
            ),
            Self::Window { center: [x, y], reach } => write!(
                f,
                "window of {reach} pixels around ({x}, {y}): the centre must lie in the image, and the reach be at least 1"
            ),
            Self::Axis { center: [x, y], reach } => {
                write!(
                    f,
                    "axis within {reach} pixels of ({x}, {y}): it must be finite, and the reach not negative"
                )
            }
            Self::Buffer { name, length, needed } => {
                write!(f, "the buffer `{name}` has {length} elements, this image needs {needed}")
            }
        }
    }
}

impl core::error::Error for VisionError {}
