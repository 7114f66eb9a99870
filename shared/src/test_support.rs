//! Fixtures for tests and on-target programs.

use crate::model::{
    ChainModel, Encoder, Friction, Inertial, JointLimits, JointModel, Motor, ObserverGains, PidGains, Pose,
    Reaction, RobotModel, Safety, ServoGains,
};

/// A joint with typical values.
///
/// # Panics
/// The name is longer than [`MAX_NAME`](crate::model::MAX_NAME).
pub fn joint(name: &str) -> JointModel {
    JointModel {
        name: name.try_into().expect("a name that fits"),
        origin: Pose::IDENTITY,
        axis: [0.0, 0.0, 1.0],
        link: Inertial {
            mass: 0.02,
            center_of_mass: [0.02, 0.0, 0.0],
            inertia: [1e-6, 5e-6, 5e-6, 0.0, 0.0, 0.0],
        },
        motor: Motor {
            rotor_inertia: 2e-4,
            torque_constant: 0.5,
            current_limit: 1.5,
            current_resolution: 1e-3,
            bandwidth: 300.0,
            delay: 3e-4,
        },
        friction: Friction { coulomb: 0.02, viscous: 0.002 },
        encoder: Encoder { counts_per_turn: 65536.0, reversed: false, zero: 0, relative: false },
        limits: JointLimits {
            lower: -1.5,
            upper: 1.5,
            velocity: 8.0,
            torque: 0.6,
            torque_rate: 200.0,
            following_error: 0.2,
        },
        servo: ServoGains {
            filter_time: 0.2,
            pid: PidGains { proportional: 0.4, integral: 1.0, derivative: 0.01, cutoff: 30.0 },
            observer: ObserverGains { inertia: 2.1e-4, bandwidth: 50.0, observer_bandwidth: 100.0 },
            rest_error: 5e-4,
        },
    }
}

/// A finger of three joints with parallel axes.
///
/// # Panics
/// Never: names and numbers fit.
pub fn finger() -> RobotModel {
    let mut joints = heapless::Vec::new();
    for name in ["base", "middle", "tip"] {
        joints.push(joint(name)).expect("fits");
    }
    RobotModel {
        name: "finger".try_into().expect("fits"),
        gravity: [0.0, 0.0, -9.81],
        chains: heapless::Vec::from_slice(&[ChainModel {
            name: "tip".try_into().expect("fits"),
            joints: 3,
            tip: Pose::IDENTITY,
            tip_radius: 0.0,
            force_sensor: None,
        }])
        .expect("fits"),
        joints,
        safety: Safety {
            command_timeout: 0.1,
            reaction: Reaction::Hold,
            damping: 0.01,
            supply_min: 20.0,
            supply_max: 28.0,
        },
    }
}
