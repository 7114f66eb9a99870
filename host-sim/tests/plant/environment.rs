//! Walls, holds and pushes at the arm's hand, and the readings of its force sensor, compared with hand
//! calculations.

use rapier3d::na::{Quaternion, UnitQuaternion, Vector3};

use crate::arm::{Arm, BENT, JOINTS, hand};
use crate::hand::{Hand, frame_of, largest};
use tesaki_sim::plant::{Hold, ObjectValues, Plant, PlantError, Push, TipTruth, Wall};

#[allow(clippy::cast_sign_loss, reason = "a duration")]
fn relax(plant: &mut Plant, seconds: f64) {
    for _ in 0..(seconds * 100.0).round() as u32 {
        plant.apply(&frame_of(&[0.0; JOINTS])).unwrap();
    }
}

fn lasting(force: [f64; 3], point: [f64; 3]) -> Push {
    Push { force, point, ramp: 0.2, hold: f64::INFINITY }
}

fn held(plant: &Plant) -> Hold {
    let TipTruth { position, orientation, .. } = hand(plant);
    Hold::firm(position, orientation, 0.0)
}

fn turn(tip: &TipTruth) -> UnitQuaternion<f64> {
    let [x, y, z, w] = tip.orientation;
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

#[test]
fn at_rest_the_sensor_feels_the_hands_weight() {
    let plant = Arm::exact().build();
    let wrench = plant.tip_wrenches()[0];
    let back = turn(&hand(&plant)).inverse();
    // 0.10 kg, 7.5 mm behind the hand's end along its frame's z.
    let force = back * Vector3::new(0.0, 0.0, -0.10 * 9.81);
    let torque = Vector3::new(0.0, 0.0, 0.0075).cross(&force);
    assert!((torque.norm() - 0.0075 * 0.10 * 9.81).abs() < 1e-6, "the hand points forward");
    assert!(largest((0..3).map(|i| wrench[i] - force[i])) < 1e-5, "{wrench:?}");
    assert!(largest((0..3).map(|i| wrench[3 + i] - torque[i])) < 1e-5, "{wrench:?}");
}

#[test]
fn a_hold_gives_way_as_its_springs_say_until_it_lets_go() {
    let mut plant = Arm::exact().floating().build();
    let start = hand(&plant);
    plant.hold_tip(0, held(&plant)).unwrap();
    // 10 N on the hold of 20 kN/m; with a lever arm of 50 mm, 0.5 N·m on the one of 100 N·m/rad.
    plant.push_tip(0, lasting([0.0, 10.0, 0.0], [0.0, 0.0, 0.05])).unwrap();
    relax(&mut plant, 1.5);
    let tip = hand(&plant);
    let shift = Vector3::from(tip.position) - Vector3::from(start.position);
    assert!((shift - Vector3::new(0.0, 5e-4, 0.0)).norm() < 5e-6, "{shift}");
    let turned = (turn(&tip) * turn(&start).inverse()).scaled_axis();
    // The hand's z is the base's −x, so the push turns about −z.
    assert!((turned - Vector3::new(0.0, 0.0, -5e-3)).norm() < 1e-4, "{turned}");
    assert!(largest(tip.force) < 0.02 && largest(tip.torque) < 0.01, "in balance: {tip:?}");
    plant.release_tip(0, 0.0).unwrap();
    relax(&mut plant, 0.01);
    let tip = hand(&plant);
    assert!((tip.force[1] - 10.0).abs() < 1e-4 && (tip.torque[2] + 0.5).abs() < 1e-3, "{tip:?}");
}

#[test]
fn a_hold_leads_the_hand_softly() {
    let mut plant = Arm::exact().build();
    let mut place = hand(&plant);
    place.position[2] += 0.03;
    plant.hold_tip(0, Hold::firm(place.position, place.orientation, 1.0)).unwrap();
    relax(&mut plant, 0.5);
    let middle = hand(&plant);
    assert!(
        (middle.velocity[2] - 1.875 * 0.03).abs() < 3e-3 && (middle.position[2] + 0.285).abs() < 2e-3,
        "{middle:?}"
    );
    relax(&mut plant, 1.5);
    let end = hand(&plant);
    // The hold carries the arm: at most its weight of 4.5 kg.
    assert!(largest((0..3).map(|i| end.position[i] - place.position[i])) < 45.0 / 20_000.0, "{end:?}");
    assert!(largest(end.velocity) < 1e-4, "{end:?}");
    plant.release_tip(0, 0.0).unwrap();
    let (before, at) = (plant.truth().velocities, hand(&plant).position);
    relax(&mut plant, 0.01);
    assert!(largest(hand(&plant).force) == 0.0 && largest(before) < 1e-3 && hand(&plant).position[2] < at[2]);
}

#[test]
fn the_sensor_feels_a_wall() {
    let mut plant = Arm::exact().floating().build();
    let wall = Wall {
        point: [0.361, 0.0, 0.0],
        normal: [-2.0, 0.0, 0.0],
        stiffness: 5_000.0,
        damping: 100.0,
        friction: 0.0,
    };
    plant.insert_wall(wall).unwrap();
    plant.hold_tip(0, Hold { stiffness: 0.0, damping: 20.0, ..held(&plant) }).unwrap();
    plant.push_tip(0, lasting([8.0, 0.0, 0.0], [0.0; 3])).unwrap();
    relax(&mut plant, 3.0);
    let tip = hand(&plant);
    assert!(
        (tip.wall_force[0] + 8.0).abs() < 0.02 && (tip.wall_depth - 8.0 / 5_000.0).abs() < 1e-5,
        "{tip:?}"
    );
    assert!((tip.position[0] - 0.361 - tip.wall_depth).abs() < 1e-7, "{tip:?}");
    // Push and wall cancel; with the wall alone, the sensor measures its force along the frame's z.
    assert!(largest(plant.tip_wrenches()[0]) < 0.05, "{:?}", plant.tip_wrenches());
    plant.remove_walls();
    relax(&mut plant, 0.01);
    let felt = plant.tip_wrenches()[0];
    assert!(
        largest(hand(&plant).wall_force) == 0.0 && felt[2] < -4.0 && felt[2] > -8.0,
        "less the hand's inertia: {felt:?}"
    );
}

/// A push of 10 N against a wall with a friction coefficient of 0.6.
#[test]
fn a_wall_holds_by_friction_up_to_coulombs_limit() {
    let slide = |along: f64| {
        let mut plant = Arm::exact().floating().build();
        let start = hand(&plant);
        let wall = Wall {
            point: start.position,
            normal: [-1.0, 0.0, 0.0],
            stiffness: 20_000.0,
            damping: 100.0,
            friction: 0.6,
        };
        plant.insert_wall(wall).unwrap();
        plant.hold_tip(0, Hold { stiffness: 0.0, damping: 0.0, ..held(&plant) }).unwrap();
        plant.push_tip(0, lasting([10.0, 0.0, 0.0], [0.0; 3])).unwrap();
        relax(&mut plant, 0.5);
        plant.push_tip(0, lasting([0.0, along, 0.0], [0.0; 3])).unwrap();
        relax(&mut plant, 0.3);
        let tip = hand(&plant);
        (tip.position[1] - start.position[1], tip.wall_force[1])
    };
    let (stuck, force) = slide(5.8);
    assert!((stuck - 5.8 / 20_000.0).abs() < 2e-5 && (force + 5.8).abs() < 0.1, "{stuck:e} {force}");
    let (slid, force) = slide(7.0);
    assert!(slid > 2e-3 && (force + 6.0).abs() < 0.1, "{slid:e} {force}");
}

/// The arm falls onto the stiffest wall in the direction of its least effective mass, 0.53 kg.
#[test]
fn a_stiff_wall_comes_to_rest() {
    let mut plant = Arm::exact().build();
    let point = [0.0, 0.0, -0.31];
    plant
        .insert_wall(Wall {
            point,
            normal: [0.0, 0.0, 1.0],
            stiffness: 50_000.0,
            damping: 150.0,
            friction: 0.5,
        })
        .unwrap();
    let (mut deepest, mut falling) = (0.0_f64, 0.0_f64);
    for _ in 0..200 {
        relax(&mut plant, 0.01);
        let tip = hand(&plant);
        (deepest, falling) = (deepest.max(tip.wall_depth), falling.max(-tip.velocity[2]));
    }
    let tip = hand(&plant);
    assert!(falling > 0.2 && falling < 0.45, "{falling}: less than √(2 g · 10 mm), and friction");
    assert!(deepest < 2e-3 && tip.wall_depth > 1e-5, "{deepest:e} {tip:?}");
    assert!((tip.wall_force[2] - 50_000.0 * tip.wall_depth).abs() < 0.05, "{tip:?}");
    assert!(largest(tip.velocity) < 1e-3, "{tip:?}");
}

#[test]
fn a_push_gives_the_hand_its_impulse() {
    let mut plant = Arm::exact().posture(BENT).floating().build();
    // 2 N for 0.1 s, including ramps: 0.2 N·s, in one direction and then in another.
    let push = Push { force: [2.0, 0.0, 0.0], point: [0.0; 3], ramp: 0.05, hold: 0.05 };
    plant.push_tip(0, push).unwrap();
    let mut impulse = 0.0;
    for _ in 0..20 {
        relax(&mut plant, 0.01);
        impulse += hand(&plant).force[0] * 0.01;
    }
    assert!((impulse - 0.2).abs() < 1e-6, "{impulse}");
    // The hand's effective mass along x is 3.42 kg (`tests/oracles/arm_motion.py`); viscous friction takes
    // some speed.
    let speed = hand(&plant).velocity[0];
    assert!(speed > 0.75 * 0.2 / 3.42 && speed < 0.2 / 3.42, "{speed}");
}

#[test]
fn errors_say_what_is_wrong() {
    let mut plant = Arm::exact().build();
    let good = held(&plant);
    assert_eq!(plant.release_tip(1, 0.0), Err(PlantError::NoTip { tip: 1, tips: 1 }));
    assert_eq!(plant.hold_tip(2, good), Err(PlantError::NoTip { tip: 2, tips: 1 }));
    let field = |error: Result<(), PlantError>| match error.unwrap_err() {
        PlantError::Value { field, .. } => field,
        other => panic!("{other}"),
    };
    let wall = Wall { point: [0.0; 3], normal: [0.0; 3], stiffness: 1e3, damping: 1.0, friction: 0.0 };
    assert_eq!(field(plant.insert_wall(wall)), "the length of wall.normal");
    let wall = Wall { normal: [1.0, 0.0, 0.0], stiffness: 1e7, ..wall };
    assert_eq!(field(plant.insert_wall(wall)), "wall.stiffness");
    assert_eq!(field(plant.insert_wall(Wall { stiffness: 1e3, damping: -1.0, ..wall })), "wall.damping");
    assert_eq!(field(plant.hold_tip(0, Hold { ramp: f64::NAN, ..good })), "hold.ramp");
    assert_eq!(
        field(plant.hold_tip(0, Hold { orientation: [0.0; 4], ..good })),
        "the square of hold.orientation"
    );
    let object =
        ObjectValues::from_toml("shape = 'box'\nsize = [0.1, 0.2, 0.3]\nmass = 0.1\nfriction = 0.5").unwrap();
    let mut arm = Arm::exact();
    arm.options.object = Some(object);
    let drives: Vec<_> = arm.robot.model.joints.iter().map(tesaki_sim::plant::Drive::from).collect();
    let error = Plant::new(&arm.robot.urdf, &drives, &arm.values, &arm.options).err().unwrap();
    assert_eq!(error, PlantError::NoSphere("hand".to_owned()));
    assert!(error.to_string().contains("<sphere>"), "{error}");
    assert_eq!(Hand::exact().build().tips().len(), 3);
}
