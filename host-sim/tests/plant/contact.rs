//! The contact model compared with hand calculations: Coulomb's law, depth, creep, and the reported true
//! values.

use crate::grip::{Grip, squeeze};
use crate::hand::{Hand, frame, largest};
use crate::pinch::{ARM, MASS, Pinch, RADIUS, SIZE};
use tesaki_sim::plant::{Load, ObjectTruth, ObjectValues, Plant, Push, Shape, Support};

const G: f64 = 9.81;
const WEIGHT: f64 = MASS * G;
const UNTURNED: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// Returns the displacement of the object [m].
fn moved(from: &ObjectTruth, to: &ObjectTruth) -> f64 {
    (0..3).map(|i| (to.position[i] - from.position[i]).powi(2)).sum::<f64>().sqrt()
}

/// Returns the rotation of the object [rad].
fn turned(from: &ObjectTruth, to: &ObjectTruth) -> f64 {
    // The sine of half the angle: the part of one quaternion that is orthogonal to the other.
    let ([a, b, c, d], [e, f, g, h]) = (from.orientation, to.orientation);
    let vector =
        [d * e - a * h - b * g + c * f, d * f - b * h - c * e + a * g, d * g - c * h - a * f + b * e];
    2.0 * vector.iter().map(|x| x * x).sum::<f64>().sqrt().asin()
}

/// A box far from the hand on a table, with gravity tilted by a slope towards +x.
fn table(friction: f64, slope: f64) -> Plant {
    let mut hand = Hand::exact();
    let share = 1.0 / (1.0 + slope * slope).sqrt();
    hand.values.gravity = [G * slope * share, 0.0, -G * share];
    let support = Support { size: [1.0, 0.5, 0.1], position: [0.0, 0.0, 0.35], orientation: UNTURNED };
    hand.options.object = Some(
        ObjectValues {
            shape: Shape::Box,
            size: SIZE,
            mass: MASS,
            friction,
            friction_spread: 0.0,
            position: [0.0, 0.0, 0.43],
            orientation: UNTURNED,
            support: None,
        }
        .on(support),
    );
    hand.build()
}

fn run(plant: &mut Plant, periods: u32) -> ObjectTruth {
    for _ in 0..periods {
        plant.apply(&frame([0.0; 9])).unwrap();
    }
    plant.object().unwrap()
}

#[test]
fn a_box_slides_on_a_table_as_coulomb_says() {
    for friction in [0.4, 0.6, 0.8] {
        let mut below = table(friction, 0.99 * friction);
        let (start, end) = (run(&mut below, 10), run(&mut below, 200));
        assert!(moved(&start, &end) < 1e-8, "{friction}: {:e}", moved(&start, &end));
        let force = end.support_force.map(|part| part / WEIGHT);
        assert!((force[2].hypot(force[0]) - 1.0).abs() < 3e-3, "{force:?}");

        let slope = 1.01 * friction;
        let mut above = table(friction, slope);
        let (start, end) = (run(&mut above, 10), run(&mut above, 50));
        let speed = (end.velocity[0] - start.velocity[0]) / 0.5;
        let expected = G * (slope - friction) / (1.0 + slope * slope).sqrt();
        assert!((speed / expected - 1.0).abs() < 1e-3, "{friction}: {speed} {expected}");
    }
}

/// Returns the force of each bar with which both tips just carry a share of the box's weight.
fn grip_for(friction: f64, share: f64) -> f64 {
    // Friction acts at a distance of one tip radius from the bar, and opens it.
    share * WEIGHT / (2.0 * friction) + WEIGHT / 2.0 * RADIUS / ARM
}

#[test]
fn two_tips_lose_a_box_as_coulomb_says() {
    for friction in [0.4, 0.6, 0.8] {
        for (share, holds) in [(1.01, true), (0.99, false)] {
            let mut rig = Pinch::new(friction, G);
            rig.squeeze(1.0, 20);
            let start = rig.plant.object().unwrap();
            rig.squeeze(grip_for(friction, share), 50);
            let gone = moved(&start, &rig.plant.object().unwrap());
            // Below the threshold it falls with 1 % of its weight for half a second: 12 mm.
            assert!(
                if holds { gone < 5e-6 } else { gone > 8e-3 && gone < 14e-3 },
                "{friction}, {share}: {gone:e}"
            );
        }
    }
}

