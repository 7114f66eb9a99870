//! The elementary functions return the same bits as in the on-target self-test.
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
    let [sine, math] = [sine_hash(), math_hash()];
    assert_eq!([sine, math], [SINE_HASH, MATH_HASH], "{sine:#010x} {math:#010x}");
}
