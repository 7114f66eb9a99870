//! A node, and the properties that must hold for all requests and sensor readings.

use std::collections::BTreeSet;

use tesaki::fault::FaultCause;
use tesaki::model::{MAX_JOINTS, RobotModel};
use tesaki::node::{MAX_STATE, Node, Replay};
use tesaki::protocol::codec::{MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    ActuatorFrame, BoardStatus, FromBoard, Item, LogRecord, MODEL_CHUNK, Mode, Refusal, Reply, Request,
    RequestFrame, SensorFrame, Stream, TaskReport, Telemetry,
};
use tesaki::task::impedance::{
    ImpedanceCommand, ImpedanceRefusal, ImpedanceSettings, InvalidImpedanceSettings,
};
use tesaki::task::{TaskCommand, TaskConfig, TaskKind, TaskRefusal, TaskTelemetry};

/// Period of the ticks [s].
const TICK: f32 = 0.01;

/// A node that is checked at every step.
pub struct Rig {
    /// The node under test.
    pub node: Box<Node>,
    /// The next sensor readings.
    pub sensors: SensorFrame,
    /// Ticks so far.
    pub ticks: u32,
    /// The phases, contacts and faults so far, if they are requested.
    pub reached: Option<BTreeSet<String>>,
    /// Sequence number of the last request of client 1.
    sequence: u16,
    /// Clients and sequence numbers of all requests: one that was used gets the reply of its first request.
    used: BTreeSet<(u32, u16)>,
    twin: Option<Box<Node>>,
    records: Vec<LogRecord>,
    /// The outputs of the last tick.
    last: ActuatorFrame,
    /// Whether an `Enable` was accepted, and no `Disable` since.
    may_be_enabled: bool,
    /// Ticks since the commander was last heard.
    silence: u32,
    /// Whether the model is still the first one: with others, numbers may exceed the range of floats.
    first_model: bool,
}

impl Rig {
    /// Creates a rig around `node`, which has handled `sequence` requests of client 1. With `repeat`, the run
    /// is repeated at the end and must give the same results.
    pub fn new(node: &Node, sequence: u16, sensors: SensorFrame, repeat: bool) -> Self {
        Self {
            node: Box::new(node.clone()),
            sensors,
            ticks: 0,
            reached: None,
            sequence,
            used: BTreeSet::from([(1, sequence)]),
            twin: repeat.then(|| Box::new(node.clone())),
            records: Vec::new(),
            last: ActuatorFrame::default(),
            may_be_enabled: false,
            silence: 0,
            first_model: true,
        }
    }

    /// Sends a request of client 1.
    pub fn ask(&mut self, request: Request) -> Reply {
        self.sequence = self.sequence.wrapping_add(1);
        self.send(RequestFrame { client: 1, sequence: self.sequence, request })
    }

    /// Sends a request of any client.
    pub fn send(&mut self, frame: RequestFrame) -> Reply {
        let face = Face::of(&self.node);
        let before = self.node.mode();
        let commander = self.node.status(&BoardStatus::default()).node.commander;
        let reply = self.node.handle(&frame, &BoardStatus::default());
        fits_a_frame(&FromBoard::Reply(reply.clone()));
        let reply = reply.reply;
        let (after, done) = (self.node.mode(), reply == Reply::Done);
        match &reply {
            Reply::Refused(refusal) => {
                assert_eq!(face.encoded(), Face::of(&self.node).encoded(), "refused: {frame:?}");
                let _ = refusal.to_string();
            }
            Reply::Exported { length, .. } if matches!(frame.request, Request::Export(Item::State)) => {
                assert!(usize::try_from(*length).is_ok_and(|length| length <= MAX_STATE), "{length} bytes");
            }
            _ => {}
        }
        if let (Mode::Disabled | Mode::Fault, Mode::Enabled(_)) = (before, after) {
            assert!(before == Mode::Disabled && done, "{before:?} to {after:?} with {reply:?}");
            assert!(matches!(frame.request, Request::Enable(_)), "enabled by {frame:?}");
            self.may_be_enabled = true;
        }
        match frame.request {
            Request::Disable => {
                assert!(done, "Disable is always granted: {reply:?}");
                self.may_be_enabled = false;
            }
            Request::Stop => assert!(done && !matches!(after, Mode::Enabled(_)), "{reply:?}, {after:?}"),
            Request::Enable(_) | Request::Task(_) | Request::Keep if done => self.silence = 0,
            Request::ModelCommit => self.first_model &= !done,
            _ => {}
        }
        if commander == Some(frame.client) {
            check_command(before, &frame.request, &reply);
        }
        let is_new = self.used.insert((frame.client, frame.sequence));
        if is_new && let Some(settings) = settings(&frame.request) {
            self.check_settings(settings, &reply);
        }
        if self.twin.is_some() {
            self.records.push(LogRecord::Request(frame));
        }
        reply
    }

