//! The elementary functions give the bits that the on-target self-test compares with.
#![allow(clippy::cast_precision_loss, reason = "small integers")]

use tesaki::math;
use tesaki::vision::{Image, find_circle};

include!("../target_bits.in");
include!("../target_circles.in");

/// The first picture of `cargo sim render-knob --seed 4 --distance 0.06`, without its header.
const PICTURE: &[u8] = include_bytes!("../target_picture.bin");

#[test]
fn the_circle_finder_has_the_bits_that_the_board_must_reproduce() {
    let mut buffers = Box::new(tesaki::vision::CameraBuffers::new());
    let hash = circle_hash(PICTURE, &mut buffers.scratch());
    assert_eq!(hash, Some(CIRCLE_HASH), "{hash:#010x?}");
}

#[test]
fn elementary_functions_have_the_bits_that_the_board_must_reproduce() {
    let mut hash = 0_u32;
    for index in 0..20_000_i32 {
        let (sine, cosine) = math::sin_cos(index as f32 * 0.731_3 - 7000.0);
        hash = hash.rotate_left(5) ^ sine.to_bits() ^ cosine.to_bits().rotate_left(16);
    }
    assert_eq!(hash, SINE_HASH, "{hash:#010x}");
    let mut hash = 0_u32;
    for index in 1..5_000_i32 {
        let x = index as f32 * 0.173;
        let bits =
            math::sqrt(x).to_bits() ^ math::atan2(x - 400.0, x * 0.7 - 200.0).to_bits().rotate_left(16);
        hash = hash.rotate_left(5) ^ bits ^ math::exp(-x * 0.01).to_bits().rotate_left(8);
    }
    assert_eq!(hash, MATH_HASH, "{hash:#010x}");
}
