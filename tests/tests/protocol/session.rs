//! The link to the plant, and the session of `docs/protocol.md`.

use tesaki::model::Reaction;
use tesaki::protocol::codec::checksum;
use tesaki::protocol::{
    ActuatorFrame, Mode, NodeStatus, Refusal, Reply, Request, SensorFrame, Status, Stream,
};
use tesaki::robot::LimitRefusal;
use tesaki::task::joint_servo::{JointCommand, JointServoRefusal};
use tesaki::task::{TaskCommand, TaskConfig, TaskRefusal};

use super::message::Message;
use super::messages::Messages;
use super::values::{CLIENT, IDENTITY, OBSERVER, SCHEMA, finger, list, quiet_board, sensor_frame};

impl Messages {
    pub fn plant_link(&mut self) {
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

    pub fn session(&mut self) {
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
        step("enable", Request::Enable(TaskConfig::JointServo(OBSERVER)), Reply::Done, 2);
        let goal =
            |angle| Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions: list([angle]) }));
        step("goal", goal(0.5), Reply::Done, 3);
        let outside = LimitRefusal::OutsideLimits { joint: 0, value: 2.0, lower: -1.5, upper: 1.5 };
        let outside = Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(outside)));
        step("goal-outside", goal(2.0), Reply::Refused(outside), 3);
        step("disable", Request::Disable, Reply::Done, 3);
        let node = NodeStatus {
            mode: Mode::Disabled,
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
