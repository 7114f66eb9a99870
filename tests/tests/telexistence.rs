//! Telexistence on the five-finger hand that comes with tesaki: a node follows the fingertips of an operator
//! over a link that loses, repeats and delays. The joints are ideal: the plant has its own scenarios.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::disallowed_methods,
    reason = "tests"
)]

use tesaki::TICK;
use tesaki::kinematics::{Angles, Hand};
use tesaki::protocol::{Refusal, Reply, Request};
use tesaki::task::telexistence::{
    FingertipPoint, FingertipSample, TelexistenceCommand, TelexistenceRefusal, TelexistenceSettings,
    TelexistenceTelemetry,
};
use tesaki::task::{TaskCommand, TaskConfig, TaskRefusal, TaskTelemetry};
use tesaki_rng::Rng;
use tesaki_tests::{Rig, robot};

#[test]
fn the_benchmark_has_the_inspire_hand_of_today() {
    const BENCHMARK: &[u8] = include_bytes!("../../firmware/src/bin/support/inspire.model");
    let bytes = postcard::to_stdvec(&robot("inspire").model).unwrap();
    if bytes != BENCHMARK {
        let file = concat!(env!("CARGO_TARGET_TMPDIR"), "/inspire.model");
        std::fs::write(file, bytes).unwrap();
        panic!("copy {file} to firmware/src/bin/support, then `cargo xtask bench`");
    }
}

/// A board whose joints are at their references.
struct Board {
    rig: Rig,
    hand: Hand,
    references: Vec<[f32; 2]>,
}

/// Returns a relaxed posture with half-bent fingers, in which the hand is homed.
fn relaxed(hand: &Hand) -> Angles {
    hand.center()
}

impl Board {
    fn new() -> Self {
        let model = robot("hand5").model;
        let hand = Hand::of_model(&model, [0.0, 0.0, 1.0], 0.0).unwrap();
        let mut board = Self { rig: Rig::new(&model), hand, references: Vec::new() };
        board.sense(&vec![0.0; model.joints.len()]);
        let positions = relaxed(&board.hand).iter().take(model.joints.len()).copied().collect();
        assert_eq!(board.ask(Request::Home { positions }), Reply::Done);
        board
    }

    fn ask(&mut self, request: Request) -> Reply {
        self.rig.ask(request)
    }

    fn task(&mut self, command: TelexistenceCommand) -> Reply {
        self.ask(Request::Task(TaskCommand::Telexistence(command)))
    }

    /// Runs a tick with the joints at these angles relative to their homed position [rad].
    fn sense(&mut self, angles: &[f32]) {
        self.rig.sense(angles.iter().map(|angle| (angle * 65_536.0 / std::f32::consts::TAU).round() as i32));
    }

    /// Runs a tick; checks velocity and acceleration of the references.
    fn tick(&mut self) {
        let home = relaxed(&self.hand);
        let now = self.rig.node.telemetry();
        let moved: Vec<f32> =
            now.joints.iter().zip(home.iter()).map(|(joint, home)| joint.reference - home).collect();
        self.sense(&moved);
        self.rig.assert_enabled();
        let now = self.rig.node.telemetry();
        for (index, joint) in now.joints.iter().enumerate() {
            let [position, velocity] = self.references.get(index).copied().unwrap_or([joint.reference, 0.0]);
            let new = (joint.reference - position) / TICK;
            // The velocity limit of 6 rad/s minus 25 ms of the acceleration; for `spread`, half of its limit
            // of 4 rad/s. `spread` takes at least 30 ms to reach its speed.
            let (speed, acceleration) = if index == 5 { (2.0, 2.0 / 0.03) } else { (3.5, 100.0) };
            assert!(new.abs() < 1.001 * speed + 1e-3, "joint {index}: {new} rad/s");
            let change = (new - velocity) / TICK;
            // The mean velocity of a tick of constant acceleration lags by half a tick.
            assert!(change.abs() < 1.01 * acceleration + 0.5, "joint {index}: {change} rad/s²");
            let (lower, upper) = self.hand.limits()[index];
            assert!(joint.reference >= lower - 1e-6 && joint.reference <= upper + 1e-6);
        }
        let points = now.joints.iter().enumerate().map(|(index, joint)| {
            let before = self.references.get(index).map_or(joint.reference, |point| point[0]);
            [joint.reference, (joint.reference - before) / TICK]
        });
        self.references = points.collect();
    }

