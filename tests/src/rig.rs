//! A node on an imagined board: requests by one client, and encoders that read what a test says.

use tesaki::model::RobotModel;
use tesaki::node::Node;
use tesaki::protocol::{BoardStatus, Mode, Reply, Request, RequestFrame, SensorFlags, SensorFrame};
use tesaki::task::TaskTelemetry;

use crate::set_up;

/// A node that has a model and a commander.
pub struct Rig {
    /// The node.
    pub node: Box<Node>,
    sequence: u16,
    tick: u32,
}

impl Rig {
    /// With the model of a robot; nothing has been sensed yet.
    ///
    /// # Panics
    /// When the node refuses the model.
    pub fn new(model: &RobotModel) -> Self {
        let mut rig = Self { node: Box::new(Node::new()), sequence: 0, tick: 0 };
        for request in set_up(model) {
            assert!(!matches!(rig.ask(request), Reply::Refused(_)));
        }
        rig
    }

    /// The node's reply to a request.
    pub fn ask(&mut self, request: Request) -> Reply {
        self.sequence += 1;
        let frame = RequestFrame { client: 7, sequence: self.sequence, request };
        self.node.handle(&frame, &BoardStatus::default()).reply
    }

    /// Telemetry of the task.
    ///
    /// # Panics
    /// When there is none.
    pub fn telemetry(&mut self) -> TaskTelemetry {
        match self.ask(Request::ReadTask) {
            Reply::Task(report) => report.telemetry,
            other => panic!("{other:?}"),
        }
    }

    /// A tick with these encoder counts, without currents and forces.
    pub fn sense(&mut self, counts: impl Iterator<Item = i32>) {
        self.tick += 1;
        let encoders: heapless::Vec<_, _> = counts.collect();
        self.node.tick(&SensorFrame {
            sequence: self.tick,
            flags: SensorFlags(0),
            supply: 24_000,
            currents: encoders.iter().map(|_| 0).collect(),
            encoders,
            forces: heapless::Vec::new(),
        });
    }

    /// The number of the last tick.
    pub const fn tick(&self) -> u32 {
        self.tick
    }

    /// Fails unless the node is enabled.
    ///
    /// # Panics
    /// When it is not, with its faults.
    pub fn assert_enabled(&self) {
        assert!(matches!(self.node.mode(), Mode::Enabled(_)), "{:?}", self.node.faults());
    }
}
