//! Objects as data, and what a plant makes of them.

use crate::grip::{Grip, squeeze};
use crate::hand::{Hand, frame};
use tesaki_sim::plant::{Load, ObjectValues, Plant, Push, Support};

const BOX: &str = include_str!("../../../robots/hand3/objects/box.toml");
const CYLINDER: &str = include_str!("../../../robots/hand3/objects/cylinder.toml");
const WEDGE: &str = include_str!("../../../robots/hand3/objects/wedge.toml");
const G: f64 = 9.81;

fn object(text: &str) -> ObjectValues {
    ObjectValues::from_toml(text).unwrap()
}

/// On a table above the hand, gravity along −z.
fn on_table(text: &str, seed: u64) -> Plant {
    let mut hand = Hand::mismatched(seed);
    hand.values.gravity = [0.0, 0.0, -G];
    let values = object(text);
    let support =
        Support { size: [0.5, 0.5, 0.02], position: [0.0, 0.0, 0.29], orientation: [0.0, 0.0, 0.0, 1.0] };
    let height = 0.3 + values.size[2] / 2.0;
    hand.options.object = Some(values.at([0.0, 0.0, height], [0.0, 0.0, 0.0, 1.0]).on(support));
    hand.build()
}

fn run(plant: &mut Plant, periods: u32) {
    for _ in 0..periods {
        plant.apply(&frame([0.0; 9])).unwrap();
    }
}

#[test]
fn every_shape_stands_on_a_table_and_falls_without() {
    for text in [BOX, CYLINDER, WEDGE] {
        let values = object(text);
        let mut plant = on_table(text, 0);
        run(&mut plant, 200);
        let state = plant.object().unwrap();
        let sunk = 0.3 + values.size[2] / 2.0 - state.position[2];
        assert!(sunk.abs() < 2e-6 && state.orientation[3] > 1.0 - 1e-9, "{state:?}");
        assert!((state.support_force[2] / (values.mass * G) - 1.0).abs() < 0.02, "{state:?}");
        plant.remove_support();
        run(&mut plant, 10);
        let fallen = state.position[2] - plant.object().unwrap().position[2];
        assert!((fallen / (0.5 * G * 0.01) - 1.0).abs() < 0.03, "{fallen}");
    }
}

/// A push on the wedge's middle turns it: its centre of mass is lower.
#[test]
fn a_wedge_has_its_own_centre_of_mass() {
    let mut hand = Hand::exact().weightless();
    hand.options.object = Some(object(WEDGE).at([0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]));
    let mut plant = hand.build();
    plant.push(Push { force: [0.01, 0.0, 0.0], point: [0.0; 3], ramp: 0.0, hold: 0.1 }).unwrap();
    run(&mut plant, 10);
    let state = plant.object().unwrap();
    // A trapezium of widths 1 and 0.75: h/6 · (1 + 2 · 0.75)/(1 + 0.75) · 2 = 0.476 h above the bottom.
    let lower = 0.060 * (0.5 - 2.5 / 1.75 / 3.0);
    // Nearly that of a box of its mean width.
    let around = 0.020 / 12.0 * (0.0860_f64.powi(2) + 0.060_f64.powi(2));
    let speed = 0.01 * 0.1 / 0.020;
    let middle = state.velocity[0] - state.angular_velocity[1] * lower;
    assert!((lower - 1.43e-3).abs() < 1e-5 && state.angular_velocity[1] > 0.0, "{state:?}");
    assert!((middle / speed - 1.0).abs() < 0.01, "{state:?}");
    let turning = 0.01 * lower * 0.1 / around;
    assert!((state.angular_velocity[1] / turning - 1.0).abs() < 0.02, "{turning} {state:?}");
}

/// A weight on top: a sideways push at the common centre of mass does not turn it, and both are as heavy as
/// they should be.
#[test]
fn a_weight_shifts_the_centre_of_mass_and_the_inertia() {
    let mut hand = Hand::exact().weightless();
    hand.options.object = Some(object(BOX).at([0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]));
    let mut plant = hand.build();
    let (mass, weight, arm) = (0.023, 0.2, 0.03);
    plant.load(Load { mass: weight, point: [0.0, 0.0, arm], ramp: 0.0 }).unwrap();
    run(&mut plant, 1);
    let center = arm * weight / (mass + weight);
    plant.push(Push { force: [0.1, 0.0, 0.0], point: [0.0, 0.0, center], ramp: 0.01, hold: 0.09 }).unwrap();
    run(&mut plant, 15);
    let state = plant.object().unwrap();
    assert!((state.velocity[0] / (0.1 * 0.1 / (mass + weight)) - 1.0).abs() < 2e-3, "{state:?}");
    assert!(state.angular_velocity.iter().all(|speed| speed.abs() < 1e-3), "{state:?}");
    plant.push(Push { force: [0.01, 0.0, 0.0], point: [0.0; 3], ramp: 0.01, hold: 0.09 }).unwrap();
    run(&mut plant, 15);
    let around = mass / 12.0 * (0.098_f64.powi(2) + 0.060_f64.powi(2))
        + mass * center * center
        + weight * (arm - center).powi(2);
    let turning = -0.01 * center * 0.1 / around;
    let turned = plant.object().unwrap().angular_velocity[1];
    assert!((turned / turning - 1.0).abs() < 5e-3, "{turned} {turning}");
}

