//! One of each refusal.

use tesaki::OutOfRange;
use tesaki::control::{ImpedanceTerm, InvalidImpedance};
use tesaki::fault::{Fault, FaultCause};
use tesaki::model::{Field, ModelError, Problem};
use tesaki::protocol::{Mode, Refusal, Reply};
use tesaki::robot::LimitRefusal;
use tesaki::task::TaskRefusal;
use tesaki::task::grasping::{GraspRefusal, InvalidPlan, PlanField};
use tesaki::task::impedance::{ImpedanceRefusal, InvalidImpedanceSettings, SetpointError};
use tesaki::task::joint_servo::JointServoRefusal;
use tesaki::task::telexistence::{InvalidTelexistenceSettings, TelexistenceRefusal};
use tesaki::task::visual_approach::{VisualApproachField, VisualApproachRefusal};
use tesaki::teleop::RetargetField;

use super::messages::Messages;
use super::values::{PHASES, SCHEMA, TASKS};
use super::variants::Variants;

const PLAN_FIELDS: [(PlanField, &str); PlanField::VARIANTS.len()] = [
    (PlanField::Clearance, "clearance"),
    (PlanField::TouchForce, "touch-force"),
    (PlanField::Friction, "friction"),
    (PlanField::ForceLimit, "force-limit"),
    (PlanField::Margin, "margin"),
    (PlanField::Capacity, "capacity"),
    (PlanField::Strength, "strength"),
    (PlanField::Gain, "gain"),
    (PlanField::Mass, "mass"),
];

const RETARGET_FIELDS: [(RetargetField, &str); RetargetField::VARIANTS.len()] = [
    (RetargetField::Fingers, "fingers"),
    (RetargetField::Follows, "follows"),
    (RetargetField::Weights, "weights"),
    (RetargetField::Scale, "scale"),
    (RetargetField::Near, "near"),
    (RetargetField::Far, "far"),
    (RetargetField::OperatorContact, "operator-contact"),
    (RetargetField::RobotContact, "robot-contact"),
    (RetargetField::Speeds, "speeds"),
    (RetargetField::Tolerance, "tolerance"),
];

const APPROACH_FIELDS: [(VisualApproachField, &str); VisualApproachField::VARIANTS.len()] = [
    (VisualApproachField::Speed, "speed"),
    (VisualApproachField::Acceleration, "acceleration"),
    (VisualApproachField::ContactForce, "contact-force"),
    (VisualApproachField::Reach, "reach"),
    (VisualApproachField::GripperRange, "gripper-range"),
    (VisualApproachField::GripperSpeed, "gripper-speed"),
    (VisualApproachField::GripperTorque, "gripper-torque"),
];

const fn invalid_impedance(
    term: ImpedanceTerm,
    axis: u8,
    value: f32,
    limit: f32,
) -> InvalidImpedanceSettings {
    InvalidImpedanceSettings::Impedance(InvalidImpedance { term, axis, value, limit })
}

const INVALID_SETTINGS: [(InvalidImpedanceSettings, &str); 17] = [
    (invalid_impedance(ImpedanceTerm::Mass, 4, 0.0, 1e4), "impedance-mass"),
    (invalid_impedance(ImpedanceTerm::Damping, 0, -1.0, 150.0), "impedance-damping"),
    (invalid_impedance(ImpedanceTerm::Stiffness, 5, 4000.0, 3750.0), "impedance-stiffness"),
    (InvalidImpedanceSettings::Joint { joint: 7, joints: 7 }, "joint"),
    (InvalidImpedanceSettings::NoArmAngle, "no-arm-angle"),
    (InvalidImpedanceSettings::ElbowBandwidth { value: 60.0, limit: 50.0 }, "elbow-bandwidth"),
    (InvalidImpedanceSettings::ContactForce { value: -1.0 }, "contact-force"),
    (InvalidImpedanceSettings::MaxDeviation { value: 0.0 }, "max-deviation"),
    (InvalidImpedanceSettings::ForceBandwidth { value: 60.0, limit: 50.0 }, "force-bandwidth"),
    (InvalidImpedanceSettings::NoRedundantJoint, "no-redundant-joint"),
    (InvalidImpedanceSettings::Friction { value: 1.5 }, "friction"),
    (invalid_impedance(ImpedanceTerm::MassMatrix, 1, -1.0, 0.5), "impedance-mass-matrix"),
    (invalid_impedance(ImpedanceTerm::DampingMatrix, 1, -1.0, 0.0), "impedance-damping-matrix"),
    (invalid_impedance(ImpedanceTerm::StiffnessMatrix, 1, -1.0, 0.0), "impedance-stiffness-matrix"),
    (invalid_impedance(ImpedanceTerm::DampingToMass, 3, -1.0, 0.0), "impedance-damping-to-mass"),
    (invalid_impedance(ImpedanceTerm::StiffnessToMass, 3, -1.0, 0.0), "impedance-stiffness-to-mass"),
    (
        InvalidImpedanceSettings::MassInContact { axis: 2, value: 0.5, own: 4.0, limit: 1.0 },
        "mass-in-contact",
    ),
];

