//! The supervisor link under damage, and supervisors that die, hang, go and come back.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::disallowed_methods,
    reason = "tests"
)]

use std::collections::HashMap;

use tesaki::control::ServoMode;
use tesaki::fault::FaultCause;
use tesaki::model::{Reaction, RobotModel};
use tesaki::protocol::codec::{Decoder, MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    ActuatorFrame, FromBoard, Mode, Refusal, Reply, Request, RequestFrame, SCHEMA_KEY, SensorFrame, Stream,
};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_description::robot::RobotFolder;
use tesaki_sim::plant::{Plant, PlantOptions};
use tesaki_sim::virtual_board::VirtualBoard;
use tesaki_supervisor::fault_injector::{Damage, LinkFaults};
use tesaki_tests::{robot, set_up, zero_sensors};

const CLIENT: u32 = 0x7e5a;

fn bytes_of<T: serde::Serialize>(message: &T) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(message, &mut frame).unwrap();
    frame[..length].to_vec()
}

fn goal(positions: &[f32]) -> Request {
    Request::Task(TaskCommand::JointServo(JointCommand::Goal {
        positions: heapless::Vec::from_slice(positions).unwrap(),
    }))
}

/// A board in this process, its client, and the machine.
struct Rig {
    board: VirtualBoard,
    sequence: u16,
    sensors: SensorFrame,
    model: RobotModel,
}

impl Rig {
    /// With a model; its joints are where the encoders say.
    fn new(model: &RobotModel) -> Self {
        let sensors = zero_sensors(model, 24_000);
        let mut rig = Self { board: VirtualBoard::default(), sequence: 0, sensors, model: model.clone() };
        set_up(model).into_iter().for_each(|request| rig.grants(request));
        rig
    }

    fn frame(&mut self, request: Request) -> RequestFrame {
        self.sequence = self.sequence.wrapping_add(1);
        RequestFrame { client: CLIENT, sequence: self.sequence, request }
    }

    fn ask(&mut self, request: Request) -> Reply {
        let frame = self.frame(request);
        self.board.handle(frame, &mut Vec::new()).reply
    }

    #[track_caller]
    fn grants(&mut self, request: Request) {
        let reply = self.ask(request);
        assert!(!matches!(reply, Reply::Refused(_)), "{reply:?}");
    }

    fn tick(&mut self) -> ActuatorFrame {
        self.sensors.sequence += 1;
        tremble(&mut self.sensors);
        self.board.tick(&self.sensors, &mut Vec::new())
    }

    fn mode(&self) -> Mode {
        self.board.node().mode()
    }
}

/// Live force sensors never read the same for long.
fn tremble(sensors: &mut SensorFrame) {
    let noise = (sensors.sequence % 3).cast_signed();
    sensors.forces.iter_mut().for_each(|counts| counts[0] = noise);
}

/// What left one end, by number, and how much of it arrived at the other as it was.
#[derive(Default)]
struct Line {
    intact: u64,
    sent: u64,
}

