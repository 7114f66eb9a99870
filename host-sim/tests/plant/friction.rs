use crate::hand::{Hand, JOINTS, frame, largest};
use tesaki_sim::plant::Plant;

const COULOMB: f64 = 0.02;

/// Returns the distance that each joint has moved after `periods` under constant torques.
fn travel(plant: &mut Plant, torques: [f32; JOINTS], periods: u32) -> Vec<f64> {
    let start = plant.truth().positions;
    for _ in 0..periods {
        plant.apply(&frame(torques)).unwrap();
    }
    plant.truth().positions.iter().zip(&start).map(|(end, start)| end - start).collect()
}

#[test]
fn below_coulomb_friction_joints_stand_still() {
    // All nine close to the limit: their friction is coupled through the links.
    for share in [0.5, 0.99] {
        let mut plant = Hand::exact().weightless().build();
        let gone = travel(&mut plant, [(share * COULOMB) as f32; JOINTS], 1000);
        assert!(largest(gone.clone()) < 1e-6, "in 10 s: {gone:?}");
    }
}

#[test]
fn above_coulomb_friction_every_joint_moves() {
    let mut plant = Hand::exact().weightless().build();
    for gone in travel(&mut plant, [(1.01 * COULOMB) as f32; JOINTS], 50) {
        assert!(gone > 0.01, "{gone}");
    }
}

#[test]
fn gravity_is_held_by_the_torque_that_statics_asks_for() {
    // Finger 1, by hand: the links lean at 19° and 58° from z, and gravity acts along (−1, 0, −1)/√2.
    let lean = |degrees: f64| (45.0 - degrees).to_radians().sin();
    let upper = (0.010 * 0.02589 + 0.005 * 0.05178) * lean(58.0);
    let lower = (0.020 * 0.023 + 0.015 * 0.046) * lean(19.0);
    let (bend, curl) = (9.81 * (lower + upper), 9.81 * upper);
    assert!((bend - 3.80e-3).abs() < 0.005e-3 && (curl + 1.14e-3).abs() < 0.005e-3, "{bend} {curl}");

    // Friction of 5 mN·m holds the hand; each joint moves when its torque is off by 1 % more than that.
    let friction = 0.005;
    for (joint, hold) in [(0, 0.0), (1, bend), (2, curl)] {
        for side in [-1.0, 1.0] {
            for (share, moves) in [(0.99, false), (1.01, true)] {
                let mut plant = Hand::exact().coulomb(friction).build();
                let mut torques = [0.0, bend, curl, 0.0, bend, curl, 0.0, bend, curl];
                torques[joint] = hold + side * share * friction;
                let gone = travel(&mut plant, torques.map(|torque| torque as f32), 20)[joint];
                assert_eq!(gone * side > 1e-4, moves, "joint {joint}, {side}, {share}: {gone:e}");
            }
        }
    }
}

#[test]
fn a_coasting_joint_slows_down_at_the_right_rate_and_stops() {
    let (torque, coulomb, swing) = (0.010, 0.005, 0);
    let mut plant = Hand::exact().weightless().viscous(0.0).coulomb(coulomb).build();
    let mut torques = [0.0; JOINTS];
    let mut velocities = Vec::new();
    for period in 0..30 {
        torques[swing] = if period < 10 { torque as f32 } else { 0.0 };
        plant.apply(&frame(torques)).unwrap();
        velocities.push(plant.truth().velocities[swing]);
    }
    // Inertia about the swing axis: rotor, knuckle, and the solids of lower link, upper link and tip at their
    // distances.
    let (s19, s58) = (19f64.to_radians().sin(), 58f64.to_radians().sin());
    let rod = |across: f64, along: f64, sine: f64| across * sine * sine + along * (1.0 - sine * sine);
    let knee = 0.046 * s19;
    let inertia = 2e-4
        + 2.88e-6
        + rod(3.772e-6, 4.9e-7, s19)
        + 0.020 * (0.023 * s19).powi(2)
        + rod(2.297e-6, 1.25e-7, s58)
        + 0.010 * (knee + 0.02589 * s58).powi(2)
        + 1.28e-7
        + 0.005 * (knee + 0.05178 * s58).powi(2);
    let speeding = (velocities[9] - velocities[4]) / 0.05;
    let coasting = (velocities[15] - velocities[11]) / 0.04;
    assert!((speeding * inertia / (torque - coulomb) - 1.0).abs() < 0.005, "{speeding}");
    assert!((coasting * inertia / -coulomb - 1.0).abs() < 0.005, "{coasting}");
    assert!(velocities[29].abs() < 1e-7, "{}", velocities[29]);
}

#[test]
fn end_stops_hold() {
    let mut plant = Hand::exact().build();
    let mut torques = [0.0; JOINTS];
    torques[2] = 0.3;
    travel(&mut plant, torques, 200);
    let stopped = plant.truth().positions[2];
    assert!((stopped - 2.4).abs() < 0.01, "{stopped}");
}
