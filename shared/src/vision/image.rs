use super::error::VisionError;

/// Smallest width and height of an image [px].
pub const MIN_SIDE: usize = 32;
/// Largest width and height of an image [px].
pub const MAX_SIDE: usize = 4096;

/// An image of 8-bit grey levels, row by row.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
}

impl<'a> Image<'a> {
    /// Checks the size: each side [`MIN_SIDE`] to [`MAX_SIDE`], and a grey level for each pixel.
    pub const fn new(pixels: &'a [u8], width: usize, height: usize) -> Result<Self, VisionError> {
        if width < MIN_SIDE || width > MAX_SIDE || height < MIN_SIDE || height > MAX_SIDE {
            return Err(VisionError::Size { width, height });
        }
        let expected = width * height;
        if pixels.len() != expected {
            return Err(VisionError::Pixels { pixels: pixels.len(), expected });
        }
        Ok(Self { pixels, width, height })
    }

    /// Width [px].
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height [px].
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Grey levels of a row; empty outside the image.
    pub(super) fn row(&self, y: usize) -> &'a [u8] {
        self.pixels.get(y * self.width..(y + 1) * self.width).unwrap_or_default()
    }

    /// Bilinear interpolation at a point at least one pixel inside the image, see [`Image::contains`].
    #[inline]
    pub(super) fn at(&self, x: f32, y: f32) -> f32 {
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let start = row * self.width + column;
        let upper = self.pixels.get(start..start + 2);
        let lower = self.pixels.get(start + self.width..start + self.width + 2);
        let (Some(&[a, b]), Some(&[c, d])) = (upper, lower) else { return 0.0 };
        let [a, b, c, d] = [a, b, c, d].map(f32::from);
        let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
        top + fy * (bottom - top)
    }

    /// Whether the point and its neighbours within `margin` are inside.
    #[inline]
    pub(super) fn contains(&self, x: f32, y: f32, margin: f32) -> bool {
        x >= margin
            && y >= margin
            && x < (self.width - 1) as f32 - margin
            && y < (self.height - 1) as f32 - margin
    }
}
