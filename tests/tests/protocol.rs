//! The bytes on the wire: every message against the frames that `oracles/protocol.py` wrote, and the examples of
//! `docs/protocol.md` against the same frames.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::arm::{
    ArmError, ArmSettings, ArmTelemetry, BadSettings, ElbowPoint, ForceSource, Law, PosePoint, Redundancy,
};
use tesaki::control::{Impedance, ImpedanceTerm, InvalidImpedance, JointPoint, ServoMode};
use tesaki::kinematics::TipPoint;
use tesaki::manipulation::{
    BadPlan, Failure, GraspCommand, GraspPlan, GraspTelemetry, InternalForce, ObjectControl, Phase,
    PlanField, PlannedContact, Unable, WrenchGains,
};
use tesaki::model::{
    ChainModel, Encoder, Field, Friction, Inertial, JointLimits, JointModel, ModelError, Motor,
    ObserverGains, PidGains, Pose, Problem, Reaction, RobotModel, Safety, ServoGains,
};
use tesaki::node::Node;
use tesaki::protocol::codec::{Decoder, FrameCounts, FrameError, MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    ActuatorFrame, BoardStatus, ClockSource, Fault, FaultCause, FaultLog, FromBoard, Identity, Item,
    JointTelemetry, LinkStatistics, LogEntry, LogRecord, LogStart, Mode, NodeStatus, Refusal, Reply,
    ReplyFrame, Request, RequestFrame, ResetCause, SCHEMA_KEY, SensorFlags, SensorFrame, SetPoint, Status,
    Stream, Task, Telemetry, TipTelemetry, Tips,
};

const GOLDEN: &str = include_str!("../oracles/data/protocol_frames.in");
const PAGE: &str = include_str!("../../docs/protocol.md");

const SCHEMA: u64 = 0x0123_4567_89ab_cdef;
const CLIENT: u32 = 0x00c0_ffee;
const IDENTITY: Identity = Identity {
    firmware: [0, 1, 0],
    image: [0x1f, 0x2e, 0x3d, 0x4c, 0x5b, 0x6a, 0x79, 0x88],
    board: [0x30, 0, 0x21, 0, 0x0d, 0x51, 0x36, 0x30, 0x34, 0x33, 0x38, 0x32],
    capabilities: 29,
};
const PID: Task = Task::JointServo(ServoMode::Pid);
const OBSERVER: Task = Task::JointServo(ServoMode::Observer);

/// A line of [`GOLDEN`], or of an example.
fn parse(line: &str) -> (&str, Vec<u8>) {
    let (name, hex) = line.split_once(": ").unwrap_or_else(|| panic!("{line:?} is not `name: hex`"));
    (name, hex.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect())
}

fn golden() -> Vec<(&'static str, Vec<u8>)> {
    GOLDEN.lines().map(parse).collect()
}

fn encoded<T: Serialize>(message: &T) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(message, &mut frame).unwrap();
    frame[..length].to_vec()
}

fn decoded<T: DeserializeOwned>(bytes: &[u8]) -> Vec<Result<T, FrameError>> {
    let mut decoder = Decoder::new();
    bytes.iter().filter_map(|&byte| decoder.push(byte)).collect()
}

/// Whatever is on a wire, by the beginning of its golden name.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "tests")]
enum Message {
    /// `request-`
    Request(RequestFrame),
    /// `board-`
    Board(FromBoard),
    /// `sensors`
    Sensors(SensorFrame),
    /// `actuators`
    Actuators(ActuatorFrame),
    /// `record-`
    Record(LogRecord),
    /// `model-`: not a frame, but the bytes that a push carries.
    Model(RobotModel),
}

impl Message {
    fn encode(&self) -> Vec<u8> {
        match self {
            Self::Request(message) => encoded(message),
            Self::Board(message) => encoded(message),
            Self::Sensors(message) => encoded(message),
            Self::Actuators(message) => encoded(message),
            Self::Record(message) => encoded(message),
            Self::Model(model) => postcard::to_stdvec(model).unwrap(),
        }
    }

    /// Decodes `bytes` as messages of the kind that `self` is.
    fn decode(&self, bytes: &[u8]) -> Vec<Result<Self, FrameError>> {
        fn all<T: DeserializeOwned>(
            bytes: &[u8],
            wrap: fn(T) -> Message,
        ) -> Vec<Result<Message, FrameError>> {
            decoded::<T>(bytes).into_iter().map(|result| result.map(wrap)).collect()
        }
        match self {
            Self::Request(_) => all(bytes, Self::Request),
            Self::Board(_) => all(bytes, Self::Board),
            Self::Sensors(_) => all(bytes, Self::Sensors),
            Self::Actuators(_) => all(bytes, Self::Actuators),
            Self::Record(_) => all(bytes, Self::Record),
            Self::Model(_) => match postcard::take_from_bytes(bytes) {
                Ok((model, [])) => vec![Ok(Self::Model(model))],
                _ => vec![Err(FrameError::Malformed)],
            },
        }
    }
}

/// An enumeration that is sent. The list must be complete, or the match does not compile, and in the order of the
/// numbers.
trait Variants: Serialize {
    const VARIANTS: &'static [&'static str];
    fn variant(&self) -> &'static str;
}

macro_rules! variants {
    ($($kind:ident { $($variant:ident),* $(,)? })*) => {
        $(impl Variants for $kind {
            const VARIANTS: &'static [&'static str] = &[$(concat!(stringify!($kind), "::", stringify!($variant))),*];
            fn variant(&self) -> &'static str {
                match self {
                    $(Self::$variant { .. } => concat!(stringify!($kind), "::", stringify!($variant)),)*
                }
            }
        })*
        fn every_variant() -> BTreeSet<&'static str> {
            [$($kind::VARIANTS),*].concat().into_iter().collect()
        }
    };
}

