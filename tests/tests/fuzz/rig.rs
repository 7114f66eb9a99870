//! A node under test, and a twin that afterwards goes through the same again.

use tesaki::model::RobotModel;
use tesaki::node::{Node, Replay};
use tesaki::protocol::codec::checksum;
use tesaki::protocol::{
    BoardStatus, LogRecord, MODEL_CHUNK, Mode, Reply, Request, RequestFrame, SCHEMA_KEY, SensorFlags,
    SensorFrame,
};

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
        let sensors = SensorFrame {
            sequence: 0,
            flags: SensorFlags(0),
            supply,
            encoders: model.joints.iter().map(|_| 0).collect(),
            currents: model.joints.iter().map(|_| 0).collect(),
            forces: model.chains.iter().filter_map(|chain| chain.force_sensor).map(|_| [0; 6]).collect(),
        };
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
    let board = BoardStatus::default();
    let mut sequence = 0_u16;
    let mut ask = |node: &mut Node, request| {
        sequence += 1;
        let reply = node.handle(&RequestFrame { client: 1, sequence, request }, &board).reply;
        assert!(!matches!(reply, Reply::Refused(_)), "{reply:?}");
    };
    ask(&mut node, Request::Hello { schema: SCHEMA_KEY });
    ask(&mut node, Request::TakeCommand { by_force: false });
    let bytes = postcard::to_stdvec(model).unwrap();
    ask(&mut node, Request::ModelBegin { length: bytes.len() as u32, checksum: checksum(&bytes) });
    for (offset, data) in (0..).step_by(MODEL_CHUNK).zip(bytes.chunks(MODEL_CHUNK)) {
        ask(&mut node, Request::ModelChunk { offset, data: heapless::Vec::from_slice(data).unwrap() });
    }
    ask(&mut node, Request::ModelCommit);
    (node, sequence)
}
