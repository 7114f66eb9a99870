//! The node from outside: what is refused, what faults, and what the outputs do then.

use heapless::Vec;
use postcard_schema::Schema;
use postcard_schema::schema::{DataModelType, DataModelVariant, NamedType};
use proptest::prelude::*;

use super::{Node, State};
use crate::control::{JointPoint, ServoMode};
use crate::kinematics::TipPoint;
use crate::manipulation::{
    BadPlan, Failure, GraspCommand, GraspPlan, GraspTelemetry, InternalForce, ObjectControl, Phase,
    PlanField, PlannedContact, Unable,
};
use crate::model::{
    ChainModel, Field, ForceSensor, MAX_JOINTS, Pose, Problem, Reaction, RobotModel, Safety, test_joint,
};
use crate::protocol::{
    ActuatorFrame, BoardStatus, EXPORT_CHUNK, Fault, FaultCause, Item, LogRecord, LogStart, MODEL_CHUNK,
    Mode, Refusal, Reply, Request, RequestFrame, SCHEMA_KEY, SensorFlags, SensorFrame, SetPoint, Stream,
    Task, codec,
};

const COUNTS_PER_RADIAN: f32 = 65536.0 / core::f32::consts::TAU;

fn model() -> RobotModel {
    let mut joints = Vec::new();
    for name in ["base", "middle", "tip"] {
        joints.push(test_joint(name)).unwrap();
    }
    RobotModel {
        name: "finger".try_into().unwrap(),
        gravity: [0.0, 0.0, -9.81],
        chains: Vec::from_slice(&[ChainModel {
            name: "tip".try_into().unwrap(),
            joints: 3,
            tip: Pose::IDENTITY,
            tip_radius: 0.0,
            force_sensor: None,
        }])
        .unwrap(),
        joints,
        safety: Safety {
            command_timeout: 0.1,
            reaction: Reaction::Hold,
            damping: 0.01,
            supply_min: 20.0,
            supply_max: 28.0,
        },
    }
}

/// A node with its board around it: sends requests, and ticks with encoders that read what the test says.
pub(super) struct Bench {
    pub node: Node,
    pub sensors: SensorFrame,
    client: u32,
    sequence: u16,
}

impl Bench {
    pub fn new() -> Self {
        let sensors = SensorFrame {
            sequence: 0,
            flags: SensorFlags(0),
            supply: 24_000,
            encoders: Vec::from_slice(&[0; 3]).unwrap(),
            currents: Vec::from_slice(&[0; 3]).unwrap(),
            forces: Vec::new(),
        };
        Self { node: Node::new(), sensors, client: 7, sequence: 0 }
    }

    /// Ready to arm.
    fn ready(model: &RobotModel) -> Self {
        let mut bench = Self::new();
        bench.command();
        assert_eq!(bench.push(model), Reply::Done);
        bench.tick();
        bench
    }

    fn armed(model: &RobotModel) -> Self {
        let mut bench = Self::ready(model);
        assert_eq!(bench.arm(), Reply::Done);
        bench
    }

    pub fn ask(&mut self, request: Request) -> Reply {
        self.sequence = self.sequence.wrapping_add(1);
        self.send(self.client, self.sequence, request)
    }

    fn send(&mut self, client: u32, sequence: u16, request: Request) -> Reply {
        let reply = self.node.handle(&RequestFrame { client, sequence, request }, &BoardStatus::default());
        assert_eq!((reply.client, reply.sequence), (client, sequence));
        reply.reply
    }

    /// Says hello and takes command.
    pub fn command(&mut self) {
        assert!(matches!(self.ask(Request::Hello { schema: SCHEMA_KEY }), Reply::Hello { .. }));
        assert_eq!(self.ask(Request::TakeCommand { by_force: false }), Reply::Done);
    }

    /// Reads an export to its end.
    fn export(&mut self, item: Item) -> (std::vec::Vec<u8>, u32) {
        let Reply::Exported { length, checksum, index } = self.ask(Request::Export(item)) else { panic!() };
        let mut bytes = std::vec::Vec::new();
        while bytes.len() < length as usize {
            let offset = bytes.len() as u32;
            let Reply::Chunk { data, .. } = self.ask(Request::ReadExport { offset }) else { panic!() };
            bytes.extend_from_slice(&data);
        }
        assert_eq!((bytes.len(), codec::checksum(&bytes)), (length as usize, checksum));
        (bytes, index)
    }

    pub fn push(&mut self, model: &RobotModel) -> Reply {
        let bytes = postcard::to_stdvec(model).unwrap();
        let begin = Request::ModelBegin { length: bytes.len() as u32, checksum: codec::checksum(&bytes) };
        assert_eq!(self.ask(begin), Reply::Done);
        for (index, data) in bytes.chunks(MODEL_CHUNK).enumerate() {
            let chunk = Request::ModelChunk {
                offset: (index * MODEL_CHUNK) as u32,
                data: Vec::from_slice(data).unwrap(),
            };
            assert_eq!(self.ask(chunk), Reply::Done);
        }
        self.ask(Request::ModelCommit)
    }

    pub fn arm(&mut self) -> Reply {
        self.ask(Request::Arm { task: Task::JointServo(ServoMode::Pid) })
    }

    fn goal(&mut self, positions: [f32; 3]) -> Reply {
        self.ask(Request::SetPoint(SetPoint::Goal { positions: Vec::from_slice(&positions).unwrap() }))
    }

    pub fn tick(&mut self) -> ActuatorFrame {
        self.sensors.sequence += 1;
        self.node.tick(&self.sensors)
    }

    /// Ticks, telling the node each time that the supervisor lives, until it faults.
    fn tick_until_fault(&mut self, goal: [f32; 3], ticks: usize) -> Fault {
        for _ in 0..ticks {
            self.tick();
            if self.node.mode() == Mode::Fault {
                return *self.node.faults().faults.last().unwrap();
            }
            assert_eq!(self.goal(goal), Reply::Done);
        }
        panic!("no fault in {ticks} ticks");
    }
}