variants! {
    Request {
        Hello, ModelBegin, ModelChunk, ModelCommit, Home, Arm, Disarm, SetPoint, Stop, ReadStatus, ReadFaults,
        ClearFaults, SetRate, TakeCommand, ReleaseCommand, Export, ReadExport, Tare, Grasp, ReadGrasp,
        Impedance, ReadArm,
    }
    Stream { Telemetry, Status, Log, Tips, Grasp, Arm }
    Item { Model, State }
    Task { JointServo, Grasp, Impedance }
    ServoMode { Pid, Observer }
    SetPoint { Goal, Stream, Reach, Keep, Guide, Pose }
    Law { Printed, Following }
    Redundancy { None, Driven, ArmAngle }
    BadSettings { Impedance, Joint, NoArmAngle, ElbowBandwidth, ContactForce, Reach, ForceBandwidth, NoFreeJoint }
    ImpedanceTerm { Mass, Damping, Stiffness }
    ArmError { Distance, Turn, NotFinite, NotAUnit, NoSettings, Elbow }
    GraspCommand { Grasp, Move, PutDown, Open }
    InternalForce { Least, Normal, Pairwise }
    ObjectControl { Differential, Wrench }
    Phase { Ready, Approach, Touch, Squeeze, Feel, Hold, Move, Lower, Open }
    Failure { Obstructed, NothingThere, GripError, NothingBelow, OutOfReach }
    Unable { Busy, Plan, OutOfReach, NotFinite, TooFast }
    BadPlan { Value, Contact, NoTriangle, CannotGrip, Unbalanced }
    PlanField { Clearance, TouchForce, Friction, ForceLimit, Margin, Least, Strength, Gain }
    FromBoard { Reply, Telemetry, Status, Log, Tips, Grasp, Arm }
    Reply { Hello, Done, Refused, Status, Faults, Exported, Chunk, Grasp, Arm }
    Refusal {
        SchemaMismatch, NoModel, Model, ModelTransfer, ModelChecksum, ModelUnreadable, WrongMode, NotHomed,
        FaultsUnread, JointCount, NotFinite, OutsideLimits, TooFast, Jump, NoSensors, Unsafe, Commanded,
        NotCommander, Stale, NotExported, TipCount, FingerShapeError, OutOfReach, Singular, TooMuchAcceleration, TipNotFinite, NoForceSensor,
        NotAHand, NotTared, Unable, TooMuchTorque, NotAnArm, Settings, Arm,
    }
    Field {
        Joints, Chains, Gravity, Name, OriginTranslation, OriginRotation, Axis, Mass, CenterOfMass, Inertia,
        RotorInertia, TorqueConstant, CurrentLimit, CurrentResolution, MotorBandwidth, MotorDelay, Coulomb,
        Viscous, CountsPerTurn, LimitLower, LimitUpper, LimitVelocity, LimitTorque, LimitTorqueRate,
        LimitFollowingError, FilterTime, Proportional, Integral, Derivative, Cutoff, ServoInertia, Bandwidth,
        ObserverBandwidth, CommandTimeout, Damping, SupplyMin, SupplyMax, RestError,
        ChainName, TipTranslation, TipRotation, ForceResolution, TorqueResolution, Saturation, ForceLimit,
        TipMass, TipCenterOfMass, TipRadius,
    }
    Problem { NotFinite, Below, NotAbove, Above, NotUnit, NotPhysical, Count, NotUnique }
    Mode { Disarmed, Armed, Fault }
    FaultCause {
        CommandTimeout, PositionLimit, VelocityLimit, FollowingError, EncoderJump, EncoderStuck, NotFinite,
        LateTick, SensorCount, EmergencyStop, SupplyLow, SupplyHigh, OverCurrent, WatchdogReset, Panic,
        HardFault, ClockFallback, Stop, ForceSaturated, ForceStuck, ForceLimit,
        ObjectLost, ObjectMoved, ToolAway, ToolTurned,
    }
    ClockSource { Crystal, InternalPll, Internal }
    ResetCause { PowerOn, Watchdog, Panic, HardFault, Software }
    LogRecord { Request, Sensors, Actuators, Start, State, Restore, Gap }
    Reaction { Off, Damp, Hold }
}

