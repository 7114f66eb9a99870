//! The visual approach on the arm that comes with tesaki: a node moves the hand and the gripper. The joints are
//! ideal, or held: the plant has its own scenario.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::disallowed_methods,
    reason = "tests"
)]

use nalgebra::{Matrix3, Vector3};
use tesaki::TICK;
use tesaki::control::ServoMode;
use tesaki::math::rotation_vector;
use tesaki::node::Node;
use tesaki::protocol::{BoardStatus, Mode, Refusal, Reply, Request, RequestFrame, SensorFlags, SensorFrame};
use tesaki::robot::Robot;
use tesaki::task::visual_approach::{
    ApproachField, GripperSettings, GripperState, HandMotion, VisualApproachCommand, VisualApproachRefusal,
    VisualApproachSettings, VisualApproachTelemetry,
};
use tesaki::task::{TaskCommand, TaskConfig, TaskRefusal, TaskTelemetry};
use tesaki_tests::{robot, set_up};

const SETTINGS: VisualApproachSettings = VisualApproachSettings {
    chain: 0,
    gripper: GripperSettings { joint: 6, open: -0.98, closed: 0.35, speed: 2.0, torque: 0.8 },
    servo_mode: ServoMode::Pid,
    speed: 0.15,
    acceleration: 0.5,
    contact_force: 20.0,
    reach: 0.5,
};

/// The start posture of the robot's folder: the hand is level, 0.72 m before the base and 0.15 m above it.
const START: [f32; 7] = [0.0, -0.529_777, 0.0, 1.891_18, -1.361_402, 0.0, -0.9];

/// A board whose joints are where their references are, but for those that are held.
struct Board {
    node: Box<Node>,
    sequence: u16,
    tick: u32,
    angles: Vec<f32>,
    references: Vec<f32>,
    held: bool,
    gripper_held: bool,
}

impl Board {
    fn new() -> Self {
        let model = robot("knob-arm").model;
        let (node, angles) = (Box::new(Node::new()), START.to_vec());
        let references = angles.clone();
        let mut board =
            Self { node, sequence: 0, tick: 0, angles, references, held: false, gripper_held: false };
        for request in set_up(&model) {
            assert!(!matches!(board.ask(request), Reply::Refused(_)));
        }
        board.sense();
        board
    }

    fn enabled() -> Self {
        let mut board = Self::new();
        assert_eq!(board.ask(Request::Enable(TaskConfig::VisualApproach(SETTINGS))), Reply::Done);
        board
    }

    fn ask(&mut self, request: Request) -> Reply {
        self.sequence += 1;
        let frame = RequestFrame { client: 7, sequence: self.sequence, request };
        self.node.handle(&frame, &BoardStatus::default()).reply
    }

    fn task(&mut self, command: VisualApproachCommand) -> Reply {
        self.ask(Request::Task(TaskCommand::VisualApproach(command)))
    }

    fn refused(&mut self, command: VisualApproachCommand) -> VisualApproachRefusal {
        match self.task(command) {
            Reply::Refused(Refusal::Task(TaskRefusal::VisualApproach(refusal))) => refusal,
            other => panic!("{other:?}"),
        }
    }

    fn move_to(&mut self, position: [f32; 3], speed: f32) {
        assert_eq!(self.task(VisualApproachCommand::Move { position, speed }), Reply::Done);
    }

    /// A tick with the joints at their angles; what is held changes by a count, as a living encoder does.
    fn sense(&mut self) {
        self.tick += 1;
        let alive = (self.tick % 2).cast_signed();
        let counts = self.angles.iter().enumerate().map(|(joint, angle)| {
            let turn = if joint == 6 { 65_536.0 } else { 262_144.0 };
            let held = if joint == 6 { self.gripper_held } else { self.held };
            (f64::from(*angle) * turn / std::f64::consts::TAU).round() as i32 + if held { alive } else { 0 }
        });
        self.node.tick(&SensorFrame {
            sequence: self.tick,
            flags: SensorFlags(0),
            supply: 24_000,
            encoders: counts.collect(),
            currents: self.angles.iter().map(|_| 0).collect(),
            forces: heapless::Vec::new(),
        });
    }

    fn step(&mut self) {
        assert_eq!(self.ask(Request::Keep), Reply::Done);
        self.sense();
        assert!(matches!(self.node.mode(), Mode::Enabled(_)), "{:?}", self.node.faults());
        for (joint, now) in self.node.telemetry().joints.iter().enumerate() {
            let held = if joint == 6 { self.gripper_held } else { self.held };
            if !held {
                // Where the reference will be in the next tick.
                self.angles[joint] = 2.0 * now.reference - self.references[joint];
            }
            self.references[joint] = now.reference;
        }
    }

