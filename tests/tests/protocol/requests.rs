//! One of each request.

use tesaki::arm::{ArmSettings, ElbowPoint, ForceSource, Law, PosePoint, Redundancy};
use tesaki::control::{Impedance, JointPoint, ServoMode};
use tesaki::kinematics::TipPoint;
use tesaki::manipulation::{GraspCommand, GraspPlan, InternalForce, ObjectControl, WrenchGains};
use tesaki::protocol::{Item, Request, SetPoint, Stream, Task};

use super::messages::Messages;
use super::values::{BOX, LONGEST, OBSERVER, PID, PUSHED, SCHEMA, YIELDING, list};

impl Messages {
    pub fn requests(&mut self) {
        let point = |position, velocity, acceleration| JointPoint { position, velocity, acceleration };
        self.request("hello", Request::Hello { schema: SCHEMA });
        self.request("hello-0", Request::Hello { schema: 0 });
        self.request("model-begin", Request::ModelBegin { length: 4096, checksum: 0xdead_beef });
        let chunk = |offset, data: &[u8]| Request::ModelChunk { offset, data: list(data.iter().copied()) };
        self.request("model-chunk", chunk(192, &[0, 1, 254, 255]));
        self.request("model-chunk-long", chunk(3840, &[255; 192]));
        self.request("model-chunk-zeros", chunk(0, &[0; 192]));
        self.request("model-commit", Request::ModelCommit);
        self.request("home", Request::Home { positions: list([0.25, -1.5]) });
        self.request("home-none", Request::Home { positions: list([]) });
        self.request("arm-pid", Request::Arm { task: PID });
        self.request("arm-observer", Request::Arm { task: OBSERVER });
        self.request("arm-grasp", Request::Arm { task: Task::Grasp });
        self.request("arm-impedance", Request::Arm { task: Task::Impedance });
        self.request("disarm", Request::Disarm);
        let goal = SetPoint::Goal { positions: list([0.5, -0.25, 0.125]) };
        self.request("set-point-goal", Request::SetPoint(goal));
        let stream = SetPoint::Stream { points: list([point(0.5, -0.25, 2.0), point(0.0, 0.0, 0.0)]) };
        self.request("set-point-stream", Request::SetPoint(stream));
        let stream = SetPoint::Stream { points: list([point(f32::MIN, f32::MIN, f32::MIN); 16]) };
        self.request("set-point-stream-16", Request::SetPoint(stream));
        let moving = TipPoint {
            position: [0.1, -0.04, 0.0625],
            velocity: [0.5, -0.25, 0.125],
            acceleration: [2.0, -1.0, 0.0],
        };
        let reach = SetPoint::Reach { tips: list([moving, TipPoint::default()]) };
        self.request("set-point-reach", Request::SetPoint(reach));
        let [position, velocity, acceleration] = [[f32::MIN; 3]; 3];
        let reach = SetPoint::Reach { tips: list([TipPoint { position, velocity, acceleration }; 6]) };
        self.request("set-point-reach-6", Request::SetPoint(reach));
        self.request("set-point-keep", Request::SetPoint(SetPoint::Keep));
        let guide = SetPoint::Guide {
            points: list([point(0.5, -0.25, 2.0), point(0.0, 0.0, 0.0)]),
            torques: list([0.125, -0.0625]),
        };
        self.request("set-point-guide", Request::SetPoint(guide));
        let guide = SetPoint::Guide {
            points: list([point(f32::MIN, f32::MIN, f32::MIN); 16]),
            torques: list([f32::MIN; 16]),
        };
        self.request("set-point-guide-16", Request::SetPoint(guide));
        self.request("stop", Request::Stop);
        self.request("read-status", Request::ReadStatus);
        self.request("read-faults", Request::ReadFaults);
        self.request("clear-faults", Request::ClearFaults { total: 300 });
        self.request("set-rate-telemetry", Request::SetRate { stream: Stream::Telemetry, every: 1 });
        self.request("set-rate-status", Request::SetRate { stream: Stream::Status, every: 100 });
        self.request("set-rate-log", Request::SetRate { stream: Stream::Log, every: 65535 });
        self.request("set-rate-tips", Request::SetRate { stream: Stream::Tips, every: 2 });
        self.request("set-rate-grasp", Request::SetRate { stream: Stream::Grasp, every: 5 });
        self.request("set-rate-arm", Request::SetRate { stream: Stream::Arm, every: 5 });
        self.request("tare", Request::Tare);
        self.grasps();
        self.impedances();
        self.request("take-command", Request::TakeCommand { by_force: false });
        self.request("take-command-by-force", Request::TakeCommand { by_force: true });
        self.request("release-command", Request::ReleaseCommand);
        self.request("export-model", Request::Export(Item::Model));
        self.request("export-state", Request::Export(Item::State));
        self.request("read-export", Request::ReadExport { offset: 192 });
        self.request_by("first-number", 1, 0, Request::ReadStatus);
        self.request_by("last-number", u32::MAX, u16::MAX, Request::ReadStatus);
    }

