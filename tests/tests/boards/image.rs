//! Three emulated boards that run the firmware image.

use std::path::PathBuf;

use tesaki::task::grasping::{GraspTelemetry, Phase};
use tesaki_sim::controller::{Controller, Native};
use tesaki_sim::qemu::{Machine, Qemu};
use tesaki_supervisor::hand::FingerBoard;

use super::rig::{Rig, distance};

fn image() -> PathBuf {
    std::env::var_os("TESAKI_ELF")
        .unwrap_or_else(|| panic!("TESAKI_ELF is not set: run `cargo xtask test`"))
        .into()
}

#[test]
#[ignore = "needs the firmware image: cargo xtask test"]
fn three_images_grasp_and_hold_a_box() {
    fn hold<B: FingerBoard + Controller>(boards: [B; 3]) -> ([f64; 3], GraspTelemetry) {
        let mut rig = Rig::new(1, Some(boards));
        rig.grasp();
        let start = rig.box_now().position;
        rig.wait(100);
        assert!(distance(rig.box_now().position, start) < 1e-3);
        (rig.box_now().position, rig.hand().telemetry())
    }
    let images = hold([(); 3].map(|()| Qemu::boot(&image(), &Machine::default()).unwrap()));
    assert_eq!(images.1.phase, Phase::Hold);
    assert_eq!(images, hold([(); 3].map(|()| Native::default())), "not the same as here, bit for bit");
}