#[test]
fn no_damaged_frame_is_acted_on_and_the_second_good_one_always_arrives() {
    const DAMAGED: u64 = 1_000_000;
    let robot = robot("hand3");
    let mut rig = Rig::new(&robot.model);
    let faults: LinkFaults = "seed=1,flip=1e-2,drop=1e-2,splice=1e-1,duplicate=1e-1".parse().unwrap();
    let (mut forth, mut back) = (Damage::new(&faults, 0), Damage::new(&faults, 1));
    let (mut board, mut pc) = (Decoder::new(), Decoder::new());
    let (mut requests, mut answers) = (Line::default(), Line::default());
    let (mut sent, mut said) = (HashMap::new(), HashMap::new());
    let mut burst = 0_u64;
    while requests.sent - requests.intact + answers.sent - answers.intact < DAMAGED {
        burst += 1;
        let mut wire = Vec::new();
        for index in 0..20_u8 {
            let request = match index % 4 {
                0 => goal(&[0.001 * f32::from(index); 9]),
                1 => Request::SetRate { stream: Stream::Status, every: 1000 + u16::from(index) },
                2 => Request::ReadFaults,
                _ => Request::Home {
                    positions: heapless::Vec::from_slice(&[0.01 * f32::from(index); 9]).unwrap(),
                },
            };
            let frame = rig.frame(request);
            forth.pass(&bytes_of(&frame), &mut wire);
            sent.insert(frame.sequence, frame);
            requests.sent += 1;
        }
        // Two good ones behind the damage: at the latest the second arrives.
        let good = [rig.frame(Request::ReadStatus), rig.frame(Request::ReadStatus)];
        let damaged_part = wire.len();
        for frame in &good {
            wire.extend(bytes_of(frame));
            sent.insert(frame.sequence, frame.clone());
        }
        let mut arrived = Vec::new();
        let mut seen = std::collections::HashSet::new();
        for (place, &byte) in wire.iter().enumerate() {
            let Some(Ok(frame)) = board.push::<RequestFrame>(byte) else { continue };
            assert_eq!(sent.get(&frame.sequence), Some(&frame), "burst {burst}: never sent");
            if place < damaged_part {
                requests.intact += u64::from(seen.insert(frame.sequence));
            } else {
                arrived.push(frame.sequence);
            }
            let reply = rig.board.handle(frame, &mut Vec::new());
            let bytes = bytes_of(&FromBoard::Reply(reply.clone()));
            said.insert((reply.sequence, checksum(&bytes)), reply);
            answers.sent += 1;
            let mut wire = Vec::new();
            back.pass(&bytes, &mut wire);
            let mut wire = &wire[..];
            while pc.take(&mut wire) {
                if let Ok(FromBoard::Reply(reply)) = pc.message() {
                    let bytes = bytes_of(&FromBoard::Reply(reply.clone()));
                    assert_eq!(said.get(&(reply.sequence, checksum(&bytes))), Some(&reply), "never said");
                    answers.intact += 1;
                }
            }
        }
        assert!(arrived.contains(&good[1].sequence), "burst {burst}: the second good frame was lost");
        if burst.is_multiple_of(1000) {
            sent.clear();
            said.clear();
        }
    }
    let counts = board.counts();
    // Each way of being damaged occurred and was told from the others.
    assert!(counts.framing > 10_000 && counts.checksum > 10_000, "{counts:?}");
    assert!(requests.intact > 10_000 && answers.intact > 10_000, "the line must not be dead either");
    assert_eq!(rig.mode(), Mode::Disabled, "nothing was enabled by accident");
    println!("{burst} bursts: {counts:?}, injected {} and {}", forth.injected(), back.injected());
}

