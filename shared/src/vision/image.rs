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
    /// Rows of `width` grey levels, from the top.
    ///
    /// # Errors
    /// A side that is not [`MIN_SIDE`] to [`MAX_SIDE`] px, or another number of grey levels than pixels.
    pub const fn try_new(pixels: &'a [u8], width: usize, height: usize) -> Result<Self, VisionError> {
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

    /// Bilinear interpolation at a point at least one pixel inside the image, see [`Image::contains`], in 65
    /// 536ths of a pixel. The grey level has 16 bits of fraction.
    #[inline(always)]
    pub(super) fn at(&self, x: i32, y: i32) -> i32 {
        let start = (y >> 16) as usize * self.width + (x >> 16) as usize;
        // Two pixels of this row and of the next one, with the rest of the row between them.
        let Some(&[a, b, .., c, d]) = self.pixels.get(start..start + self.width + 2) else { return 0 };
        let [a, b, c, d] = [a, b, c, d].map(i32::from);
        let (fx, fy) = (x >> 8 & 0xFF, y >> 8 & 0xFF);
        let (top, bottom) = (256 * a + fx * (b - a), 256 * c + fx * (d - c));
        256 * top + fy * (bottom - top)
    }

    /// A coordinate in 65 536ths of a pixel.
    #[inline]
    pub(super) fn fixed(coordinate: f32) -> i32 {
        (coordinate * 65536.0) as i32
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
