//! The circle finder on a picture of a door knob, on the emulated Cortex-M4F with `-icount shift=0`: prints
//! the executed instructions, one `name instructions` per line, and checks for the bits that the host
//! computed. The picture lies in flash; the buffers take 44 kB of RAM, which the other programs do not have.

#![no_std]
#![no_main]

use core::hint::black_box;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use tesaki::vision::{CameraBuffers, Image, find_circle};
use tesaki_firmware as _;

mod support;

include!("../../../tests/target_circles.in");

const PICTURE: &[u8] = include_bytes!("../../../tests/target_picture.bin");

#[entry]
fn main() -> ! {
    let mut systick = cortex_m::Peripherals::take().expect("taken once").SYST;
    systick.set_clock_source(SystClkSource::Core);
    // 24 bits: a search must be shorter than 0.1 s of virtual time.
    systick.set_reload(0xFF_FFFF);
    systick.clear_current();
    systick.enable_counter();
    let buffers = cortex_m::singleton!(: CameraBuffers = CameraBuffers::new()).expect("taken once");
    let image = Image::try_new(PICTURE, 256, 240).expect("its size");
    for (name, search) in ["find_circle", "find_circle_window"].into_iter().zip(&CIRCLE_SEARCHES) {
        systick.clear_current();
        let start = SYST::get_current();
        let found = find_circle(black_box(&image), search, &mut buffers.scratch());
        let ticks = start.wrapping_sub(SYST::get_current()) & 0xFF_FFFF;
        assert!(!systick.has_wrapped(), "{name} takes more than 0.1 s of virtual time");
        assert!(matches!(black_box(found), Ok(Some(_))), "no circle");
        hprintln!("{} {}.0", name, u64::from(ticks) * 1000 / 168);
    }
    assert_eq!(
        circle_hash(PICTURE, &mut buffers.scratch()),
        Some(CIRCLE_HASH),
        "other bits than on the host"
    );
    debug::exit(debug::EXIT_SUCCESS);
    loop {
        cortex_m::asm::nop();
    }
}