    fn telemetry(&mut self) -> VisualApproachTelemetry {
        match self.ask(Request::ReadTask) {
            Reply::Task(report) => match report.telemetry {
                TaskTelemetry::VisualApproach(telemetry) => telemetry,
                other => panic!("{other:?}"),
            },
            other => panic!("{other:?}"),
        }
    }

    /// Place and orientation of the hand where the references are; the gripper at 0.
    fn hand(&self) -> (Vector3<f32>, Matrix3<f32>) {
        let mut angles: Vec<f32> = self.node.telemetry().joints.iter().map(|joint| joint.reference).collect();
        angles[6] = 0.0;
        let posture = self.node.robot().unwrap().chains()[0].chain.posture(&angles);
        (posture.tip().translation.vector, *posture.tip().rotation.matrix())
    }
}

#[test]
fn the_hand_goes_straight_at_a_constant_orientation() {
    let mut board = Board::enabled();
    board.step();
    let (start, turn) = board.hand();
    assert!((start - Vector3::new(0.72, 0.0, 0.15)).norm() < 1e-3, "{start}");
    let way = Vector3::new(0.12, 0.06, -0.05);
    let target = start + way;
    board.move_to(target.into(), 0.1);
    let (mut before, mut speed_before, mut fastest, mut ticks) = (start, 0.0_f32, 0.0_f32, 0);
    while board.telemetry().motion == HandMotion::Moving {
        board.step();
        ticks += 1;
        let (place, now) = board.hand();
        let along = (place - start).dot(&way) / way.norm();
        let aside = (place - start - way * (along / way.norm())).norm();
        // The damping of the inverse bends the line by a hundredth of its length.
        assert!(aside < 2.2e-3, "{aside} m off the line");
        let error = rotation_vector(&(now * turn.transpose())).norm();
        assert!(error < 1e-3, "{error} rad");
        let speed = (place - before).norm() / TICK;
        assert!(speed < 0.1 * 1.005, "{speed} m/s");
        assert!((speed - speed_before).abs() / TICK < 0.5 * 1.05 + 0.05, "{speed} m/s after {speed_before}");
        (before, speed_before, fastest) = (place, speed, fastest.max(speed));
        assert!(ticks < 400);
    }
    let (place, _) = board.hand();
    assert!((place - target).norm() < 1e-3 && fastest > 0.099, "{place} {fastest}");
    // 143 mm at 0.1 m/s, with 0.2 s to start and 0.4 s to brake.
    assert!((150..200).contains(&ticks), "{ticks} ticks");
}

#[test]
fn another_target_on_the_way_changes_the_motion_without_a_jump() {
    let mut board = Board::enabled();
    board.step();
    let (start, _) = board.hand();
    board.move_to((start + Vector3::new(0.1, 0.0, 0.0)).into(), 0.15);
    let (mut before, mut velocity) = (start, Vector3::zeros());
    for tick in 0..300 {
        if tick == 50 {
            board.move_to((start + Vector3::new(0.0, 0.1, 0.02)).into(), 0.1);
        }
        if tick == 60 {
            // The same once more, as a link may deliver it.
            board.move_to((start + Vector3::new(0.0, 0.1, 0.02)).into(), 0.1);
        }
        board.step();
        let (place, _) = board.hand();
        let now = (place - before) / TICK;
        let acceleration = (now - velocity).norm() / TICK;
        assert!(acceleration < 0.7, "{acceleration} m/s² in tick {tick}");
        (before, velocity) = (place, now);
    }
    assert_eq!(board.telemetry().motion, HandMotion::Standing);
    assert!((before - start - Vector3::new(0.0, 0.1, 0.02)).norm() < 1e-3);
}

#[test]
fn joint_limits_hold_the_hand_back_without_a_fault() {
    let mut board = Board::new();
    // Near the limits some joints are fast, and what they lag behind looks like a force.
    let settings = VisualApproachSettings { reach: 1.0, contact_force: 500.0, ..SETTINGS };
    assert_eq!(board.ask(Request::Enable(TaskConfig::VisualApproach(settings))), Reply::Done);
    board.step();
    let (start, _) = board.hand();
    let model = robot("knob-arm").model;
    for way in [Vector3::new(0.0, 0.9, 0.0), Vector3::new(0.5, 0.0, 0.0), Vector3::new(-0.6, 0.0, 0.3)] {
        board.move_to((start + way).into(), 0.15);
        let mut velocities = [0.0_f32; 7];
        let mut references: Vec<f32> = board.angles.clone();
        for _ in 0..1500 {
            board.step();
            for (joint, now) in board.node.telemetry().joints.iter().enumerate() {
                let limits = &model.joints[joint].limits;
                assert!(now.reference >= limits.lower && now.reference <= limits.upper, "joint {joint}");
                let velocity = (now.reference - references[joint]) / TICK;
                assert!(velocity.abs() <= limits.velocity, "joint {joint}: {velocity} rad/s");
                let change = (velocity - velocities[joint]).abs() / TICK;
                assert!(change < 8.5 * limits.velocity, "joint {joint}: {change} rad/s²");
                (references[joint], velocities[joint]) = (now.reference, velocity);
            }
        }
        let motion = board.telemetry().motion;
        assert!(matches!(motion, HandMotion::Limited | HandMotion::Moving), "{way:?}: {motion:?}");
        board.move_to(start.into(), 0.15);
        for _ in 0..1500 {
            board.step();
        }
        assert_eq!(board.telemetry().motion, HandMotion::Standing, "back from {way:?}");
    }
}

