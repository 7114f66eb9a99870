//! A test rig: a node with a simulated board, and a robot model.

use heapless::Vec;

use crate::TICK;
use crate::control::ServoMode;
use crate::fault::Fault;
use crate::model::{MAX_JOINTS, RobotModel};
use crate::node::Node;
use crate::protocol::{
    ActuatorFrame, BoardStatus, Item, MODEL_CHUNK, Mode, Refusal, Reply, Request, RequestFrame, SCHEMA_KEY,
    SensorFlags, SensorFrame, codec,
};
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig};
pub use crate::test_support::finger as model;

pub const COUNTS_PER_RADIAN: f32 = 65536.0 / core::f32::consts::TAU;

/// A node on a simulated board: sends requests, and ticks with the sensor values of the test. Checks the
/// torques of every tick.
#[derive(Clone)]
pub struct Rig {
    pub node: Node,
    pub sensors: SensorFrame,
    pub client: u32,
    pub sequence: u16,
    /// The torques of the last tick [N·m].
    last: Vec<f32, MAX_JOINTS>,
}

impl Rig {
    pub fn new() -> Self {
        let sensors = SensorFrame {
            sequence: 0,
            flags: SensorFlags(0),
            supply: 24_000,
            encoders: Vec::from_slice(&[0; 3]).unwrap(),
            currents: Vec::from_slice(&[0; 3]).unwrap(),
            forces: Vec::new(),
        };
        Self { node: Node::new(), sensors, client: 7, sequence: 0, last: Vec::new() }
    }

    /// A rig that is ready to be enabled.
    pub fn ready(model: &RobotModel) -> Self {
        let mut rig = Self::new();
        rig.command();
        assert_eq!(rig.push(model), Reply::Done);
        rig.tick();
        rig
    }

    pub fn enabled(model: &RobotModel) -> Self {
        let mut rig = Self::ready(model);
        assert_eq!(rig.enable(), Reply::Done);
        rig
    }

    pub fn ask(&mut self, request: Request) -> Reply {
        self.sequence = self.sequence.wrapping_add(1);
        self.send(self.client, self.sequence, request)
    }

    pub fn send(&mut self, client: u32, sequence: u16, request: Request) -> Reply {
        let reply = self.node.handle(&RequestFrame { client, sequence, request }, &BoardStatus::default());
        assert_eq!((reply.client, reply.sequence), (client, sequence));
        reply.reply
    }

    /// Says hello and takes command.
    pub fn command(&mut self) {
        assert!(matches!(self.ask(Request::Hello { schema: SCHEMA_KEY }), Reply::Hello { .. }));
        assert_eq!(self.ask(Request::TakeCommand { by_force: false }), Reply::Done);
    }

    /// Reads a whole export; returns it and the index of its log entry.
    pub fn export(&mut self, item: Item) -> (std::vec::Vec<u8>, u32) {
        let Reply::Exported { length, checksum, index, .. } = self.ask(Request::Export(item)) else {
            panic!()
        };
        let mut bytes = std::vec::Vec::new();
        while bytes.len() < length as usize {
            let offset = bytes.len() as u32;
            let Reply::Chunk { data, .. } = self.ask(Request::ReadExport { offset }) else { panic!() };
            bytes.extend_from_slice(&data);
        }
        assert_eq!((bytes.len(), codec::checksum(&bytes)), (length as usize, checksum));
        (bytes, index)
    }

    pub fn push(&mut self, model: &RobotModel) -> Reply {
        let bytes = postcard::to_stdvec(model).unwrap();
        let begin = Request::ModelBegin { length: bytes.len() as u32, checksum: codec::checksum(&bytes) };
        assert_eq!(self.ask(begin), Reply::Done);
        for (index, data) in bytes.chunks(MODEL_CHUNK).enumerate() {
            let chunk = Request::ModelChunk {
                offset: (index * MODEL_CHUNK) as u32,
                data: Vec::from_slice(data).unwrap(),
            };
            assert_eq!(self.ask(chunk), Reply::Done);
        }
        self.ask(Request::ModelCommit)
    }

    pub fn enable(&mut self) -> Reply {
        self.ask(Request::Enable(TaskConfig::JointServo(ServoMode::Pid)))
    }

    /// Reads the faults and clears them.
    pub fn clear_faults(&mut self) {
        let Reply::Faults(log) = self.ask(Request::ReadFaults) else { panic!() };
        assert_eq!(self.ask(Request::ClearFaults { total: log.total }), Reply::Done);
    }

    pub fn goal(&mut self, positions: [f32; 3]) -> Reply {
        self.ask(Request::Task(TaskCommand::JointServo(JointCommand::Goal {
            positions: Vec::from_slice(&positions).unwrap(),
        })))
    }

    pub fn tick(&mut self) -> ActuatorFrame {
        self.sensors.sequence += 1;
        let frame = self.node.tick(&self.sensors);
        self.check_torques(&frame);
        self.last.clone_from(&frame.torques);
        frame
    }

    /// Torques are finite and within the limits, and change within the torque rate while the outputs are on.
    fn check_torques(&self, frame: &ActuatorFrame) {
        let joints = self.node.robot().map_or(&[][..], |robot| &robot.model().joints);
        let last = self.last.iter().copied().chain(core::iter::repeat(0.0));
        for ((joint, &torque), last) in joints.iter().zip(&frame.torques).zip(last) {
            let (limits, name) = (joint.limits, &joint.name);
            assert!(frame.enabled || torque == 0.0, "{name}: {torque} N·m with outputs off");
            assert!(torque.abs() <= limits.torque, "{name}: {torque} N·m, {limits:?}");
            let max = limits.torque_rate * TICK * (1.0 + 1e-4) + 1e-6 * limits.torque;
            let steps = frame.enabled && (torque - last).abs() > max;
            assert!(!steps, "{name}: from {last} to {torque} N·m, {max} a tick");
        }
    }

    /// Sends a goal in every tick until a fault occurs.
    pub fn tick_until_fault(&mut self, goal: [f32; 3], ticks: usize) -> Fault {
        for _ in 0..ticks {
            self.tick();
            if self.node.mode() == Mode::Fault {
                return *self.node.faults().faults.last().unwrap();
            }
            assert_eq!(self.goal(goal), Reply::Done);
        }
        panic!("no fault in {ticks} ticks");
    }
}

pub fn refusal(reply: Reply) -> Refusal {
    match reply {
        Reply::Refused(refusal) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

pub fn near(a: [f32; 3], b: [f32; 3], tolerance: f32) -> bool {
    a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= tolerance)
}
