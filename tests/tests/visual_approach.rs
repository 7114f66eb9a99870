//! The visual approach on the arm that comes with tesaki: a node moves the hand and the gripper. The joints
//! are ideal, or held: the plant has its own scenario.
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
use tesaki::model::RobotModel;
use tesaki::protocol::{Refusal, Reply, Request};
use tesaki::robot::Robot;
use tesaki::task::visual_approach::{
    GripperSettings, GripperState, HandMotion, VisualApproachCommand, VisualApproachField,
    VisualApproachRefusal, VisualApproachSettings, VisualApproachTelemetry,
};
use tesaki::task::{TaskCommand, TaskConfig, TaskRefusal, TaskTelemetry};
use tesaki_tests::{Rig, robot};

const SETTINGS: VisualApproachSettings = VisualApproachSettings {
    chain: 0,
    gripper: GripperSettings { joint: 6, open: -0.98, closed: 0.35, speed: 2.0, torque: 0.8 },
    servo_mode: ServoMode::Pid,
    speed: 0.15,
    acceleration: 0.5,
    contact_force: 20.0,
    reach: 0.5,
};

/// The start posture of the robot's folder: the hand is level, 0.72 m in front of the base and 0.15 m above
/// it.
const START: [f32; 7] = [0.0, -0.529_777, 0.0, 1.891_18, -1.361_402, 0.0, -0.9];

/// A board whose joints are at their references minus their lag, except for held joints.
struct Board {
    rig: Rig,
    angles: Vec<f32>,
    references: Vec<f32>,
    lag: [f32; 7],
    held: bool,
    gripper_held: bool,
}

impl Board {
    fn new() -> Self {
        Self::of(&robot("knob-arm").model, &START)
    }

    fn of(model: &RobotModel, start: &[f32; 7]) -> Self {
        let (angles, references) = (start.to_vec(), start.to_vec());
        let rig = Rig::new(model);
        let mut board = Self { rig, angles, references, lag: [0.0; 7], held: false, gripper_held: false };
        board.sense();
        board
    }

    fn enabled() -> Self {
        let mut board = Self::new();
        assert_eq!(board.ask(Request::Enable(TaskConfig::VisualApproach(SETTINGS))), Reply::Done);
        board
    }