/// Which variants there are among the messages.
#[derive(Default)]
struct Seen(BTreeSet<&'static str>);

impl Seen {
    /// Takes note of a value, and checks that its number on the wire is its place in the list.
    fn variant<T: Variants>(&mut self, value: &T) {
        let name = value.variant();
        let place = T::VARIANTS.iter().position(|&other| other == name).unwrap();
        assert_eq!(usize::from(postcard::to_stdvec(value).unwrap()[0]), place, "{name}");
        self.0.insert(name);
    }

    fn task(&mut self, task: Task) {
        self.variant(&task);
        if let Task::JointServo(mode) = task {
            self.variant(&mode);
        }
    }

    fn mode(&mut self, mode: Mode) {
        self.variant(&mode);
        if let Mode::Armed(task) = mode {
            self.task(task);
        }
    }

    fn request(&mut self, frame: &RequestFrame) {
        self.variant(&frame.request);
        match &frame.request {
            Request::Arm { task } => self.task(*task),
            Request::SetPoint(set_point) => self.variant(set_point),
            Request::SetRate { stream, .. } => self.variant(stream),
            Request::Export(item) => self.variant(item),
            Request::Grasp(command) => {
                self.variant(command);
                if let GraspCommand::Grasp(plan) = command {
                    self.variant(&plan.internal);
                    self.variant(&plan.control);
                }
            }
            Request::Impedance(settings) => {
                self.variant(&settings.law);
                self.variant(&settings.redundancy);
            }
            _ => {}
        }
    }

    fn unable(&mut self, unable: &Unable) {
        self.variant(unable);
        match unable {
            Unable::Busy(phase) => self.variant(phase),
            Unable::Plan(plan) => {
                self.variant(plan);
                if let BadPlan::Value { field, .. } = plan {
                    self.variant(field);
                }
            }
            _ => {}
        }
    }

    fn grasp(&mut self, grasp: &GraspTelemetry) {
        self.variant(&grasp.phase);
        if let Some(failure) = &grasp.failure {
            self.variant(failure);
        }
    }

    fn refusal(&mut self, refusal: &Refusal) {
        self.variant(refusal);
        match refusal {
            Refusal::Model(error) => {
                self.variant(&error.field);
                self.variant(&error.problem);
            }
            Refusal::WrongMode(mode) => self.mode(*mode),
            Refusal::Unsafe(fault) => self.variant(&fault.cause),
            Refusal::Unable(unable) => self.unable(unable),
            Refusal::Settings(bad) => {
                self.variant(bad);
                if let BadSettings::Impedance(InvalidImpedance { term, .. }) = bad {
                    self.variant(term);
                }
            }
            Refusal::Arm(error) => self.variant(error),
            _ => {}
        }
    }

    fn status(&mut self, status: &Status) {
        self.mode(status.node.mode);
        self.variant(&status.board.clock);
        self.variant(&status.board.reset);
    }

    fn record(&mut self, record: &LogRecord) {
        self.variant(record);
        if let LogRecord::Request(frame) = record {
            self.request(frame);
        }
    }

    fn board(&mut self, message: &FromBoard) {
        self.variant(message);
        match message {
            FromBoard::Reply(ReplyFrame { reply, .. }) => {
                self.variant(reply);
                match reply {
                    Reply::Refused(refusal) => self.refusal(refusal),
                    Reply::Status(status) => self.status(status),
                    Reply::Faults(log) => log.faults.iter().for_each(|fault| self.variant(&fault.cause)),
                    Reply::Grasp(grasp) => self.grasp(grasp),
                    _ => {}
                }
            }
            FromBoard::Telemetry(telemetry) => self.mode(telemetry.mode),
            FromBoard::Status(status) => self.status(status),
            FromBoard::Log(entry) => self.record(&entry.record),
            FromBoard::Tips(_) | FromBoard::Arm(_) => {}
            FromBoard::Grasp(grasp) => self.grasp(grasp),
        }
    }

    fn message(&mut self, message: &Message) {
        match message {
            Message::Request(frame) => self.request(frame),
            Message::Board(message) => self.board(message),
            Message::Record(record) => self.record(record),
            Message::Model(model) => self.variant(&model.safety.reaction),
            Message::Sensors(_) | Message::Actuators(_) => {}
        }
    }
}

/// Collects into the lists of messages, which have a capacity.
fn list<T, L: FromIterator<T>>(items: impl IntoIterator<Item = T>) -> L {
    items.into_iter().collect()
}

fn finger(reaction: Reaction) -> RobotModel {
    let knuckle = JointModel {
        name: "knuckle".try_into().unwrap(),
        origin: Pose { translation: [0.0, 0.0, 0.1], rotation: [0.0, 0.0, 0.0, 1.0] },
        axis: [0.0, 0.0, 1.0],
        link: Inertial {
            mass: 0.02,
            center_of_mass: [0.02, 0.0, 0.0],
            inertia: [1e-6, 5e-6, 5e-6, 0.0, 0.0, 0.0],
        },
        motor: Motor {
            rotor_inertia: 2e-4,
            torque_constant: 0.5,
            current_limit: 1.5,
            current_resolution: 1e-3,
            bandwidth: 300.0,
            delay: 3e-4,
        },
        friction: Friction { coulomb: 0.02, viscous: 0.002 },
        encoder: Encoder { counts_per_turn: 65536.0, reversed: false, zero: -40, relative: true },
        limits: JointLimits {
            lower: -1.5,
            upper: 1.5,
            velocity: 8.0,
            torque: 0.6,
            torque_rate: 200.0,
            following_error: 0.25,
        },
        servo: ServoGains {
            filter_time: 0.2,
            pid: PidGains { proportional: 0.4, integral: 1.0, derivative: 0.01, cutoff: 30.0 },
            observer: ObserverGains { inertia: 2.1e-4, bandwidth: 50.0, observer_bandwidth: 100.0 },
            rest_error: 5e-4,
        },
    };
    let tip = ChainModel {
        name: "finger_tip".try_into().unwrap(),
        joints: 1,
        tip: Pose { translation: [0.0, 0.0, 0.05], rotation: [0.0, 0.0, 0.0, 1.0] },
        tip_radius: 0.0,
        force_sensor: None,
    };
    RobotModel {
        name: "finger".try_into().unwrap(),
        gravity: [0.0; 3],
        chains: list([tip]),
        joints: list([knuckle]),
        safety: Safety { command_timeout: 0.1, reaction, damping: 0.01, supply_min: 20.0, supply_max: 28.0 },
    }
}

const CONTACTS: [PlannedContact; 3] = [
    PlannedContact { position: [0.0625, 0.04, 0.125], normal: [1.0, 0.0, -0.5] },
    PlannedContact { position: [0.0625, -0.04, 0.125], normal: [1.0, 0.0, -0.5] },
    PlannedContact { position: [0.125, 0.0, 0.0625], normal: [-2.0, 0.0, 1.0] },
];

const BOX: GraspPlan = GraspPlan {
    contacts: CONTACTS,
    clearance: 0.01,
    touch_force: 0.1,
    friction: None,
    internal: InternalForce::Least { margin: 0.2, least: 0.3, moving: 1.0 },
    force_limit: 9.0,
    feedback: true,
    control: ObjectControl::Differential(ServoMode::Observer),
};

/// With the longest encoding.
const LONGEST: GraspPlan = GraspPlan {
    contacts: [PlannedContact { position: [f32::MIN; 3], normal: [f32::MIN; 3] }; 3],
    clearance: f32::MIN,
    touch_force: f32::MIN,
    friction: Some(f32::MIN),
    internal: InternalForce::Pairwise { strengths: [f32::MIN; 3] },
    force_limit: f32::MIN,
    feedback: true,
    control: ObjectControl::Wrench(WrenchGains {
        position: [f32::MIN; 2],
        orientation: [f32::MIN; 2],
        damping: f32::MIN,
        compensated: true,
    }),
};

const HOLDING: GraspTelemetry = GraspTelemetry {
    tick: 1234,
    phase: Phase::Hold,
    failure: None,
    position: [0.09, 0.0, 0.0625],
    orientation: [0.0, 0.375, 0.0, 0.927],
    load: [0.5, 0.0, 1.75, 0.0, -0.015_625, 0.0],
    wanted: [[1.0, 0.0, 0.5], [1.0, 0.0, 0.5], [-1.5, 0.0, 0.75]],
    friction: 0.4375,
    slips: 300,
    overloaded: false,
};

const NO_GRASP: GraspTelemetry = GraspTelemetry {
    tick: 1234,
    phase: Phase::Ready,
    failure: None,
    position: [0.0; 3],
    orientation: [0.0, 0.0, 0.0, 1.0],
    load: [0.0; 6],
    wanted: [[0.0; 3]; 3],
    friction: 0.0,
    slips: 0,
    overloaded: false,
};

const PHASES: [(Phase, &str); Phase::VARIANTS.len()] = [
    (Phase::Ready, "ready"),
    (Phase::Approach, "approach"),
    (Phase::Touch, "touch"),
    (Phase::Squeeze, "squeeze"),
    (Phase::Feel, "feel"),
    (Phase::Hold, "hold"),
    (Phase::Move, "move"),
    (Phase::Lower, "lower"),
    (Phase::Open, "open"),
];

const PLAN_FIELDS: [(PlanField, &str); PlanField::VARIANTS.len()] = [
    (PlanField::Clearance, "clearance"),
    (PlanField::TouchForce, "touch-force"),
    (PlanField::Friction, "friction"),
    (PlanField::ForceLimit, "force-limit"),
    (PlanField::Margin, "margin"),
    (PlanField::Least, "least"),
    (PlanField::Strength, "strength"),
    (PlanField::Gain, "gain"),
];

const FAILURES: [(Failure, &str); Failure::VARIANTS.len()] = [
    (Failure::Obstructed { finger: 2, force: 0.75 }, "obstructed"),
    (Failure::NothingThere { finger: 0, distance: 0.02 }, "nothing-there"),
    (Failure::GripError { force: 0.25, limit: 3.0 }, "no-grip"),
    (Failure::NothingBelow { distance: 0.05 }, "nothing-below"),
    (Failure::OutOfReach { finger: 1 }, "out-of-reach"),
];

const YIELDING: ArmSettings = ArmSettings {
    impedance: Impedance {
        mass: [1.5, 1.5, 1.5, 0.0625, 0.0625, 0.0625],
        damping: [7.5, 7.5, 7.5, 0.5, 0.5, 0.5],
        stiffness: [300.0, 300.0, 300.0, 8.0, 8.0, 8.0],
    },
    law: Law::Following,
    redundancy: Redundancy::ArmAngle,
    elbow_bandwidth: 12.0,
    force: ForceSource::Sensor,
    contact_force: 1.5,
    reach: [0.25, 1.5],
};

const PUSHED: ArmTelemetry = ArmTelemetry {
    tick: 1234,
    position: [0.5, 0.0, -0.25],
    rotation: [0.0, 0.0, 0.0, 1.0],
    error: [0.0625, 0.0, 0.0, 0.0, 0.0, -0.125],
    wrench: [18.75, 0.0, 0.0, 0.0, 0.0, -1.0],
    contact: true,
    weakest: 0.15625,
    elbow: 0.25,
};

const BAD_SETTINGS: [(BadSettings, &str); 10] = [
    (bad_impedance(ImpedanceTerm::Mass, 4, 0.0, 1e4), "impedance-mass"),
    (bad_impedance(ImpedanceTerm::Damping, 0, -1.0, 150.0), "impedance-damping"),
    (bad_impedance(ImpedanceTerm::Stiffness, 5, 4000.0, 3750.0), "impedance-stiffness"),
    (BadSettings::Joint { joint: 7, joints: 7 }, "joint"),
    (BadSettings::NoArmAngle, "no-arm-angle"),
    (BadSettings::ElbowBandwidth { value: 60.0, limit: 50.0 }, "elbow-bandwidth"),
    (BadSettings::ContactForce { value: -1.0 }, "contact-force"),
    (BadSettings::Reach { value: 0.0 }, "reach"),
    (BadSettings::ForceBandwidth { value: 60.0, limit: 50.0 }, "force-bandwidth"),
    (BadSettings::NoFreeJoint, "no-free-joint"),
];

const fn bad_impedance(term: ImpedanceTerm, axis: u8, value: f32, limit: f32) -> BadSettings {
    BadSettings::Impedance(InvalidImpedance { term, axis, value, limit })
}

const ARM_ERRORS: [(ArmError, &str); ArmError::VARIANTS.len()] = [
    (ArmError::Distance { value: 1.0, limit: 0.25 }, "distance"),
    (ArmError::Turn { value: 3.125, limit: 1.5 }, "turn"),
    (ArmError::NotFinite, "not-finite"),
    (ArmError::NotAUnit { norm: 0.5 }, "not-a-unit"),
    (ArmError::NoSettings, "no-settings"),
    (ArmError::Elbow { value: 2.0, limit: 1.5 }, "elbow"),
];

/// The messages of the golden file, by name.
#[derive(Default)]
struct Messages(BTreeMap<String, Message>);

impl Messages {
    fn add(&mut self, name: impl Into<String>, message: Message) {
        assert!(self.0.insert(name.into(), message).is_none());
    }

    fn request(&mut self, name: &str, request: Request) {
        self.request_by(name, CLIENT, 9, request);
    }

    fn request_by(&mut self, name: &str, client: u32, sequence: u16, request: Request) {
        self.add(format!("request-{name}"), Message::Request(RequestFrame { client, sequence, request }));
    }

    fn reply(&mut self, name: &str, reply: Reply) {
        self.reply_to(name, CLIENT, 9, 1234, reply);
    }

    fn reply_to(&mut self, name: &str, client: u32, sequence: u16, tick: u32, reply: Reply) {
        let reply = ReplyFrame { client, sequence, tick, reply };
        self.add(format!("board-{name}"), Message::Board(FromBoard::Reply(reply)));
    }

    fn requests(&mut self) {
        let point = |position, velocity, acceleration| JointPoint { position, velocity, acceleration };
        self.request("hello", Request::Hello { schema: SCHEMA });
        self.request("hello-0", Request::Hello { schema: 0 });
        self.request("model-begin", Request::ModelBegin { length: 4096, checksum: 0xdead_beef });
        let chunk = |offset, data: &[u8]| Request::ModelChunk { offset, data: list(data.iter().copied()) };
        self.request("model-chunk", chunk(192, &[0, 1, 254, 255]));
        self.request("model-chunk-long", chunk(3840, &[255; 192]));
        self.request("model-chunk-zeros", chunk(0, &[0; 192]));
        self.request("model-commit", Request::ModelCommit);
        self.request("home", Request::Home { positions: list([0.25, -1.5]) });
        self.request("home-none", Request::Home { positions: list([]) });
        self.request("arm-pid", Request::Arm { task: PID });
        self.request("arm-observer", Request::Arm { task: OBSERVER });
        self.request("arm-grasp", Request::Arm { task: Task::Grasp });
        self.request("arm-impedance", Request::Arm { task: Task::Impedance });
        self.request("disarm", Request::Disarm);
        let goal = SetPoint::Goal { positions: list([0.5, -0.25, 0.125]) };
        self.request("set-point-goal", Request::SetPoint(goal));
        let stream = SetPoint::Stream { points: list([point(0.5, -0.25, 2.0), point(0.0, 0.0, 0.0)]) };
        self.request("set-point-stream", Request::SetPoint(stream));
        let stream = SetPoint::Stream { points: list([point(f32::MIN, f32::MIN, f32::MIN); 16]) };
        self.request("set-point-stream-16", Request::SetPoint(stream));
        let moving = TipPoint {
            position: [0.1, -0.04, 0.0625],
            velocity: [0.5, -0.25, 0.125],
            acceleration: [2.0, -1.0, 0.0],
        };
        let reach = SetPoint::Reach { tips: list([moving, TipPoint::default()]) };
        self.request("set-point-reach", Request::SetPoint(reach));
        let [position, velocity, acceleration] = [[f32::MIN; 3]; 3];
        let reach = SetPoint::Reach { tips: list([TipPoint { position, velocity, acceleration }; 6]) };
        self.request("set-point-reach-6", Request::SetPoint(reach));
        self.request("set-point-keep", Request::SetPoint(SetPoint::Keep));
        let guide = SetPoint::Guide {
            points: list([point(0.5, -0.25, 2.0), point(0.0, 0.0, 0.0)]),
            torques: list([0.125, -0.0625]),
        };
        self.request("set-point-guide", Request::SetPoint(guide));
        let guide = SetPoint::Guide {
            points: list([point(f32::MIN, f32::MIN, f32::MIN); 16]),
            torques: list([f32::MIN; 16]),
        };
        self.request("set-point-guide-16", Request::SetPoint(guide));
        self.request("stop", Request::Stop);
        self.request("read-status", Request::ReadStatus);
        self.request("read-faults", Request::ReadFaults);
        self.request("clear-faults", Request::ClearFaults { total: 300 });
        self.request("set-rate-telemetry", Request::SetRate { stream: Stream::Telemetry, every: 1 });
        self.request("set-rate-status", Request::SetRate { stream: Stream::Status, every: 100 });
        self.request("set-rate-log", Request::SetRate { stream: Stream::Log, every: 65535 });
        self.request("set-rate-tips", Request::SetRate { stream: Stream::Tips, every: 2 });
        self.request("set-rate-grasp", Request::SetRate { stream: Stream::Grasp, every: 5 });
        self.request("set-rate-arm", Request::SetRate { stream: Stream::Arm, every: 5 });
        self.request("tare", Request::Tare);
        self.grasps();
        self.impedances();
        self.request("take-command", Request::TakeCommand { by_force: false });
        self.request("take-command-by-force", Request::TakeCommand { by_force: true });
        self.request("release-command", Request::ReleaseCommand);
        self.request("export-model", Request::Export(Item::Model));
        self.request("export-state", Request::Export(Item::State));
        self.request("read-export", Request::ReadExport { offset: 192 });
        self.request_by("first-number", 1, 0, Request::ReadStatus);
        self.request_by("last-number", u32::MAX, u16::MAX, Request::ReadStatus);
    }

    fn grasps(&mut self) {
        let mut grasp = |name: &str, command| self.request(name, Request::Grasp(command));
        grasp("grasp", GraspCommand::Grasp(BOX));
        let normal = GraspPlan {
            clearance: 0.005,
            touch_force: 0.125,
            friction: Some(0.5),
            internal: InternalForce::Normal { strength: 2.0 },
            force_limit: 4.0,
            feedback: false,
            control: ObjectControl::Differential(ServoMode::Pid),
            ..BOX
        };
        grasp("grasp-normal", GraspCommand::Grasp(normal));
        let gains = WrenchGains {
            position: [150.0, 300.0],
            orientation: [0.5, 1.0],
            damping: 0.03125,
            compensated: false,
        };
        let pairwise = GraspPlan {
            friction: Some(0.75),
            internal: InternalForce::Pairwise { strengths: [0.5, 1.0, 1.5] },
            control: ObjectControl::Wrench(gains),
            ..BOX
        };
        grasp("grasp-pairwise", GraspCommand::Grasp(pairwise));
        grasp("grasp-longest", GraspCommand::Grasp(LONGEST));
        let (translation, rotation) = ([0.0, 0.0, 0.02], [0.25, -0.125, 0.0]);
        grasp("grasp-move", GraspCommand::Move { translation, rotation, duration: 1.5 });
        grasp("grasp-put-down", GraspCommand::PutDown);
        grasp("grasp-open", GraspCommand::Open);
        self.request("read-grasp", Request::ReadGrasp);
    }

    fn impedances(&mut self) {
        let mut impedance = |name: &str, settings| self.request(name, Request::Impedance(settings));
        impedance("impedance", YIELDING);
        impedance(
            "impedance-driven",
            ArmSettings { redundancy: Redundancy::Driven { joint: 2 }, ..YIELDING },
        );
        let (law, redundancy) = (Law::Printed, Redundancy::None);
        let force = ForceSource::Observer { bandwidth: 30.0 };
        impedance("impedance-observed", ArmSettings { force, ..YIELDING });
        impedance("impedance-printed", ArmSettings { law, redundancy, ..YIELDING });
        let [mass, damping, stiffness] = [[f32::MIN; 6]; 3];
        let longest = ArmSettings {
            impedance: Impedance { mass, damping, stiffness },
            law: Law::Following,
            redundancy: Redundancy::Driven { joint: u8::MAX },
            elbow_bandwidth: f32::MIN,
            force: ForceSource::Observer { bandwidth: f32::MIN },
            contact_force: f32::MIN,
            reach: [f32::MIN; 2],
        };
        impedance("impedance-longest", longest);
        let mut pose = |name: &str, point, elbow| {
            self.request(name, Request::SetPoint(SetPoint::Pose { point, elbow }));
        };
        let point = PosePoint {
            position: PUSHED.position,
            rotation: PUSHED.rotation,
            velocity: [0.125, 0.0, 0.0, 0.0, 0.0, 0.5],
            acceleration: [0.0; 6],
        };
        pose("set-point-pose", point, ElbowPoint { angle: 0.25, ..ElbowPoint::default() });
        let [velocity, acceleration] = [[f32::MIN; 6]; 2];
        let point = PosePoint { position: [f32::MIN; 3], rotation: [f32::MIN; 4], velocity, acceleration };
        let elbow = ElbowPoint { angle: f32::MIN, velocity: f32::MIN, acceleration: f32::MIN };
        pose("set-point-pose-longest", point, elbow);
        self.request("read-arm", Request::ReadArm);
    }

    fn refused(&mut self, name: &str, refusal: Refusal) {
        self.reply(&format!("refused-{name}"), Reply::Refused(refusal));
    }

    fn refusals(&mut self) {
        let mut model = |name: &str, joint, field, value, problem| {
            self.refused(
                &format!("model-{name}"),
                Refusal::Model(ModelError { joint, field, value, problem }),
            );
        };
        model("not-finite", None, Field::Gravity, f32::INFINITY, Problem::NotFinite);
        model("below", Some(3), Field::Mass, -0.5, Problem::Below(0.0));
        model("not-above", Some(15), Field::LimitUpper, 1.0, Problem::NotAbove(1.0));
        model("above", Some(0), Field::MotorDelay, 0.5, Problem::Above(0.01));
        model("not-unit", Some(1), Field::Axis, 0.5, Problem::NotUnit);
        model("not-physical", Some(2), Field::Inertia, -0.125, Problem::NotPhysical);
        model("count", None, Field::Chains, 8.0, Problem::Count(9.0));
        model("not-unique", Some(4), Field::Name, 4.0, Problem::NotUnique);
        self.refused("schema-mismatch", Refusal::SchemaMismatch { board: SCHEMA, firmware: [0, 1, 0] });
        self.refused("no-model", Refusal::NoModel);
        self.refused("model-transfer", Refusal::ModelTransfer { received: 192, announced: 220 });
        let (received, announced) = (0x0102_0304, 0xdead_beef);
        self.refused("model-checksum", Refusal::ModelChecksum { received, announced });
        self.refused("model-unreadable", Refusal::ModelUnreadable { length: 5000, limit: 4096 });
        self.refused("wrong-mode-disarmed", Refusal::WrongMode(Mode::Disarmed));
        self.refused("wrong-mode-armed-pid", Refusal::WrongMode(Mode::Armed(PID)));
        self.refused("wrong-mode-armed-observer", Refusal::WrongMode(Mode::Armed(OBSERVER)));
        self.refused("wrong-mode-armed-grasp", Refusal::WrongMode(Mode::Armed(Task::Grasp)));
        self.refused("wrong-mode-armed-impedance", Refusal::WrongMode(Mode::Armed(Task::Impedance)));
        self.refused("wrong-mode-fault", Refusal::WrongMode(Mode::Fault));
        self.refused("not-homed", Refusal::NotHomed { joint: 8 });
        self.refused("faults-unread", Refusal::FaultsUnread { total: 3 });
        self.refused("joint-count", Refusal::JointCount { got: 2, expected: 9 });
        self.refused("not-finite", Refusal::NotFinite { joint: 15 });
        let outside = Refusal::OutsideLimits { joint: 0, value: 2.0, lower: -1.5, upper: 1.5 };
        self.refused("outside-limits", outside);
        self.refused("too-fast", Refusal::TooFast { joint: 1, value: 9.0, limit: 8.0 });
        self.refused("jump", Refusal::Jump { joint: 2, value: 0.5, limit: 0.25 });
        self.refused("no-sensors", Refusal::NoSensors);
        let (cause, joint) = (FaultCause::SupplyLow, None);
        let fault = Fault { cause, joint, value: 12.0, limit: 20.0, tick: 1234 };
        self.refused("unsafe", Refusal::Unsafe(fault));
        self.refused("commanded", Refusal::Commanded { by: 0x00de_cade });
        self.refused("not-commander", Refusal::NotCommander);
        self.refused("stale", Refusal::Stale { latest: 12 });
        self.refused("not-exported", Refusal::NotExported { length: 0 });
        self.refused("tip-count", Refusal::TipCount { got: 1, expected: 3 });
        self.refused("not-a-finger", Refusal::FingerShapeError { chain: 2 });
        let nearest = [0.1, 0.0, -0.25];
        self.refused("out-of-reach", Refusal::OutOfReach { chain: 1, nearest });
        self.refused("singular", Refusal::Singular { chain: 0 });
        let acceleration = Refusal::TooMuchAcceleration { joint: 3, value: 9000.0, limit: 2857.0 };
        self.refused("too-much-acceleration", acceleration);
        self.refused("tip-not-finite", Refusal::TipNotFinite { chain: 2 });
        self.refused("no-force-sensor", Refusal::NoForceSensor);
        self.refused("not-a-hand", Refusal::NotAHand);
        self.refused("not-tared", Refusal::NotTared { chain: 1 });
        self.refused("too-much-torque", Refusal::TooMuchTorque { joint: 3, value: 0.75, limit: 0.6 });
        self.refused("not-an-arm", Refusal::NotAnArm);
        for (bad, name) in BAD_SETTINGS {
            self.refused(&format!("settings-{name}"), Refusal::Settings(bad));
        }
        for (error, name) in ARM_ERRORS {
            self.refused(&format!("arm-{name}"), Refusal::Arm(error));
        }
        self.unable();
        for (field, name) in FIELDS {
            let error = ModelError { joint: Some(7), field, value: 0.5, problem: Problem::NotFinite };
            self.refused(&format!("field-{name}"), Refusal::Model(error));
        }
    }

    fn unable(&mut self) {
        let mut unable =
            |name: &str, unable| self.refused(&format!("unable-{name}"), Refusal::Unable(unable));
        for (phase, name) in PHASES {
            unable(&format!("busy-{name}"), Unable::Busy(phase));
        }
        let (value, lower, upper) = (2.0, 0.25, 1.0);
        for (field, name) in PLAN_FIELDS {
            unable(&format!("plan-{name}"), Unable::Plan(BadPlan::Value { field, value, lower, upper }));
        }
        unable("plan-contact", Unable::Plan(BadPlan::Contact { finger: 2 }));
        unable("plan-no-triangle", Unable::Plan(BadPlan::NoTriangle));
        unable("plan-cannot-grip", Unable::Plan(BadPlan::CannotGrip));
        unable("plan-unbalanced", Unable::Plan(BadPlan::Unbalanced { rest: 0.25 }));
        unable("out-of-reach", Unable::OutOfReach { finger: 1, nearest: [0.1, 0.0, -0.25] });
        unable("not-finite", Unable::NotFinite);
        unable("too-fast", Unable::TooFast { value: 0.375, limit: 0.2 });
    }

    fn board(&mut self) {
        self.reply("hello", Reply::Hello { schema: SCHEMA, identity: IDENTITY });
        self.reply("done", Reply::Done);
        self.reply_to("done-first-number", 1, 0, 0, Reply::Done);
        self.reply_to("done-last-number", u32::MAX, u16::MAX, u32::MAX, Reply::Done);
        for (name, status) in statuses() {
            self.reply(&format!("status-{name}"), Reply::Status(status));
        }
        self.reply("faults-none", Reply::Faults(FaultLog::new()));
        let first = CAUSES.iter().take(16).zip(0_u8..).map(|(&cause, number)| Fault {
            cause,
            joint: (number % 2 == 1).then_some(number),
            value: f32::from(number) + 0.5,
            limit: 0.25,
            tick: 100 + u32::from(number),
        });
        self.reply("faults-0-to-15", Reply::Faults(FaultLog { total: 16, faults: list(first) }));
        let second = CAUSES.iter().skip(16).map(|&cause| Fault {
            cause,
            joint: None,
            value: 2.0,
            limit: 0.0,
            tick: 0,
        });
        self.reply("faults-16-to-24", Reply::Faults(FaultLog { total: u32::MAX, faults: list(second) }));
        self.reply("exported", Reply::Exported { length: 220, checksum: 0xdead_beef, index: 2469 });
        self.reply("chunk", Reply::Chunk { offset: 192, data: list([0, 1, 254, 255]) });
        self.reply("chunk-long", Reply::Chunk { offset: 0, data: list(0..192) });

        let mut telemetry =
            |name: &str, tick, mode, faults, joints: &[[f32; 4]]| {
                let joints = list(joints.iter().map(|&[position, velocity, reference, torque]| {
                    JointTelemetry { position, velocity, reference, torque }
                }));
                let telemetry = Telemetry { tick, mode, faults, joints };
                self.add(format!("board-{name}"), Message::Board(FromBoard::Telemetry(telemetry)));
            };
        telemetry("telemetry-none", 0, Mode::Disarmed, 0, &[]);
        let two = [[0.5, -0.25, 0.5625, 0.03125], [-0.5, 0.25, -0.5625, -0.03125]];
        telemetry("telemetry-pid", 1234, Mode::Armed(PID), 0, &two);
        telemetry("telemetry-16", u32::MAX, Mode::Fault, u32::MAX, &[[f32::MIN; 4]; 16]);
        telemetry("telemetry-grasp", 1235, Mode::Armed(Task::Grasp), 0, &two[..1]);
        telemetry("telemetry-impedance", 1236, Mode::Armed(Task::Impedance), 0, &two[..1]);
        telemetry("session-telemetry", 3, Mode::Armed(OBSERVER), 0, &[[0.0; 4]]);
        let tip = TipTelemetry {
            position: [0.1, -0.04, 0.0625],
            force: [1.5, 0.0, -0.5],
            torque: [0.0, 0.015_625, 0.0],
            tared: true,
        };
        let mut tips = |name: &str, tick, tips| {
            self.add(format!("board-{name}"), Message::Board(FromBoard::Tips(Tips { tick, tips })));
        };
        tips("tips", 1234, list([tip, TipTelemetry::default()]));
        let [position, force, torque] = [[f32::MIN; 3]; 3];
        tips("tips-6", u32::MAX, list([TipTelemetry { position, force, torque, tared: true }; 6]));
        self.add("board-grasp", Message::Board(FromBoard::Grasp(HOLDING)));
        let longest = GraspTelemetry {
            tick: u32::MAX,
            phase: Phase::Open,
            failure: Some(Failure::GripError { force: 0.25, limit: 3.0 }),
            position: [f32::MIN; 3],
            orientation: [f32::MIN; 4],
            load: [f32::MIN; 6],
            wanted: [[f32::MIN; 3]; 3],
            friction: f32::MIN,
            slips: u16::MAX,
            overloaded: true,
        };
        self.add("board-grasp-longest", Message::Board(FromBoard::Grasp(longest)));
        self.reply("read-grasp", Reply::Grasp(NO_GRASP));
        for (phase, name) in PHASES {
            let grasp = GraspTelemetry { tick: 1233, phase, slips: 0, overloaded: true, ..HOLDING };
            self.reply(&format!("read-grasp-{name}"), Reply::Grasp(grasp));
        }
        for (failure, name) in FAILURES {
            let grasp = GraspTelemetry { failure: Some(failure), ..NO_GRASP };
            self.reply(&format!("read-grasp-{name}"), Reply::Grasp(grasp));
        }
        self.add("board-arm", Message::Board(FromBoard::Arm(PUSHED)));
        let longest = ArmTelemetry {
            tick: u32::MAX,
            position: [f32::MIN; 3],
            rotation: [f32::MIN; 4],
            error: [f32::MIN; 6],
            wrench: [f32::MIN; 6],
            contact: true,
            weakest: f32::MIN,
            elbow: f32::MIN,
        };
        self.add("board-arm-longest", Message::Board(FromBoard::Arm(longest)));
        self.reply("read-arm", Reply::Arm(PUSHED));
        let status = statuses().remove("fault").unwrap();
        self.add("board-stream-status", Message::Board(FromBoard::Status(status)));
        for (index, (name, record)) in (2468..).zip(records()) {
            self.add(
                format!("board-log-{name}"),
                Message::Board(FromBoard::Log(LogEntry { index, record: record.clone() })),
            );
            self.add(format!("record-{name}"), Message::Record(record));
        }
    }

    fn plant_link(&mut self) {
        let mut sensors = |name: &str, frame| self.add(format!("sensors{name}"), Message::Sensors(frame));
        sensors("", sensor_frame(1234, 0, 24000, &[100, -100, 0], &[5, -5, 0]));
        sensors("-none", SensorFrame::default());
        let ends = sensor_frame(300, 1, u16::MAX, &[i32::MIN, i32::MAX], &[i16::MIN, i16::MAX]);
        sensors("-emergency-stop", ends);
        let full = sensor_frame(u32::MAX, 255, u16::MAX, &[i32::MIN; 16], &[i16::MIN; 16]);
        sensors("-16", SensorFrame { forces: list([[i32::MIN; 6]; 6]), ..full });
        let forces = list([[1000, -1000, 0, 7, -7, 63], [0, 0, 0, 0, 0, 1]]);
        sensors("-forces", SensorFrame { forces, ..sensor_frame(1234, 0, 24000, &[100], &[5]) });
        for tick in 1..=3 {
            sensors(&format!("-session-{tick}"), sensor_frame(tick, 0, 24000, &[1000], &[0]));
        }
        let mut actuators = |name: &str, sequence, enabled, torques: &[f32]| {
            let torques = list(torques.iter().copied());
            self.add(
                format!("actuators-{name}"),
                Message::Actuators(ActuatorFrame { sequence, enabled, torques }),
            );
        };
        actuators("off", 1234, false, &[0.0; 3]);
        actuators("on", 300, true, &[0.0, -0.25, 0.5]);
        actuators("none", 0, false, &[]);
        actuators("16", u32::MAX, true, &[f32::MIN; 16]);
        actuators("session-1", 1, false, &[]);
        actuators("session-2", 2, false, &[0.0]);
        actuators("session-3", 3, true, &[0.0]);
    }

    fn session(&mut self) {
        let model = postcard::to_stdvec(&finger(Reaction::Hold)).unwrap();
        let mut sequence = 0;
        let mut step = |name: &str, request, reply, tick| {
            sequence += 1;
            self.request_by(&format!("session-{name}"), CLIENT, sequence, request);
            self.reply_to(&format!("session-{name}"), CLIENT, sequence, tick, reply);
        };
        let hello = Reply::Hello { schema: SCHEMA, identity: IDENTITY };
        step("hello", Request::Hello { schema: SCHEMA }, hello, 1);
        step("take-command", Request::TakeCommand { by_force: false }, Reply::Done, 1);
        let length = u32::try_from(model.len()).unwrap();
        let model_checksum = checksum(&model);
        let begin = Request::ModelBegin { length, checksum: model_checksum };
        step("model-begin", begin, Reply::Done, 1);
        for (offset, data) in (0..).step_by(192).zip(model.chunks(192)) {
            let chunk = Request::ModelChunk { offset, data: list(data.iter().copied()) };
            step(&format!("model-chunk-{offset}"), chunk, Reply::Done, 1);
        }
        step("model-commit", Request::ModelCommit, Reply::Done, 1);
        step("home", Request::Home { positions: list([0.0]) }, Reply::Done, 2);
        step("set-rate", Request::SetRate { stream: Stream::Telemetry, every: 1 }, Reply::Done, 2);
        step("arm", Request::Arm { task: OBSERVER }, Reply::Done, 2);
        let goal = |angle| Request::SetPoint(SetPoint::Goal { positions: list([angle]) });
        step("goal", goal(0.5), Reply::Done, 3);
        let outside = Refusal::OutsideLimits { joint: 0, value: 2.0, lower: -1.5, upper: 1.5 };
        step("goal-outside", goal(2.0), Reply::Refused(outside), 3);
        step("disarm", Request::Disarm, Reply::Done, 3);
        let node = NodeStatus {
            mode: Mode::Disarmed,
            model: "finger".try_into().unwrap(),
            model_checksum,
            homed: 1,
            faults: 0,
            faults_read: true,
            commander: Some(CLIENT),
            tick: 3,
            supply: 24.0,
        };
        let status = Status { node, board: quiet_board() };
        step("read-status", Request::ReadStatus, Reply::Status(status), 3);
        step("release-command", Request::ReleaseCommand, Reply::Done, 3);
    }
}

const FIELDS: [(Field, &str); Field::VARIANTS.len()] = [
    (Field::Joints, "joints"),
    (Field::Chains, "chains"),
    (Field::Gravity, "gravity"),
    (Field::Name, "name"),
    (Field::OriginTranslation, "origin-translation"),
    (Field::OriginRotation, "origin-rotation"),
    (Field::Axis, "axis"),
    (Field::Mass, "mass"),
    (Field::CenterOfMass, "center-of-mass"),
    (Field::Inertia, "inertia"),
    (Field::RotorInertia, "rotor-inertia"),
    (Field::TorqueConstant, "torque-constant"),
    (Field::CurrentLimit, "current-limit"),
    (Field::CurrentResolution, "current-resolution"),
    (Field::MotorBandwidth, "motor-bandwidth"),
    (Field::MotorDelay, "motor-delay"),
    (Field::Coulomb, "coulomb"),
    (Field::Viscous, "viscous"),
    (Field::CountsPerTurn, "counts-per-turn"),
    (Field::LimitLower, "limit-lower"),
    (Field::LimitUpper, "limit-upper"),
    (Field::LimitVelocity, "limit-velocity"),
    (Field::LimitTorque, "limit-torque"),
    (Field::LimitTorqueRate, "limit-torque-rate"),
    (Field::LimitFollowingError, "limit-following-error"),
    (Field::FilterTime, "filter-time"),
    (Field::Proportional, "proportional"),
    (Field::Integral, "integral"),
    (Field::Derivative, "derivative"),
    (Field::Cutoff, "cutoff"),
    (Field::ServoInertia, "servo-inertia"),
    (Field::Bandwidth, "bandwidth"),
    (Field::ObserverBandwidth, "observer-bandwidth"),
    (Field::CommandTimeout, "command-timeout"),
    (Field::Damping, "damping"),
    (Field::SupplyMin, "supply-min"),
    (Field::SupplyMax, "supply-max"),
    (Field::RestError, "rest-error"),
    (Field::ChainName, "chain-name"),
    (Field::TipTranslation, "tip-translation"),
    (Field::TipRotation, "tip-rotation"),
    (Field::ForceResolution, "force-resolution"),
    (Field::TorqueResolution, "torque-resolution"),
    (Field::Saturation, "saturation"),
    (Field::ForceLimit, "force-limit"),
    (Field::TipMass, "tip-mass"),
    (Field::TipCenterOfMass, "tip-center-of-mass"),
    (Field::TipRadius, "tip-radius"),
];

const CAUSES: [FaultCause; FaultCause::VARIANTS.len()] = [
    FaultCause::CommandTimeout,
    FaultCause::PositionLimit,
    FaultCause::VelocityLimit,
    FaultCause::FollowingError,
    FaultCause::EncoderJump,
    FaultCause::EncoderStuck,
    FaultCause::NotFinite,
    FaultCause::LateTick,
    FaultCause::SensorCount,
    FaultCause::EmergencyStop,
    FaultCause::SupplyLow,
    FaultCause::SupplyHigh,
    FaultCause::OverCurrent,
    FaultCause::WatchdogReset,
    FaultCause::Panic,
    FaultCause::HardFault,
    FaultCause::ClockFallback,
    FaultCause::Stop,
    FaultCause::ForceSaturated,
    FaultCause::ForceStuck,
    FaultCause::ForceLimit,
    FaultCause::ObjectLost,
    FaultCause::ObjectMoved,
    FaultCause::ToolAway,
    FaultCause::ToolTurned,
];

fn quiet_board() -> BoardStatus {
    BoardStatus { identity: IDENTITY, ..BoardStatus::default() }
}

fn statuses() -> BTreeMap<&'static str, Status> {
    let nobody = NodeStatus {
        mode: Mode::Disarmed,
        model: "".try_into().unwrap(),
        model_checksum: 0,
        homed: 0,
        faults: 0,
        faults_read: true,
        commander: None,
        tick: 0,
        supply: 0.0,
    };
    let fault = NodeStatus {
        mode: Mode::Fault,
        model: "hand3".try_into().unwrap(),
        model_checksum: 0x89ab_cdef,
        homed: 511,
        faults: 18,
        faults_read: false,
        commander: Some(0x00de_cade),
        tick: 100_000,
        supply: 23.5,
    };
    let full = BoardStatus {
        identity: IDENTITY,
        clock: ClockSource::InternalPll,
        reset: ResetCause::Panic,
        last_words: "panicked at src/main.rs:7".try_into().unwrap(),
        stack_used: 2048,
        stack_size: 16384,
        supervisor_link: LinkStatistics {
            frames: FrameCounts { good: 1, overlong: 2, framing: 3, checksum: 4, malformed: 5 },
            receive_overflow: 6,
            receive_errors: 7,
            send_overflow: 8,
        },
        plant: LinkStatistics {
            frames: FrameCounts { good: 128, checksum: 16384, ..FrameCounts::default() },
            send_overflow: u32::MAX,
            ..LinkStatistics::default()
        },
    };
    let board = |clock, reset, words: &str| {
        let last_words = words.try_into().unwrap();
        Status { node: nobody.clone(), board: BoardStatus { clock, reset, last_words, ..quiet_board() } }
    };
    BTreeMap::from([
        ("nothing", board(ClockSource::Crystal, ResetCause::PowerOn, "")),
        ("fault", Status { node: fault, board: full }),
        ("watchdog", board(ClockSource::Internal, ResetCause::Watchdog, "")),
        ("hard-fault", board(ClockSource::Crystal, ResetCause::HardFault, &"w".repeat(96))),
        ("software", board(ClockSource::Crystal, ResetCause::Software, "")),
    ])
}

