//! One of each refusal.

use tesaki::OutOfRange;
use tesaki::fault::{Fault, FaultCause};
use tesaki::model::{Field, ModelError, Problem};
use tesaki::protocol::{Mode, Refusal, Reply};
use tesaki::robot::LimitRefusal;
use tesaki::task::TaskRefusal;
use tesaki::task::grasping::{GraspRefusal, InvalidPlan};
use tesaki::task::impedance::ImpedanceRefusal;
use tesaki::task::joint_servo::JointServoRefusal;
use tesaki::task::telexistence::{InvalidTelexistenceSettings, TelexistenceRefusal};

use tesaki::task::visual_approach::VisualApproachRefusal;

use super::messages::Messages;
use super::values::{
    APPROACH_FIELDS, FIELDS, INVALID_SETTINGS, LIMITS, PHASES, PLAN_FIELDS, RETARGET_FIELDS, SCHEMA,
    SETPOINT_ERRORS, TASKS,
};

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