pub(super) fn refusal(reply: Reply) -> Refusal {
    match reply {
        Reply::Refused(refusal) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

#[test]
fn arms_only_when_everything_is_ready() {
    let mut bench = Bench::new();
    let mismatch = Refusal::SchemaMismatch { board: SCHEMA_KEY, firmware: crate::VERSION };
    assert_eq!(refusal(bench.arm()), mismatch);
    bench.ask(Request::Hello { schema: SCHEMA_KEY ^ 1 });
    assert_eq!(refusal(bench.arm()), mismatch);
    bench.ask(Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(bench.arm()), Refusal::NotCommander);
    bench.command();
    assert_eq!(refusal(bench.arm()), Refusal::NoModel);
    let mut relative = model();
    relative.joints[1].encoder.relative = true;
    assert_eq!(bench.push(&relative), Reply::Done);
    assert_eq!(refusal(bench.arm()), Refusal::NoSensors);
    bench.tick();
    assert_eq!(refusal(bench.arm()), Refusal::NotHomed { joint: 1 });
    let home = Request::Home { positions: Vec::from_slice(&[0.1, 0.2, 0.3]).unwrap() };
    assert_eq!(bench.ask(home), Reply::Done);
    assert!((bench.node.telemetry().joints[1].position - 0.2).abs() < 1e-4);
    bench.sensors.supply = 12_000;
    bench.tick();
    let Refusal::Unsafe(fault) = refusal(bench.arm()) else { panic!() };
    assert_eq!((fault.cause, fault.value, fault.limit), (FaultCause::SupplyLow, 12.0, 20.0));
    bench.sensors.supply = 24_000;
    bench.tick();
    assert_eq!(bench.arm(), Reply::Done);
    assert_eq!(refusal(bench.arm()), Refusal::WrongMode(Mode::Armed(Task::JointServo(ServoMode::Pid))));
}

#[test]
fn refuses_a_model_that_makes_no_sense_by_joint_and_field() {
    type Spoil = fn(&mut RobotModel);
    let cases: &[(Spoil, Option<u8>, Field)] = &[
        (|m| m.joints[1].link.mass = -0.1, Some(1), Field::Mass),
        (|m| m.joints[2].link.inertia[0] = -1e-6, Some(2), Field::Inertia),
        (|m| m.joints[2].link.inertia = [1.0, 1.0, 3.0, 0.0, 0.0, 0.0], Some(2), Field::Inertia),
        (|m| m.joints[0].limits.upper = -2.0, Some(0), Field::LimitUpper),
        (|m| m.joints[0].axis = [0.0; 3], Some(0), Field::Axis),
        (|m| m.joints[0].motor.torque_constant = f32::NAN, Some(0), Field::TorqueConstant),
        (|m| m.joints[1].name = "base".try_into().unwrap(), Some(1), Field::Name),
        (|m| m.chains[0].joints = 4, None, Field::Chains),
        (|m| m.chains[0].joints = 8, None, Field::Chains),
        (|m| m.joints.clear(), None, Field::Joints),
        (|m| m.safety.supply_max = 10.0, None, Field::SupplyMax),
    ];
    for (spoil, joint, field) in cases {
        let mut bench = Bench::ready(&model());
        let mut spoilt = model();
        spoil(&mut spoilt);
        let Refusal::Model(error) = refusal(bench.push(&spoilt)) else { panic!("{field:?}") };
        assert_eq!((error.joint, error.field), (*joint, *field));
        // The model that was there is still in use.
        assert_eq!(bench.arm(), Reply::Done);
    }
    let mut negative = model();
    negative.joints[0].limits.upper = -2.0;
    let error = negative.validate().unwrap_err();
    assert_eq!((error.value, error.problem), (-2.0, Problem::NotAbove(-1.5)));
    assert_eq!(error.to_string(), "joint 0: limits.upper = -2 must be above -1.5");
}

#[test]
fn refuses_a_damaged_or_incomplete_model_transfer() {
    let mut bench = Bench::ready(&model());
    let bytes = postcard::to_stdvec(&model()).unwrap();
    let chunk = |offset: usize| Request::ModelChunk {
        offset: offset as u32,
        data: Vec::from_slice(&bytes[offset..(offset + MODEL_CHUNK).min(bytes.len())]).unwrap(),
    };
    let length = bytes.len() as u32;
    let wrong_sum = codec::checksum(&bytes) ^ 4;
    bench.ask(Request::ModelBegin { length, checksum: wrong_sum });
    assert_eq!(bench.ask(chunk(0)), Reply::Done);
    assert!(matches!(
        refusal(bench.ask(chunk(2 * MODEL_CHUNK))),
        Refusal::ModelTransfer { received: 192, .. }
    ));
    assert_eq!(bench.ask(chunk(0)), Reply::Done, "a repeated piece is taken again");
    assert!(matches!(refusal(bench.ask(Request::ModelCommit)), Refusal::ModelTransfer { received: 192, .. }));
    for offset in (MODEL_CHUNK..bytes.len()).step_by(MODEL_CHUNK) {
        assert_eq!(bench.ask(chunk(offset)), Reply::Done);
    }
    assert!(matches!(refusal(bench.ask(Request::ModelCommit)), Refusal::ModelChecksum { .. }));
    assert!(matches!(
        refusal(bench.ask(Request::ModelBegin { length: 100_000, checksum: 0 })),
        Refusal::ModelUnreadable { length: 100_000, .. }
    ));
}

#[test]
fn refuses_targets_by_joint_and_limit_and_stays_where_it_was() {
    let mut bench = Bench::armed(&model());
    let before = bench.tick();
    assert_eq!(refusal(bench.goal([0.0, f32::NAN, 0.0])), Refusal::NotFinite { joint: 1 });
    assert_eq!(
        refusal(bench.goal([0.0, 0.0, 1.6])),
        Refusal::OutsideLimits { joint: 2, value: 1.6, lower: -1.5, upper: 1.5 }
    );
    let short = Request::SetPoint(SetPoint::Goal { positions: Vec::from_slice(&[0.0; 2]).unwrap() });
    assert_eq!(refusal(bench.ask(short)), Refusal::JointCount { got: 2, expected: 3 });
    let stream = |position, velocity| {
        let rest = JointPoint::default();
        let points =
            Vec::from_slice(&[rest, rest, JointPoint { position, velocity, acceleration: 0.0 }]).unwrap();
        Request::SetPoint(SetPoint::Stream { points })
    };
    assert_eq!(refusal(bench.ask(stream(0.5, 0.0))), Refusal::Jump { joint: 2, value: 0.5, limit: 0.2 });
    assert_eq!(refusal(bench.ask(stream(0.0, 9.0))), Refusal::TooFast { joint: 2, value: 9.0, limit: 8.0 });
    assert_eq!(refusal(bench.ask(stream(f32::INFINITY, 0.0))), Refusal::NotFinite { joint: 2 });
    let after = bench.tick();
    assert_eq!(before.torques, after.torques);
    assert!(bench.node.telemetry().joints.iter().all(|joint| joint.reference == 0.0));
}

#[test]
fn a_jumping_encoder_switches_off() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    bench.sensors.encoders[1] += 10_000;
    let output = bench.tick();
    let fault = *bench.node.faults().faults.last().unwrap();
    assert_eq!(
        (fault.cause, fault.joint, fault.tick),
        (FaultCause::EncoderJump, Some(1), bench.sensors.sequence)
    );
    // 10 000 counts of 65 536 a turn are 0.9587 rad; the limit is twice 8 rad/s · 10 ms and two counts.
    assert!((fault.value - 0.958_738).abs() < 1e-5 && (fault.limit - 0.160_192).abs() < 1e-5, "{fault:?}");
    assert!(!output.enabled && output.torques == [0.0; 3]);
}

#[test]
fn a_stuck_encoder_switches_off() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    let fault = bench.tick_until_fault([0.0, 0.0, 0.19], 400);
    assert_eq!((fault.cause, fault.joint), (FaultCause::EncoderStuck, Some(2)));
    assert!(fault.value > fault.limit && (fault.limit - 0.1).abs() < 1e-6, "{fault:?}");
    assert!(!bench.tick().enabled);
}

#[test]
fn frame_faults_are_named_with_value_limit_and_tick() {
    type Spoil = fn(&mut SensorFrame);
    let cases: &[(Spoil, FaultCause, f32, f32, bool)] = &[
        (|s| s.sequence += 2, FaultCause::LateTick, 3.0, 1.0, true),
        (|s| s.sequence -= 1, FaultCause::LateTick, 0.0, 1.0, true),
        (|s| s.supply = 19_000, FaultCause::SupplyLow, 19.0, 20.0, true),
        (|s| s.supply = 30_000, FaultCause::SupplyHigh, 30.0, 28.0, false),
        (|s| s.flags = SensorFlags(1), FaultCause::EmergencyStop, 1.0, 0.0, false),
        (|s| s.currents[0] = 2000, FaultCause::OverCurrent, 2.0, 1.875, false),
        (|s| s.encoders.truncate(2), FaultCause::SensorCount, 2.0, 3.0, false),
    ];
    for &(spoil, cause, value, limit, still_enabled) in cases {
        let mut bench = Bench::armed(&model());
        bench.tick();
        spoil(&mut bench.sensors);
        let output = bench.tick();
        let fault = *bench.node.faults().faults.last().unwrap_or_else(|| panic!("{cause:?}"));
        assert_eq!((fault.cause, fault.value, fault.limit), (cause, value, limit));
        assert_eq!((fault.tick, output.enabled), (bench.sensors.sequence, still_enabled), "{cause:?}");
        if !still_enabled {
            assert!(output.torques.iter().all(|&torque| torque == 0.0));
        }
    }
}