fn sensor_frame(sequence: u32, flags: u8, supply: u16, encoders: &[i32], currents: &[i16]) -> SensorFrame {
    let (encoders, currents) = (list(encoders.iter().copied()), list(currents.iter().copied()));
    SensorFrame { sequence, flags: SensorFlags(flags), supply, encoders, currents, forces: list([]) }
}

fn records() -> [(&'static str, LogRecord); LogRecord::VARIANTS.len()] {
    let request = RequestFrame { client: CLIENT, sequence: 9, request: Request::Disarm };
    let torques = list([0.25, -0.25]);
    [
        ("request", LogRecord::Request(request)),
        ("sensors", LogRecord::Sensors(sensor_frame(1234, 1, 24000, &[100, -100], &[5, -5]))),
        ("actuators", LogRecord::Actuators(ActuatorFrame { sequence: 1234, enabled: true, torques })),
        (
            "start",
            LogRecord::Start(LogStart { schema: SCHEMA, identity: IDENTITY, unix_time: 1_795_000_000 }),
        ),
        ("state", LogRecord::State { offset: 192, data: list([0, 1, 254, 255]) }),
        ("restore", LogRecord::Restore { length: 196, checksum: 0xdead_beef }),
        ("gap", LogRecord::Gap { missing: 300 }),
    ]
}

fn messages() -> BTreeMap<String, Message> {
    let mut messages = Messages::default();
    messages.requests();
    messages.refusals();
    messages.board();
    messages.plant_link();
    messages.session();
    for (name, reaction) in [("off", Reaction::Off), ("damp", Reaction::Damp), ("hold", Reaction::Hold)] {
        messages.add(format!("model-{name}"), Message::Model(finger(reaction)));
    }
    messages.0
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

#[test]
fn every_message_has_the_golden_bytes_and_they_mean_that_message() {
    let mut messages = messages();
    for (name, bytes) in golden() {
        let message = messages.remove(name).unwrap_or_else(|| panic!("{name} is not built here"));
        assert_eq!(hex(&message.encode()), hex(&bytes), "{name}");
        assert_eq!(message.decode(&bytes), [Ok(message)], "{name}");
    }
    assert!(messages.is_empty(), "without golden bytes: {:?}", messages.keys());
}

#[test]
fn no_variant_of_any_enumeration_is_missing() {
    let mut seen = Seen::default();
    messages().values().for_each(|message| seen.message(message));
    let missing: Vec<_> = every_variant().difference(&seen.0).copied().collect();
    assert!(missing.is_empty(), "no golden frame shows {missing:?}: add them to oracles/protocol.py");
}

#[test]
fn every_single_flipped_bit_and_every_truncation_of_every_frame_is_rejected() {
    let messages = messages();
    for (name, good) in golden() {
        let message = &messages[name];
        if let Message::Model(_) = message {
            continue; // travels inside frames
        }
        let rejected = |bad: &[u8]| message.decode(bad).iter().all(Result::is_err);
        for byte in 0..good.len() {
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[byte] ^= 1 << bit;
                bad.push(0); // in case it was the closing zero
                assert!(rejected(&bad), "{name}: byte {byte} bit {bit}");
            }
        }
        for length in 0..good.len() - 1 {
            let mut short = good[..length].to_vec();
            short.push(0);
            assert!(rejected(&short), "{name}: cut at {length}");
        }
    }
}

/// The lines of the page's blocks of that kind.
fn blocks(kind: &str) -> Vec<&'static str> {
    let mut inside = false;
    let mut lines = Vec::new();
    for line in PAGE.lines() {
        if let Some(fence) = line.strip_prefix("```") {
            inside = fence == kind;
        } else if inside {
            lines.push(line);
        }
    }
    lines
}

