//! The enumerations that are sent, and which of their variants the messages show.

use std::collections::BTreeSet;

use serde::Serialize;
use tesaki::arm::{ArmError, BadSettings, Law, Redundancy};
use tesaki::control::{BadImpedance, ImpedanceTerm, ServoMode};
use tesaki::manipulation::{
    BadPlan, Failure, GraspCommand, GraspTelemetry, InternalForce, ObjectControl, Phase, PlanField, Unable,
};
use tesaki::model::{Field, Problem, Reaction};
use tesaki::protocol::{
    ClockSource, FaultCause, FromBoard, Item, LogRecord, Mode, Refusal, Reply, ReplyFrame, Request,
    RequestFrame, ResetCause, SetPoint, Status, Stream, Task,
};

use super::message::Message;

/// An enumeration that is sent. The list must be complete, or the match does not compile, and in the order of
/// the numbers.
pub trait Variants: Serialize {
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
        pub fn every_variant() -> BTreeSet<&'static str> {
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
    Failure { Obstructed, NothingThere, NoGrip, NothingBelow, OutOfReach }
    Unable { Busy, Plan, OutOfReach, NotFinite, TooFast }
    BadPlan { Value, Contact, NoTriangle, CannotGrip, Unbalanced }
    PlanField { Clearance, TouchForce, Friction, ForceLimit, Margin, Least, Strength, Gain }
    FromBoard { Reply, Telemetry, Status, Log, Tips, Grasp, Arm }
    Reply { Hello, Done, Refused, Status, Faults, Exported, Chunk, Grasp, Arm }
    Refusal {
        SchemaMismatch, NoModel, Model, ModelTransfer, ModelChecksum, ModelUnreadable, WrongMode, NotHomed,
        FaultsUnread, JointCount, NotFinite, OutsideLimits, TooFast, Jump, NoSensors, Unsafe, Commanded,
        NotCommander, Stale, NotExported, TipCount, NotAFinger, OutOfReach, Singular, TooMuchAcceleration, TipNotFinite, NoForceSensor,
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
pub struct Seen(pub BTreeSet<&'static str>);

impl Seen {
    /// Takes note of a value, and checks that its number on the wire is its place in the list.
    pub fn variant<T: Variants>(&mut self, value: &T) {
        let name = value.variant();
        let place = T::VARIANTS.iter().position(|&other| other == name).unwrap();
        assert_eq!(usize::from(postcard::to_stdvec(value).unwrap()[0]), place, "{name}");
        self.0.insert(name);
    }

    pub fn task(&mut self, task: Task) {
        self.variant(&task);
        if let Task::JointServo(mode) = task {
            self.variant(&mode);
        }
    }

    pub fn mode(&mut self, mode: Mode) {
        self.variant(&mode);
        if let Mode::Armed(task) = mode {
            self.task(task);
        }
    }

    pub fn request(&mut self, frame: &RequestFrame) {
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

    pub fn unable(&mut self, unable: &Unable) {
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

    pub fn grasp(&mut self, grasp: &GraspTelemetry) {
        self.variant(&grasp.phase);
        if let Some(failure) = &grasp.failure {
            self.variant(failure);
        }
    }

    pub fn refusal(&mut self, refusal: &Refusal) {
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
                if let BadSettings::Impedance(BadImpedance { term, .. }) = bad {
                    self.variant(term);
                }
            }
            Refusal::Arm(error) => self.variant(error),
            _ => {}
        }
    }

    pub fn status(&mut self, status: &Status) {
        self.mode(status.node.mode);
        self.variant(&status.board.clock);
        self.variant(&status.board.reset);
    }

    pub fn record(&mut self, record: &LogRecord) {
        self.variant(record);
        if let LogRecord::Request(frame) = record {
            self.request(frame);
        }
    }

    pub fn board(&mut self, message: &FromBoard) {
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

    pub fn message(&mut self, message: &Message) {
        match message {
            Message::Request(frame) => self.request(frame),
            Message::Board(message) => self.board(message),
            Message::Record(record) => self.record(record),
            Message::Model(model) => self.variant(&model.safety.reaction),
            Message::Sensors(_) | Message::Actuators(_) => {}
        }
    }
}