const SETPOINT_ERRORS: [(SetpointError, &str); SetpointError::VARIANTS.len()] = [
    (SetpointError::Distance { value: 1.0, limit: 0.25 }, "distance"),
    (SetpointError::Rotation { value: 3.125, limit: 1.5 }, "rotation"),
    (SetpointError::NotFinite, "not-finite"),
    (SetpointError::NotUnit { norm: 0.5 }, "not-unit"),
    (SetpointError::Elbow { value: 2.0, limit: 1.5 }, "elbow"),
];

const LIMITS: [(LimitRefusal, &str); LimitRefusal::VARIANTS.len()] = [
    (LimitRefusal::JointCount { got: 2, expected: 9 }, "joint-count"),
    (LimitRefusal::NotFinite { joint: 15 }, "not-finite"),
    (LimitRefusal::OutsideLimits { joint: 0, value: 2.0, lower: -1.5, upper: 1.5 }, "outside-limits"),
    (LimitRefusal::TooFast { joint: 1, value: 9.0, limit: 8.0 }, "too-fast"),
    (LimitRefusal::Jump { joint: 2, value: 0.5, limit: 0.25 }, "jump"),
    (LimitRefusal::TooMuchAcceleration { joint: 3, value: 9000.0, limit: 2857.0 }, "too-much-acceleration"),
    (LimitRefusal::TooMuchTorque { joint: 3, value: 0.75, limit: 0.6 }, "too-much-torque"),
];

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
    (Field::MimicJoint, "mimic-joint"),
    (Field::MimicMultiplier, "mimic-multiplier"),
    (Field::MimicOffset, "mimic-offset"),
    (Field::MimicForceSensor, "mimic-force-sensor"),
    (Field::EncoderRelative, "encoder-relative"),
    (Field::MotorResistance, "motor-resistance"),
    (Field::MotorInductance, "motor-inductance"),
    (Field::MimicChain, "mimic-chain"),
    (Field::MimicPlace, "mimic-place"),
    (Field::Gauges, "gauges"),
    (Field::CalibrationMatrix, "calibration-matrix"),
    (Field::GaugeRange, "gauge-range"),
    (Field::GaugeGains, "gauge-gains"),
];

impl Messages {
    fn refused(&mut self, name: &str, refusal: Refusal) {
        self.reply(&format!("refused-{name}"), Reply::Refused(refusal));
    }

    pub fn refusals(&mut self) {
        self.refused("schema-mismatch", Refusal::SchemaMismatch { board: SCHEMA, firmware: [0, 1, 0] });
        self.refused("wrong-mode-disabled", Refusal::WrongMode(Mode::Disabled));
        self.refused("wrong-mode-fault", Refusal::WrongMode(Mode::Fault));
        self.refused("commanded", Refusal::Commanded { by: 0x00de_cade });
        self.refused("not-commander", Refusal::NotCommander);
        self.refused("stale", Refusal::Stale { latest: 12 });
        self.refused("faults-unread", Refusal::FaultsUnread { total: 3 });
        self.refused("no-model", Refusal::NoModel);
        self.refused("model-transfer", Refusal::ModelTransfer { received: 192, announced: 220 });
        let (received, announced) = (0x0102_0304, 0xdead_beef);
        self.refused("model-checksum", Refusal::ModelChecksum { received, announced });
        self.refused("model-unreadable", Refusal::ModelUnreadable { length: 5000, limit: 4096 });
        self.refused("no-sensors", Refusal::NoSensors);
        let (cause, joint) = (FaultCause::SupplyLow, None);
        let fault = Fault { cause, joint, value: 12.0, limit: 20.0, tick: 1234 };
        self.refused("unsafe", Refusal::Unsafe(fault));
        self.refused("not-homed", Refusal::NotHomed { joint: 8 });
        self.refused("no-force-sensor", Refusal::NoForceSensor);
        self.refused("not-exported", Refusal::NotExported { length: 0 });
        self.refused("no-task", Refusal::NoTask);
        for (task, name) in TASKS {
            self.refused(&format!("wrong-mode-{name}"), Refusal::WrongMode(Mode::Enabled(task)));
            self.refused(&format!("other-task-{name}"), Refusal::OtherTask(task));
        }
        for (limit, name) in LIMITS {
            self.refused(&format!("limit-{name}"), Refusal::Limit(limit));
        }
        self.model_refusals();
        self.joint_servo_refusals();
        self.grasping_refusals();
        self.impedance_refusals();
        self.telexistence_refusals();
        self.visual_approach_refusals();
    }