#[test]
fn a_contact_ends_the_motion_and_the_hand_goes_back() {
    let mut board = Board::enabled();
    for _ in 0..50 {
        board.step();
    }
    let (start, _) = board.hand();
    let target: [f32; 3] = (start + Vector3::new(0.1, 0.0, 0.0)).into();
    board.move_to(target, 0.05);
    for _ in 0..50 {
        board.step();
    }
    assert_eq!(board.telemetry().motion, HandMotion::Moving);
    // What the joints cannot move pushes back.
    board.held = true;
    let mut ticks = 0;
    while board.telemetry().motion == HandMotion::Moving {
        board.step();
        ticks += 1;
        assert!(ticks < 100, "{:?}", board.telemetry());
    }
    let stopped = board.telemetry();
    assert_eq!(stopped.motion, HandMotion::Blocked);
    assert!(stopped.force[0] < -20.0 && stopped.force[1].abs() < 3.0, "{:?}", stopped.force);
    // A repeated command does not press again.
    let held = Vector3::from(stopped.hand.translation);
    for _ in 0..100 {
        board.move_to(target, 0.05);
        board.step();
    }
    assert_eq!(board.telemetry().motion, HandMotion::Blocked);
    let (reference, _) = board.hand();
    assert!((held.x - reference.x - 2e-3).abs() < 3e-4, "{} m before the contact", held.x - reference.x);
    // Another target does: away from it.
    board.held = false;
    board.move_to(start.into(), 0.05);
    for _ in 0..300 {
        board.step();
    }
    assert_eq!(board.telemetry().motion, HandMotion::Standing);
}

#[test]
fn a_latch_keeps_the_pose_of_its_tick() {
    let mut board = Board::enabled();
    board.step();
    let (start, _) = board.hand();
    assert_eq!(board.telemetry().latched, None);
    board.move_to((start + Vector3::new(0.1, 0.0, 0.0)).into(), 0.1);
    for _ in 0..50 {
        board.step();
    }
    let hand = board.telemetry().hand;
    assert_eq!(board.task(VisualApproachCommand::Latch { number: 65_535 }), Reply::Done);
    for _ in 0..50 {
        board.step();
    }
    let now = board.telemetry();
    assert_eq!(now.latched, Some((65_535, hand)));
    assert!(now.hand.translation[0] - hand.translation[0] > 0.02);
}

#[test]
fn the_gripper_opens_closes_on_nothing_and_holds_what_is_in_it() {
    let mut board = Board::enabled();
    board.step();
    assert_eq!(board.telemetry().gripper, GripperState::Still);
    let run = |board: &mut Board, command, until: GripperState| {
        assert_eq!(board.task(command), Reply::Done);
        for _ in 0..300 {
            board.step();
            let speed = board.node.telemetry().joints[6].velocity.abs();
            assert!(speed < 2.1, "{speed} rad/s");
            if board.telemetry().gripper == until {
                return;
            }
        }
        panic!("{:?}", board.telemetry());
    };
    run(&mut board, VisualApproachCommand::Open, GripperState::Open);
    run(&mut board, VisualApproachCommand::Close, GripperState::Empty);
    assert!((board.telemetry().opening - 0.35).abs() < 0.03);
    run(&mut board, VisualApproachCommand::Open, GripperState::Open);
    assert_eq!(board.task(VisualApproachCommand::Close), Reply::Done);
    for _ in 0..40 {
        board.step();
    }
    board.gripper_held = true;
    run(&mut board, VisualApproachCommand::Close, GripperState::Holding);
    for _ in 0..50 {
        board.step();
    }
    let torque = board.node.telemetry().joints[6].torque;
    assert!((torque - 0.8).abs() < 0.25, "{torque} N·m");
    // What vanishes is not held: the joint is free, and moves on.
    for _ in 0..20 {
        board.angles[6] += 0.025;
        board.step();
    }
    assert_eq!(board.telemetry().gripper, GripperState::Empty);
    // It presses no more, and brakes.
    let torque = board.node.telemetry().joints[6].torque;
    assert!(torque < 0.1, "{torque} N·m");
}

