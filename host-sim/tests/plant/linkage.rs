//! The five-finger hand, of which one motor spreads four fingers.

use std::path::Path;

use tesaki::protocol::ActuatorFrame;
use tesaki_description::robot::RobotFolder;
use tesaki_sim::plant::{Drive, Plant, PlantOptions, PlantValues};

const SPREAD: usize = 5;

fn plant(gravity: [f64; 3]) -> Plant {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand5");
    let folder = RobotFolder::load(&path).unwrap();
    let mut values = PlantValues::load(&path).unwrap();
    values.gravity = gravity;
    // With straight fingers.
    values.posture.clear();
    let drives: Vec<Drive> = folder.model.joints.iter().map(Drive::from).collect();
    let options = PlantOptions { held_at_start: false, ..PlantOptions::exact() };
    Plant::new(&folder.urdf, &drives, &values, &options).unwrap()
}

fn frame(spread: f32) -> ActuatorFrame {
    let mut torques = [0.0; 16];
    torques[SPREAD] = spread;
    ActuatorFrame { sequence: 0, enabled: true, torques: torques.into_iter().collect() }
}

/// Direction of a finger's proximal link about the palm's normal, positive towards the thumb [rad].
fn direction(plant: &Plant, joint: usize) -> f64 {
    let (_, [x, y, z, w]) = plant.link_pose(joint).unwrap();
    // z axis of the link.
    let (ey, ez) = (2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y));
    ey.atan2(ez)
}

#[test]
fn one_motor_spreads_four_fingers_in_their_ratios() {
    let mut plant = plant([0.0; 3]);
    for _ in 0..30 {
        plant.apply(&frame(0.05)).unwrap();
    }
    let spread = plant.truth().positions[SPREAD];
    assert!(spread > 0.05, "{spread}");
    // The bend joints of index, middle, ring and little finger, whose links the spread turns.
    for (joint, ratio) in [(6, 1.0), (9, 0.3), (12, -0.4), (14, -1.0)] {
        let direction = direction(&plant, joint);
        assert!((direction - ratio * spread).abs() < 0.01, "{joint}: {direction}, {spread}");
    }
}

#[test]
fn the_motor_feels_the_inertia_of_all_fingers() {
    // By hand: the fingers are straight, so each is a rod about its knuckle; the inertia is the sum of ratio²
    // · I, the rotor, and the linkages. The acceleration starts from rest under 0.1 N·m minus friction.
    let rod = |masses: &[(f64, f64, f64)]| -> f64 {
        // Mass, start and length of each link: m (l²/12 + (start + l/2)²).
        masses.iter().map(|(m, start, l)| m * (l * l / 12.0 + (start + l / 2.0) * (start + l / 2.0))).sum()
    };
    let index = rod(&[(0.018, 0.0, 0.03978), (0.011, 0.03978, 0.02238), (0.007, 0.06216, 0.01966)]);
    let middle = rod(&[(0.018, 0.0, 0.04463), (0.011, 0.04463, 0.02633), (0.007, 0.07096, 0.02135)]);
    let ring = rod(&[(0.018, 0.0, 0.04137), (0.011, 0.04137, 0.02565), (0.007, 0.06702, 0.02125)]);
    let little = rod(&[(0.018, 0.0, 0.03274), (0.011, 0.03274, 0.01811), (0.007, 0.05085, 0.01969)]);
    let links = index + 0.09 * middle + 0.16 * ring + little;
    let mut plant = plant([0.0; 3]);
    let torque = 0.1;
    for _ in 0..4 {
        plant.apply(&frame(torque)).unwrap();
    }
    let linkages = 2e-5 * (0.09 + 0.16 + 1.0);
    let friction = 0.008 + 0.004 * 1.7;
    // The tips of 2 g at the ends of the fingers.
    let tip = |length: f64, ratio: f64| 0.002 * length * length * ratio * ratio;
    let tips = tip(0.08182, 1.0) + tip(0.09231, 0.3) + tip(0.08827, 0.4) + tip(0.07054, 1.0);
    let inertia = links + tips + 1e-4 + linkages;
    // From rest with viscous friction: x = F/b (t − I/b (1 − exp(−b t / I))).
    let (force, viscous, time) = (f64::from(torque) - friction, 0.002 + 0.001 * (0.09 + 0.16 + 1.0), 0.04);
    let constant: f64 = inertia / viscous;
    let expected = force / viscous * (time - constant * (1.0 - (-time / constant).exp()));
    let got = plant.truth().positions[SPREAD];
    assert!((got / expected - 1.0).abs() < 0.15, "{got} {expected}");
}