#[test]
fn silence_of_the_supervisor_ends_in_the_configured_reaction() {
    for reaction in [Reaction::Off, Reaction::Damp, Reaction::Hold] {
        let mut model = model();
        model.safety.reaction = reaction;
        let mut bench = Bench::armed(&model);
        bench.goal([0.0, 0.05, 0.0]);
        // 100 ms of silence are allowed: the tenth tick is still armed, the eleventh is not.
        for _ in 0..10 {
            assert!(bench.tick().enabled);
            assert!(matches!(bench.node.mode(), Mode::Armed(_)));
        }
        let output = bench.tick();
        let fault = *bench.node.faults().faults.last().unwrap();
        assert_eq!(fault.cause, FaultCause::CommandTimeout);
        assert!((fault.value - 0.11).abs() < 1e-6 && fault.limit == 0.1);
        assert_eq!(output.enabled, reaction != Reaction::Off);
        if reaction == Reaction::Hold {
            // The reference comes to rest short of the goal.
            for _ in 0..100 {
                bench.tick();
            }
            let telemetry = bench.node.telemetry();
            assert!(
                telemetry.joints[1].reference > 0.0 && telemetry.joints[1].reference < 0.03,
                "{telemetry:?}"
            );
        }
    }
}

#[test]
fn a_fault_stays_until_it_was_read() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    bench.ask(Request::Stop);
    assert_eq!(bench.node.mode(), Mode::Fault);
    assert_eq!(refusal(bench.arm()), Refusal::WrongMode(Mode::Fault));
    for total in [0, 1] {
        let clear = Request::ClearFaults { total };
        assert_eq!(refusal(bench.ask(clear)), Refusal::FaultsUnread { total: 1 }, "nobody has read them");
    }
    let Reply::Faults(log) = bench.ask(Request::ReadFaults) else { panic!() };
    assert_eq!(log.faults[0].cause, FaultCause::Stop);
    assert_eq!(bench.ask(Request::ClearFaults { total: log.total }), Reply::Done);
    assert_eq!(bench.node.mode(), Mode::Disarmed);
    // After a reset the board gives the log back, and it is still there to be read.
    let mut reborn = Node::new();
    reborn.restore_faults(log.clone());
    assert_eq!(reborn.faults(), &log);
}

#[test]
fn disarm_puts_a_faulted_node_off_but_keeps_the_fault() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    bench.ask(Request::Stop);
    assert!(bench.tick().enabled, "the reaction is to hold");
    bench.ask(Request::Disarm);
    assert!(!bench.tick().enabled);
    assert_eq!(bench.node.mode(), Mode::Fault);
}

#[test]
fn a_stream_is_followed_to_the_point_and_left_without_a_jump() {
    let mut bench = Bench::armed(&model());
    let mut position = 0.0;
    for _ in 0..20 {
        position += 0.01 * 0.5;
        let point = JointPoint { position, velocity: 0.5, acceleration: 0.0 };
        let points = Vec::from_slice(&[JointPoint::default(), point, JointPoint::default()]).unwrap();
        assert_eq!(bench.ask(Request::SetPoint(SetPoint::Stream { points })), Reply::Done);
        bench.sensors.encoders[1] = (position * COUNTS_PER_RADIAN) as i32;
        bench.tick();
        assert_eq!(bench.node.telemetry().joints[1].reference, position);
    }
    bench.goal([0.0, position, 0.0]);
    bench.tick();
    // The reference goes on at the stream's speed and comes back: 0.5 rad/s · 10 ms · e^(−0.05) at first.
    let step = bench.node.telemetry().joints[1].reference - position;
    assert!((step - 0.004_756).abs() < 1e-5, "{step}");
}

#[test]
fn a_joint_stays_homed_through_a_change_of_the_model_that_leaves_its_encoder_alone() {
    let mut relative = model();
    relative.joints.iter_mut().for_each(|joint| joint.encoder.relative = true);
    let mut bench = Bench::ready(&relative);
    bench.ask(Request::Home { positions: Vec::from_slice(&[0.1, 0.2, 0.3]).unwrap() });
    relative.joints[0].servo.pid.proportional *= 2.0;
    relative.joints[2].encoder.counts_per_turn *= 2.0;
    assert_eq!(bench.push(&relative), Reply::Done);
    bench.tick();
    assert_eq!(bench.node.status(&BoardStatus::default()).node.homed, 0b011);
    assert!((bench.node.telemetry().joints[1].position - 0.2).abs() < 1e-4);
    assert_eq!(refusal(bench.arm()), Refusal::NotHomed { joint: 2 });
}

#[test]
fn a_new_model_does_not_cost_the_commander_its_lease() {
    let mut bench = Bench::new();
    bench.sensors.sequence = 5000;
    bench.tick();
    bench.command();
    assert_eq!(bench.push(&model()), Reply::Done);
    bench.send(8, 1, Request::Hello { schema: SCHEMA_KEY });
    let refused = Reply::Refused(Refusal::Commanded { by: 7 });
    assert_eq!(bench.send(8, 2, Request::TakeCommand { by_force: false }), refused);
    assert_eq!(bench.node.last_tick(), 5001);
    assert_eq!(bench.arm(), Reply::Refused(Refusal::NoSensors));
    bench.tick();
    assert_eq!(bench.arm(), Reply::Done);
}

#[test]
fn only_the_commander_moves_the_machine_but_anyone_may_look_and_stop_it() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    let goal = || Request::SetPoint(SetPoint::Goal { positions: Vec::from_slice(&[0.0; 3]).unwrap() });
    let other = 8;
    assert!(matches!(refusal(bench.send(other, 1, goal())), Refusal::SchemaMismatch { .. }));
    bench.send(other, 2, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(bench.send(other, 3, goal())), Refusal::Commanded { by: 7 });
    for by_force in [false, true] {
        let take = Request::TakeCommand { by_force };
        assert_eq!(refusal(bench.send(other, 4, take)), Refusal::Commanded { by: 7 }, "armed");
    }
    let Reply::Status(status) = bench.send(other, 5, Request::ReadStatus) else { panic!() };
    assert_eq!(status.node.commander, Some(7));
    assert_eq!(bench.send(other, 6, Request::SetRate { stream: Stream::Telemetry, every: 1 }), Reply::Done);
    // The first client still agrees and commands, however many others come.
    for client in 100..120 {
        bench.send(client, 1, Request::Hello { schema: SCHEMA_KEY });
    }
    bench.send(other, 6, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(bench.ask(goal()), Reply::Done);
    assert_eq!(bench.send(other, 7, Request::Stop), Reply::Done);
    assert_eq!(bench.node.mode(), Mode::Fault);
    assert_eq!(bench.send(other, 8, Request::TakeCommand { by_force: true }), Reply::Done);
    bench.ask(Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(bench.ask(goal())), Refusal::Commanded { by: other });
}

#[test]
fn requests_that_come_twice_or_late_change_nothing() {
    let mut bench = Bench::ready(&model());
    let arm = || Request::Arm { task: Task::JointServo(ServoMode::Pid) };
    let first = bench.sequence + 1;
    assert_eq!(bench.ask(arm()), Reply::Done);
    assert_eq!(bench.send(7, first, arm()), Reply::Done, "its reply was lost");
    bench.ask(Request::Disarm);
    assert_eq!(bench.send(7, first, arm()), Reply::Done, "an echo of what happened");
    assert_eq!(bench.node.mode(), Mode::Disarmed, "and not armed again");
    assert_eq!(bench.ask(Request::ReleaseCommand), Reply::Done);
    assert_eq!(refusal(bench.send(7, first, arm())), Refusal::NotCommander);
    bench.command();
    assert!(matches!(refusal(bench.send(7, first, arm())), Refusal::Stale { .. }));
    assert_eq!(bench.node.mode(), Mode::Disarmed);
}

