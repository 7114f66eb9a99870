//! The arm's folder: what is in it fits together, and the plain joint servo holds and moves the simulated arm.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::disallowed_methods, reason = "tests")]
#![allow(clippy::cast_possible_truncation, reason = "tests")]

use std::f64::consts::FRAC_PI_2;
use std::path::PathBuf;

use tesaki::control::ServoMode;
use tesaki::protocol::Task;
use tesaki_sim::controller::{Controller, Native};
use tesaki_sim::plant::{Drive, Plant, PlantOptions, PlantValues};
use tesaki_supervisor::Board;
use tesaki_supervisor::robot::RobotFolder;

const BENT: [f64; 7] = [0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0, 0.0];

fn folder() -> RobotFolder {
    RobotFolder::load(&PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/arm7"))).unwrap()
}

fn plant(robot: &RobotFolder, options: &PlantOptions) -> Plant {
    let drives: Vec<Drive> = robot.model.joints.iter().map(Drive::from).collect();
    Plant::new(&robot.urdf, &drives, &PlantValues::load(&robot.path).unwrap(), options).unwrap()
}

/// Largest distance of any joint from where it should be, in the last half of a time [s].
fn servo(posture: &[f64], goal: &[f64], mode: ServoMode, seed: u64, time: f64) -> f64 {
    let robot = folder();
    let mut options = PlantOptions::mismatched(seed);
    options.posture = Some(posture.to_vec());
    let mut plant = plant(&robot, &options);
    let mut controller = Native::default();
    controller.hello().unwrap();
    controller.take_command(false).unwrap();
    controller.push_model(&robot.model).unwrap();
    let mut sequence = 0;
    let mut tick = |controller: &mut Native, plant: &mut Plant| {
        sequence += 1;
        let actuators = controller.tick(&plant.sensors(sequence)).unwrap();
        plant.apply(&actuators).unwrap();
        actuators.enabled
    };
    tick(&mut controller, &mut plant);
    controller.arm(Task::JointServo(mode)).unwrap();
    let goal: Vec<f32> = goal.iter().map(|&angle| angle as f32).collect();
    let ticks = (time / 0.01) as usize;
    let mut worst = 0.0_f64;
    for number in 0..ticks {
        controller.set_goal(&goal).unwrap();
        assert!(tick(&mut controller, &mut plant), "{:?}", controller.faults().unwrap());
        if number >= ticks / 2 {
            let errors = plant.homed_positions().into_iter().zip(&goal).map(|(a, &b)| (a - f64::from(b)).abs());
            worst = errors.fold(worst, f64::max);
        }
    }
    worst
}

#[test]
fn the_joint_servo_holds_the_arm() {
    for posture in [BENT, [0.0; 7], [1.5, 0.3, 0.0, 0.1, 0.0, 0.0, 0.0], [0.5, 0.5, -0.7, 2.2, 0.6, -0.6, 0.6]] {
        for mode in [ServoMode::Pid, ServoMode::Observer] {
            let worst = servo(&posture, &posture, mode, 3, 4.0);
            println!("{posture:?} {mode:?} {worst:e}");
        }
    }
}

#[test]
fn the_joint_servo_moves_the_arm() {
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        for seed in 0..4 {
        let goal = BENT.map(|angle| angle + 0.3);
        let worst = servo(&BENT, &goal, mode, seed, 6.0);
        let back = servo(&[0.3; 7], &[0.0; 7], mode, seed, 6.0);
        println!("{mode:?} {worst:e} {back:e}");
    }}
}
