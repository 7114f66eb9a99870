//! The force sensors of the fingertips.

use rapier3d::na::{Quaternion, UnitQuaternion, Vector3};

use crate::grip::{Grip, squeeze};
use crate::hand::{Hand, JOINTS, frame, largest};
use tesaki_sim::plant::Plant;

const G: [f64; 3] = [-6.936_718, 0.0, -6.936_718];

/// Transforms a vector from the base to the frame of a fingertip.
fn in_tip(plant: &Plant, finger: usize, vector: [f64; 3]) -> Vector3<f64> {
    let (_, [x, y, z, w]) = plant.link_pose(3 * finger + 2).unwrap();
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).inverse() * Vector3::from(vector)
}

#[test]
fn at_rest_they_feel_the_fingertips_own_weight() {
    let plant = Hand::exact().build();
    for (finger, wrench) in plant.tip_wrenches().iter().enumerate() {
        let weight = in_tip(&plant, finger, G) * 0.005;
        assert!(largest((0..3).map(|i| wrench[i] - weight[i])) < 1e-6, "{wrench:?} {weight}");
        assert!(largest(wrench[3..].iter().copied()) < 1e-9, "{wrench:?}");
    }
}

#[test]
fn in_motion_they_feel_its_inertia() {
    let mut hand = Hand::exact().weightless().coulomb(0.0).viscous(0.0);
    hand.options.posture = Some([0.0, 0.0, 0.0].repeat(3));
    let mut plant = hand.build();
    let mut torques = [0.0; JOINTS];
    torques[1] = 0.01;
    for _ in 0..3 {
        plant.apply(&frame(torques)).unwrap();
    }
    let before = plant.truth().velocities;
    plant.apply(&frame(torques)).unwrap();
    // The straight finger turns about the bend joint; its tip moves along x of the tip's frame.
    let arm = [0.046 + 0.05178, 0.05178];
    let gained: f64 = (0..2).map(|i| (plant.truth().velocities[1 + i] - before[1 + i]) * arm[i]).sum();
    let felt = plant.tip_wrenches()[0][0];
    assert!(gained > 0.01 && (felt / (-0.005 * gained / 0.01) - 1.0).abs() < 0.03, "{felt} {gained}");
}

#[test]
fn they_feel_the_contact() {
    let mut grip = Grip::new(0.6, 0.02, 0.001);
    grip.hold(squeeze(4.0), 100);
    let contacts = grip.plant.contacts();
    for (finger, (wrench, contact)) in grip.plant.tip_wrenches().iter().zip(contacts).enumerate() {
        let force = in_tip(&grip.plant, finger, core::array::from_fn(|i| 0.005 * G[i] - contact.force[i]));
        assert!(largest((0..3).map(|i| wrench[i] - force[i])) < 1e-3, "{wrench:?} {force}");
        // The force acts at one radius from the centre, so only friction causes a torque.
        let turn = Vector3::new(wrench[3], wrench[4], wrench[5]).norm();
        assert!((turn / (0.008 * contact.tangential_force()) - 1.0).abs() < 0.05, "{turn} {contact:?}");
    }
}

#[test]
fn errors_have_their_sizes() {
    let (mut offsets, mut gains, mut noise) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..40 {
        let mut hand = Hand::mismatched(seed).coulomb(1.0);
        let mut plant = hand.build();
        let reads: Vec<_> = (0..400).map(|_| plant.force_sensors()).collect();
        let mean = |finger: usize, axis: usize| {
            reads.iter().map(|read| f64::from(read[finger][axis])).sum::<f64>() / reads.len() as f64
        };
        let scales = hand.values.force_sensor.unwrap().scales();
        let truth = plant.tip_wrenches();
        offsets.push(mean(0, 1) * scales[1] - truth[0][1]);
        let spread = reads.iter().map(|read| (f64::from(read[1][5]) - mean(1, 5)).powi(2)).sum::<f64>();
        noise.push((spread / reads.len() as f64).sqrt() * scales[5]);
        // The same machine with gravity increased by a factor of 100.
        hand.values.gravity = G.map(|part| 100.0 * part);
        hand.values.posture.clear();
        let mut heavy = hand.build();
        let read = heavy.force_sensors()[0][2];
        hand.values.gravity = [0.0; 3];
        let empty = hand.build().force_sensors()[0][2];
        gains.push(f64::from(read - empty) * scales[2] / heavy.tip_wrenches()[0][2]);
    }
    let (high, low) =
        (offsets.iter().copied().fold(0.0, f64::max), offsets.iter().copied().fold(0.0, f64::min));
    assert!(high > 0.8 && high < 1.01 && low < -0.8 && low > -1.01, "{low} {high}");
    assert!(noise.iter().all(|deviation| (deviation / 5e-4 - 1.0).abs() < 0.2), "{noise:?}");
    // The noise of a single reading is about 1 % of 3 N.
    let widest = largest(gains.iter().map(|gain| gain - 1.0));
    assert!(widest > 0.005 && widest < 0.045, "{widest}");
}

#[test]
fn they_saturate_and_a_robot_without_has_none() {
    let mut hand = Hand::exact();
    hand.values.gravity = [-1e5, 0.0, 0.0];
    let read = hand.build().force_sensors();
    assert!(read[0].iter().any(|count| count.abs() == 20_000), "{read:?}");
    hand.values.force_sensor = None;
    assert!(hand.build().force_sensors().is_empty());
}
