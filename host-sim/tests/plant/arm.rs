//! The arm's folder: its files are consistent, and the plain joint servo holds and moves the simulated arm.

use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use tesaki::control::ServoMode;
use tesaki::task::TaskConfig;
use tesaki_description::robot::RobotFolder;
use tesaki_sim::controller::{Controller, Native};
use tesaki_sim::plant::{Drive, Plant, PlantOptions, PlantValues, TipTruth};
use tesaki_supervisor::Board;

pub const JOINTS: usize = 7;
/// The basic posture.
pub const BENT: [f64; JOINTS] = [0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0, 0.0];

/// All parts of the arm's plant, for tests to change.
pub struct Arm {
    pub robot: RobotFolder,
    pub values: PlantValues,
    pub options: PlantOptions,
}

impl Arm {
    /// An arm that matches the model, with ideal sensors, not held at the start.
    pub fn exact() -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7");
        Self {
            robot: RobotFolder::load(&path).unwrap(),
            values: PlantValues::load(&path).unwrap(),
            options: PlantOptions { held_at_start: false, ..PlantOptions::exact() },
        }
    }

    pub fn mismatched(seed: u64, posture: [f64; JOINTS]) -> Self {
        let options = PlantOptions { posture: Some(posture.to_vec()), ..PlantOptions::mismatched(seed) };
        Self { options, ..Self::exact() }
    }

    pub fn posture(mut self, posture: [f64; JOINTS]) -> Self {
        self.options.posture = Some(posture.to_vec());
        self
    }

    /// Removes weight and dry friction, so that only inertia resists.
    pub fn floating(mut self) -> Self {
        (self.values.gravity, self.options.coulomb) = ([0.0; 3], Some(0.0));
        self
    }

    pub fn step(mut self, step: f64) -> Self {
        self.values.integration.step = step;
        self
    }

    pub fn build(&self) -> Plant {
        let drives: Vec<Drive> = self.robot.model.joints.iter().map(Drive::from).collect();
        Plant::new(&self.robot.urdf, &drives, &self.values, &self.options).unwrap()
    }
}

pub fn hand(plant: &Plant) -> TipTruth {
    let [hand] = <[TipTruth; 1]>::try_from(plant.tips()).unwrap();
    hand
}

/// Runs the joint servo for 4 s; returns the largest deviation of any joint from its target in the second
/// half.
fn servo(from: [f64; JOINTS], to: [f64; JOINTS], mode: ServoMode, seed: u64) -> f64 {
    let arm = Arm::mismatched(seed, from);
    let (mut plant, mut controller, mut sequence) = (arm.build(), Native::default(), 0);
    controller.hello().unwrap();
    controller.take_command(false).unwrap();
    controller.push_model(&arm.robot.model).unwrap();
    let mut tick = |controller: &mut Native, plant: &mut Plant| {
        sequence += 1;
        let actuators = controller.tick(&plant.sensors(sequence)).unwrap();
        plant.apply(&actuators).unwrap();
        actuators.enabled
    };
    tick(&mut controller, &mut plant);
    controller.enable(TaskConfig::JointServo(mode)).unwrap();
    let goal = to.map(|angle| angle as f32);
    let mut worst = 0.0_f64;
    for number in 0..400 {
        controller.set_goal(&goal).unwrap();
        assert!(tick(&mut controller, &mut plant), "{:?}", controller.faults().unwrap());
        if number >= 200 {
            let errors = plant.homed_positions().into_iter().zip(to).map(|(at, to)| (at - to).abs());
            worst = errors.fold(worst, f64::max);
        }
    }
    worst
}

#[test]
fn the_joint_servo_holds_and_moves_the_arm() {
    let raised = [1.5, 0.3, 0.0, 0.1, 0.0, 0.0, 0.0];
    let folded = [0.5, 0.5, -0.7, 2.2, 0.6, -0.6, 0.6];
    let moves = [
        (BENT, BENT),
        (raised, raised),
        (folded, folded),
        (BENT, BENT.map(|angle| angle + 0.3)),
        ([0.3; 7], [0.0, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0]),
    ];
    for (seed, (from, to)) in (0..).zip(moves) {
        for (mode, bound) in [(ServoMode::Pid, 5e-3), (ServoMode::Observer, 6e-4)] {
            let worst = servo(from, to, mode, seed);
            assert!(worst < bound, "{from:?} to {to:?}, {mode:?}: {worst:e}");
        }
    }
}

/// Every inertia in the URDF is that of the corresponding solid.
#[test]
fn inertias_are_those_of_the_solids() {
    let mut total = 0.0;
    for link in Arm::exact().robot.urdf.robot.links.iter().filter(|link| link.inertial.mass.value > 0.0) {
        let (mass, inertia, visual) = (link.inertial.mass.value, &link.inertial.inertia, &link.visual[0]);
        total += mass;
        assert_eq!(visual.origin.xyz, link.inertial.origin.xyz, "{}", link.name);
        let mut expected = match visual.geometry {
            urdf_rs::Geometry::Cylinder { radius, length } => {
                let across = (3.0 * radius * radius + length * length) / 12.0;
                [across, across, radius * radius / 2.0]
            }
            urdf_rs::Geometry::Sphere { radius } => [0.4 * radius * radius; 3],
            urdf_rs::Geometry::Box { ref size } => {
                let [x, y, z] = size.0.map(|extent| extent * extent / 12.0);
                [y + z, x + z, x + y]
            }
            ref other => panic!("{}: {other:?}", link.name),
        };
        if visual.origin.rpy.0[0] != 0.0 {
            expected.swap(1, 2);
        }
        for (got, expected) in [inertia.ixx, inertia.iyy, inertia.izz].iter().zip(expected) {
            let expected = mass * expected;
            assert!((got - expected).abs() < 1e-3 * expected, "{}: {got:e}, not {expected:e}", link.name);
        }
    }
    assert!((total - 4.5).abs() < 1e-9, "{total}");
}

#[test]
fn the_hand_is_where_the_lengths_say() {
    let near = |arm: &Arm, place: [f64; 3]| {
        let at = hand(&arm.build()).position;
        assert!((0..3).all(|i| (at[i] - place[i]).abs() < 1e-6), "{at:?} {place:?}");
    };
    near(&Arm::exact(), [0.36, 0.0, -0.30]);
    near(&Arm::exact().posture([0.0; 7]), [0.0, 0.0, -0.66]);
    // Pointing to the right, and inwards.
    near(&Arm::exact().posture([0.0, FRAC_PI_2, 0.0, 0.0, 0.0, 0.0, 0.0]), [0.0, -0.66, 0.0]);
    near(&Arm::exact().posture([0.0, 0.0, FRAC_PI_2, FRAC_PI_2, 0.0, 0.0, 0.0]), [0.0, 0.36, -0.30]);
    near(&Arm::exact().posture([0.0, 0.0, 0.0, FRAC_PI_2, 0.0, FRAC_PI_2, 0.0]), [0.26, 0.0, -0.20]);
    near(&Arm::exact().posture([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, FRAC_PI_2]), [0.0, 0.10, -0.56]);
}