#[test]
fn the_page_quotes_the_golden_bytes() {
    let golden: BTreeMap<_, _> = golden().into_iter().collect();
    let quoted = blocks("frames");
    assert!(quoted.len() >= 20, "only {} frames found in docs/protocol.md", quoted.len());
    for line in quoted {
        let (name, bytes) = parse(line);
        let expected = golden.get(name).unwrap_or_else(|| panic!("there is no golden frame {name}"));
        assert_eq!(hex(&bytes), hex(expected), "{name} in docs/protocol.md");
    }
}

/// What the numbers of the example client stand for; `xtask test` runs it against a board.
#[test]
fn the_example_client_knows_every_fault_and_every_refusal() {
    let client = include_str!("../../docs/examples/client.py");
    let between = |from: &str, to: &str| client.split_once(from).unwrap().1.split_once(to).unwrap().0;
    assert_eq!(between("CAUSES = \"\"\"", "\"\"\"").split(';').count(), FaultCause::VARIANTS.len());
    assert_eq!(between("REFUSALS = [", "\n]").matches("\n    (").count(), Refusal::VARIANTS.len());
}

#[test]
fn the_page_is_about_this_version_of_the_messages() {
    let key = format!("`{SCHEMA_KEY:016x}`");
    assert!(
        PAGE.contains(&key),
        "docs/protocol.md describes another version: bring it and oracles/protocol.py up to date, then write the key \
         {key} there"
    );
    for variants in [
        Request::VARIANTS,
        SetPoint::VARIANTS,
        Reply::VARIANTS,
        Refusal::VARIANTS,
        FaultCause::VARIANTS,
        GraspCommand::VARIANTS,
        InternalForce::VARIANTS,
        ObjectControl::VARIANTS,
        Phase::VARIANTS,
        Failure::VARIANTS,
        Unable::VARIANTS,
        BadPlan::VARIANTS,
        PlanField::VARIANTS,
        Law::VARIANTS,
        Redundancy::VARIANTS,
        BadSettings::VARIANTS,
        ImpedanceTerm::VARIANTS,
        ArmError::VARIANTS,
    ] {
        for (number, variant) in variants.iter().enumerate() {
            let row = format!("| {number} | `{}` |", variant.rsplit(':').next().unwrap());
            assert!(PAGE.contains(&row), "docs/protocol.md has no row {row:?}");
        }
    }
}