    /// Ticks with the present sensor values, and increments their sequence number.
    pub fn tick(&mut self) {
        let frame = self.sensors.clone();
        self.tick_with(frame);
        self.sensors.sequence = self.sensors.sequence.wrapping_add(1);
    }

    /// Tares a node that was homed, when it may: after 1 s. Constant counts would be a fault meanwhile.
    pub fn tare(&mut self) -> Reply {
        for _ in 0..100 {
            self.sensors.forces.iter_mut().for_each(|counts| counts[5] ^= 1);
            self.tick();
        }
        self.ask(Request::Tare)
    }

    /// Ticks with `frame`.
    pub fn tick_with(&mut self, frame: SensorFrame) {
        let before = self.node.mode();
        let actuators = self.node.tick(&frame);
        let after = self.node.mode();
        self.ticks += 1;
        self.silence += 1;
        assert_eq!(actuators.sequence, frame.sequence);
        let enabled = matches!(after, Mode::Enabled(_));
        assert!(!enabled || before == after, "a tick led from {before:?} to {after:?}");
        assert!(!(enabled && frame.flags.emergency_stop()), "enabled with the emergency stop pressed");
        assert!(!(after == Mode::Disabled && actuators.enabled), "the outputs are on while disabled");
        self.may_be_enabled &= after != Mode::Disabled;
        assert!(!actuators.enabled || self.may_be_enabled, "the outputs are on without an Enable");
        self.check_torques(&actuators);
        if let Some(robot) = self.node.robot() {
            let timeout = robot.model().safety.command_timeout;
            #[expect(clippy::cast_precision_loss, reason = "small numbers")]
            let silence = self.silence as f32 * TICK;
            assert!(!enabled || silence <= timeout + 2.0 * TICK, "no command for {silence} s");
        }
        self.check_numbers();
        self.note();
        self.last = actuators.clone();
        if self.twin.is_some() {
            self.records.push(LogRecord::Sensors(frame));
            self.records.push(LogRecord::Actuators(actuators));
        }
        if self.ticks.is_multiple_of(8) {
            self.read();
        }
    }

