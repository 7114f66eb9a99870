//! One of each reply, refusal and stream.

use tesaki::arm::ArmTelemetry;
use tesaki::manipulation::{BadPlan, Failure, GraspTelemetry, Phase, Unable};
use tesaki::model::{Field, ModelError, Problem};
use tesaki::protocol::{
    Fault, FaultCause, FaultLog, FromBoard, JointTelemetry, LogEntry, Mode, Refusal, Reply, Task, Telemetry,
    TipTelemetry, Tips,
};

use super::message::Message;
use super::messages::Messages;
use super::values::{
    ARM_ERRORS, BAD_SETTINGS, CAUSES, FAILURES, FIELDS, HOLDING, IDENTITY, NO_GRASP, OBSERVER, PHASES, PID,
    PLAN_FIELDS, PUSHED, SCHEMA, list, records, statuses,
};

impl Messages {
    fn refused(&mut self, name: &str, refusal: Refusal) {
        self.reply(&format!("refused-{name}"), Reply::Refused(refusal));
    }

    pub fn refusals(&mut self) {
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
        self.refused("not-a-finger", Refusal::NotAFinger { chain: 2 });
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

    pub fn unable(&mut self) {
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

    pub fn board(&mut self) {
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
            failure: Some(Failure::NoGrip { force: 0.25, limit: 3.0 }),
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
}