/// A node goes through the session of the page and says what the page says.
#[test]
fn the_session_of_the_page_happens_like_that() {
    let messages = messages();
    let mut node = Box::new(Node::new());
    let mut telemetry = 0;
    let mut replies = 0;
    for (name, _) in golden() {
        match &messages[name] {
            Message::Sensors(sensors) if name.contains("-session-") => {
                let actuators = Message::Actuators(node.tick(sensors));
                assert_eq!(actuators, messages[&name.replace("sensors", "actuators")], "{name}");
            }
            Message::Request(frame) if name.contains("-session-") => {
                // The page has a key of its own.
                let mut frame = frame.clone();
                if let Request::Hello { schema } = &mut frame.request {
                    assert_eq!(*schema, SCHEMA);
                    *schema = SCHEMA_KEY;
                }
                let mut reply = node.handle(&frame, &quiet_board());
                if let Reply::Hello { schema, .. } = &mut reply.reply {
                    *schema = SCHEMA;
                }
                let expected = &messages[&name.replace("request", "board")];
                assert_eq!(&Message::Board(FromBoard::Reply(reply)), expected, "{name}");
                replies += 1;
            }
            Message::Board(FromBoard::Telemetry(expected)) if name.contains("-session-") => {
                assert_eq!(&node.telemetry(), expected);
                telemetry += 1;
            }
            _ => {}
        }
    }
    assert_eq!((replies, telemetry), (14, 1));
    assert_eq!(node.robot().unwrap().model(), &finger(Reaction::Hold));
}