#[test]
fn an_hour_at_100_hz_with_a_damaged_percent_loses_nothing_that_matters() {
    const TICKS: u32 = 360_000;
    let mut model = robot("hand3").model;
    model.joints.iter_mut().for_each(|joint| joint.encoder.relative = false);
    let mut rig = Rig::new(&model);
    rig.tick();
    rig.grants(Request::SetRate { stream: Stream::Telemetry, every: 1 });
    rig.grants(Request::Enable(TaskConfig::JointServo(ServoMode::Pid)));
    // About one frame in a hundred is hit.
    let faults: LinkFaults = "seed=2,flip=1e-4,drop=5e-5,splice=3e-3,duplicate=3e-3".parse().unwrap();
    let (mut forth, mut back) = (Damage::new(&faults, 0), Damage::new(&faults, 1));
    let mut pc = Decoder::new();
    let (mut telemetries, mut replies, mut last_tick, mut longest_gap) = (0, 0, 0, 0);
    let (mut wire, mut out) = (Vec::new(), Vec::new());
    for index in 0..TICKS {
        let position = 0.1 + 0.1 * (f64::from(index) * 0.001).sin() as f32;
        let frame = rig.frame(goal(&[position; 9]));
        wire.clear();
        forth.pass(&bytes_of(&frame), &mut wire);
        out.clear();
        rig.board.receive(&wire, &mut out);
        rig.sensors.sequence += 1;
        tremble(&mut rig.sensors);
        // Joints that follow exactly: the link is what is tested here.
        for (count, joint) in rig.sensors.encoders.iter_mut().zip(rig.board.node().telemetry().joints) {
            // A count that never moves would be a dead encoder.
            *count = (joint.reference * 65_536.0 / core::f32::consts::TAU) as i32 + (index % 2).cast_signed();
        }
        rig.board.tick(&rig.sensors, &mut out);
        assert!(
            matches!(rig.mode(), Mode::Enabled(_)),
            "tick {index}: {:?}",
            rig.board.node().faults().faults.last()
        );
        wire.clear();
        back.pass(&out, &mut wire);
        let mut bytes = &wire[..];
        while pc.take(&mut bytes) {
            match pc.message() {
                Ok(FromBoard::Telemetry(telemetry)) if telemetry.tick != last_tick => {
                    longest_gap = longest_gap.max(telemetry.tick - last_tick);
                    last_tick = telemetry.tick;
                    telemetries += 1;
                }
                Ok(FromBoard::Reply(_)) => replies += 1,
                _ => {}
            }
        }
    }
    let damaged = forth.injected().total() + back.injected().total();
    assert!(damaged > u64::from(TICKS) / 100, "{damaged}");
    // No missed tick, nothing stuck, nothing growing: the node has no memory that could.
    assert_eq!(rig.board.node().last_tick(), TICKS + 1);
    assert!(telemetries > TICKS * 95 / 100 && replies > TICKS * 95 / 100, "{telemetries} {replies}");
    assert!(longest_gap < 10, "{longest_gap} ticks without telemetry");
    println!(
        "{telemetries} telemetries, {replies} replies, longest gap {longest_gap} ticks, {damaged} injected"
    );
}

/// What happens to the supervisor.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Loss {
    /// It is gone for good; another takes over.
    Killed,
    /// The line is cut for a second and a half; what is sent meanwhile is lost.
    Unplugged,
    /// The line holds everything back for a second and a half, and then delivers it.
    Stalled,
}

#[test]
fn the_loss_of_the_supervisor_ends_in_the_configured_reaction_and_never_in_a_jump() {
    let robot = robot("hand3");
    for reaction in [Reaction::Off, Reaction::Damp, Reaction::Hold] {
        for servo in [ServoMode::Pid, ServoMode::Observer] {
            for streaming in [false, true] {
                for loss in [Loss::Killed, Loss::Unplugged, Loss::Stalled] {
                    lose(&robot, reaction, servo, streaming, loss);
                }
            }
        }
    }
}

