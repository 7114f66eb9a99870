//! The transmitted enumerations, and their variants that occur in the messages.

use std::collections::BTreeSet;

use serde::Serialize;
use tesaki::OutOfRange;
use tesaki::control::{ImpedanceAxes, ImpedanceTerm, InvalidImpedance, ServoMode};
use tesaki::fault::FaultCause;
use tesaki::model::{Field, Problem, Reaction};
use tesaki::protocol::{
    ClockSource, FromBoard, Item, LogRecord, Mode, Refusal, Reply, ReplyFrame, Request, RequestFrame,
    ResetCause, Status, Stream,
};
use tesaki::robot::LimitRefusal;
use tesaki::task::grasping::{
    Failure, GraspCommand, GraspRefusal, InternalForce, InvalidPlan, JointTargets, LoadSource, ObjectControl,
    ObjectFrame, Phase, PlanField,
};
use tesaki::task::impedance::{
    ForceSource, ImpedanceCommand, ImpedanceRefusal, ImpedanceSettings, InvalidImpedanceSettings, Law,
    Redundancy, SetpointError,
};
use tesaki::task::joint_servo::{JointCommand, JointServoRefusal};
use tesaki::task::telexistence::{InvalidTelexistenceSettings, TelexistenceCommand, TelexistenceRefusal};
use tesaki::task::visual_approach::{
    GripperState, HandMotion, VisualApproachCommand, VisualApproachField, VisualApproachRefusal,
};
use tesaki::task::{TaskCommand, TaskConfig, TaskKind, TaskRefusal, TaskTelemetry};
use tesaki::teleop::RetargetField;

use super::message::Message;

/// A transmitted enumeration. The list must be complete, or the match does not compile, and in the order of
/// the numbers.
pub trait Variants: Serialize {
    const VARIANTS: &'static [&'static str];
    fn variant(&self) -> &'static str;
}

