//! Someone else's arm, of six joints and without a force sensor: a person pulls its tool.

use std::path::Path;

use rapier3d::na::Vector3;
use tesaki::task::TaskConfig;
use tesaki_description::init::{InitOptions, robot_texts};
use tesaki_description::robot::RobotFolder;
use tesaki_sim::controller::{Controller, Native};
use tesaki_sim::plant::{Drive, Hold, Plant, PlantOptions, PlantValues};
use tesaki_supervisor::Board;

use crate::arm::hand;

/// Stiffness and damping of the person's grip [N/m, N·s/m].
const GRIP: (f64, f64) = (500.0, 20.0);
/// Time to let go [ticks].
const LET_GO: i32 = 15;

/// A UR5e as `tesaki model init` describes it, in a folder of its own.
fn ur5e() -> RobotFolder {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/robots/ur5e.urdf");
    let text = std::fs::read_to_string(&tests).unwrap();
    let texts = robot_texts(&tests, &text, &InitOptions::default()).unwrap();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ur5e");
    std::fs::create_dir_all(&folder).unwrap();
    for (name, text) in
        [("robot.urdf", texts.urdf), ("controller.toml", texts.controller), ("plant.toml", texts.plant)]
    {
        std::fs::write(folder.join(name), text).unwrap();
    }
    RobotFolder::load(&folder).unwrap()
}

/// A person moves the grip by `distance` [m] along `direction`, holds it there, and lets it go: the tool
/// follows, without chatter, and returns. Returns how far it followed [m].
fn pull(robot: &RobotFolder, seed: u64, direction: Vector3<f64>, distance: f64) -> f64 {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/examples/soft_six_joints.toml");
    let settings = tesaki_description::impedance::load(&example, &robot.model).unwrap();
    let values = PlantValues::load(&robot.path).unwrap();
    let options = PlantOptions {
        posture: Some(vec![0.3, -1.2, 1.4, -1.6, -1.3, 0.4]),
        ..PlantOptions::mismatched(seed)
    };
    let drives: Vec<Drive> = robot.model.joints.iter().map(Drive::from).collect();
    let mut plant = Plant::new(&robot.urdf, &drives, &values, &options).unwrap();
    let (mut controller, mut sequence) = (Native::default(), 0);
    controller.hello().unwrap();
    controller.take_command(false).unwrap();
    controller.push_model(&robot.model).unwrap();
    let (mut contacts, mut in_contact) = (0, false);
    let mut run = |plant: &mut Plant, controller: &mut Native, ticks: i32| {
        for _ in 0..ticks {
            sequence += 1;
            let actuators = controller.tick(&plant.sensors(sequence)).unwrap();
            plant.apply(&actuators).unwrap();
            if sequence > 1 {
                controller.keep().unwrap_or_else(|error| panic!("{error}: {:?}", controller.faults()));
                let contact = controller.read_impedance().unwrap().contact;
                contacts += i32::from(contact && !in_contact);
                in_contact = contact;
            }
            if sequence == 1 {
                let homed: Vec<f32> = plant.homed_positions().into_iter().map(|angle| angle as f32).collect();
                controller.home(&homed).unwrap();
                controller.enable(TaskConfig::Impedance(settings)).unwrap();
            }
        }
        contacts
    };
    run(&mut plant, &mut controller, 100);
    let start = hand(&plant);
    let moved = |plant: &Plant| Vector3::from(hand(plant).position) - Vector3::from(start.position);
    let grip = Hold {
        position: (Vector3::from(start.position) + distance * direction).into(),
        orientation: start.orientation,
        ramp: 1.5,
        stiffness: GRIP.0,
        damping: GRIP.1,
        rotational_stiffness: 0.0,
        rotational_damping: 0.0,
    };
    plant.hold_tip(0, grip).unwrap();
    for _ in 0..300 {
        run(&mut plant, &mut controller, 1);
        let along = moved(&plant).dot(&direction);
        assert!(along > -2e-3, "seed {seed}: {along} m against the pull along {direction:?}");
    }
    let along = moved(&plant).dot(&direction);
    for tick in 1..=LET_GO {
        let stiffness = GRIP.0 * (1.0 - f64::from(tick) / f64::from(LET_GO));
        plant.hold_tip(0, Hold { ramp: 0.0, stiffness, ..grip }).unwrap();
        run(&mut plant, &mut controller, 1);
    }
    plant.release_tip(0, 0.0).unwrap();
    let contacts = run(&mut plant, &mut controller, 200);
    assert!(contacts <= 2, "seed {seed}: {contacts} contacts along {direction:?}");
    assert!(moved(&plant).norm() < 1e-3, "seed {seed}: {:?}", moved(&plant));
    along
}

#[test]
fn a_pulled_arm_without_a_force_sensor_goes_with_the_hand() {
    let robot = ur5e();
    for (seed, direction) in [(1, Vector3::x()), (2, Vector3::y()), (3, Vector3::z()), (4, -Vector3::z())] {
        let across = (direction + Vector3::new(0.3, -0.5, 0.4)).normalize();
        for (seed, direction) in [(seed, direction), (seed + 4, across)] {
            // Springs of 500 and 300 N/m, of which the latter yields beyond 40 N: 44 mm without friction.
            let along = pull(&robot, seed, direction, 0.15);
            assert!((0.02..0.07).contains(&along), "seed {seed}: {along} m along {direction:?}");
            // About the threshold: 35 N.
            let along = pull(&robot, seed, direction, 0.07);
            assert!((-2e-3..0.04).contains(&along), "seed {seed}: {along} m along {direction:?}");
        }
    }
}