    fn telemetry(&mut self) -> TelexistenceTelemetry {
        match self.rig.telemetry() {
            TaskTelemetry::Telexistence(telemetry) => telemetry,
            other => panic!("{other:?}"),
        }
    }

    fn angles(&self) -> Angles {
        let mut angles = Angles::zeros();
        for (angle, joint) in angles.iter_mut().zip(&self.rig.node.telemetry().joints) {
            *angle = joint.reference;
        }
        angles
    }

    fn enable(&mut self) {
        let config = TaskConfig::Telexistence(TelexistenceSettings::DEFAULT);
        assert_eq!(self.ask(Request::Enable(config)), Reply::Done);
        self.references =
            self.rig.node.telemetry().joints.iter().map(|joint| [joint.reference, 0.0]).collect();
    }
}

/// Returns the posture of an operator with the robot's hand, who bends the fingers and spreads them to and
/// fro.
fn operator(hand: &Hand, time: f32) -> Angles {
    let mut angles = relaxed(hand);
    for (index, (angle, (lower, upper))) in angles.iter_mut().zip(hand.limits()).enumerate() {
        let phase = (3.0 + 0.1 * index as f32) * time;
        *angle += 0.25 * (upper - lower) * phase.sin();
    }
    angles
}

/// Returns the operator's sample at `time` [s], displaced by `away` from the robot's hand [m].
fn sample(hand: &Hand, number: u16, time: f32, away: [f32; 3]) -> FingertipSample {
    let (here, soon) = (operator(hand, time), operator(hand, time + 1e-3));
    let tip = |finger| {
        let (position, direction) = hand.tip(finger, &here)?;
        let velocity = (hand.tip(finger, &soon)?.0 - position) * 1e3;
        let position = [0, 1, 2].map(|axis| position[axis] + away[axis]);
        Some(FingertipPoint { position, velocity: velocity.into(), direction: Some(direction.into()) })
    };
    FingertipSample { number, age: 0.0, tips: [0, 1, 2, 3, 4].map(tip) }
}

/// Returns the largest deviation of the vectors between the thumb's tip and the others from the operator's
/// [m].
fn deviation(hand: &Hand, robot: &Angles, operator: &Angles) -> f32 {
    let vector =
        |angles: &Angles, finger| hand.tip(finger, angles).unwrap().0 - hand.tip(0, angles).unwrap().0;
    (1..5).map(|finger| (vector(robot, finger) - vector(operator, finger)).norm()).fold(0.0, f32::max)
}

#[test]
fn the_hand_follows_and_reproduces_the_fingertips_at_rest() {
    let mut board = Board::new();
    board.enable();
    let away = [0.02, -0.01, 0.03];
    // At rest, so that the offset is exact and all fingertips can be reached together.
    let mut first = sample(&board.hand, u16::MAX, 0.0, away);
    first.tips.iter_mut().flatten().for_each(|tip| tip.velocity = [0.0; 3]);
    assert_eq!(board.task(TelexistenceCommand::Follow(first)), Reply::Done);
    board.tick();
    let mut worst = 0.0_f32;
    for tick in 0..300_u16 {
        let time = f32::from(tick) * TICK;
        let sample = sample(&board.hand, tick, time, away);
        assert_eq!(board.task(TelexistenceCommand::Follow(sample)), Reply::Done);
        board.tick();
        // The operator starts at full speed, the hand at rest.
        if tick > 30 {
            worst = worst.max(deviation(&board.hand, &board.angles(), &operator(&board.hand, time)));
        }
    }
    // The fingertips move at up to 0.5 m/s; a lag of two ticks is 10 mm.
    assert!(worst < 6e-3, "{worst} m in motion");
    for number in 300..350 {
        let mut sample = sample(&board.hand, number, 3.0, away);
        sample.tips.iter_mut().flatten().for_each(|tip| tip.velocity = [0.0; 3]);
        assert_eq!(board.task(TelexistenceCommand::Follow(sample)), Reply::Done);
        board.tick();
    }
    let rest = deviation(&board.hand, &board.angles(), &operator(&board.hand, 3.0));
    assert!(rest < 1e-4, "{rest} m at rest");
    let telemetry = board.telemetry();
    assert_eq!((telemetry.samples, telemetry.ignored), (351, 0));
    assert_eq!((telemetry.unknown, telemetry.limited), (0, 0), "{telemetry:?}");
}

