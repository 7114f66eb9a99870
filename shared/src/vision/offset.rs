//! Where the rim crosses a ray.
//!
//! The strongest edge is not the rim: the bevel of the rose and the shadow at its foot have edges as well,
//! and in a blurred picture they merge with that of the rim. A small neural network estimates the distance of
//! the rim from an ellipse near it, and how uncertain that is. It sees the contrasts along a ray and along
//! two neighbours, up to 4 px from the ellipse, and in all rays together from where the light comes.
//! `tests/oracles/rim_offset.py` fits it to rendered pictures.

use super::ellipse::Ellipse;
use super::image::Image;
use super::offset_weights::{ALONG, BIASES, DEEP, FIRST, LAST, MEAN};
use super::ring::{FEW_RAYS, MAX_HALF, PLACES, RAYS, Ring, directions, every_other};
use crate::math;

/// Steps in which the network sees a ray: fine ones, and coarse ones that reach farther [px].
const STEPS: [f32; 2] = [0.5, 1.0];
/// Inputs from a ray in steps of one length: the contrasts relative to the largest, and the largest.
const OF_STEP: usize = PLACES + 1;
/// Inputs from each of the three rays.
pub(super) const OF_RAY: usize = STEPS.len() * OF_STEP;
/// Inputs: of the ray, of both neighbours; the radius.
pub(super) const INPUTS: usize = 3 * OF_RAY + 1;
/// Width of the first layer.
const WIDTH: usize = BIASES.0.len();
/// Contrasts are small compared with these [grey levels].
const SMALL: f32 = 3.0;
const MEDIUM: f32 = 12.0;
/// Unit of the radius [px].
const RADIUS: f32 = 30.0;
/// Bounds of the logarithm of the uncertainty [px].
const LOG_SCALE: [f32; 2] = [-3.0, 2.0];
/// Outputs of a layer that are computed together: each input is loaded once for all of them.
const BLOCK: usize = 8;

/// What the network sees about an ellipse, on every other ray; the contrasts are smoothed over all.
pub(super) struct Profiles {
    rays: [[f32; OF_RAY]; FEW_RAYS],
    /// Rays on which the rim can be seen, one bit each.
    open: u64,
    radius: f32,
}

impl Profiles {
    /// The picture about an ellipse that `front` partly hides.
    pub fn new(image: &Image<'_>, ellipse: &Ellipse, front: Option<&Ellipse>) -> Self {
        let rings = STEPS.map(|step| Ring::new(image, ellipse, RAYS, (MAX_HALF, step)));
        let mut rays = [[0.0; OF_RAY]; FEW_RAYS];
        for (ray, profile) in rays.iter_mut().enumerate() {
            for (profile, ring) in profile.as_chunks_mut::<OF_STEP>().0.iter_mut().zip(&rings) {
                // Coarse steps leave the image earlier.
                let Some(contrasts) = ring.contrasts(every_other(ray)) else { continue };
                let largest =
                    contrasts.iter().fold(0.0, |max, contrast| math::max(max, math::abs(*contrast)));
                let scale = 1.0 / (largest + SMALL);
                for (value, contrast) in profile.iter_mut().zip(contrasts) {
                    *value = contrast * scale;
                }
                profile[PLACES] = largest / (largest + MEDIUM);
            }
        }
        let [fine, _] = rings;
        let seen = fine.open(front);
        let open = (0..FEW_RAYS).fold(0, |open, ray| open | (seen >> every_other(ray) & 1) << ray);
        Self { rays, open, radius: ellipse.radius / RADIUS }
    }

    /// Number of rays on which the rim can be seen.
    pub const fn count(&self) -> u32 {
        self.open.count_ones()
    }