    fn model_refusals(&mut self) {
        let mut model = |name: &str, joint, field, value, problem| {
            self.refused(name, Refusal::Model(ModelError { joint, field, value, problem }));
        };
        model("model-not-finite", None, Field::Gravity, f32::INFINITY, Problem::NotFinite);
        model("model-below", Some(3), Field::Mass, -0.5, Problem::Below(0.0));
        model("model-not-above", Some(15), Field::LimitUpper, 1.0, Problem::NotAbove(1.0));
        model("model-above", Some(0), Field::MotorDelay, 0.5, Problem::Above(0.01));
        model("model-not-unit", Some(1), Field::Axis, 0.5, Problem::NotUnit);
        model("model-not-physical", Some(2), Field::Inertia, -0.125, Problem::NotPhysical);
        model("model-count", None, Field::Chains, 8.0, Problem::Count(9.0));
        model("model-not-unique", Some(4), Field::Name, 4.0, Problem::NotUnique);
        model("model-no-such-joint", Some(8), Field::MimicJoint, 7.0, Problem::NoSuchJoint);
        model("model-not-supported", Some(8), Field::MimicMultiplier, 0.0, Problem::NotSupported);
        model("model-board-limit", Some(3), Field::Joints, 9.0, Problem::BoardLimit(3.0));
        model("model-missing", Some(2), Field::MotorResistance, 0.0, Problem::Missing);
        model("model-singular", Some(2), Field::CalibrationMatrix, 0.001, Problem::Singular);
        for (field, name) in FIELDS {
            model(&format!("field-{name}"), Some(7), field, 0.5, Problem::NotFinite);
        }
    }

    fn joint_servo_refusals(&mut self) {
        let mut refused = |name: &str, refusal| {
            let refusal = Refusal::Task(TaskRefusal::JointServo(refusal));
            self.refused(&format!("joint-servo-{name}"), refusal);
        };
        let outside = LimitRefusal::OutsideLimits { joint: 0, value: 2.0, lower: -1.5, upper: 1.5 };
        refused("limit", JointServoRefusal::Limit(outside));
        refused("tip-count", JointServoRefusal::TipCount { got: 1, expected: 3 });
        refused("not-a-finger", JointServoRefusal::NotAFinger { chain: 2 });
        let nearest = [0.1, 0.0, -0.25];
        refused("out-of-reach", JointServoRefusal::OutOfReach { chain: 1, nearest });
        refused("singular", JointServoRefusal::Singular { chain: 0 });
        refused("tip-not-finite", JointServoRefusal::TipNotFinite { chain: 2 });
    }