#[test]
fn lost_late_and_repeated_samples_are_bridged() {
    let mut board = Board::new();
    board.enable();
    let mut rng = Rng::new(8, 0);
    let (mut waiting, mut worst) = (Vec::new(), 0.0_f32);
    for tick in 0..500_u16 {
        let time = f32::from(tick) * TICK;
        let mut new = sample(&board.hand, tick, time, [0.0; 3]);
        if rng.uniform() < 0.1 {
            // The sensor has lost a finger.
            new.tips[usize::from(tick) % 5] = None;
        }
        // Lost, sent at once, sent slightly later, or sent twice.
        let chance = rng.uniform();
        if tick == 0 || chance < 0.5 {
            waiting.push((tick, new));
        } else if chance < 0.6 {
            waiting.push((tick + 2, new));
        } else if chance < 0.7 {
            waiting.extend([(tick, new), (tick + 1, new)]);
        }
        let (due, later): (Vec<_>, Vec<_>) = waiting.into_iter().partition(|(due, _)| *due <= tick);
        waiting = later;
        for (_, mut sample) in due {
            sample.age = f32::from(tick - sample.number) * TICK;
            assert_eq!(board.task(TelexistenceCommand::Follow(sample)), Reply::Done);
        }
        let _ = board.ask(Request::Keep);
        board.tick();
        // The operator starts at full speed, the hand at rest.
        if tick > 30 {
            worst = worst.max(deviation(&board.hand, &board.angles(), &operator(&board.hand, time)));
        }
    }
    let telemetry = board.telemetry();
    assert!(telemetry.ignored > 40 && telemetry.samples > 250, "{telemetry:?}");
    assert!(worst < 0.015, "{worst} m");
}

#[test]
fn a_stream_that_stops_leaves_the_hand_at_rest() {
    let mut board = Board::new();
    board.enable();
    for tick in 0..100_u16 {
        let sample = sample(&board.hand, tick, f32::from(tick) * TICK, [0.0; 3]);
        assert_eq!(board.task(TelexistenceCommand::Follow(sample)), Reply::Done);
        board.tick();
    }
    for _ in 0..80 {
        let _ = board.ask(Request::Keep);
        board.tick();
    }
    let before = board.angles();
    let _ = board.ask(Request::Keep);
    board.tick();
    assert!((board.angles() - before).norm() < 1e-5);
    let telemetry = board.telemetry();
    assert_eq!((telemetry.age, telemetry.unknown), (82, 0b1_1111));
}

#[test]
fn an_open_clutch_lets_the_operator_move_away() {
    let mut board = Board::new();
    board.enable();
    let follow = |board: &mut Board, number: u16, away: [f32; 3]| {
        let mut sample = sample(&board.hand, number, 0.0, away);
        sample.tips.iter_mut().flatten().for_each(|tip| tip.velocity = [0.0; 3]);
        assert_eq!(board.task(TelexistenceCommand::Follow(sample)), Reply::Done);
        board.tick();
    };
    (0..30).for_each(|number| follow(&mut board, number, [0.0; 3]));
    let before = board.angles();
    assert_eq!(board.task(TelexistenceCommand::Release), Reply::Done);
    (30..60).for_each(|number| follow(&mut board, number, [0.05, 0.1, -0.05]));
    assert!((board.angles() - before).norm() < 1e-3, "{}", (board.angles() - before).norm());
}