    /// Checks that settings of an impedance are accepted only if they are valid, and called invalid only if
    /// they are not. Whether a mass is too small for the arm's own mass depends on the posture.
    fn check_settings(&self, settings: &ImpedanceSettings, reply: &Reply) {
        let Some(robot) = self.node.robot() else { return };
        let valid = settings.validate(robot.model().joints.len()).is_ok();
        let refused = match reply {
            Reply::Refused(Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Settings(why)))) => {
                !matches!(why, InvalidImpedanceSettings::MassInContact { .. })
            }
            Reply::Done => false,
            _ => return,
        };
        assert_eq!(valid, !refused, "{reply:?}: {settings:?}");
    }

    /// Checks that everything computed from the readings is finite, whatever they are.
    fn check_numbers(&self) {
        if !self.first_model {
            return;
        }
        let task = self.node.task_report().map(|report| report.telemetry);
        let numbers = match &task {
            Some(TaskTelemetry::Grasping(grasp)) => {
                [&grasp.position[..], &grasp.orientation, &grasp.load, grasp.target_forces.as_flattened()]
                    .concat()
            }
            Some(TaskTelemetry::Impedance(tool)) => {
                let scalars = [tool.sigma_min, tool.elbow, tool.derating];
                [&tool.position[..], &tool.rotation, &tool.error, &tool.wrench, &scalars].concat()
            }
            _ => Vec::new(),
        };
        assert!(numbers.iter().all(|number| number.is_finite()), "{task:?}");
        let fault = self.node.faults().faults.iter().find(|fault| fault.cause == FaultCause::NotFinite);
        assert!(fault.is_none(), "{}", fault.map(ToString::to_string).unwrap_or_default());
    }

    /// Records the phase of a grasp, whether an arm is in contact, and the last fault.
    fn note(&mut self) {
        let Some(reached) = &mut self.reached else { return };
        match self.node.task_report().map(|report| report.telemetry) {
            Some(TaskTelemetry::Grasping(grasp)) => reached.insert(format!("{:?}", grasp.phase)),
            Some(TaskTelemetry::Impedance(tool)) if matches!(self.node.mode(), Mode::Enabled(_)) => {
                reached.insert(if tool.contact { "contact" } else { "free" }.to_owned())
            }
            _ => false,
        };
        reached.extend(self.node.faults().faults.last().map(|fault| format!("{:?}", fault.cause)));
    }

    /// Checks that the torques are finite, within the limits and their rates, and 0 while the outputs are
    /// off.
    fn check_torques(&self, actuators: &ActuatorFrame) {
        let Some(robot) = self.node.robot() else {
            return assert!(actuators.torques.is_empty() && !actuators.enabled);
        };
        let joints = &robot.model().joints;
        assert_eq!(actuators.torques.len(), joints.len());
        let zeros = [0.0; MAX_JOINTS];
        let last = if self.last.torques.is_empty() { &zeros[..] } else { &self.last.torques };
        for ((&torque, joint), &last) in actuators.torques.iter().zip(joints).zip(last) {
            let limit = joint.limits.torque;
            assert!(torque.is_finite() && torque.abs() <= limit, "{}: {torque} of {limit} N·m", joint.name);
            if !actuators.enabled {
                assert!(torque == 0.0, "{}: {torque} N·m with outputs off", joint.name);
                continue;
            }
            let change = joint.limits.torque_rate * TICK * 1.0001;
            // Cancellation error in the subtraction of large numbers.
            let rounding = limit * 1e-6;
            assert!(
                (torque - last).abs() <= change + rounding,
                "{}: from {last} to {torque} N·m, {change} a tick",
                joint.name
            );
        }
    }

    /// Checks that everything that can be read fits into a frame.
    fn read(&self) {
        for stream in Stream::ALL {
            if let Some(message) = self.node.due(stream, &BoardStatus::default()) {
                fits_a_frame(&message);
            }
        }
        fits_a_frame(&FromBoard::Telemetry(self.node.telemetry()));
        fits_a_frame(&FromBoard::Tips(self.node.tips()));
        if let Some(report) = self.node.task_report() {
            fits_a_frame(&FromBoard::Task(report));
        }
        for fault in &self.node.faults().faults {
            let _ = fault.to_string();
        }
    }

    /// Pushes `bytes` as a model. Returns whether it was accepted.
    pub fn push(&mut self, bytes: &[u8]) -> bool {
        let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        self.ask(Request::ModelBegin { length, checksum: checksum(bytes) });
        for (offset, chunk) in (0..).step_by(MODEL_CHUNK).zip(bytes.chunks(MODEL_CHUNK)) {
            let data = heapless::Vec::from_slice(chunk).unwrap_or_default();
            self.ask(Request::ModelChunk { offset, data });
        }
        let accepted = self.ask(Request::ModelCommit) == Reply::Done;
        if accepted && let Some(robot) = self.node.robot() {
            let model: &RobotModel = robot.model();
            assert!(model.validate().is_ok(), "accepted, but not valid");
            let forces = model.chains.iter().filter(|chain| chain.force_sensor.is_some()).count();
            self.sensors.encoders = model.joints.iter().map(|_| 0).collect();
            self.sensors.currents = model.joints.iter().map(|_| 0).collect();
            self.sensors.forces = (0..forces).map(|_| [0; 6]).collect();
        }
        accepted
    }

    /// Reads the whole state or model, and checks that it is as long as announced.
    pub fn export(&mut self, item: Item) {
        let Reply::Exported { length, checksum: announced, .. } = self.ask(Request::Export(item)) else {
            return;
        };
        let mut bytes = Vec::new();
        while bytes.len() < usize::try_from(length).unwrap_or(usize::MAX) {
            let offset = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
            match self.ask(Request::ReadExport { offset }) {
                Reply::Chunk { data, .. } if !data.is_empty() => bytes.extend_from_slice(&data),
                reply => panic!("at {offset} of {length} bytes: {reply:?}"),
            }
        }
        assert_eq!(checksum(&bytes), announced);
    }

    /// Checks that the same inputs give the same outputs again.
    pub fn finish(mut self) {
        self.read();
        let Some(twin) = &mut self.twin else { return };
        let mut replay = Replay::new(twin);
        for record in &self.records {
            replay.feed(record).unwrap_or_else(|error| panic!("a repetition differs: {error}"));
        }
    }
}