    /// Directions of these rays, and the inputs of the network on each.
    pub fn rays(&self) -> impl Iterator<Item = ([f32; 2], [f32; INPUTS])> + Clone + '_ {
        let rays = directions(FEW_RAYS).iter().enumerate().filter(|(ray, _)| self.open >> ray & 1 == 1);
        rays.map(|(ray, direction)| {
            let mut inputs = [self.radius; INPUTS];
            let parts = [ray, (ray + FEW_RAYS - 1) % FEW_RAYS, (ray + 1) % FEW_RAYS];
            for (inputs, ray) in inputs.chunks_exact_mut(OF_RAY).zip(parts) {
                inputs.copy_from_slice(&self.rays[ray]);
            }
            (*direction, inputs)
        })
    }
}

/// What the first layer gets from all rays: from their mean, and from how they change with the direction.
pub(super) struct Context {
    mean: [f32; WIDTH],
    /// Mean of the directions.
    middle: [f32; 2],
    /// From the covariance of the rays with their direction along x and y.
    covariance: [[f32; WIDTH]; 2],
}

impl Context {
    /// From directions and inputs of the rays on which the rim can be seen.
    pub fn new(rays: impl Iterator<Item = ([f32; 2], [f32; INPUTS])>) -> Self {
        let (mut sums, mut directions, mut count) = ([[0.0; OF_RAY]; 3], [0.0; 2], 0.0);
        for ([u, v], inputs) in rays {
            for (sums, factor) in sums.iter_mut().zip([1.0, u, v]) {
                for (sum, value) in sums.iter_mut().zip(inputs) {
                    *sum += factor * value;
                }
            }
            directions[0] += u;
            directions[1] += v;
            count += 1.0;
        }
        let share = 1.0 / math::max(count, 1.0);
        let [mean, along_x, along_y] = sums.map(|sums| sums.map(|sum| share * sum));
        let middle = directions.map(|sum| share * sum);
        let covariance = |mut products: [f32; OF_RAY], direction: f32| {
            for (product, mean) in products.iter_mut().zip(&mean) {
                *product -= direction * mean;
            }
            layer(&products, &ALONG, &[0.0; WIDTH])
        };
        Self {
            covariance: [covariance(along_x, middle[0]), covariance(along_y, middle[1])],
            mean: layer(&mean, &MEAN, &BIASES.0),
            middle,
        }
    }

    /// Distance of the rim from the ellipse along a ray, outwards [px], and the weight of this estimate in a
    /// fit: its inverse squared uncertainty [1/px²].
    pub fn offset(&self, [u, v]: [f32; 2], inputs: &[f32; INPUTS]) -> (f32, f32) {
        let (u, v) = (u - self.middle[0], v - self.middle[1]);
        let mut start = self.mean;
        for (value, (x, y)) in start.iter_mut().zip(self.covariance[0].iter().zip(&self.covariance[1])) {
            *value += u * x + v * y;
        }
        let first = layer(inputs, &FIRST, &start);
        let deep = layer(&first.map(positive), &DEEP, &BIASES.1);
        let [offset, log_scale] = layer(&deep.map(positive), &LAST, &BIASES.2);
        (offset, math::exp(-2.0 * math::clamp(log_scale, LOG_SCALE[0], LOG_SCALE[1])))
    }
}

const fn positive(value: f32) -> f32 {
    math::max(value, 0.0)
}

/// Weighted sums of the inputs, beginning at `start`. Row `i` of the weights belongs to output `i`.
fn layer<const I: usize, const O: usize>(
    inputs: &[f32; I],
    weights: &[[f32; I]; O],
    start: &[f32; O],
) -> [f32; O] {
    let mut outputs = *start;
    let (blocks, rest) = outputs.as_chunks_mut::<BLOCK>();
    let (rows, last_rows) = weights.as_chunks::<BLOCK>();
    for (outputs, rows) in blocks.iter_mut().zip(rows) {
        for (index, input) in inputs.iter().enumerate() {
            for (output, row) in outputs.iter_mut().zip(rows) {
                *output += row[index] * input;
            }
        }
    }
    for (output, row) in rest.iter_mut().zip(last_rows) {
        for (input, weight) in inputs.iter().zip(row) {
            *output += weight * input;
        }
    }
    outputs
}