#[test]
fn friction_is_drawn_from_its_range() {
    let drawn: Vec<f64> = (0..200).map(|seed| on_table(BOX, seed).object().unwrap().friction).collect();
    let (low, high) = drawn.iter().fold((1.0_f64, 0.0_f64), |(l, h), &x| (l.min(x), h.max(x)));
    assert!(0.4 <= low && low < 0.41 && 0.79 < high && high <= 0.8, "{low} {high}");
    let mut hand = Hand::exact();
    hand.options.object = Some(object(BOX));
    assert!((hand.build().object().unwrap().friction - 0.6).abs() < 1e-12);
}

#[test]
fn bad_objects_are_refused_by_name() {
    let error = |from: &str, to: &str| {
        assert!(BOX.contains(from));
        ObjectValues::from_toml(&BOX.replacen(from, to, 1)).unwrap_err().to_string()
    };
    assert!(error("mass = 0.023", "mass = 0.0").contains(":4: mass is 0: it must be above 0"));
    assert!(error("0.098", "-0.098").contains(":3: size is -0.098"));
    assert!(error("spread = 0.2", "spread = 0.7").contains("friction_spread is 0.7"));
    assert!(error("\"box\"", "\"ball\"").contains("ball"));
    assert!(error("\"box\"", "\"cylinder\"").contains("same along x and y"));
    let mut hand = Hand::exact();
    hand.options.object = Some(object(BOX).at([0.0; 3], [0.0; 4]));
    let refused =
        Plant::new(&hand.urdf, &hand.drives, &hand.values, &hand.options).err().unwrap().to_string();
    assert!(refused.contains("object: the length of orientation is 0"), "{refused}");
    let mut plant = on_table(BOX, 0);
    let push = Push { force: [0.0; 3], point: [0.0; 3], ramp: -1.0, hold: 0.0 };
    assert!(plant.push(push).unwrap_err().to_string().contains("push.ramp is -1"));
    let load = Load { mass: f64::NAN, point: [0.0; 3], ramp: 0.1 };
    assert!(plant.load(load).unwrap_err().to_string().contains("load.mass"));
}

#[test]
fn a_plant_without_an_object_has_no_contacts() {
    let mut plant = Hand::exact().build();
    let push = Push { force: [1.0; 3], point: [0.0; 3], ramp: 0.0, hold: 1.0 };
    plant.push(push).unwrap();
    run(&mut plant, 3);
    assert!(plant.contacts().is_empty() && plant.object().is_none());
}

#[test]
fn the_same_grasp_gives_the_same_bits() {
    let run = || {
        let mut grip = Grip::open(0.002);
        grip.hold(squeeze(3.0), 100);
        let object = grip.plant.object().unwrap();
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        (bits(&object.position), bits(&object.orientation), bits(&grip.plant.truth().positions))
    };
    assert_eq!(run(), run());
}

/// The tips come from 2 mm away, hit the box at some 0.3 m/s, and hold it when its support is gone.
#[test]
fn the_hand_takes_a_box_from_its_support() {
    let mut grip = Grip::open(0.002);
    let start = grip.plant.object().unwrap();
    assert!(grip.plant.contacts().iter().all(|contact| contact.normal_force().abs() < 1e-12));
    let (mut fastest, mut deepest) = (0.0, 0.0);
    for _ in 0..100 {
        grip.hold(squeeze(3.0), 1);
        let speed = grip.plant.object().unwrap().velocity;
        fastest = f64::max(fastest, speed.iter().map(|v| v * v).sum::<f64>().sqrt());
        deepest =
            grip.plant.contacts().iter().fold(deepest, |deepest, contact| f64::max(deepest, contact.depth));
    }
    grip.plant.remove_support();
    grip.hold(squeeze(3.0), 100);
    let held = grip.plant.object().unwrap();
    let gone = (0..3).map(|i| (held.position[i] - start.position[i]).powi(2)).sum::<f64>().sqrt();
    assert!(fastest < 1.0 && deepest < 2e-4 && gone < 3e-3, "{deepest:e} {gone:e}");
    assert!(held.velocity.iter().all(|speed| speed.abs() < 1e-4), "{held:?}");
    // Three weights, one after the other and together, and off again.
    for mass in [0.05, 0.1] {
        grip.plant.load(Load { mass, point: [0.0, 0.0, 0.03], ramp: 0.3 }).unwrap();
        grip.hold(squeeze(3.0), 60);
    }
    let loaded = grip.plant.object().unwrap();
    assert!((loaded.load - 0.15).abs() < 1e-12);
}