#[test]
fn an_open_clutch_brings_a_moving_hand_to_rest_without_a_way_back() {
    let mut board = Board::new();
    board.enable();
    for tick in 0..40_u16 {
        let sample = sample(&board.hand, tick, f32::from(tick) * TICK, [0.0; 3]);
        assert_eq!(board.task(TelexistenceCommand::Follow(sample)), Reply::Done);
        board.tick();
    }
    let moving: Vec<f32> = board.references.iter().map(|point| point[1]).collect();
    assert!(moving.iter().any(|velocity| velocity.abs() > 0.6), "{moving:?}");
    assert_eq!(board.task(TelexistenceCommand::Release), Reply::Done);
    for _ in 0..40 {
        board.tick();
        for (joint, (point, before)) in board.references.iter().zip(&moving).enumerate() {
            let is_back = before.abs() > 0.2 && point[1] * before.signum() < -0.01;
            assert!(!is_back, "joint {joint} goes back at {} rad/s", point[1]);
        }
        let _ = board.ask(Request::Keep);
    }
    assert!(board.references.iter().all(|point| point[1].abs() < 1e-3), "{:?}", board.references);
}

#[test]
fn bad_input_is_refused_by_name_and_moves_nothing() {
    let mut board = Board::new();
    let refused = |reply| match reply {
        Reply::Refused(Refusal::Task(TaskRefusal::Telexistence(refusal))) => refusal,
        other => panic!("{other:?}"),
    };
    let mut settings = TelexistenceSettings { acceleration: f32::NAN, ..TelexistenceSettings::DEFAULT };
    let reply = board.ask(Request::Enable(TaskConfig::Telexistence(settings)));
    assert!(refused(reply).to_string().contains("the acceleration is NaN"));
    settings = TelexistenceSettings::DEFAULT;
    settings.retargeting.scale = 20.0;
    let reply = board.ask(Request::Enable(TaskConfig::Telexistence(settings)));
    assert_eq!(refused(reply).to_string(), "scale is 20; it must be 0.1 to 10");

    board.enable();
    let good = sample(&board.hand, 1, 0.0, [0.0; 3]);
    let mut bad = |change: &dyn Fn(&mut FingertipSample)| {
        let mut sample = good;
        change(&mut sample);
        refused(board.task(TelexistenceCommand::Follow(sample)))
    };
    let finger = |refusal| match refusal {
        TelexistenceRefusal::Fingertip { finger } => finger,
        other => panic!("{other:?}"),
    };
    assert_eq!(finger(bad(&|sample| sample.tips[3].as_mut().unwrap().position[1] = f32::NAN)), 3);
    assert_eq!(finger(bad(&|sample| sample.tips[0].as_mut().unwrap().position[0] = 90.0)), 0);
    assert_eq!(finger(bad(&|sample| sample.tips[4].as_mut().unwrap().velocity[2] = f32::INFINITY)), 4);
    assert_eq!(finger(bad(&|sample| sample.tips[1].as_mut().unwrap().direction = Some([0.0; 3]))), 1);
    assert_eq!(bad(&|sample| sample.age = -0.1), TelexistenceRefusal::Age { value: -0.1 });
    let before = board.angles();
    board.tick();
    assert_eq!((board.angles(), board.telemetry().samples), (before, 0));

    // An arm is not a hand.
    let arm = robot("arm7").model;
    let mut rig = Rig::new(&arm);
    let mut sensors = tesaki_tests::zero_sensors(&arm, 48_000);
    sensors.sequence = 1;
    rig.node.tick(&sensors);
    let positions = arm.joints.iter().map(|joint| 0.5 * (joint.limits.lower + joint.limits.upper)).collect();
    rig.ask(Request::Home { positions });
    let reply = rig.ask(Request::Enable(TaskConfig::Telexistence(TelexistenceSettings::DEFAULT)));
    assert_eq!(refused(reply), TelexistenceRefusal::NotAHand);
}