    fn grasps(&mut self) {
        let mut grasp = |name: &str, command| self.request(name, Request::Grasp(command));
        grasp("grasp", GraspCommand::Grasp(BOX));
        let normal = GraspPlan {
            clearance: 0.005,
            touch_force: 0.125,
            friction: Some(0.5),
            internal: InternalForce::Normal { strength: 2.0 },
            force_limit: 4.0,
            feedback: false,
            control: ObjectControl::Differential(ServoMode::Pid),
            ..BOX
        };
        grasp("grasp-normal", GraspCommand::Grasp(normal));
        let gains = WrenchGains {
            position: [150.0, 300.0],
            orientation: [0.5, 1.0],
            damping: 0.03125,
            compensated: false,
        };
        let pairwise = GraspPlan {
            friction: Some(0.75),
            internal: InternalForce::Pairwise { strengths: [0.5, 1.0, 1.5] },
            control: ObjectControl::Wrench(gains),
            ..BOX
        };
        grasp("grasp-pairwise", GraspCommand::Grasp(pairwise));
        grasp("grasp-longest", GraspCommand::Grasp(LONGEST));
        let (translation, rotation) = ([0.0, 0.0, 0.02], [0.25, -0.125, 0.0]);
        grasp("grasp-move", GraspCommand::Move { translation, rotation, duration: 1.5 });
        grasp("grasp-put-down", GraspCommand::PutDown);
        grasp("grasp-open", GraspCommand::Open);
        self.request("read-grasp", Request::ReadGrasp);
    }

    fn impedances(&mut self) {
        let mut impedance = |name: &str, settings| self.request(name, Request::Impedance(settings));
        impedance("impedance", YIELDING);
        impedance(
            "impedance-driven",
            ArmSettings { redundancy: Redundancy::Driven { joint: 2 }, ..YIELDING },
        );
        let (law, redundancy) = (Law::Printed, Redundancy::None);
        let force = ForceSource::Observer { bandwidth: 30.0 };
        impedance("impedance-observed", ArmSettings { force, ..YIELDING });
        impedance("impedance-printed", ArmSettings { law, redundancy, ..YIELDING });
        let [mass, damping, stiffness] = [[f32::MIN; 6]; 3];
        let longest = ArmSettings {
            impedance: Impedance { mass, damping, stiffness },
            law: Law::Following,
            redundancy: Redundancy::Driven { joint: u8::MAX },
            elbow_bandwidth: f32::MIN,
            force: ForceSource::Observer { bandwidth: f32::MIN },
            contact_force: f32::MIN,
            reach: [f32::MIN; 2],
        };
        impedance("impedance-longest", longest);
        let mut pose = |name: &str, point, elbow| {
            self.request(name, Request::SetPoint(SetPoint::Pose { point, elbow }));
        };
        let point = PosePoint {
            position: PUSHED.position,
            rotation: PUSHED.rotation,
            velocity: [0.125, 0.0, 0.0, 0.0, 0.0, 0.5],
            acceleration: [0.0; 6],
        };
        pose("set-point-pose", point, ElbowPoint { angle: 0.25, ..ElbowPoint::default() });
        let [velocity, acceleration] = [[f32::MIN; 6]; 2];
        let point = PosePoint { position: [f32::MIN; 3], rotation: [f32::MIN; 4], velocity, acceleration };
        let elbow = ElbowPoint { angle: f32::MIN, velocity: f32::MIN, acceleration: f32::MIN };
        pose("set-point-pose-longest", point, elbow);
        self.request("read-arm", Request::ReadArm);
    }
}