/// A moving hand loses its supervisor.
fn lose(robot: &RobotFolder, reaction: Reaction, servo: ServoMode, streaming: bool, loss: Loss) {
    let case = format!("{reaction:?} {servo:?} streaming {streaming} {loss:?}");
    let mut model = robot.model.clone();
    model.safety.reaction = reaction;
    let mut plant = Plant::of(robot, &PlantOptions::mismatched(3)).unwrap();
    let mut rig = Rig::new(&model);
    let mut torques = vec![0.0_f32; model.joints.len()];
    let mut tick = |rig: &mut Rig| {
        rig.sensors = plant.sensors(rig.sensors.sequence + 1);
        let actuators = rig.board.tick(&rig.sensors, &mut Vec::new());
        for ((torque, last), joint) in actuators.torques.iter().zip(&mut torques).zip(&rig.model.joints) {
            let rate = joint.limits.torque_rate * 0.01 * 1.0001;
            assert!(
                *torque == 0.0 || (torque - *last).abs() <= rate,
                "{case}: torque jumps {last} to {torque}"
            );
            *last = *torque;
        }
        plant.apply(&actuators).unwrap();
        (actuators, plant.truth(), plant.homed_positions())
    };
    let (.., homed) = tick(&mut rig);
    let start: Vec<f32> = homed.iter().map(|&angle| angle as f32).collect();
    rig.grants(Request::Home { positions: heapless::Vec::from_slice(&start).unwrap() });
    tick(&mut rig);
    rig.grants(Request::Enable(TaskConfig::JointServo(servo)));
    // Under way: 0.3 rad/s when the last set-point comes.
    let point = |index: u32| -> Request {
        let moved = 0.003 * index as f32;
        if streaming {
            let points = start.iter().map(|angle| tesaki::control::JointPoint {
                position: angle + moved,
                velocity: 0.3,
                acceleration: 0.0,
            });
            Request::Task(TaskCommand::JointServo(JointCommand::Stream { points: points.collect() }))
        } else {
            goal(&start.iter().map(|angle| angle + 0.2).collect::<Vec<f32>>())
        }
    };
    for index in 1..=30 {
        rig.grants(point(index));
        assert!(tick(&mut rig).0.enabled, "{case}");
    }
    // 100 ms are allowed: ten more ticks, and the eleventh reacts.
    let (mut held_back, mut resting) = (Vec::new(), Vec::new());
    for silent in 1..=150_u32 {
        let frame = rig.frame(point(30 + silent));
        if loss == Loss::Stalled {
            held_back.push(frame);
        }
        let (actuators, truth, _) = tick(&mut rig);
        if silent < 10 {
            assert!(matches!(rig.mode(), Mode::Enabled(_)), "{case}: after {silent} ticks");
        }
        if silent >= 11 {
            assert_eq!(rig.mode(), Mode::Fault, "{case}: after {silent} ticks");
            assert_eq!(rig.board.node().faults().faults.last().unwrap().cause, FaultCause::CommandTimeout);
            assert_eq!(actuators.enabled, reaction != Reaction::Off, "{case}");
        }
        if silent == 100 {
            resting = truth.positions;
        } else if silent == 150 && reaction == Reaction::Hold {
            // A PID that has not learnt the friction yet lets a joint slip by some hundredths before it
            // holds.
            for (now, then) in truth.positions.iter().zip(&resting) {
                assert!((now - then).abs() < 0.05, "{case}: still moves: {}", now - then);
            }
        }
    }
    // What was held back is refused: it is too late for it.
    for frame in held_back {
        let reply = rig.board.handle(frame, &mut Vec::new()).reply;
        assert_eq!(reply, Reply::Refused(Refusal::WrongMode(Mode::Fault)), "{case}");
    }
    if loss == Loss::Killed {
        // Somebody else commands in between.
        let other = RequestFrame { client: 2, sequence: 1, request: Request::Hello { schema: SCHEMA_KEY } };
        rig.board.handle(other, &mut Vec::new());
        let take = RequestFrame { client: 2, sequence: 2, request: Request::TakeCommand { by_force: true } };
        assert_eq!(rig.board.handle(take, &mut Vec::new()).reply, Reply::Done, "{case}");
        let release = RequestFrame { client: 2, sequence: 3, request: Request::ReleaseCommand };
        assert_eq!(rig.board.handle(release, &mut Vec::new()).reply, Reply::Done, "{case}");
        rig.grants(Request::TakeCommand { by_force: false });
    }
    // The same client goes on, without a restart: reads, clears, enables, and the joints stay where they are.
    let Reply::Faults(log) = rig.ask(Request::ReadFaults) else { panic!() };
    rig.grants(Request::ClearFaults { total: log.total });
    assert!(!tick(&mut rig).0.enabled, "{case}: cleared is disarmed");
    rig.grants(Request::Enable(TaskConfig::JointServo(servo)));
    let (_, before, _) = tick(&mut rig);
    for _ in 0..9 {
        let (actuators, truth, _) = tick(&mut rig);
        assert!(actuators.enabled, "{case}");
        for (now, then) in truth.positions.iter().zip(&before.positions) {
            assert!((now - then).abs() < 0.03, "{case}: moved by {} rad on return", now - then);
        }
    }
}