macro_rules! variants {
    ($($kind:ident { $($variant:ident),* $(,)? })*) => {
        $(impl Variants for $kind {
            const VARIANTS: &'static [&'static str] =
                &[$(concat!(stringify!($kind), "::", stringify!($variant))),*];
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
        Hello, Disable, Stop, TakeCommand, ReleaseCommand, ModelBegin, ModelChunk, ModelCommit, Home, Tare,
        Enable, Task, Keep, ReadTask, ReadStatus, ReadFaults, ClearFaults, SetRate, Export, ReadExport,
    }
    Stream { Telemetry, Status, Log, Tips, Task }
    Item { Model, State }
    TaskKind { JointServo, Grasping, Impedance, Telexistence, VisualApproach }
    TaskConfig { JointServo, Grasping, Impedance, Telexistence, VisualApproach }
    TaskCommand { JointServo, Grasping, Impedance, Telexistence, VisualApproach }
    TaskTelemetry { JointServo, Grasping, Impedance, Telexistence, VisualApproach }
    TaskRefusal { JointServo, Grasping, Impedance, Telexistence, VisualApproach }
    ServoMode { Pid, Observer, BarePid }
    JointCommand { Goal, Stream, StreamTips, StreamTorques }
    JointServoRefusal { Limit, TipCount, NotAFinger, OutOfReach, Singular, TipNotFinite }
    LimitRefusal { JointCount, NotFinite, OutsideLimits, TooFast, Jump, TooMuchAcceleration, TooMuchTorque }
    GraspCommand { Grasp, Move, PutDown, Open }
    InternalForce { LeastGrip, Normal, Pairwise }
    ObjectControl { Differential, Wrench }
    ObjectFrame { Rolling, Triangle }
    LoadSource { Measured, Constant }
    JointTargets { ClosedForm, Accumulated }
    Phase { Ready, Approach, Touch, Squeeze, ProbeFriction, Hold, Move, Lower, Open }
    Failure { Obstructed, NoObject, NoGrip, NoSupport, OutOfReach }
    GraspRefusal { NotAHand, NotTared, Busy, Plan, OutOfReach, NotFinite, TooFast, Limit }
    InvalidPlan { Value, Contact, NoTriangle, CannotGrip, Unbalanced }
    PlanField { Clearance, TouchForce, Friction, ForceLimit, Margin, Capacity, Strength, Gain, Mass }
    ImpedanceCommand { SetTarget, Configure }
    Law { Direct, ModelFollowing }
    Redundancy { None, DrivenJoint, ArmAngle }
    ForceSource { Sensor, Observer }
    ImpedanceRefusal { NotAnArm, NotTared, NoForceSensor, ForceSourceInUse, Settings, Setpoint }
    InvalidImpedanceSettings {
        Impedance, Joint, NoArmAngle, ElbowBandwidth, ContactForce, MaxDeviation, ForceBandwidth, NoRedundantJoint,
        Friction, MassInContact,
    }
    ImpedanceTerm {
        Mass, Damping, Stiffness, MassMatrix, DampingMatrix, StiffnessMatrix, DampingToMass, StiffnessToMass,
    }
    ImpedanceAxes { Base, Tool }
    SetpointError { Distance, Rotation, NotFinite, NotUnit, Elbow }
    TelexistenceCommand { Follow, Release }
    TelexistenceRefusal { NotAHand, Settings, Fingertip, Age }
    InvalidTelexistenceSettings { Retargeting, Acceleration, MaxSampleAge }
    RetargetField {
        Fingers, Follows, Weights, Scale, Near, Far, OperatorContact, RobotContact, Speeds, Tolerance,
    }
    VisualApproachCommand { Latch, Move, Stand, Open, Close, Acknowledge }
    HandMotion { Standing, Moving, Blocked, Limited }
    GripperState { Still, Opening, Open, Closing, Holding, Empty, Jammed }
    VisualApproachRefusal { NoChain, NoGripper, Limit, Value, Target, Speed, Blocked, GripperAxis, Singular }
    VisualApproachField { Speed, Acceleration, ContactForce, Reach, GripperRange, GripperSpeed, GripperTorque }
    FromBoard { Reply, Telemetry, Status, Log, Tips, Task }
    Reply { Hello, Done, Refused, Status, Faults, Exported, Chunk, Task }
    Refusal {
        SchemaMismatch, WrongMode, Commanded, NotCommander, Stale, FaultsUnread, NoModel, Model,
        ModelTransfer, ModelChecksum, ModelUnreadable, NoSensors, Unsafe, NotHomed, NoForceSensor,
        NotExported, Limit, NoTask, OtherTask, Task,
    }
    Field {
        Joints, Chains, Gravity, Name, OriginTranslation, OriginRotation, Axis, Mass, CenterOfMass, Inertia,
        RotorInertia, TorqueConstant, CurrentLimit, CurrentResolution, MotorBandwidth, MotorDelay, Coulomb,
        Viscous, CountsPerTurn, LimitLower, LimitUpper, LimitVelocity, LimitTorque, LimitTorqueRate,
        LimitFollowingError, FilterTime, Proportional, Integral, Derivative, Cutoff, ServoInertia, Bandwidth,
        ObserverBandwidth, CommandTimeout, Damping, SupplyMin, SupplyMax, RestError,
        ChainName, TipTranslation, TipRotation, ForceResolution, TorqueResolution, Saturation, ForceLimit,
        TipMass, TipCenterOfMass, TipRadius, MimicJoint, MimicMultiplier, MimicOffset, MimicForceSensor,
        EncoderRelative, MotorResistance, MotorInductance, MimicChain, MimicPlace, Gauges,
        CalibrationMatrix, GaugeRange, GaugeGains,
    }
    Problem {
        NotFinite, Below, NotAbove, Above, NotUnit, NotPhysical, Count, NotUnique, NoSuchJoint, NotSupported,
        BoardLimit, Missing, Singular,
    }
    Mode { Disabled, Enabled, Fault }
    FaultCause {
        CommandTimeout, PositionLimit, VelocityLimit, FollowingError, EncoderJump, EncoderStuck, NotFinite,
        LateTick, SensorCount, EmergencyStop, SupplyLow, SupplyHigh, OverCurrent, WatchdogReset, Panic,
        HardFault, ClockFallback, Stop, ForceSaturated, ForceStuck, ForceLimit,
        ObjectLost, ObjectMoved, ToolPositionError, ToolOrientationError, Runaway,
        ForceMismatch, EnergyGained, SensorsSilent, CrystalStopped, WrongCrystal,
        PowerStage, ForceSilent, ChipSupplyLow, BrownOutResetOff,
    }
    ClockSource { Crystal, InternalPll, Internal }
    ResetCause { PowerOn, Watchdog, Panic, HardFault, Software, CrystalStopped, BrownOut }
    LogRecord { Request, Sensors, Actuators, Start, State, Restore, Gap, End }
    Reaction { Off, Damp, Hold }
}

/// The variants that occur in the messages.
#[derive(Default)]
pub struct Seen(pub BTreeSet<&'static str>);

impl Seen {
    /// Records a value, and checks that its number on the wire is its position in the list.
    pub fn variant<T: Variants>(&mut self, value: &T) {
        let name = value.variant();
        let place = T::VARIANTS.iter().position(|&other| other == name).unwrap();
        assert_eq!(usize::from(postcard::to_stdvec(value).unwrap()[0]), place, "{name}");
        self.0.insert(name);
    }

    pub fn mode(&mut self, mode: Mode) {
        self.variant(&mode);
        if let Mode::Enabled(task) = mode {
            self.variant(&task);
        }
    }

    pub fn request(&mut self, frame: &RequestFrame) {
        self.variant(&frame.request);
        match &frame.request {
            Request::Enable(config) => self.config(config),
            Request::Task(command) => self.command(command),
            Request::SetRate { stream, .. } => self.variant(stream),
            Request::Export(item) => self.variant(item),
            _ => {}
        }
    }

    pub fn config(&mut self, config: &TaskConfig) {
        self.variant(config);
        match config {
            TaskConfig::JointServo(mode) => self.variant(mode),
            TaskConfig::Grasping(()) => {}
            TaskConfig::Impedance(settings) => self.settings(settings),
            TaskConfig::Telexistence(settings) => self.variant(&settings.servo_mode),
            TaskConfig::VisualApproach(settings) => self.variant(&settings.servo_mode),
        }
    }

    pub fn command(&mut self, command: &TaskCommand) {
        self.variant(command);
        match command {
            TaskCommand::JointServo(command) => self.variant(command),
            TaskCommand::Grasping(command) => {
                self.variant(command);
                if let GraspCommand::Grasp(plan) = command {
                    self.variant(&plan.internal);
                    self.variant(&plan.control);
                    self.variant(&plan.object_frame);
                    self.variant(&plan.load);
                    self.variant(&plan.joint_targets);
                }
            }
            TaskCommand::Impedance(command) => {
                self.variant(command);
                if let ImpedanceCommand::Configure(settings) = command {
                    self.settings(settings);
                }
            }
            TaskCommand::Telexistence(command) => self.variant(command),
            TaskCommand::VisualApproach(command) => self.variant(command),
        }
    }

    pub fn settings(&mut self, settings: &ImpedanceSettings) {
        self.variant(&settings.impedance.axes);
        self.variant(&settings.law);
        self.variant(&settings.redundancy);
        self.variant(&settings.force);
    }

    pub fn telemetry(&mut self, telemetry: &TaskTelemetry) {
        self.variant(telemetry);
        if let TaskTelemetry::Grasping(grasp) = telemetry {
            self.variant(&grasp.phase);
            if let Some(failure) = &grasp.failure {
                self.variant(failure);
            }
        }
        if let TaskTelemetry::VisualApproach(hand) = telemetry {
            self.variant(&hand.motion);
            self.variant(&hand.gripper);
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
            Refusal::Limit(limit) => self.variant(limit),
            Refusal::OtherTask(task) => self.variant(task),
            Refusal::Task(refusal) => self.task_refusal(refusal),
            _ => {}
        }
    }

    pub fn task_refusal(&mut self, refusal: &TaskRefusal) {
        self.variant(refusal);
        match refusal {
            TaskRefusal::JointServo(refusal) => {
                self.variant(refusal);
                if let JointServoRefusal::Limit(limit) = refusal {
                    self.variant(limit);
                }
            }
            TaskRefusal::Grasping(refusal) => self.grasp_refusal(refusal),
            TaskRefusal::Impedance(refusal) => self.impedance_refusal(refusal),
            TaskRefusal::Telexistence(refusal) => self.telexistence_refusal(refusal),
            TaskRefusal::VisualApproach(refusal) => self.visual_approach_refusal(refusal),
        }
    }

    pub fn grasp_refusal(&mut self, refusal: &GraspRefusal) {
        self.variant(refusal);
        match refusal {
            GraspRefusal::Busy(phase) => self.variant(phase),
            GraspRefusal::Plan(plan) => {
                self.variant(plan);
                if let InvalidPlan::Value { field, .. } = plan {
                    self.variant(field);
                }
            }
            GraspRefusal::Limit(limit) => self.variant(limit),
            _ => {}
        }
    }

    pub fn impedance_refusal(&mut self, refusal: &ImpedanceRefusal) {
        self.variant(refusal);
        match refusal {
            ImpedanceRefusal::Settings(invalid) => {
                self.variant(invalid);
                if let InvalidImpedanceSettings::Impedance(InvalidImpedance { term, .. }) = invalid {
                    self.variant(term);
                }
            }
            ImpedanceRefusal::Setpoint(error) => self.variant(error),
            _ => {}
        }
    }

    pub fn telexistence_refusal(&mut self, refusal: &TelexistenceRefusal) {
        self.variant(refusal);
        if let TelexistenceRefusal::Settings(invalid) = refusal {
            self.variant(invalid);
            if let InvalidTelexistenceSettings::Retargeting(OutOfRange { field, .. }) = invalid {
                self.variant(field);
            }
        }
    }

    pub fn visual_approach_refusal(&mut self, refusal: &VisualApproachRefusal) {
        self.variant(refusal);
        match refusal {
            VisualApproachRefusal::Limit(limit) => self.variant(limit),
            VisualApproachRefusal::Value { field, .. } => self.variant(field),
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
                    Reply::Task(report) => self.telemetry(&report.telemetry),
                    _ => {}
                }
            }
            FromBoard::Telemetry(telemetry) => self.mode(telemetry.mode),
            FromBoard::Status(status) => self.status(status),
            FromBoard::Log(entry) => self.record(&entry.record),
            FromBoard::Tips(_) => {}
            FromBoard::Task(report) => self.telemetry(&report.telemetry),
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
