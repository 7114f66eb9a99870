//! Panic handler and robot model of the on-target programs.
#![allow(dead_code, reason = "each program uses its part")]

use core::panic::PanicInfo;

use cortex_m_semihosting::{debug, hprintln};
use tesaki::model::{
    ChainModel, Inertial, JointLimits, JointModel, Motor, ObserverGains, PidGains, Pose, Reaction,
    RobotModel, Safety, ServoGains,
};

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    hprintln!("panicked: {}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}

/// A joint of the hand; axes alternate.
pub fn joint(index: usize) -> JointModel {
    const NAMES: [&str; 9] = ["j0", "j1", "j2", "j3", "j4", "j5", "j6", "j7", "j8"];
    let typical = tesaki::test_support::joint(NAMES[index]);
    JointModel {
        origin: Pose { translation: [0.01, 0.0, 0.04], ..Pose::IDENTITY },
        axis: if index.is_multiple_of(3) { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] },
        link: Inertial {
            mass: 0.02,
            center_of_mass: [0.0, 0.0, 0.02],
            inertia: [5e-6, 5e-6, 1e-6, 0.0, 0.0, 0.0],
        },
        motor: Motor { current_limit: 1.4, ..typical.motor },
        limits: JointLimits { torque_rate: 60.0, following_error: 0.5, ..typical.limits },
        servo: ServoGains {
            pid: PidGains { proportional: 0.1, integral: 0.1, derivative: 0.001, ..typical.servo.pid },
            observer: ObserverGains { bandwidth: 20.0, observer_bandwidth: 40.0, ..typical.servo.observer },
            ..typical.servo
        },
        ..typical
    }
}

fn finger(name: &str) -> ChainModel {
    let tip = Pose { translation: [0.0, 0.0, 0.05], ..Pose::IDENTITY };
    ChainModel {
        name: name.try_into().expect("short"),
        joints: 3,
        tip,
        tip_radius: 0.0,
        force_sensor: None,
        mimic: None,
    }
}

/// Three chains of three joints.
pub fn hand() -> RobotModel {
    RobotModel {
        name: "bench".try_into().expect("short"),
        gravity: [-6.9367, 0.0, -6.9367],
        chains: ["tip0", "tip1", "tip2"].into_iter().map(finger).collect(),
        joints: (0..9).map(joint).collect(),
        safety: Safety {
            command_timeout: 10.0,
            reaction: Reaction::Hold,
            damping: 0.01,
            supply_min: 20.0,
            supply_max: 28.0,
        },
    }
}