    fn grasping_refusals(&mut self) {
        let mut refused = |name: &str, refusal| {
            self.refused(&format!("grasping-{name}"), Refusal::Task(TaskRefusal::Grasping(refusal)));
        };
        refused("not-a-hand", GraspRefusal::NotAHand);
        refused("not-tared", GraspRefusal::NotTared { chain: 1 });
        for (phase, name) in PHASES {
            refused(&format!("busy-{name}"), GraspRefusal::Busy(phase));
        }
        let (value, lower, upper) = (2.0, 0.25, 1.0);
        for (field, name) in PLAN_FIELDS {
            let plan = InvalidPlan::Value { field, value, lower, upper };
            refused(&format!("plan-{name}"), GraspRefusal::Plan(plan));
        }
        refused("plan-contact", GraspRefusal::Plan(InvalidPlan::Contact { finger: 2 }));
        refused("plan-no-triangle", GraspRefusal::Plan(InvalidPlan::NoTriangle));
        refused("plan-cannot-grip", GraspRefusal::Plan(InvalidPlan::CannotGrip));
        refused("plan-unbalanced", GraspRefusal::Plan(InvalidPlan::Unbalanced { residual: 0.25 }));
        refused("out-of-reach", GraspRefusal::OutOfReach { finger: 1, nearest: [0.1, 0.0, -0.25] });
        refused("not-finite", GraspRefusal::NotFinite);
        refused("too-fast", GraspRefusal::TooFast { value: 0.375, limit: 0.2 });
        let outside = LimitRefusal::OutsideLimits { joint: 0, value: 2.0, lower: -1.5, upper: 1.5 };
        refused("limit", GraspRefusal::Limit(outside));
    }

    fn telexistence_refusals(&mut self) {
        let mut refused = |name: &str, refusal| {
            self.refused(&format!("telexistence-{name}"), Refusal::Task(TaskRefusal::Telexistence(refusal)));
        };
        refused("not-a-hand", TelexistenceRefusal::NotAHand);
        for (field, name) in RETARGET_FIELDS {
            let invalid = OutOfRange { field, value: 2.0, min: 0.25, max: 1.0 };
            let invalid = InvalidTelexistenceSettings::Retargeting(invalid);
            refused(&format!("settings-{name}"), TelexistenceRefusal::Settings(invalid));
        }
        let acceleration = InvalidTelexistenceSettings::Acceleration { value: 0.5 };
        refused("settings-acceleration", TelexistenceRefusal::Settings(acceleration));
        let max_sample_age = InvalidTelexistenceSettings::MaxSampleAge { value: 3.0 };
        refused("settings-max-sample-age", TelexistenceRefusal::Settings(max_sample_age));
        refused("fingertip", TelexistenceRefusal::Fingertip { finger: 4 });
        refused("age", TelexistenceRefusal::Age { value: 1.5 });
    }

    fn visual_approach_refusals(&mut self) {
        let mut refused = |name: &str, refusal| {
            let refusal = Refusal::Task(TaskRefusal::VisualApproach(refusal));
            self.refused(&format!("visual-approach-{name}"), refusal);
        };
        refused("no-chain", VisualApproachRefusal::NoChain { chain: 3 });
        refused("no-gripper", VisualApproachRefusal::NoGripper { joint: 2 });
        for (limit, name) in LIMITS {
            refused(&format!("limit-{name}"), VisualApproachRefusal::Limit(limit));
        }
        for (field, name) in APPROACH_FIELDS {
            let (value, lower, upper) = (2.0, 0.25, 1.0);
            refused(name, VisualApproachRefusal::Value { field, value, lower, upper });
        }
        refused("target", VisualApproachRefusal::Target { distance: 0.75, reach: 0.5 });
        refused("too-fast", VisualApproachRefusal::Speed { value: 0.25, limit: 0.125 });
        refused("blocked", VisualApproachRefusal::Blocked { ahead: 0.03125 });
        let (tilt, offset) = (0.0625, 0.007_812_5);
        refused("gripper-axis", VisualApproachRefusal::GripperAxis { joint: 6, tilt, offset });
        refused("singular", VisualApproachRefusal::Singular { chain: 3 });
    }

    fn impedance_refusals(&mut self) {
        let mut refused = |name: &str, refusal| {
            self.refused(&format!("impedance-{name}"), Refusal::Task(TaskRefusal::Impedance(refusal)));
        };
        refused("not-an-arm", ImpedanceRefusal::NotAnArm);
        refused("not-tared", ImpedanceRefusal::NotTared { chain: 0 });
        refused("no-force-sensor", ImpedanceRefusal::NoForceSensor);
        refused("force-source-in-use", ImpedanceRefusal::ForceSourceInUse);
        for (invalid, name) in INVALID_SETTINGS {
            refused(&format!("settings-{name}"), ImpedanceRefusal::Settings(invalid));
        }
        for (error, name) in SETPOINT_ERRORS {
            refused(&format!("setpoint-{name}"), ImpedanceRefusal::Setpoint(error));
        }
    }
}