fn fits_a_frame(message: &FromBoard) {
    let mut frame = [0; MAX_FRAME];
    encode(message, &mut frame).unwrap_or_else(|error| panic!("{error}: {message:?}"));
}

/// Checks that a running task refuses its own commands only for its own reasons, unless they are late or from
/// a client that has since said hello with another schema.
fn check_command(mode: Mode, request: &Request, reply: &Reply) {
    let (Mode::Enabled(kind), Request::Task(command)) = (mode, request) else { return };
    let own = matches!(
        (kind, command),
        (TaskKind::JointServo, TaskCommand::JointServo(_))
            | (TaskKind::Grasping, TaskCommand::Grasping(_))
            | (TaskKind::Impedance, TaskCommand::Impedance(_))
    );
    let heard = match reply {
        Reply::Refused(refusal) => {
            matches!(refusal, Refusal::Stale { .. } | Refusal::SchemaMismatch { .. } | Refusal::Task(_))
        }
        reply => *reply == Reply::Done,
    };
    assert!(!own || heard, "{kind:?}: {reply:?} to {command:?}");
}

/// Returns the settings of an impedance in a request.
const fn settings(request: &Request) -> Option<&ImpedanceSettings> {
    match request {
        Request::Enable(TaskConfig::Impedance(settings))
        | Request::Task(TaskCommand::Impedance(ImpedanceCommand::Configure(settings))) => Some(settings),
        _ => None,
    }
}

/// The state that a refused request must not change.
struct Face {
    mode: Mode,
    telemetry: Telemetry,
    task: Option<TaskReport>,
    model: Option<RobotModel>,
}

impl Face {
    fn of(node: &Node) -> Self {
        Self {
            mode: node.mode(),
            telemetry: node.telemetry(),
            task: node.task_report(),
            model: node.robot().map(|robot| robot.model().clone()),
        }
    }

    /// Encodes all of it, to compare every bit.
    fn encoded(&self) -> Vec<u8> {
        let parts = (self.mode, &self.telemetry, &self.task, &self.model);
        postcard::to_stdvec(&parts).expect("all of it has an encoding")
    }
}