#[test]
fn exports_are_whole_and_end_where_they_end() {
    let mut bench = Bench::ready(&model());
    let (bytes, _) = bench.export(Item::Model);
    assert_eq!(bytes, postcard::to_stdvec(&model()).unwrap());
    let length = bytes.len() as u32;
    let beyond = Request::ReadExport { offset: length };
    assert_eq!(refusal(bench.ask(beyond)), Refusal::NotExported { length });
    let Reply::Chunk { data, .. } = bench.ask(Request::ReadExport { offset: length - 5 }) else { panic!() };
    assert_eq!(data, bytes[bytes.len() - 5..]);
    let mut empty = Bench::new();
    empty.command();
    assert_eq!(refusal(empty.ask(Request::ReadExport { offset: 0 })), Refusal::NotExported { length: 0 });
    assert_eq!(refusal(empty.ask(Request::Export(Item::Model))), Refusal::NoModel);
}

#[test]
fn the_largest_state_can_be_exported() {
    let mut node = Node::new();
    let extreme = super::JointState::extreme();
    node.state.joints = [extreme; MAX_JOINTS];
    for _ in 0..20 {
        let (joint, value) = (Some(15), f32::MIN);
        node.record_fault(Fault { cause: FaultCause::Stop, joint, value, limit: value, tick: u32::MAX });
    }
    let length = postcard::to_stdvec(&node.state).unwrap().len();
    let longest = longest(State::SCHEMA);
    assert!(length < longest && longest <= super::MAX_STATE, "{length} {longest}");
    // Nothing is missing in what the types say.
    assert_eq!(longest_after(&Some(Reaction::Hold)), 2);
    assert_eq!(longest_after(&[JointPoint { position: 0.0, velocity: 0.0, acceleration: 0.0 }; 2]), 24);
    assert_eq!(longest_after(&Task::Grasp), 2);
    assert_eq!(longest_after(&crate::arm::tests::SOFT), 18 * 4 + 1 + 2 + 5 + 4 * 4);
    assert_eq!(longest_after(&(u32::MAX, u16::MAX, i32::MIN, true)), 5 + 3 + 5 + 1);
}

/// The longest encoding of the value's type, which is no shorter than the value's.
fn longest_after<T: Schema + serde::Serialize>(value: &T) -> usize {
    let longest = longest(T::SCHEMA);
    assert!(postcard::to_stdvec(value).unwrap().len() <= longest);
    longest
}

/// Most bytes that a value of a type takes; no list of a state has more than sixteen elements.
fn longest(of: &NamedType) -> usize {
    let fields = |fields: &[&postcard_schema::schema::NamedValue]| -> usize {
        fields.iter().map(|field| longest(field.ty)).sum()
    };
    let all = |types: &[&NamedType]| -> usize { types.iter().map(|of| longest(of)).sum() };
    match of.ty {
        DataModelType::Bool | DataModelType::U8 | DataModelType::I8 => 1,
        DataModelType::U16 | DataModelType::I16 => 3,
        DataModelType::U32 | DataModelType::I32 => 5,
        DataModelType::U64 | DataModelType::I64 => 10,
        DataModelType::F32 => 4,
        DataModelType::Unit | DataModelType::UnitStruct => 0,
        DataModelType::Option(of) => 1 + longest(of),
        DataModelType::NewtypeStruct(of) => longest(of),
        DataModelType::Seq(of) => 1 + 16 * longest(of),
        DataModelType::Tuple(types) | DataModelType::TupleStruct(types) => all(types),
        DataModelType::Struct(values) => fields(values),
        DataModelType::Enum(variants) => {
            let longest = |variant: &&postcard_schema::schema::NamedVariant| match variant.ty {
                DataModelVariant::UnitVariant => 0,
                DataModelVariant::NewtypeVariant(of) => longest(of),
                DataModelVariant::TupleVariant(types) => all(types),
                DataModelVariant::StructVariant(values) => fields(values),
            };
            1 + variants.iter().map(longest).max().unwrap_or(0)
        }
        other => panic!("a state has no {other:?}"),
    }
}

/// Two fingers of Hand3, side by side.
fn fingers() -> RobotModel {
    let mut model = model();
    model.joints.extend_from_slice(&model.joints.clone()).unwrap();
    let shapes = [(0.0, [0.0, 0.0, 1.0]), (0.039, [0.0, 1.0, 0.0]), (0.046, [0.0, 1.0, 0.0])];
    for (index, joint) in model.joints.iter_mut().enumerate() {
        let (height, axis) = shapes[index % 3];
        joint.name = ["a", "b", "c", "d", "e", "f"][index].try_into().unwrap();
        joint.origin.translation = [0.0, if index == 3 { 0.1 } else { 0.0 }, height];
        joint.axis = axis;
    }
    model.chains[0].tip.translation = [0.0, 0.0, 0.051_78];
    model.chains.push(ChainModel { name: "other".try_into().unwrap(), ..model.chains[0].clone() }).unwrap();
    model
}

/// Armed, the fingers at these angles.
fn fingers_at(angles: [f32; 6]) -> Bench {
    let mut bench = Bench::new();
    bench.sensors.encoders = angles.iter().map(|angle| (angle * COUNTS_PER_RADIAN) as i32).collect();
    bench.sensors.currents = [0; 6].into_iter().collect();
    bench.command();
    assert_eq!(bench.push(&fingers()), Reply::Done);
    bench.tick();
    assert_eq!(bench.arm(), Reply::Done);
    bench.tick();
    bench
}

fn reach(tips: &[TipPoint]) -> Request {
    Request::SetPoint(SetPoint::Reach { tips: Vec::from_slice(tips).unwrap() })
}

fn references(bench: &Bench) -> std::vec::Vec<JointPoint> {
    bench.node.state.joints[..6].iter().map(|joint| joint.reference).collect()
}

/// Tip of the first finger at (0.1, 0.5, 0.8): r = 46 sin 0.5 + 51.78 sin 1.3 = 71.9466 mm,
/// z = 39 + 46 cos 0.5 + 51.78 cos 1.3 = 93.2199 mm; and of the second one, 0.1 m beside it, at (−0.2, 1.349 97, −0.8), which
/// bends the other way to the same r and z.
const TIPS: [[f32; 3]; 2] =
    [[0.071_587_2, 0.007_182_7, 0.093_219_9], [0.070_512_5, 0.085_706_5, 0.093_219_9]];
const ANGLES: [f32; 6] = [0.1, 0.5, 0.8, -0.2, 1.349_97, -0.8];

#[test]
fn fingertips_are_led_through_space_with_their_velocities_and_accelerations() {
    let mut bench = fingers_at(ANGLES);
    // The first round its root's axis: only its first joint turns, at 0.5 rad/s, and the tip falls towards the axis with
    // ω² r. The second stays where it is, bent as it is.
    let [x, y, _] = TIPS[0];
    let turning = TipPoint {
        position: TIPS[0],
        velocity: [-0.5 * y, 0.5 * x, 0.0],
        acceleration: [-0.25 * x, -0.25 * y, 0.0],
    };
    let resting = TipPoint { position: TIPS[1], ..TipPoint::default() };
    assert_eq!(bench.ask(reach(&[turning, resting])), Reply::Done);
    bench.tick();
    for ((joint, angle), speed) in references(&bench).iter().zip(ANGLES).zip([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]) {
        assert!((joint.position - angle).abs() < 2e-4, "{joint:?} {angle}");
        assert!((joint.velocity - speed).abs() < 1e-3 && joint.acceleration.abs() < 1e-2, "{joint:?}");
    }
}

