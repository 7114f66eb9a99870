//! Where the rim crosses a ray.
//!
//! The strongest edge is not the rim: the bevel of the rose and the shadow at its foot have edges as well,
//! and in a blurred picture they merge with that of the rim. A small neural network estimates the distance of
//! the rim from an ellipse near it, and how uncertain that is. It sees the contrasts along a ray and along
//! two neighbours, and in all rays together from where the light comes. `tests/oracles/rim_offset.py` fits it
//! to rendered pictures.

use super::offset_weights::{ALONG, BIASES, DEEP, FIRST, LAST, MEAN};
use super::ring::{PLACES, RAYS, Ring};
use crate::math;

/// Inputs from each of the three rays: the contrasts relative to the largest, and the largest.
pub(super) const OF_RAY: usize = PLACES + 1;
/// Inputs: of the ray, of both neighbours; the radius.
pub(super) const INPUTS: usize = 3 * OF_RAY + 1;
/// Width of the first layer.
const WIDTH: usize = BIASES.0.len();
/// Distance of the neighbours [rays].
const APART: usize = 2;
/// Contrasts are small compared with these [grey levels].
const SMALL: f32 = 3.0;
const MEDIUM: f32 = 12.0;
/// Unit of the radius [px].
const RADIUS: f32 = 30.0;
/// Bounds of the logarithm of the uncertainty [px].
const LOG_SCALE: [f32; 2] = [-3.0, 2.0];
/// Outputs of a layer that are computed together: each input is loaded once for all of them.
const BLOCK: usize = 4;

/// What the network sees of a ring in steps of half a pixel.
pub(super) struct Profiles {
    rays: [[f32; OF_RAY]; RAYS],
    radius: f32,
}

impl Profiles {
    pub fn new(ring: &Ring) -> Self {
        let mut rays = [[0.0; OF_RAY]; RAYS];
        for (ray, profile) in rays.iter_mut().enumerate() {
            let Some(contrasts) = ring.contrasts(ray) else { continue };
            let largest = contrasts.iter().fold(0.0, |max, contrast| math::max(max, math::abs(*contrast)));
            let scale = 1.0 / (largest + SMALL);
            for (value, contrast) in profile.iter_mut().zip(contrasts) {
                *value = contrast * scale;
            }
            profile[PLACES] = largest / (largest + MEDIUM);
        }
        Self { rays, radius: ring.radius() / RADIUS }
    }

    /// Inputs of the network on each ray.
    pub fn inputs(&self) -> impl Iterator<Item = [f32; INPUTS]> + '_ {
        (0..RAYS).map(|ray| {
            let mut inputs = [self.radius; INPUTS];
            let parts = [ray, (ray + RAYS - APART) % RAYS, (ray + APART) % RAYS];
            for (inputs, ray) in inputs.chunks_exact_mut(OF_RAY).zip(parts) {
                inputs.copy_from_slice(&self.rays[ray]);
            }
            inputs
        })
    }

    /// What the rays together, each with its direction, tell each of them.
    pub fn context(&self, rays: impl Iterator<Item = (usize, [f32; 2])>) -> Context {
        Context::new(rays.map(|(ray, direction)| (direction, &self.rays[ray])))
    }
}

/// What the first layer gets from all rays: from their mean, and from their first harmonic around the ring.
pub(super) struct Context {
    mean: [f32; WIDTH],
    harmonic: [[f32; WIDTH]; 2],
}

impl Context {
    /// From directions and contrasts of the rays on which the rim can be seen.
    pub fn new<'a>(rays: impl Iterator<Item = ([f32; 2], &'a [f32; OF_RAY])>) -> Self {
        let (mut sums, mut count) = ([[0.0; OF_RAY]; 3], 0.0);
        for ([u, v], profile) in rays {
            for (sums, factor) in sums.iter_mut().zip([1.0, u, v]) {
                for (sum, value) in sums.iter_mut().zip(profile) {
                    *sum += factor * value;
                }
            }
            count += 1.0;
        }
        let share = 1.0 / math::max(count, 1.0);
        let [mean, u, v] = sums.map(|sums| sums.map(|sum| share * sum));
        Self {
            mean: layer(&mean, &MEAN, &BIASES.0),
            harmonic: [u, v].map(|values| layer(&values, &ALONG, &[0.0; WIDTH])),
        }
    }

    /// Distance of the rim from the ellipse along a ray, outwards [px], and the weight of this estimate in a
    /// fit: its inverse squared uncertainty [1/px²].
    pub fn offset(&self, [u, v]: [f32; 2], inputs: &[f32; INPUTS]) -> (f32, f32) {
        let mut start = self.mean;
        for (value, (along, across)) in start.iter_mut().zip(self.harmonic[0].iter().zip(&self.harmonic[1])) {
            *value += u * along + v * across;
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
