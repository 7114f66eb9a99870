//! Where the rim crosses a ray.
//!
//! The strongest edge is not the rim: the bevel of the rose and the shadow at its foot have edges as well,
//! and in a blurred picture they merge with that of the rim. A small neural network, fitted to rendered
//! pictures by `tests/oracles/rim_offset.py`, estimates the distance of the rim from an ellipse near it, and
//! how uncertain that is, from the contrasts along a ray and along two neighbours.

use super::offset_weights::{BIASES, DEEP, FIRST, LAST};
use super::ring::{PLACES, RAYS, Ring};
use crate::math;

/// Inputs from each of the three rays: the contrasts relative to the largest, and the largest.
const OF_RAY: usize = PLACES + 1;
/// Inputs: of the ray, of both neighbours; the radius.
pub(super) const INPUTS: usize = 3 * OF_RAY + 1;
/// Distance of the neighbours [rays].
const APART: usize = 2;
/// Contrasts are small compared with these [grey levels].
const SMALL: f32 = 3.0;
const MEDIUM: f32 = 12.0;
/// Unit of the radius [px].
const RADIUS: f32 = 30.0;
/// Bounds of the logarithm of the uncertainty [px].
const LOG_SCALE: [f32; 2] = [-3.0, 2.0];

/// Inputs of the network on each ray, from a ring in steps of half a pixel.
pub(super) fn inputs(ring: &Ring) -> impl Iterator<Item = [f32; INPUTS]> {
    let mut rays = [[0.0; OF_RAY]; RAYS];
    for (ray, inputs) in rays.iter_mut().enumerate() {
        let Some(contrasts) = ring.contrasts(ray) else { continue };
        let largest = contrasts.iter().fold(0.0, |max, contrast| math::max(max, math::abs(*contrast)));
        let scale = 1.0 / (largest + SMALL);
        for (input, contrast) in inputs.iter_mut().zip(contrasts) {
            *input = contrast * scale;
        }
        inputs[PLACES] = largest / (largest + MEDIUM);
    }
    let radius = ring.radius() / RADIUS;
    (0..RAYS).map(move |ray| {
        let mut inputs = [radius; INPUTS];
        let parts = [ray, (ray + RAYS - APART) % RAYS, (ray + APART) % RAYS];
        for (inputs, ray) in inputs.chunks_exact_mut(OF_RAY).zip(parts) {
            inputs.copy_from_slice(&rays[ray]);
        }
        inputs
    })
}

/// Distance of the rim from the ellipse, outwards [px], and the weight of this estimate in a fit: its inverse
/// squared uncertainty [1/px²].
pub(super) fn offset(inputs: &[f32; INPUTS]) -> (f32, f32) {
    let first = layer(inputs, &FIRST, &BIASES.0);
    let deep = layer(&first.map(positive), &DEEP, &BIASES.1);
    let [offset, log_scale] = layer(&deep.map(positive), &LAST, &BIASES.2);
    (offset, math::exp(-2.0 * math::clamp(log_scale, LOG_SCALE[0], LOG_SCALE[1])))
}

const fn positive(value: f32) -> f32 {
    math::max(value, 0.0)
}

/// Weighted sums of the inputs. Row `i` of the weights belongs to output `i`.
fn layer<const I: usize, const O: usize>(
    inputs: &[f32; I],
    weights: &[[f32; I]; O],
    biases: &[f32; O],
) -> [f32; O] {
    let mut outputs = *biases;
    for (output, weights) in outputs.iter_mut().zip(weights) {
        for (input, weight) in inputs.iter().zip(weights) {
            *output += weight * input;
        }
    }
    outputs
}