    fn ask(&mut self, request: Request) -> Reply {
        self.rig.ask(request)
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

    /// Runs a tick with the joints at their angles.
    fn sense(&mut self) {
        let counts: Vec<i32> = (self.angles.iter().enumerate())
            .map(|(joint, angle)| (f64::from(*angle) / Self::count(joint)).round() as i32)
            .collect();
        self.rig.sense(counts.into_iter());
    }

    /// Returns the angle of one count of a joint's encoder [rad].
    fn count(joint: usize) -> f64 {
        std::f64::consts::TAU / if joint == 6 { 65_536.0 } else { 262_144.0 }
    }

    /// Runs a control period. A held joint moves by one count every other period, so that its encoder does
    /// not seem dead.
    fn step(&mut self) {
        assert_eq!(self.ask(Request::Keep), Reply::Done);
        self.sense();
        self.rig.assert_enabled();
        for (joint, now) in self.rig.node.telemetry().joints.iter().enumerate() {
            let held = if joint == 6 { self.gripper_held } else { self.held };
            if held {
                self.angles[joint] += (self.rig.tick() % 2) as f32 * Self::count(joint) as f32;
            } else {
                // Position of the reference in the next tick.
                self.angles[joint] = 2.0 * now.reference - self.references[joint] - self.lag[joint];
            }
            self.references[joint] = now.reference;
        }
    }

    fn telemetry(&mut self) -> VisualApproachTelemetry {
        match self.rig.telemetry() {
            TaskTelemetry::VisualApproach(telemetry) => telemetry,
            other => panic!("{other:?}"),
        }
    }

    /// Position and orientation of the hand at the references, with the gripper at 0.
    fn hand(&self) -> (Vector3<f32>, Matrix3<f32>) {
        let mut angles: Vec<f32> =
            self.rig.node.telemetry().joints.iter().map(|joint| joint.reference).collect();
        angles[6] = 0.0;
        let posture = self.rig.node.robot().unwrap().chains()[0].chain.posture(&angles);
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
    board.step();
    // The motion begins half a second after the task; the way is told from the first tick on.
    let remaining = board.telemetry().remaining;
    assert!((remaining - way.norm()).abs() < 1e-3, "{remaining} m");
    let (mut before, mut speed_before, mut fastest, mut ticks) = (start, 0.0_f32, 0.0_f32, 0);
    while board.telemetry().motion == HandMotion::Moving {
        board.step();
        ticks += 1;
        let (place, now) = board.hand();
        let along = (place - start).dot(&way) / way.norm();
        let aside = (place - start - way * (along / way.norm())).norm();
        // The damped inverse bends the line by a hundredth of its length.
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
    // 143 mm at 0.1 m/s, with 0.5 s before the first motion, 0.2 s to accelerate, 0.4 s to brake, and 0.1 s
    // of rest.
    assert!((210..260).contains(&ticks), "{ticks} ticks");
}

#[test]
fn another_target_on_the_way_changes_the_motion_without_a_jump() {
    let mut board = Board::enabled();
    for _ in 0..60 {
        board.step();
    }
    let (start, _) = board.hand();
    board.move_to((start + Vector3::new(0.1, 0.0, 0.0)).into(), 0.15);
    let (mut before, mut velocity) = (start, Vector3::zeros());
    for tick in 0..300 {
        if tick == 50 {
            board.move_to((start + Vector3::new(0.0, 0.1, 0.02)).into(), 0.1);
        }
        if tick == 60 {
            // The same command once more, as a link may deliver it.
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
fn a_hand_that_shall_stand_brakes_without_a_way_back() {
    let mut board = Board::enabled();
    for _ in 0..60 {
        board.step();
    }
    let (start, _) = board.hand();
    board.move_to((start + Vector3::new(0.1, 0.0, 0.0)).into(), 0.15);
    for _ in 0..40 {
        board.step();
    }
    let (mut before, _) = board.hand();
    assert_eq!(board.task(VisualApproachCommand::Stand), Reply::Done);
    for _ in 0..100 {
        board.step();
        let (place, _) = board.hand();
        assert!(place.x > before.x - 2e-6, "back by {} m", before.x - place.x);
        before = place;
    }
    // 0.15 m/s and half of 0.5 m/s²: 45 mm.
    assert_eq!(board.telemetry().motion, HandMotion::Standing);
    assert!((0.08..0.1).contains(&(before.x - start.x)), "{} m", before.x - start.x);
}

#[test]
fn joint_limits_hold_the_hand_back_without_a_fault() {
    let mut board = Board::new();
    // Near the limits some joints are fast, and their lag looks like a force.
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
            for (joint, now) in board.rig.node.telemetry().joints.iter().enumerate() {
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
    // The joints are blocked and push back.
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
    let held = Vector3::from(stopped.hand.translation);
    // It no longer presses: the references are at the joints' positions.
    let (reference, _) = board.hand();
    assert!((reference - held).norm() < 1e-4, "{}", (reference - held).norm());
    // Nothing makes it press again: neither the same target nor another one, and standing still does not
    // clear the contact.
    for _ in 0..100 {
        for ahead in [0.0, 0.02, -0.05] {
            let target = [target[0] + ahead, target[1], target[2]];
            let refusal = board.refused(VisualApproachCommand::Move { position: target, speed: 0.05 });
            assert!(matches!(refusal, VisualApproachRefusal::Blocked { ahead } if ahead > 0.01), "{refusal}");
        }
        assert_eq!(board.task(VisualApproachCommand::Stand), Reply::Done);
        board.step();
    }
    assert_eq!(board.telemetry().motion, HandMotion::Blocked);
    let (reference, _) = board.hand();
    assert!((held.x - reference.x - 2e-3).abs() < 3e-4, "{} m before the contact", held.x - reference.x);
    board.held = false;
    let run = |board: &mut Board| (0..300).for_each(|_| board.step());
    // Sideways and slightly back is a retreat, but not far enough to allow another press.
    board.move_to((held + Vector3::new(-5e-3, 0.02, 0.0)).into(), 0.05);
    run(&mut board);
    assert_eq!(board.telemetry().motion, HandMotion::Standing);
    assert!(matches!(
        board.refused(VisualApproachCommand::Move { position: target, speed: 0.05 }),
        VisualApproachRefusal::Blocked { .. }
    ));
    // After 10 mm back it may press again.
    board.move_to((held + Vector3::new(-0.013, 0.02, 0.0)).into(), 0.05);
    run(&mut board);
    board.move_to(target, 0.05);
    run(&mut board);
    assert_eq!(board.telemetry().motion, HandMotion::Standing);
}

#[test]
fn who_acknowledges_a_contact_may_press_again() {
    let mut board = Board::enabled();
    (0..60).for_each(|_| board.step());
    let (start, _) = board.hand();
    let target: [f32; 3] = (start + Vector3::new(0.1, 0.0, 0.0)).into();
    board.move_to(target, 0.05);
    (0..50).for_each(|_| board.step());
    board.held = true;
    (0..200).for_each(|_| board.step());
    assert_eq!(board.telemetry().motion, HandMotion::Blocked);
    assert_eq!(board.task(VisualApproachCommand::Acknowledge), Reply::Done);
    board.step();
    assert_eq!(board.telemetry().motion, HandMotion::Blocked);
    board.held = false;
    board.move_to(target, 0.05);
    (0..400).for_each(|_| board.step());
    assert_eq!(board.telemetry().motion, HandMotion::Standing);
}

#[test]
fn a_force_that_grows_slowly_is_noticed_at_one_and_a_half_times_the_limit() {
    let model = robot("knob-arm").model;
    for rate in [1.0_f32, 3.0, 8.0] {
        let mut board = Board::enabled();
        (0..60).for_each(|_| board.step());
        let (start, _) = board.hand();
        board.move_to((start + Vector3::new(0.2, 0.0, 0.0)).into(), 0.006);
        (0..60).for_each(|_| board.step());
        // An integrator under a constant error grows: P·e at once, and I·e per second.
        let posture = board.rig.node.robot().unwrap().chains()[0].chain.posture(&board.angles);
        let torques = posture.jacobian().fixed_rows::<3>(0).transpose() * Vector3::new(rate, 0.0, 0.0);
        let mut at_once = 0.0_f32;
        for (joint, model) in model.joints.iter().enumerate().take(6) {
            let gains = &model.servo.pid;
            board.lag[joint] = torques[joint] / gains.integral;
            at_once = at_once.max(rate * gains.proportional / gains.integral);
        }
        let mut time = 0.0;
        while board.telemetry().motion == HandMotion::Moving {
            board.step();
            time += TICK;
            assert!(time < 35.0, "{rate} N/s: {:?}", board.telemetry());
        }
        assert_eq!(board.telemetry().motion, HandMotion::Blocked);
        let force = rate * time + at_once;
        // The limit is 20 N; up to 10 N are attributed to errors of the model, and the posture has changed in
        // the meantime.
        assert!((19.0..33.0).contains(&force), "{rate} N/s: {force} N");
    }
}

#[test]
fn a_gripper_that_closes_at_once_does_not_end_the_learning_of_efforts() {
    let forces = [false, true].map(|closes| {
        let mut board = Board::enabled();
        board.gripper_held = true;
        if closes {
            assert_eq!(board.task(VisualApproachCommand::Close), Reply::Done);
        }
        // The integrator of the shoulder takes up an error of the model.
        board.lag[1] = 2e-3;
        (0..10).for_each(|_| board.step());
        board.lag[1] = 0.0;
        (0..50).for_each(|_| board.step());
        assert_eq!(board.telemetry().gripper == GripperState::Holding, closes);
        Vector3::from(board.telemetry().force).norm()
    });
    assert!(forces.iter().all(|force| *force < 0.5), "{forces:?} N");
}

#[test]
fn where_the_joints_show_no_force_the_hand_goes_no_farther_but_back() {
    let mut board = Board::enabled();
    (0..60).for_each(|_| board.step());
    let (start, _) = board.hand();
    // Towards the stretched arm; the wrist is at most 0.76 m from the base.
    board.move_to((start + Vector3::new(0.4, 0.0, 0.0)).into(), 0.15);
    let mut ticks = 0;
    while board.telemetry().motion == HandMotion::Moving {
        board.step();
        ticks += 1;
        assert!(ticks < 4000, "{:?}", board.telemetry());
    }
    assert_eq!(board.telemetry().motion, HandMotion::Limited);
    let (end, _) = board.hand();
    // Computed with NumPy: at 1.020 m the efforts show a fraction of 0.72 of a force along x, at 1.038 m
    // 0.46.
    assert!((1.02..1.04).contains(&end.x), "{end}");
    let farther = VisualApproachCommand::Move { position: [1.06, start.y, start.z], speed: 0.1 };
    assert!(matches!(board.refused(farther), VisualApproachRefusal::Blocked { .. }));
    board.move_to(start.into(), 0.1);
    (0..800).for_each(|_| board.step());
    assert_eq!(board.telemetry().motion, HandMotion::Standing);
    // Nor can the task start there.
    let stretched = [0.0, -0.4, 0.0, 0.06, 0.34, 0.0, -0.9];
    let mut board = Board::of(&robot("knob-arm").model, &stretched);
    let reply = board.ask(Request::Enable(TaskConfig::VisualApproach(SETTINGS)));
    let refusal = TaskRefusal::VisualApproach(VisualApproachRefusal::Singular { chain: 0 });
    assert_eq!(reply, Reply::Refused(Refusal::Task(refusal)));
}

#[test]
fn a_hand_that_is_pushed_about_does_not_stand() {
    let mut board = Board::enabled();
    (0..60).for_each(|_| board.step());
    let (start, _) = board.hand();
    board.move_to((start + Vector3::new(0.02, 0.0, 0.0)).into(), 0.1);
    (0..200).for_each(|_| board.step());
    assert_eq!(board.telemetry().motion, HandMotion::Standing);
    for tick in 0..100_u16 {
        // 1 mm to and fro, ten times per second, while the reference is at rest.
        board.lag[0] = if tick / 5 % 2 == 0 { 1.4e-3 } else { -1.4e-3 };
        board.step();
        if tick > 5 {
            assert_ne!(board.telemetry().motion, HandMotion::Standing, "{tick}");
        }
    }
}

#[test]
fn a_gripper_that_something_keeps_from_opening_is_jammed() {
    for torque in [0.8, 3.0] {
        let mut board = Board::new();
        let gripper = GripperSettings { torque, ..SETTINGS.gripper };
        let settings = VisualApproachSettings { gripper, ..SETTINGS };
        assert_eq!(board.ask(Request::Enable(TaskConfig::VisualApproach(settings))), Reply::Done);
        board.step();
        let open = |board: &mut Board, ticks| {
            let mut largest = 0.0_f32;
            for _ in 0..ticks {
                // Repeated, as by a leader.
                assert_eq!(board.task(VisualApproachCommand::Open), Reply::Done);
                board.step();
                largest = largest.max(board.rig.node.telemetry().joints[6].torque.abs());
            }
            largest
        };
        assert_eq!(board.task(VisualApproachCommand::Close), Reply::Done);
        (0..30).for_each(|_| board.step());
        board.gripper_held = true;
        let largest = open(&mut board, 350);
        assert_eq!(board.telemetry().gripper, GripperState::Jammed);
        // 0.1 s above half the torque, while it still grows.
        assert!(largest < 3.0 && (torque > 1.0 || largest < 1.8), "{largest} N·m");
        board.gripper_held = false;
        open(&mut board, 100);
        assert_eq!(board.telemetry().gripper, GripperState::Jammed);
        assert_eq!(board.task(VisualApproachCommand::Close), Reply::Done);
        (0..50).for_each(|_| board.step());
        open(&mut board, 150);
        assert_eq!(board.telemetry().gripper, GripperState::Open);
    }
}

#[test]
fn a_gripper_whose_axis_is_not_the_approach_is_refused() {
    for (rotation, translation) in
        [([0.0, 0.05, 0.0, 1.0], [0.0; 3]), ([0.0, 0.0, 0.0, 1.0], [0.0, 5e-3, 0.0])]
    {
        let mut model = robot("knob-arm").model;
        let [x, y, z, w] = rotation;
        let turn = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z)).coords;
        let tip = &mut model.chains[0].tip;
        tip.rotation = [turn.x, turn.y, turn.z, turn.w];
        tip.translation = [0, 1, 2].map(|axis| tip.translation[axis] + translation[axis]);
        let mut robot = Box::new(Robot::NONE);
        robot.configure(&model).unwrap();
        let refusal = SETTINGS.validate(&robot).unwrap_err();
        assert!(matches!(refusal, VisualApproachRefusal::GripperAxis { joint: 6, .. }), "{refusal}");
    }
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
            let speed = board.rig.node.telemetry().joints[6].velocity.abs();
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
    // It has arrived: a moving reference would cause a constant friction feed-forward.
    for _ in 0..400 {
        board.step();
    }
    let resting = board.rig.node.telemetry().joints[6];
    assert!((resting.reference - 0.35).abs() < 1e-3 && resting.torque.abs() < 0.02, "{resting:?}");
    // A leader that repeats the command, and reads directly after it, learns that the gripper is empty.
    assert_eq!(board.task(VisualApproachCommand::Close), Reply::Done);
    assert_eq!(board.telemetry().gripper, GripperState::Empty);
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
    let torque = board.rig.node.telemetry().joints[6].torque;
    assert!((torque - 0.8).abs() < 0.01, "{torque} N·m");
    // An object that vanishes is not held: the joint is free, and continues to move.
    for _ in 0..20 {
        board.angles[6] += 0.025;
        board.step();
    }
    assert_eq!(board.telemetry().gripper, GripperState::Empty);
    // It no longer presses, and brakes.
    let torque = board.rig.node.telemetry().joints[6].torque;
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
        (VisualApproachSettings { speed: f32::NAN, ..SETTINGS }, VisualApproachField::Speed),
        (VisualApproachSettings { acceleration: 0.0, ..SETTINGS }, VisualApproachField::Acceleration),
        (VisualApproachSettings { contact_force: 1e9, ..SETTINGS }, VisualApproachField::ContactForce),
        (VisualApproachSettings { reach: -1.0, ..SETTINGS }, VisualApproachField::Reach),
        (
            VisualApproachSettings {
                gripper: GripperSettings { closed: -0.98, ..SETTINGS.gripper },
                ..SETTINGS
            },
            VisualApproachField::GripperRange,
        ),
        (
            VisualApproachSettings {
                gripper: GripperSettings { speed: 4.0, ..SETTINGS.gripper },
                ..SETTINGS
            },
            VisualApproachField::GripperSpeed,
        ),
        (
            VisualApproachSettings {
                gripper: GripperSettings { torque: 3.5, ..SETTINGS.gripper },
                ..SETTINGS
            },
            VisualApproachField::GripperTorque,
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
    // A joint of another finger is not a gripper either.
    let gripper = GripperSettings { joint: 5, ..gripper };
    let refusal = VisualApproachSettings { gripper, ..SETTINGS }.validate(&robot);
    assert_eq!(refusal, Err(VisualApproachRefusal::NoGripper { joint: 5 }));
}