#[test]
fn fingertips_are_refused_by_name_what_they_cannot_do() {
    let mut bench = fingers_at(ANGLES);
    let before = references(&bench);
    let rest = |position| TipPoint { position, ..TipPoint::default() };
    let still = rest(TIPS[0]);
    let mut refused = |second: TipPoint| refusal(bench.ask(reach(&[still, second])));
    // Straight out from the second finger's second joint it reaches 97.78 mm.
    let Refusal::OutOfReach { chain: 1, nearest: [x, y, z] } = refused(rest([0.3, 0.1, 0.039])) else {
        panic!()
    };
    assert!((x - 0.097_78).abs() < 1e-6 && (y - 0.1).abs() < 1e-6 && (z - 0.039).abs() < 1e-6, "{x} {y} {z}");
    assert_eq!(refused(rest([f32::NAN, 0.1, 0.1])), Refusal::TipNotFinite { chain: 1 });
    let [x, y, z] = TIPS[1];
    let moving = |velocity, acceleration| TipPoint { position: [x, y, z], velocity, acceleration };
    assert_eq!(refused(moving([f32::NAN, 0.0, 0.0], [0.0; 3])), Refusal::NotFinite { joint: 3 });
    assert!(matches!(refused(moving([0.0, 2.0, 0.0], [0.0; 3])), Refusal::TooFast { joint: 3, .. }));
    // 0.6 N·m on 2.1e-4 kg·m².
    let Refusal::TooMuchAcceleration { joint: 3, limit, .. } = refused(moving([0.0; 3], [0.0, 900.0, 0.0]))
    else {
        panic!()
    };
    assert!((limit - 2857.14).abs() < 0.1, "{limit}");
    // Its first joint at 1.54 rad, or bent over its axis at −1.60 rad: both beyond ±1.5.
    let Refusal::OutsideLimits { joint: 3, value, lower: -1.5, upper: 1.5 } =
        refused(rest([0.002_215, 0.171_912, z]))
    else {
        panic!()
    };
    assert!((value + 1.6).abs() < 0.01 || (value - 1.54).abs() < 0.01, "{value}");
    // Over its axis: within the limits, but far from how it is bent.
    assert!(matches!(refused(rest([-x, 0.2 - y, z])), Refusal::Jump { joint: 4, .. }));
    // Nearly straight: the tip hardly moves outwards.
    let straight = rest([0.097_779_9 * 0.841_471, 0.1, 0.039 + 0.097_779_9 * 0.540_302]);
    let straight = TipPoint { velocity: [0.001, 0.0, 0.0], ..straight };
    assert_eq!(refused(straight), Refusal::Singular { chain: 1 });
    assert_eq!(refusal(bench.ask(reach(&[still]))), Refusal::TipCount { got: 1, expected: 2 });
    bench.tick();
    assert_eq!(references(&bench), before);
    // Another robot has no closed form.
    let mut other = Bench::armed(&model());
    assert_eq!(refusal(other.ask(reach(&[still]))), Refusal::FingerShapeError { chain: 0 });
}

const SENSOR: ForceSensor = ForceSensor {
    force_resolution: 1e-3,
    torque_resolution: 1e-5,
    saturation: 20_000,
    force_limit: 5.0,
    mass: 0.01,
    center_of_mass: [0.0, 0.0, 0.02],
};

/// Two fingers whose tips, 10 g each with their centre 20 mm along z, stand on force sensors; gravity along −z.
fn feeling_fingers(counts: [[i32; 6]; 2]) -> Bench {
    let mut model = fingers();
    model.chains.iter_mut().for_each(|chain| chain.force_sensor = Some(SENSOR));
    let mut bench = Bench::new();
    bench.sensors.encoders = ANGLES.iter().map(|angle| (angle * COUNTS_PER_RADIAN) as i32).collect();
    bench.sensors.currents = [0; 6].into_iter().collect();
    bench.sensors.forces = counts.into_iter().collect();
    bench.command();
    assert_eq!(bench.push(&model), Reply::Done);
    bench.tick();
    bench
}

fn near(a: [f32; 3], b: [f32; 3], tolerance: f32) -> bool {
    a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= tolerance)
}

#[test]
fn the_weight_of_a_tip_and_the_offset_of_its_sensor_are_not_taken_for_contact() {
    // The first finger's links stand 1.3 rad off z, after 0.1 rad about z: gravity in the tip's frame is
    // 9.81 (sin 1.3, 0, −cos 1.3); the tip's 98.1 mN read (94.53, 0, −26.24) mN, and at its centre they turn by
    // 20 mm · 94.53 mN = 1.8905 mN·m about y.
    let weight = [95, 0, -26, 0, 189, 0];
    let mut bench = feeling_fingers([weight, [0; 6]]);
    let tips = bench.node.tips();
    let [first, second] = tips.tips[..] else { panic!() };
    assert!(near(first.position, TIPS[0], 2e-5), "{first:?}");
    assert!(near(first.force, [0.0; 3], 1e-3) && near(first.torque, [0.0; 3], 2e-5), "{first:?}");
    assert!(!first.tared && second.force.iter().any(|force| force.abs() > 0.05), "{second:?}");
    // An offset of 0.3 N along the tip's x on both: tared it is gone, and 1 N along its z points where the link points.
    bench.sensors.forces = [[weight[0] + 300, 0, -26, 0, 189, 0], [300, 0, 0, 0, 0, 0]].into_iter().collect();
    (0..100).for_each(|_| drop(bench.tick()));
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    bench.sensors.forces[0][2] += 1000;
    bench.tick();
    let tips = bench.node.tips();
    let expected = [0.958_745, 0.096_195, 0.267_499]; // sin 1.3 cos 0.1, sin 1.3 sin 0.1, cos 1.3
    assert!(near(tips.tips[0].force, expected, 3e-3), "{tips:?}");
    assert!(near(tips.tips[1].force, [0.0; 3], 3e-3) && tips.tips[1].tared, "{tips:?}");
}

#[test]
fn force_sensors_that_are_dead_saturated_or_overloaded_are_faults_by_name() {
    let armed = || {
        let mut bench = feeling_fingers([[0; 6]; 2]);
        assert_eq!(bench.arm(), Reply::Done);
        bench.tick();
        bench
    };
    // Noise keeps the first one alive.
    let fault = |change: &dyn Fn(&mut Bench, i32), ticks: i32| {
        let mut bench = armed();
        assert_eq!(bench.ask(Request::Tare), Reply::Done);
        for tick in 0..ticks {
            bench.sensors.forces[0][3] = tick % 2;
            change(&mut bench, tick);
            bench.tick();
            if bench.node.mode() == Mode::Fault {
                return *bench.node.faults().faults.last().unwrap();
            }
            let now = [0, 1, 2, 3, 4, 5].map(|joint| bench.node.state.joints[joint].position);
            let hold = SetPoint::Goal { positions: Vec::from_slice(&now).unwrap() };
            bench.ask(Request::SetPoint(hold));
        }
        panic!("no fault")
    };
    let noise = |bench: &mut Bench, tick: i32| bench.sensors.forces[1][4] = tick % 3;
    let dead = fault(&|_, _| {}, 60);
    assert_eq!((dead.cause, dead.joint, dead.limit), (FaultCause::ForceStuck, Some(5), 50.0));
    let saturated = fault(
        &|bench, tick| {
            noise(bench, tick);
            bench.sensors.forces[1][0] = -20_000;
        },
        5,
    );
    assert_eq!(
        (saturated.cause, saturated.joint, saturated.value),
        (FaultCause::ForceSaturated, Some(5), 20_000.0)
    );
    let overload = fault(
        &|bench, tick| {
            noise(bench, tick);
            bench.sensors.forces[0][1] = 500 * tick;
        },
        20,
    );
    assert_eq!((overload.cause, overload.joint, overload.limit), (FaultCause::ForceLimit, Some(2), 5.0));
    assert!((overload.value - 5.5).abs() < 0.1, "{overload:?}");
    let missing = fault(&|bench, _| bench.sensors.forces.truncate(1), 2);
    assert_eq!((missing.cause, missing.value, missing.limit), (FaultCause::SensorCount, 1.0, 2.0));
    assert_eq!(refusal(Bench::ready(&model()).ask(Request::Tare)), Refusal::NoForceSensor);
}

