use tesaki_rng::Rng;

use super::geometry::Camera;

/// An 8-bit grey image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Grey values, row by row from the top left.
    pub pixels: Vec<u8>,
}

impl Image {
    /// Encodes the image as a PNG file.
    ///
    /// # Errors
    /// The image has no pixels.
    pub fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.pixels)?;
        writer.finish()?;
        Ok(file)
    }
}

/// The effects of lens, sensor and amplifier between light and grey values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Standard deviation of the lens's point spread function, a Gaussian [px].
    pub blur: f64,
    /// Motion of the image during the exposure [px].
    pub motion: [f64; 2],
    /// Fraction of the natural vignetting, cos⁴ of the angle to the optical axis; 0 for none.
    pub vignetting: f64,
    /// Mean of the exposed image; 1 is saturation.
    pub mean: f64,
    /// Exponent of the conversion from light to grey value.
    pub gamma: f64,
    /// Standard deviation of the read noise; 1 is saturation.
    pub read_noise: f64,
    /// Number of electrons at saturation, which determines the shot noise.
    pub full_well: f64,
}

impl Optics {
    /// Optics without blur, noise and vignetting, with grey values proportional to light.
    pub const fn ideal(mean: f64) -> Self {
        let (blur, vignetting, gamma, read_noise, full_well) = (0.0, 0.0, 1.0, 0.0, f64::INFINITY);
        Self { blur, motion: [0.0; 2], vignetting, mean, gamma, read_noise, full_well }
    }

    /// Computes the image of radiances, given row by row. `noise` generates the sensor's noise.
    pub fn expose(&self, camera: &Camera, mut radiances: Vec<f32>, noise: &mut Rng) -> Image {
        let &Camera { width, height, .. } = camera;
        self.darken_corners(camera, &mut radiances);
        let radiances = self.smear(width, height, radiances);
        let radiances = blurred(width, height, radiances, self.blur);
        let mean =
            radiances.iter().map(|&light| f64::from(light)).sum::<f64>() / radiances.len().max(1) as f64;
        let gain = (self.mean / mean.max(1e-12)) as f32;
        let grey = self.grey_values();
        let (read, shot) = ((self.read_noise * self.read_noise) as f32, (1.0 / self.full_well) as f32);
        let silent = self.read_noise <= 0.0 && shot <= 0.0;
        let pixel = |&light: &f32| {
            let light = light * gain;
            let deviation = if silent { 0.0 } else { (read + shot * light).max(0.0).sqrt() * normal(noise) };
            grey[((light + deviation).clamp(0.0, 1.0).sqrt() * (GREY_STEPS - 1) as f32 + 0.5) as usize]
        };
        Image { width, height, pixels: radiances.iter().map(pixel).collect() }
    }

    fn darken_corners(&self, camera: &Camera, radiances: &mut [f32]) {
        if self.vignetting <= 0.0 {
            return;
        }
        for (row, line) in radiances.chunks_exact_mut(camera.width).enumerate() {
            for (column, light) in line.iter_mut().enumerate() {
                let ray = camera.ray([column as f64, row as f64]);
                let cos2 = 1.0 / (1.0 + ray.x * ray.x + ray.y * ray.y);
                *light *= (1.0 - self.vignetting * (1.0 - cos2 * cos2)) as f32;
            }
        }
    }

    /// Averages over five points of the image's path during the exposure.
    fn smear(&self, width: usize, height: usize, radiances: Vec<f32>) -> Vec<f32> {
        let [u, v] = self.motion;
        if libm::hypot(u, v) < 0.1 {
            return radiances;
        }
        const POINTS: usize = 5;
        let shifts: [Shift; POINTS] = core::array::from_fn(|index| {
            let along = index as f64 / (POINTS - 1) as f64 - 0.5;
            Shift::new(u * along, v * along)
        });
        let mut sums = vec![0.0; radiances.len()];
        for shift in &shifts {
            shift.add(width, height, &radiances, &mut sums);
        }
        sums.iter().map(|sum| sum / POINTS as f32).collect()
    }

