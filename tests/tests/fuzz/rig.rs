//! A node under test, and a twin that afterwards goes through the same again.

use tesaki::model::RobotModel;
use tesaki::node::{Node, Replay};
use tesaki::protocol::{BoardStatus, LogRecord, Mode, Reply, Request, RequestFrame, SensorFrame};
use tesaki_tests::{set_up, zero_sensors};

/// A node with a model, commanded by client 1, and what went in and out of it.
pub struct Rig {
    pub node: Box<Node>,
    /// What the sensors read next; at first zeros.
    pub sensors: SensorFrame,
    /// Of the last request of client 1.
    pub sequence: u16,
    twin: Box<Node>,
    records: Vec<LogRecord>,
    last: Vec<f32>,
    seed: u64,
}

impl Rig {
    /// `supply` [mV].
    pub fn new(model: &RobotModel, supply: u16, seed: u64) -> Self {
        let ((node, sequence), (twin, _)) = (prepared(model), prepared(model));
        let sensors = zero_sensors(model, supply);
        let last = vec![0.0; model.joints.len()];
        Self { node, sensors, sequence, twin, records: Vec::new(), last, seed }
    }

    pub fn ask(&mut self, request: Request) -> Reply {
        self.sequence = self.sequence.wrapping_add(1);
        self.send(RequestFrame { client: 1, sequence: self.sequence, request })
    }

    pub fn send(&mut self, frame: RequestFrame) -> Reply {
        let reply = self.node.handle(&frame, &BoardStatus::default()).reply;
        self.records.push(LogRecord::Request(frame));
        reply
    }

    /// Ticks, and checks that the torques are within their limits and their rates.
    pub fn tick(&mut self, frame: SensorFrame) {
        let seed = self.seed;
        let actuators = self.node.tick(&frame);
        let robot = self.node.robot().unwrap().model();
        assert_eq!(actuators.torques.len(), robot.joints.len());
        for ((torque, joint), last) in actuators.torques.iter().zip(&robot.joints).zip(&mut self.last) {
            assert!(torque.is_finite() && torque.abs() <= joint.limits.torque, "seed {seed}: {torque}");
            assert!(actuators.enabled || *torque == 0.0, "seed {seed}");
            let rate = joint.limits.torque_rate * 0.01 * 1.0001;
            assert!(*torque == 0.0 || (torque - *last).abs() <= rate, "seed {seed}: from {last} to {torque}");
            *last = *torque;
        }
        assert!(!(actuators.enabled && self.node.mode() == Mode::Disarmed), "seed {seed}");
        self.records.push(LogRecord::Sensors(frame));
        self.records.push(LogRecord::Actuators(actuators));
    }

    /// The same again gives the same again.
    pub fn replay(mut self) {
        let mut replay = Replay::new(&mut self.twin);
        for record in &self.records {
            replay.feed(record).unwrap_or_else(|error| panic!("seed {}: {error}", self.seed));
        }
    }
}

/// A node with a model, commanded by client 1, and the number of the last request.
fn prepared(model: &RobotModel) -> (Box<Node>, u16) {
    let mut node = Box::new(Node::new());
    let mut sequence = 0;
    for request in set_up(model) {
        sequence += 1;
        let frame = RequestFrame { client: 1, sequence, request };
        let reply = node.handle(&frame, &BoardStatus::default()).reply;
        assert!(!matches!(reply, Reply::Refused(_)), "{reply:?}");
    }
    (node, sequence)
}