/// Three such fingers; the third stands opposite the middle between the others.
fn hand() -> RobotModel {
    let mut model = fingers();
    for (index, name) in ["g", "h", "i"].into_iter().enumerate() {
        let mut joint = model.joints[index].clone();
        joint.name = name.try_into().unwrap();
        model.joints.push(joint).unwrap();
    }
    model.joints[6].origin.translation = [0.3, 0.05, 0.0];
    model.chains.push(ChainModel { name: "third".try_into().unwrap(), ..model.chains[0].clone() }).unwrap();
    for chain in &mut model.chains {
        (chain.tip_radius, chain.force_sensor) = (0.008, Some(SENSOR));
    }
    model
}

/// The hand, not tared yet, bent so that its tips are at x = ±71.9466 mm from its roots and at z = 93.2199 mm.
fn untared_hand() -> Bench {
    let angles = [0.0, 0.5, 0.8, 0.0, 0.5, 0.8, 0.0, -0.5, -0.8];
    let mut bench = Bench::new();
    bench.sensors.encoders = angles.iter().map(|angle| (angle * COUNTS_PER_RADIAN) as i32).collect();
    bench.sensors.currents = [0; 9].into_iter().collect();
    bench.sensors.forces = [[0; 6]; 3].into_iter().collect();
    bench.command();
    assert_eq!(bench.push(&hand()), Reply::Done);
    bench.tick();
    bench
}

/// The hand, ready to arm for a grasp.
fn tared_hand() -> Bench {
    let mut bench = untared_hand();
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    bench
}

const GRASP: Request = Request::Arm { task: Task::Grasp };
pub(super) const KEEP: Request = Request::SetPoint(SetPoint::Keep);

/// What is 2 mm in front of the tips of [`untared_hand`].
fn in_front() -> GraspPlan {
    let contact = |x: f32, y: f32, normal: f32| PlannedContact {
        position: [x, y, 0.093_219_9],
        normal: [normal, 0.0, 0.0],
    };
    // 8 mm of the tips and 2 mm from them.
    let near = 0.071_946_6 + 0.01;
    GraspPlan {
        contacts: [contact(near, 0.0, 1.0), contact(near, 0.1, 1.0), contact(0.3 - near, 0.05, -1.0)],
        clearance: 0.002,
        touch_force: 0.1,
        friction: Some(0.5),
        internal: InternalForce::Least { margin: 0.2, least: 0.3, moving: 1.0 },
        force_limit: 4.0,
        feedback: true,
        control: ObjectControl::Differential(ServoMode::Pid),
    }
}

fn seen(bench: &mut Bench) -> GraspTelemetry {
    let Reply::Grasp(grasp) = bench.ask(Request::ReadGrasp) else { panic!() };
    assert_eq!(grasp, bench.node.grasp());
    grasp
}

#[test]
fn arming_for_a_grasp_needs_a_hand_with_tared_sensors() {
    assert_eq!(refusal(Bench::ready(&model()).ask(GRASP)), Refusal::NotAHand);
    assert_eq!(refusal(feeling_fingers([[0; 6]; 2]).ask(GRASP)), Refusal::NotAHand);
    let mut bench = untared_hand();
    let mut numb = hand();
    numb.chains[1].force_sensor = None;
    assert_eq!(bench.push(&numb), Reply::Done);
    bench.sensors.forces.truncate(2);
    bench.tick();
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    assert_eq!(refusal(bench.ask(GRASP)), Refusal::NotAHand);

    let mut bench = untared_hand();
    assert_eq!(refusal(bench.ask(GRASP)), Refusal::NotTared { chain: 0 });
    assert_eq!(bench.node.mode(), Mode::Disarmed);
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    assert_eq!(bench.ask(GRASP), Reply::Done);
    assert_eq!(bench.node.mode(), Mode::Armed(Task::Grasp));
    assert_eq!(refusal(bench.ask(GRASP)), Refusal::WrongMode(Mode::Armed(Task::Grasp)));
    assert_eq!(bench.node.mode().to_string(), "armed (grasp)");
    // Another model may have other sensors.
    bench.ask(Request::Disarm);
    assert_eq!(bench.push(&hand()), Reply::Done);
    bench.tick();
    assert_eq!(refusal(bench.ask(GRASP)), Refusal::NotTared { chain: 0 });
}

#[test]
fn keep_keeps_an_armed_node_alive_whatever_its_task() {
    let servo = |mode| Request::Arm { task: Task::JointServo(mode) };
    for arm in [servo(ServoMode::Pid), servo(ServoMode::Observer), GRASP] {
        let mut bench = tared_hand();
        assert_eq!(refusal(bench.ask(KEEP)), Refusal::WrongMode(Mode::Disarmed));
        assert_eq!(bench.ask(arm), Reply::Done);
        let before = references(&bench);
        let tick = |bench: &mut Bench| {
            // Noise keeps the force sensors alive.
            bench.sensors.forces.iter_mut().for_each(|counts| counts[3] = 1 - counts[3]);
            bench.tick();
            matches!(bench.node.mode(), Mode::Armed(_))
        };
        for _ in 0..100 {
            assert!(tick(&mut bench));
            assert_eq!(bench.ask(KEEP), Reply::Done);
        }
        assert_eq!(references(&bench), before);
        (0..10).for_each(|_| assert!(tick(&mut bench)));
        assert!(!tick(&mut bench));
        assert_eq!(bench.node.faults().faults.last().unwrap().cause, FaultCause::CommandTimeout);
        assert_eq!(refusal(bench.ask(KEEP)), Refusal::WrongMode(Mode::Fault));
    }
}

#[test]
fn the_joints_of_a_hand_that_grasps_are_led_by_nobody_else() {
    let mut bench = tared_hand();
    let command = || Request::Grasp(GraspCommand::Grasp(in_front()));
    assert_eq!(refusal(bench.ask(command())), Refusal::WrongMode(Mode::Disarmed));
    assert_eq!(bench.arm(), Reply::Done);
    let mode = bench.node.mode();
    for command in [command(), Request::Grasp(GraspCommand::Open)] {
        assert_eq!(refusal(bench.ask(command)), Refusal::WrongMode(mode));
    }
    bench.ask(Request::Disarm);
    assert_eq!(bench.ask(GRASP), Reply::Done);
    bench.tick();
    let before = bench.node.telemetry();
    let points: Vec<JointPoint, MAX_JOINTS> = before
        .joints
        .iter()
        .map(|joint| JointPoint { position: joint.position, ..JointPoint::default() })
        .collect();
    let tips = [TipPoint::default(); 3].into_iter().collect();
    for set_point in [
        SetPoint::Goal { positions: points.iter().map(|point| point.position).collect() },
        SetPoint::Stream { points: points.clone() },
        SetPoint::Reach { tips },
        SetPoint::Guide { torques: [0.0; 9].into_iter().collect(), points },
    ] {
        let refused = refusal(bench.ask(Request::SetPoint(set_point)));
        assert_eq!(refused, Refusal::WrongMode(Mode::Armed(Task::Grasp)));
    }
    assert_eq!(bench.node.telemetry(), before);
}