    fn grey_values(&self) -> Vec<u8> {
        let grey = |step| {
            let root = f64::from(step) / f64::from(GREY_STEPS as u32 - 1);
            libm::round(255.0 * libm::pow(root, 2.0 * self.gamma)) as u8
        };
        (0..GREY_STEPS as u32).map(grey).collect()
    }
}

/// Number of steps into which the square root of light is quantised before the gamma correction.
const GREY_STEPS: usize = 4096;

/// A translation with bilinear interpolation.
struct Shift {
    whole: [isize; 2],
    weights: [f32; 4],
}

impl Shift {
    fn new(u: f64, v: f64) -> Self {
        let [x, y] = [u - u.floor(), v - v.floor()];
        let weights =
            [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y].map(|weight| weight as f32);
        Self { whole: [u.floor() as isize, v.floor() as isize], weights }
    }

    fn add(&self, width: usize, height: usize, image: &[f32], sums: &mut [f32]) {
        let [du, dv] = self.whole;
        let [a, b, c, d] = self.weights;
        let within =
            |value: usize, shift: isize, size: usize| value.saturating_add_signed(shift).min(size - 1);
        for row in 0..height {
            let line = |shift| &image[within(row, shift, height) * width..][..width];
            let (upper, lower) = (line(dv), line(dv + 1));
            for column in 0..width {
                let (left, right) = (within(column, du, width), within(column, du + 1, width));
                sums[row * width + column] +=
                    a * upper[left] + b * upper[right] + c * lower[left] + d * lower[right];
            }
        }
    }
}

/// Convolves with a Gaussian; the border pixels are extended outwards.
fn blurred(width: usize, height: usize, image: Vec<f32>, deviation: f64) -> Vec<f32> {
    if deviation <= 0.0 {
        return image;
    }
    let reach = (3.0 * deviation).ceil().max(1.0) as usize;
    let weight = |offset: usize| {
        let x = (offset as f64 - reach as f64) / deviation;
        libm::exp(-0.5 * x * x) as f32
    };
    let kernel: Vec<f32> = (0..=2 * reach).map(weight).collect();
    let sum: f32 = kernel.iter().sum();
    let kernel: Vec<f32> = kernel.iter().map(|weight| weight / sum).collect();
    let mut across = vec![0.0; image.len()];
    let mut padded = vec![0.0; width + 2 * reach];
    for (line, out) in image.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
        padded[..reach].fill(line[0]);
        padded[reach..reach + width].copy_from_slice(line);
        padded[reach + width..].fill(line[width - 1]);
        for (offset, weight) in kernel.iter().enumerate() {
            out.iter_mut().zip(&padded[offset..]).for_each(|(out, light)| *out += weight * light);
        }
    }
    let mut both = vec![0.0; image.len()];
    for (row, out) in both.chunks_exact_mut(width).enumerate() {
        for (offset, weight) in kernel.iter().enumerate() {
            let from = (row + offset).saturating_sub(reach).min(height - 1);
            let line = &across[from * width..][..width];
            out.iter_mut().zip(line).for_each(|(out, light)| *out += weight * light);
        }
    }
    both
}

/// Draws an approximately normal value with standard deviation 1: the sum of four uniform numbers, which
/// never exceeds 3.5. Much faster than [`Rng::normal`], which matters for 61 440 pixels.
fn normal(rng: &mut Rng) -> f32 {
    let bits = rng.next_u64();
    let sum: u64 = [0, 16, 32, 48].iter().map(|shift| bits >> shift & 0xFFFF).sum();
    // The variance of a uniform number is 1/12.
    const SCALE: f32 = 1.732_050_8 / 65_536.0;
    (sum as f32 - 131_070.0) * SCALE
}
