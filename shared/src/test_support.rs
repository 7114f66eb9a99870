//! Fixtures for tests and on-target programs.

use crate::kinematics::{Chain, FingerDescription, Hand};
use crate::model::{
    ChainModel, Coupling, Encoder, ForceSensor, Friction, Inertial, JointLimits, JointModel, Motor,
    ObserverGains, PidGains, Pose, Reaction, RobotModel, Safety, ServoGains,
};

/// A force sensor of a fingertip with typical values: up to 30 N and 0.3 N·m, without a mass on it.
pub const FORCE_SENSOR: ForceSensor = ForceSensor {
    force_resolution: 1e-3,
    torque_resolution: 1e-5,
    saturation: 30_000,
    force_limit: 10.0,
    mass: 0.0,
    center_of_mass: [0.0; 3],
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
            resistance: None,
            inductance: None,
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
        mimics: heapless::Vec::new(),
        gauges: None,
        safety: Safety {
            command_timeout: 0.1,
            reaction: Reaction::Hold,
            damping: 0.01,
            supply_min: 20.0,
            supply_max: 28.0,
        },
    }
}

/// Joint limits of the five-finger hand [rad], in the order of `robots/hand5`.
pub const HAND5_LIMITS: [(f32, f32); 16] = [
    (-0.3, 1.6),
    (0.0, 1.1),
    (-0.35, 0.35),
    (-0.2, 1.2),
    (-0.2, 1.4),
    (-0.15, 0.35),
    (-0.2, 1.6),
    (0.0, 1.8),
    (0.0, 1.2),
    (-0.2, 1.6),
    (0.0, 1.8),
    (0.0, 1.2),
    (-0.2, 1.6),
    (0.0, 1.8),
    (-0.2, 1.6),
    (0.0, 1.8),
];

/// The five-finger hand of `robots/hand5`: thumb with five joints; index, middle, ring and little finger,
/// whose first joints are all moved by the sixth actuator.
///
/// # Panics
/// Never: the numbers are valid.
pub fn hand5() -> Hand {
    const NO_MASS: Inertial = Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] };
    let chain = |joints: &[([f32; 3], [f32; 3])], tip: Pose| {
        let origins: heapless::Vec<Pose, 7> = joints
            .iter()
            .map(|&(translation, _)| Pose { translation, rotation: Pose::IDENTITY.rotation })
            .collect();
        let links = origins.iter().zip(joints).map(|(origin, (_, axis))| (origin, axis, &NO_MASS));
        Chain::of_links(links, &tip)
    };
    let straight = |length: f32| Pose { translation: [0.0, 0.0, length], ..Pose::IDENTITY };
    // The last segment is bent by 0.35 rad.
    let bent = |middle: f32, distal: f32| Pose {
        translation: [0.342_897_8 * distal, 0.0, middle + 0.939_372_7 * distal],
        rotation: [0.0, 0.174_108_14, 0.0, 0.984_726_54],
    };
    let (x, y) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let (back_x, back_z) = ([-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]);
    let zero = [0.0; 3];
    let up = |length: f32| [0.0, 0.0, length];
    let three = |base, a, b, c| chain(&[(base, back_x), (zero, y), (up(a), y), (up(b), y)], straight(c));
    let two = |base, a, tip| chain(&[(base, back_x), (zero, y), (up(a), y)], tip);
    let thumb =
        [([0.01, 0.022, 0.02], back_z), (zero, back_x), (up(0.046_22), y), (zero, x), (up(0.031_57), x)];
    let chains = [
        chain(&thumb, straight(0.027_34)),
        three([0.0, 0.025, 0.09], 0.039_78, 0.022_38, 0.019_66),
        three([0.0, 0.004, 0.092], 0.044_63, 0.026_33, 0.021_35),
        two([0.0, -0.016, 0.087], 0.041_37, bent(0.025_65, 0.021_25)),
        two([0.0, -0.034, 0.078], 0.032_74, bent(0.018_11, 0.019_69)),
    ];
    let spread = |multiplier| Coupling { actuated: 5, multiplier, offset: 0.0 };
    let couplings: [&[Coupling]; 5] = [
        &[0, 1, 2, 3, 4].map(Coupling::direct),
        &[5, 6, 7, 8].map(Coupling::direct),
        &[spread(0.3), Coupling::direct(9), Coupling::direct(10), Coupling::direct(11)],
        &[spread(-0.4), Coupling::direct(12), Coupling::direct(13)],
        &[spread(-1.0), Coupling::direct(14), Coupling::direct(15)],
    ];
    let fingers = chains.into_iter().zip(couplings).map(|(chain, couplings)| FingerDescription {
        limits: [None; 7].get(..chain.len()).unwrap_or_default(),
        chain,
        couplings,
        pointing: [0.0, 0.0, 1.0],
    });
    Hand::try_new(fingers, &HAND5_LIMITS).expect("valid")
}