#[test]
fn a_grasp_begins_and_ends_as_the_fingers_feel() {
    let mut bench = tared_hand();
    assert_eq!(bench.ask(GRASP), Reply::Done);
    assert_eq!(seen(&mut bench).phase, Phase::Ready);
    for command in [
        GraspCommand::PutDown,
        GraspCommand::Open,
        GraspCommand::Move { translation: [0.0; 3], rotation: [0.0; 3], duration: 1.0 },
    ] {
        let busy = Refusal::Unable(Unable::Busy(Phase::Ready));
        assert_eq!(refusal(bench.ask(Request::Grasp(command))), busy);
    }
    let grasp = |plan| Request::Grasp(GraspCommand::Grasp(plan));
    let deep = GraspPlan { clearance: 0.5, ..in_front() };
    let Refusal::Unable(Unable::Plan(bad)) = refusal(bench.ask(grasp(deep))) else { panic!() };
    assert_eq!(bad, BadPlan::Value { field: PlanField::Clearance, value: 0.5, lower: 0.001, upper: 0.05 });
    let mut far = in_front();
    far.contacts[2].position[0] = 0.15;
    let Refusal::Unable(Unable::OutOfReach { finger: 2, .. }) = refusal(bench.ask(grasp(far))) else {
        panic!()
    };
    assert_eq!(seen(&mut bench).phase, Phase::Ready);

    // It begins, and is a sign of life: with the tick before, eleven of them without another.
    bench.tick();
    assert_eq!(bench.ask(grasp(in_front())), Reply::Done);
    assert_eq!(seen(&mut bench).phase, Phase::Approach);
    let busy = Refusal::Unable(Unable::Busy(Phase::Approach));
    assert_eq!(refusal(bench.ask(grasp(in_front()))), busy);
    for _ in 0..10 {
        bench.tick();
        assert_eq!(bench.node.mode(), Mode::Armed(Task::Grasp));
    }
    assert_eq!(bench.ask(KEEP), Reply::Done);
    // Half a newton on the way is more than three times the touch force.
    bench.sensors.forces[2][1] += 500;
    bench.tick();
    let after = seen(&mut bench);
    let Some(Failure::Obstructed { finger: 2, force }) = after.failure else { panic!("{after:?}") };
    assert!((force - 0.5).abs() < 1e-3 && after.phase == Phase::Ready, "{after:?}");
    assert_eq!(bench.node.mode(), Mode::Armed(Task::Grasp), "that does no harm");
    let open = Request::Grasp(GraspCommand::Open);
    assert_eq!(refusal(bench.ask(open.clone())), Refusal::Unable(Unable::Busy(Phase::Ready)));
    assert_eq!(seen(&mut bench).failure, after.failure);
    assert_eq!(bench.ask(grasp(in_front())), Reply::Done);
    assert_eq!(seen(&mut bench).failure, None);

    // On its way, it can be told to go back.
    bench.sensors.forces[2][1] -= 500;
    bench.tick();
    assert_eq!(bench.ask(open), Reply::Done);
    assert_eq!(seen(&mut bench).phase, Phase::Open);
    bench.tick();
    assert_eq!(seen(&mut bench).phase, Phase::Open);
}

fn guide(positions: [f32; 3], torques: &[f32]) -> Request {
    let points = positions.map(|position| JointPoint { position, ..JointPoint::default() });
    Request::SetPoint(SetPoint::Guide {
        points: points.into_iter().collect(),
        torques: torques.iter().copied().collect(),
    })
}

#[test]
fn a_guided_torque_is_added_and_stays_in_the_reaction_until_the_node_is_disarmed() {
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        // One of two nodes gets torques; the joints of both stand still.
        let mut benches = [(); 2].map(|()| {
            let mut bench = Bench::ready(&model());
            assert_eq!(bench.ask(Request::Arm { task: Task::JointServo(mode) }), Reply::Done);
            bench.tick();
            bench
        });
        let added = |benches: &mut [Bench; 2]| {
            let [pressed, free] = benches.each_mut().map(|bench| bench.tick().torques);
            [0, 1, 2].map(|joint| pressed[joint] - free[joint])
        };
        assert_eq!(benches[0].ask(guide([0.0; 3], &[0.0, 0.25, -0.125])), Reply::Done);
        assert_eq!(benches[1].ask(guide([0.0; 3], &[0.0; 3])), Reply::Done);
        for _ in 0..10 {
            let added = added(&mut benches);
            assert!(near(added, [0.0, 0.25, -0.125], 1e-4), "{mode:?} {added:?}");
        }
        // Nobody commands any more.
        for _ in 0..50 {
            let added = added(&mut benches);
            assert!(near(added, [0.0, 0.25, -0.125], 1e-3), "{mode:?} {added:?}");
        }
        assert_eq!(benches[0].node.faults().faults.last().unwrap().cause, FaultCause::CommandTimeout);
        for bench in &mut benches {
            bench.ask(Request::Disarm);
            assert_eq!(bench.tick().torques, [0.0; 3]);
            let Reply::Faults(log) = bench.ask(Request::ReadFaults) else { panic!() };
            assert_eq!(bench.ask(Request::ClearFaults { total: log.total }), Reply::Done);
            assert_eq!(bench.ask(Request::Arm { task: Task::JointServo(mode) }), Reply::Done);
        }
        assert!(near(added(&mut benches), [0.0; 3], 1e-6));
        // A set-point of another kind takes it off.
        assert_eq!(benches[0].ask(guide([0.0; 3], &[0.125; 3])), Reply::Done);
        assert!(near(added(&mut benches), [0.125; 3], 1e-4));
        let rest = [JointPoint::default(); 3].into_iter().collect();
        assert_eq!(benches[0].ask(Request::SetPoint(SetPoint::Stream { points: rest })), Reply::Done);
        assert!(near(added(&mut benches), [0.0; 3], 1e-4));
    }
}

#[test]
fn a_guide_that_is_refused_changes_neither_points_nor_torques() {
    let mut bench = Bench::armed(&model());
    assert_eq!(bench.ask(guide([0.0; 3], &[0.125; 3])), Reply::Done);
    bench.tick();
    let too_much = Refusal::TooMuchTorque { joint: 1, value: -0.7, limit: 0.6 };
    let before = format!("{:?}", bench.node.state.joints);
    assert_eq!(refusal(bench.ask(guide([0.01; 3], &[0.0, -0.7, 0.0]))), too_much);
    assert_eq!(refusal(bench.ask(guide([0.01; 3], &[0.0, 0.0, f32::NAN]))), Refusal::NotFinite { joint: 2 });
    let jump = Refusal::Jump { joint: 0, value: 0.5, limit: 0.2 };
    assert_eq!(refusal(bench.ask(guide([0.5; 3], &[0.0; 3]))), jump);
    let count = Refusal::JointCount { got: 2, expected: 3 };
    assert_eq!(refusal(bench.ask(guide([0.01; 3], &[0.0; 2]))), count);
    let points = [JointPoint::default(); 2].into_iter().collect();
    let torques = [0.0; 3].into_iter().collect();
    assert_eq!(refusal(bench.ask(Request::SetPoint(SetPoint::Guide { points, torques }))), count);
    assert_eq!(format!("{:?}", bench.node.state.joints), before);
    assert_eq!(bench.ask(guide([0.01; 3], &[0.6, -0.6, 0.0])), Reply::Done, "the limits themselves");
}

#[test]
fn a_joint_that_presses_on_an_object_is_not_taken_for_stuck() {
    for (torque, stuck) in [(0.0, true), (0.01, false)] {
        let mut bench = Bench::armed(&model());
        for _ in 0..100 {
            bench.tick();
            bench.ask(guide([0.0, 0.0, 0.19], &[0.0, 0.0, torque]));
        }
        let cause = bench.node.faults().faults.last().map(|fault| fault.cause);
        assert_eq!(cause, stuck.then_some(FaultCause::EncoderStuck));
    }
}

#[test]
fn what_is_refused_to_a_hand_says_why() {
    let texts = [
        (
            Refusal::NotAHand,
            "the robot is not a hand of three fingers, each with three joints and a force sensor",
        ),
        (
            Refusal::NotTared { chain: 1 },
            "the force sensor of chain 1 was not tared since the model was pushed: tare it while nothing touches the tips",
        ),
        (Refusal::Unable(Unable::Busy(Phase::Move)), "not possible while the hand moves an object"),
        (Refusal::Unable(Unable::Plan(BadPlan::NoTriangle)), "the contacts are at the same place or in line"),
        (
            Refusal::TooMuchTorque { joint: 2, value: -0.75, limit: 0.5 },
            "joint 2: -0.75 N·m is beyond its limit of 0.5 N·m",
        ),
    ];
    for (refusal, text) in texts {
        assert_eq!(refusal.to_string(), text);
    }
    assert_eq!(Refusal::TooMuchTorque { joint: 2, value: 1.0, limit: 0.5 }.joint(), Some(2));
    assert_eq!(Refusal::NotTared { chain: 1 }.chain(), Some(1));
    let fault = |cause, joint, value, limit| {
        Fault { cause, joint, value, limit, tick: 12 }.named(&hand()).to_string()
    };
    assert_eq!(
        fault(FaultCause::ObjectLost, Some(5), 0.01, 0.015),
        "fault 21 in tick 12: f: its finger no longer touches the object in the hand (value 0.01 N, limit 0.015 N)"
    );
    assert_eq!(
        fault(FaultCause::ObjectMoved, None, 0.016, 0.015),
        "fault 22 in tick 12: the object in the hand was moved, or slid between the fingers (value 0.016 m, limit \
         0.015 m)"
    );
}

