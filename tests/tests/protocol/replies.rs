//! One of each reply except the refusals, and one of each stream.

use tesaki::fault::{Fault, FaultLog};
use tesaki::model::Pose;
use tesaki::protocol::{
    FromBoard, JointTelemetry, LogEntry, LogRecord, Mode, Reply, TaskReport, Telemetry, TipTelemetry, Tips,
};
use tesaki::task::grasping::{Failure, GraspTelemetry, Phase};
use tesaki::task::impedance::ImpedanceTelemetry;
use tesaki::task::telexistence::TelexistenceTelemetry;
use tesaki::task::visual_approach::{GripperState, HandMotion, VisualApproachTelemetry};
use tesaki::task::{TaskKind, TaskTelemetry};

use super::message::Message;
use super::messages::Messages;
use super::values::{
    APPROACHING, CAUSES, FAILURES, GRIPPER_STATES, GRIPPING, HOLDING, IDENTITY, MOTIONS, NO_GRASP, PHASES,
    PUSHED, REPRODUCED, SCHEMA, STATE, full_sensors, list, records, statuses,
};

impl Messages {
    pub fn board(&mut self) {
        self.reply("hello", Reply::Hello { schema: SCHEMA, identity: IDENTITY });
        self.reply("done", Reply::Done);
        self.reply_to("done-first-number", 1, 0, 0, Reply::Done);
        self.reply_to("done-last-number", u32::MAX, u16::MAX, u32::MAX, Reply::Done);
        let status = statuses().remove("fault").unwrap();
        self.add("board-stream-status", Message::Board(FromBoard::Status(status)));
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
        let second = CAUSES.iter().skip(16).take(16).map(|&cause| Fault {
            cause,
            joint: None,
            value: 2.0,
            limit: 0.0,
            tick: 0,
        });
        self.reply("faults-16-to-31", Reply::Faults(FaultLog { total: u32::MAX, faults: list(second) }));
        let last = Fault { cause: CAUSES[32], joint: Some(5), value: 3.0, limit: 0.0, tick: 70 };
        self.reply("faults-32", Reply::Faults(FaultLog { total: 33, faults: list([last]) }));
        let [low, off] = [(33, 1.0, 0.0), (34, 0.0, 3.0)].map(|(number, value, limit)| Fault {
            cause: CAUSES[number],
            joint: None,
            value,
            limit,
            tick: 0,
        });
        self.reply("faults-33-and-34", Reply::Faults(FaultLog { total: 35, faults: list([low, off]) }));
        let (length, checksum, index) = (220, 0xdead_beef, 2469);
        self.reply("exported", Reply::Exported { length, checksum, index, key: STATE });
        self.reply("chunk", Reply::Chunk { offset: 192, data: list([0, 1, 254, 255]) });
        self.reply("chunk-long", Reply::Chunk { offset: 0, data: list(0..192) });
    }

    pub fn streams(&mut self) {
        let mut telemetry =
            |name: &str, tick, mode, faults, joints: &[[f32; 4]]| {
                let joints = list(joints.iter().map(|&[position, velocity, reference, torque]| {
                    JointTelemetry { position, velocity, reference, torque }
                }));
                let telemetry = Telemetry { tick, mode, faults, joints };
                self.add(format!("board-{name}"), Message::Board(FromBoard::Telemetry(telemetry)));
            };
        telemetry("telemetry-none", 0, Mode::Disabled, 0, &[]);
        let two = [[0.5, -0.25, 0.5625, 0.03125], [-0.5, 0.25, -0.5625, -0.03125]];
        telemetry("telemetry-joint-servo", 1234, Mode::Enabled(TaskKind::JointServo), 0, &two);
        telemetry("telemetry-grasping", 1235, Mode::Enabled(TaskKind::Grasping), 0, &two[..1]);
        telemetry("telemetry-impedance", 1236, Mode::Enabled(TaskKind::Impedance), 0, &two[..1]);
        telemetry("telemetry-telexistence", 1237, Mode::Enabled(TaskKind::Telexistence), 0, &two[..1]);
        telemetry("telemetry-16", u32::MAX, Mode::Fault, u32::MAX, &[[f32::MIN; 4]; 16]);
        telemetry("session-telemetry", 3, Mode::Enabled(TaskKind::JointServo), 0, &[[0.0; 4]]);
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
        self.task("joint-servo", 1234, TaskTelemetry::JointServo(()));
        self.read_task("joint-servo", 1234, TaskTelemetry::JointServo(()));
        self.grasping_telemetry();
        self.impedance_telemetry();
        self.telexistence_telemetry();
        self.visual_approach_telemetry();
    }