#[test]
fn a_bad_setting_or_command_is_refused_by_name_and_changes_nothing() {
    let mut board = Board::new();
    let mut refused = |settings: VisualApproachSettings| match board
        .ask(Request::Enable(TaskConfig::VisualApproach(settings)))
    {
        Reply::Refused(Refusal::Task(TaskRefusal::VisualApproach(refusal))) => refusal,
        other => panic!("{other:?}"),
    };
    assert_eq!(
        refused(VisualApproachSettings { chain: 1, ..SETTINGS }),
        VisualApproachRefusal::NoChain { chain: 1 }
    );
    for joint in [3, 7] {
        let gripper = GripperSettings { joint, ..SETTINGS.gripper };
        assert_eq!(
            refused(VisualApproachSettings { gripper, ..SETTINGS }),
            VisualApproachRefusal::NoGripper { joint }
        );
    }
    let gripper = GripperSettings { open: -1.2, ..SETTINGS.gripper };
    assert!(matches!(
        refused(VisualApproachSettings { gripper, ..SETTINGS }),
        VisualApproachRefusal::Limit(_)
    ));
    for (settings, field) in [
        (VisualApproachSettings { speed: f32::NAN, ..SETTINGS }, ApproachField::Speed),
        (VisualApproachSettings { acceleration: 0.0, ..SETTINGS }, ApproachField::Acceleration),
        (VisualApproachSettings { contact_force: 1e9, ..SETTINGS }, ApproachField::ContactForce),
        (VisualApproachSettings { reach: -1.0, ..SETTINGS }, ApproachField::Reach),
        (
            VisualApproachSettings {
                gripper: GripperSettings { closed: -0.98, ..SETTINGS.gripper },
                ..SETTINGS
            },
            ApproachField::GripperRange,
        ),
        (
            VisualApproachSettings {
                gripper: GripperSettings { speed: 4.0, ..SETTINGS.gripper },
                ..SETTINGS
            },
            ApproachField::GripperSpeed,
        ),
        (
            VisualApproachSettings {
                gripper: GripperSettings { torque: 3.5, ..SETTINGS.gripper },
                ..SETTINGS
            },
            ApproachField::GripperTorque,
        ),
    ] {
        let refusal = refused(settings);
        assert!(
            matches!(refusal, VisualApproachRefusal::Value { field: name, .. } if name == field),
            "{refusal}"
        );
    }
    let mut board = Board::enabled();
    board.step();
    let (start, _) = board.hand();
    let place = |way: [f32; 3]| (start + Vector3::from(way)).into();
    let move_to = |position, speed| VisualApproachCommand::Move { position, speed };
    let refusal = board.refused(move_to(place([0.6, 0.0, 0.0]), 0.1));
    assert!(
        matches!(refusal, VisualApproachRefusal::Target { distance, reach: 0.5 } if (distance - 0.6).abs() < 1e-3)
    );
    let refusal = board.refused(move_to([f32::NAN, 0.0, 0.0], 0.1));
    assert!(matches!(refusal, VisualApproachRefusal::Target { .. }));
    let refusal = board.refused(move_to([f32::INFINITY, 0.0, 0.0], 0.1));
    assert!(matches!(refusal, VisualApproachRefusal::Target { .. }));
    for speed in [0.0, -0.1, 1e-3, 0.16, f32::NAN] {
        let refusal = board.refused(move_to(place([0.1, 0.0, 0.0]), speed));
        assert!(matches!(refusal, VisualApproachRefusal::Speed { limit: 0.15, .. }), "{refusal}");
    }
    for _ in 0..50 {
        board.step();
    }
    assert!((board.hand().0 - start).norm() < 1e-5);
}

#[test]
fn a_finger_is_no_arm() {
    let mut robot = Box::new(Robot::NONE);
    robot.configure(&tesaki_tests::robot("hand3").model).unwrap();
    let gripper = GripperSettings { joint: 2, open: 0.0, closed: 0.3, ..SETTINGS.gripper };
    let refusal = VisualApproachSettings { gripper, ..SETTINGS }.validate(&robot);
    assert_eq!(refusal, Err(VisualApproachRefusal::NoChain { chain: 0 }));
    // Nor is a joint of another finger a gripper.
    let gripper = GripperSettings { joint: 5, ..gripper };
    let refusal = VisualApproachSettings { gripper, ..SETTINGS }.validate(&robot);
    assert_eq!(refusal, Err(VisualApproachRefusal::NoGripper { joint: 5 }));
}