#[test]
fn tips_hardly_sink_in() {
    for (force, bound) in [(2.0, 5e-6), (4.0, 1e-5), (8.0, 2e-5)] {
        let mut rig = Pinch::new(0.6, 0.0);
        rig.squeeze(force, 50);
        for contact in rig.plant.contacts() {
            assert!((contact.normal_force() / force - 1.0).abs() < 1e-3, "{contact:?}");
            assert!(contact.depth > 0.0 && contact.depth < bound, "{force}: {:e}", contact.depth);
        }
    }
}

#[test]
fn a_held_box_does_not_creep() {
    let mut pinch = Pinch::new(0.6, G);
    pinch.squeeze(1.0, 50);
    let start = pinch.plant.object().unwrap();
    pinch.squeeze(1.0, 1000);
    let end = pinch.plant.object().unwrap();
    assert!(moved(&start, &end) < 1e-9 && turned(&start, &end) < 1e-9, "{start:?} {end:?}");

    for force in [2.0, 4.0] {
        let mut grip = Grip::new(0.6, 0.02, 0.001);
        grip.hold(squeeze(force), 50);
        let start = grip.plant.object().unwrap();
        grip.hold(squeeze(force), 1000);
        let end = grip.plant.object().unwrap();
        assert!(moved(&start, &end) < 2e-8 && turned(&start, &end) < 1e-6, "{start:?} {end:?}");
        for contact in grip.plant.contacts() {
            let slip = largest(contact.slip);
            assert!(slip < 1e-5 && contact.slip_path < 1e-5 && contact.depth < 1e-5, "{contact:?}");
        }
    }
}

#[test]
fn contact_forces_balance_the_weight() {
    let mut grip = Grip::new(0.6, 0.02, 0.001);
    grip.hold(squeeze(4.0), 200);
    let mut sum = [0.0; 3];
    for contact in grip.plant.contacts() {
        assert!(contact.tangential_force() < 0.6 * contact.normal_force());
        for (sum, part) in sum.iter_mut().zip(contact.force) {
            *sum += part;
        }
    }
    let weight = WEIGHT / 2f64.sqrt();
    let off = largest([sum[0] - weight, sum[1], sum[2] - weight]);
    assert!(off < 2e-3 * WEIGHT, "{sum:?}");
}

#[test]
fn slip_is_what_slid() {
    let mut rig = Pinch::new(0.6, G);
    rig.squeeze(1.0, 20);
    let start = rig.plant.object().unwrap();
    rig.squeeze(grip_for(0.6, 0.8), 10);
    let dropped = start.position[2] - rig.plant.object().unwrap().position[2];
    assert!(dropped > 0.005);
    for contact in rig.plant.contacts() {
        let [x, y, z] = contact.slip;
        assert!(
            (z / dropped - 1.0).abs() < 0.01 && x.abs() < 1e-5 && y.abs() < 1e-5,
            "{dropped} {contact:?}"
        );
        assert!((contact.slip_path / dropped - 1.0).abs() < 0.01);
        assert!((contact.slip_velocity[2] + rig.plant.object().unwrap().velocity[2]).abs() < 1e-3);
    }
}

#[test]
fn pushes_and_weights_act() {
    // Accelerated upwards: gravity off, no squeeze, the tips drawn back.
    let mut rig = Pinch::new(0.6, 0.0);
    rig.squeeze(-0.5, 3);
    let push = Push { force: [0.0, 0.3, 0.0], point: [0.0; 3], ramp: 0.1, hold: 0.1 };
    rig.plant.push(push).unwrap();
    rig.squeeze(0.0, 40);
    let velocity = rig.plant.object().unwrap().velocity[1];
    assert!((velocity / (0.3 * 0.2 / MASS) - 1.0).abs() < 2e-3, "{velocity}");

    // The tips carry a weight at the top of the box.
    let mut rig = Pinch::new(0.6, G);
    rig.squeeze(4.0, 20);
    rig.plant.load(Load { mass: 0.2, point: [0.0, 0.0, -SIZE[2] / 2.0], ramp: 0.3 }).unwrap();
    rig.squeeze(4.0, 200);
    let carried: f64 = rig.plant.contacts().iter().map(|contact| contact.force[2]).sum();
    assert!((carried / (WEIGHT + 0.2 * G) - 1.0).abs() < 2e-3, "{carried}");
    rig.plant.unload(0.3);
    rig.squeeze(4.0, 200);
    let carried: f64 = rig.plant.contacts().iter().map(|contact| contact.force[2]).sum();
    assert!((carried / WEIGHT - 1.0).abs() < 5e-3 && rig.plant.object().unwrap().load < 1e-12, "{carried}");
}