    fn task(&mut self, name: &str, tick: u32, telemetry: TaskTelemetry) {
        let report = TaskReport { tick, telemetry };
        self.add(format!("board-task-{name}"), Message::Board(FromBoard::Task(report)));
    }

    fn read_task(&mut self, name: &str, tick: u32, telemetry: TaskTelemetry) {
        self.reply(&format!("read-task-{name}"), Reply::Task(TaskReport { tick, telemetry }));
    }

    fn grasping_telemetry(&mut self) {
        self.task("grasping", 1234, TaskTelemetry::Grasping(HOLDING));
        let longest = GraspTelemetry {
            phase: Phase::Open,
            failure: Some(Failure::NoGrip { force: 0.25, limit: 3.0 }),
            position: [f32::MIN; 3],
            orientation: [f32::MIN; 4],
            load: [f32::MIN; 6],
            target_forces: [[f32::MIN; 3]; 3],
            friction: f32::MIN,
            slips: u16::MAX,
            overloaded: true,
        };
        self.task("grasping-longest", u32::MAX, TaskTelemetry::Grasping(longest));
        self.read_task("grasping", 1234, TaskTelemetry::Grasping(NO_GRASP));
        for (phase, name) in PHASES {
            let grasp = GraspTelemetry { phase, slips: 0, overloaded: true, ..HOLDING };
            self.read_task(&format!("grasping-{name}"), 1233, TaskTelemetry::Grasping(grasp));
        }
        for (failure, name) in FAILURES {
            let grasp = GraspTelemetry { failure: Some(failure), ..NO_GRASP };
            self.read_task(&format!("grasping-{name}"), 1234, TaskTelemetry::Grasping(grasp));
        }
    }

    fn impedance_telemetry(&mut self) {
        self.task("impedance", 1234, TaskTelemetry::Impedance(PUSHED));
        let longest = ImpedanceTelemetry {
            position: [f32::MIN; 3],
            rotation: [f32::MIN; 4],
            error: [f32::MIN; 6],
            wrench: [f32::MIN; 6],
            contact: true,
            sigma_min: f32::MIN,
            elbow: f32::MIN,
            derating: f32::MIN,
        };
        self.task("impedance-longest", u32::MAX, TaskTelemetry::Impedance(longest));
        self.read_task("impedance", 1234, TaskTelemetry::Impedance(PUSHED));
    }

    fn telexistence_telemetry(&mut self) {
        self.task("telexistence", 1234, TaskTelemetry::Telexistence(REPRODUCED));
        let longest = TelexistenceTelemetry {
            samples: u32::MAX,
            ignored: u32::MAX,
            age: u8::MAX,
            errors: [f32::MIN; 5],
            missed: u8::MAX,
            unknown: u8::MAX,
            limited: u16::MAX,
        };
        self.task("telexistence-longest", u32::MAX, TaskTelemetry::Telexistence(longest));
        self.read_task("telexistence", 1234, TaskTelemetry::Telexistence(REPRODUCED));
    }

    fn visual_approach_telemetry(&mut self) {
        for (motion, name) in MOTIONS {
            let moves = VisualApproachTelemetry { motion, ..APPROACHING };
            self.task(&format!("visual-approach-{name}"), 1234, TaskTelemetry::VisualApproach(moves));
        }
        for (gripper, name) in GRIPPER_STATES {
            let grips = VisualApproachTelemetry { gripper, ..GRIPPING };
            self.task(&format!("visual-approach-{name}"), 1234, TaskTelemetry::VisualApproach(grips));
        }
        let pose = Pose { translation: [f32::MIN; 3], rotation: [f32::MIN; 4] };
        let longest = VisualApproachTelemetry {
            hand: pose,
            latched: Some((u16::MAX, pose)),
            motion: HandMotion::Limited,
            remaining: f32::MIN,
            force: [f32::MIN; 3],
            gripper: GripperState::Empty,
            opening: f32::MIN,
        };
        self.task("visual-approach-longest", u32::MAX, TaskTelemetry::VisualApproach(longest));
        self.read_task("visual-approach", 1234, TaskTelemetry::VisualApproach(GRIPPING));
    }

    pub fn records(&mut self) {
        for (index, (name, record)) in (2468..).zip(records()) {
            self.add(
                format!("board-log-{name}"),
                Message::Board(FromBoard::Log(LogEntry { index, record: record.clone() })),
            );
            self.add(format!("record-{name}"), Message::Record(record));
        }
        let record = LogRecord::Sensors(full_sensors());
        let longest = FromBoard::Log(LogEntry { index: u32::MAX, record });
        self.add("board-log-longest", Message::Board(longest));
    }
}