#[test]
fn a_recording_that_starts_while_the_joints_move_repeats_bit_for_bit() {
    let mut bench = Bench::armed(&model());
    bench.goal([0.01, 0.2, -0.1]);
    let step = |bench: &mut Bench, index: i32| {
        bench.sensors.encoders[1] = index * 7 % 50;
        bench.tick()
    };
    (0..8).for_each(|index| drop(step(&mut bench, index)));
    let (state, index) = bench.export(Item::State);
    // Reading the pieces were requests, too: the copy is of before them.
    let mut records = std::vec![];
    for (offset, data) in (0..).step_by(EXPORT_CHUNK).zip(state.chunks(EXPORT_CHUNK)) {
        records.push(LogRecord::State { offset, data: Vec::from_slice(data).unwrap() });
    }
    records.push(LogRecord::Restore { length: state.len() as u32, checksum: codec::checksum(&state) });
    for at in (0..state.len() as u32).step_by(EXPORT_CHUNK) {
        let sequence =
            bench.sequence - state.len().div_ceil(EXPORT_CHUNK) as u16 + 1 + at as u16 / EXPORT_CHUNK as u16;
        let request = RequestFrame { client: 7, sequence, request: Request::ReadExport { offset: at } };
        records.push(LogRecord::Request(request));
    }
    for index in 8..60 {
        let actuators = step(&mut bench, index);
        records.push(LogRecord::Sensors(bench.sensors.clone()));
        records.push(LogRecord::Actuators(actuators));
    }
    assert_eq!(bench.node.mode(), Mode::Fault, "nobody commanded for 0.5 s");
    assert_eq!(bench.node.records() - index, records.iter().filter(|record| counted(record)).count() as u32);

    let replay = |records: &[LogRecord]| {
        let mut node = Node::new();
        let mut robot = Bench::ready(&model());
        core::mem::swap(&mut node, &mut robot.node);
        let mut replay = super::Replay::new(&mut node);
        let mut compared = 0;
        for record in records {
            compared += u32::from(replay.feed(record)?);
        }
        Ok::<u32, super::ReplayError>(compared)
    };
    assert_eq!(replay(&records), Ok(52));
    let LogRecord::Actuators(last) = records.last_mut().unwrap() else { panic!() };
    last.torques[1] = f32::from_bits(last.torques[1].to_bits() ^ 1);
    let Err(super::ReplayError::Different { tick, difference }) = replay(&records) else { panic!() };
    assert_eq!(tick, bench.sensors.sequence);
    assert!(matches!(difference, super::Difference::Torque { joint: 1, .. }), "{difference:?}");
    // Without the state the same frames give other torques: the test above could have failed.
    let middle: std::vec::Vec<LogRecord> = records.iter().filter(|record| counted(record)).cloned().collect();
    assert!(matches!(replay(&middle), Err(super::ReplayError::Different { .. })));
    // What follows a gap is not compared until the state is known again.
    let mut gap = std::vec![LogRecord::Gap { missing: 3 }];
    gap.extend(middle);
    assert_eq!(replay(&gap), Ok(0));
    // A new start knows no model.
    let start = LogRecord::Start(LogStart { schema: SCHEMA_KEY, ..LogStart::default() });
    let reset = [std::vec![start], gap.split_off(1)].concat();
    let Err(super::ReplayError::Different { difference, .. }) = replay(&reset) else { panic!() };
    assert_eq!(difference, super::Difference::Enabled { computed: false });
}

fn counted(record: &LogRecord) -> bool {
    matches!(record, LogRecord::Request(_) | LogRecord::Sensors(_) | LogRecord::Actuators(_))
}

fn any_request() -> impl Strategy<Value = Request> {
    let value = prop_oneof![
        4 => -1.5_f32..1.5, 1 => Just(f32::NAN), 1 => Just(f32::INFINITY), 1 => any::<f32>(), 3 => Just(0.0)
    ];
    let list = proptest::collection::vec(value.clone(), 0..5);
    let points = proptest::collection::vec((value.clone(), value.clone(), value), 3);
    let torques = proptest::collection::vec(prop_oneof![4 => -0.7_f32..0.7, 1 => any::<f32>()], 3);
    prop_oneof![
        Just(KEEP),
        Just(Request::ReadGrasp),
        Just(Request::Grasp(GraspCommand::Grasp(in_front()))),
        torques.prop_map(|torques| guide([0.0; 3], &torques)),
        Just(Request::Hello { schema: SCHEMA_KEY }),
        Just(Request::Disarm),
        Just(Request::Stop),
        Just(Request::ReadFaults),
        (0_u32..4).prop_map(|total| Request::ClearFaults { total }),
        any::<u16>().prop_map(|every| Request::SetRate { stream: Stream::Log, every }),
        any::<bool>().prop_map(|by_force| Request::TakeCommand { by_force }),
        Just(Request::ReleaseCommand),
        Just(Request::ModelCommit),
        Just(Request::Export(Item::State)),
        any::<u32>().prop_map(|offset| Request::ReadExport { offset }),
        (any::<u32>(), any::<u32>()).prop_map(|(length, checksum)| Request::ModelBegin { length, checksum }),
        Just(Request::Arm { task: Task::JointServo(ServoMode::Pid) }),
        Just(Request::Arm { task: Task::JointServo(ServoMode::Observer) }),
        list.clone().prop_map(|list| Request::Home { positions: Vec::from_slice(&list).unwrap() }),
        list.prop_map(|list| Request::SetPoint(SetPoint::Goal {
            positions: Vec::from_slice(&list).unwrap()
        })),
        points.prop_map(|points| {
            let points = points.iter().map(|&(position, velocity, acceleration)| JointPoint {
                position,
                velocity,
                acceleration,
            });
            Request::SetPoint(SetPoint::Stream { points: points.collect() })
        }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Whatever is asked and whatever the sensors read: no panic, and every torque finite and within its limits.
    #[test]
    fn torques_stay_within_limits_whatever_comes(
        steps in proptest::collection::vec(
            (proptest::option::of(any_request()), -40_000_i32..40_000, any::<bool>(), any::<i16>(), 0_u8..30),
            1..120,
        )
    ) {
        let mut bench = Bench::armed(&model());
        let mut last = [0.0_f32; MAX_JOINTS];
        for (request, count, wild, current, special) in steps {
            if let Some(request) = request {
                bench.ask(request);
            }
            bench.sensors.encoders[1] = if wild { count } else { count / 1000 };
            bench.sensors.currents[0] = if special == 0 { current } else { 0 };
            bench.sensors.flags = SensorFlags(u8::from(special == 1));
            bench.sensors.sequence += u32::from(special == 2);
            let output = bench.tick();
            for (index, &torque) in output.torques.iter().enumerate() {
                prop_assert!(torque.is_finite() && torque.abs() <= 0.6);
                // Torque rate: 200 N·m/s, or off at once.
                prop_assert!(torque == 0.0 || (torque - last[index]).abs() <= 2.0 + 1e-5);
                prop_assert!(output.enabled || torque == 0.0);
                last[index] = torque;
            }
        }
    }
}
