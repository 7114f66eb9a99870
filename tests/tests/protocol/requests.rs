//! One of each request.

use tesaki::control::{Impedance, ImpedanceAxes, ImpedanceCoupling, JointPoint, ServoMode};
use tesaki::kinematics::{ElbowSetpoint, PosePoint, TipPoint};
use tesaki::model::MAX_JOINTS;
use tesaki::protocol::{Item, Request, Stream};
use tesaki::task::grasping::{
    GraspCommand, GraspPlan, InternalForce, JointTargets, LoadSource, ObjectControl, ObjectFrame, WrenchGains,
};
use tesaki::task::impedance::{DirectLaw, ForceSource, ImpedanceCommand, ImpedanceSettings, Law, Redundancy};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::telexistence::{
    FingertipPoint, FingertipSample, TelexistenceCommand, TelexistenceSettings,
};
use tesaki::task::visual_approach::{GripperSettings, VisualApproachCommand, VisualApproachSettings};
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki::teleop::RetargetSettings;

use super::messages::Messages;
use super::values::{
    BOX, FIVE_FINGERS, KNOB, LONGEST, OBSERVER, PID, PUSHED, SCHEMA, THUMB_AND_INDEX, YIELDING, list,
};

impl Messages {
    pub fn requests(&mut self) {
        self.request("hello", Request::Hello { schema: SCHEMA });
        self.request("hello-0", Request::Hello { schema: 0 });
        self.request("disable", Request::Disable);
        self.request("stop", Request::Stop);
        self.request("take-command", Request::TakeCommand { by_force: false });
        self.request("take-command-by-force", Request::TakeCommand { by_force: true });
        self.request("release-command", Request::ReleaseCommand);
        self.request("model-begin", Request::ModelBegin { length: 4096, checksum: 0xdead_beef });
        let chunk = |offset, data: &[u8]| Request::ModelChunk { offset, data: list(data.iter().copied()) };
        self.request("model-chunk", chunk(192, &[0, 1, 254, 255]));
        self.request("model-chunk-long", chunk(3840, &[255; 192]));
        self.request("model-chunk-zeros", chunk(0, &[0; 192]));
        self.request("model-commit", Request::ModelCommit);
        self.request("home", Request::Home { positions: list([0.25, -1.5]) });
        self.request("home-none", Request::Home { positions: list([]) });
        self.request("tare", Request::Tare);
        self.joint_servo();
        self.grasping();
        self.visual_approach();
        self.impedance();
        self.telexistence();
        self.request("keep", Request::Keep);
        self.request("read-task", Request::ReadTask);
        self.request("read-status", Request::ReadStatus);
        self.request("read-faults", Request::ReadFaults);
        self.request("clear-faults", Request::ClearFaults { total: 300 });
        self.request("set-rate-telemetry", Request::SetRate { stream: Stream::Telemetry, every: 1 });
        self.request("set-rate-status", Request::SetRate { stream: Stream::Status, every: 100 });
        self.request("set-rate-log", Request::SetRate { stream: Stream::Log, every: 65535 });
        self.request("set-rate-tips", Request::SetRate { stream: Stream::Tips, every: 2 });
        self.request("set-rate-task", Request::SetRate { stream: Stream::Task, every: 5 });
        self.request("export-model", Request::Export(Item::Model));
        self.request("export-state", Request::Export(Item::State));
        self.request("read-export", Request::ReadExport { offset: 192 });
        self.request_by("first-number", 1, 0, Request::ReadStatus);
        self.request_by("last-number", u32::MAX, u16::MAX, Request::ReadStatus);
    }

    fn joint_servo(&mut self) {
        self.request("enable-pid", Request::Enable(TaskConfig::JointServo(PID)));
        self.request("enable-observer", Request::Enable(TaskConfig::JointServo(OBSERVER)));
        self.request("enable-bare-pid", Request::Enable(TaskConfig::JointServo(ServoMode::BarePid)));
        let mut joints = |name: &str, command| {
            self.request(&format!("joints-{name}"), Request::Task(TaskCommand::JointServo(command)));
        };
        joints("goal", JointCommand::Goal { positions: list([0.5, -0.25, 0.125]) });

        let point = |position, velocity, acceleration| JointPoint { position, velocity, acceleration };
        let points = list([point(0.5, -0.25, 2.0), point(0.0, 0.0, 0.0)]);
        joints("stream", JointCommand::Stream { points });
        let points = list([point(f32::MIN, f32::MIN, f32::MIN); 16]);
        joints("stream-16", JointCommand::Stream { points });

        let moving = TipPoint {
            position: [0.1, -0.04, 0.0625],
            velocity: [0.5, -0.25, 0.125],
            acceleration: [2.0, -1.0, 0.0],
        };
        joints("stream-tips", JointCommand::StreamTips { tips: list([moving, TipPoint::default()]) });
        let [position, velocity, acceleration] = [[f32::MIN; 3]; 3];
        let tips = list([TipPoint { position, velocity, acceleration }; 6]);
        joints("stream-tips-6", JointCommand::StreamTips { tips });

        let points = list([point(0.5, -0.25, 2.0), point(0.0, 0.0, 0.0)]);
        joints("stream-torques", JointCommand::StreamTorques { points, torques: list([0.125, -0.0625]) });
        let points = list([point(f32::MIN, f32::MIN, f32::MIN); 16]);
        joints("stream-torques-16", JointCommand::StreamTorques { points, torques: list([f32::MIN; 16]) });
    }

    fn grasping(&mut self) {
        self.request("enable-grasping", Request::Enable(TaskConfig::Grasping(())));
        let mut grasp =
            |name: &str, command| self.request(name, Request::Task(TaskCommand::Grasping(command)));
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
            object_frame: ObjectFrame::Triangle,
            load: LoadSource::Constant { mass: 0.5 },
            joint_targets: JointTargets::Accumulated,
            ..BOX
        };
        grasp("grasp-pairwise", GraspCommand::Grasp(pairwise));
        grasp("grasp-longest", GraspCommand::Grasp(LONGEST));
        let (translation, rotation) = ([0.0, 0.0, 0.02], [0.25, -0.125, 0.0]);
        grasp("grasp-move", GraspCommand::Move { translation, rotation, duration: 1.5 });
        grasp("grasp-put-down", GraspCommand::PutDown);
        grasp("grasp-open", GraspCommand::Open);
    }

    fn telexistence(&mut self) {
        let longest = TelexistenceSettings {
            retargeting: RetargetSettings {
                follows: [u8::MAX; 5],
                weights: [f32::MIN; 5],
                scale: f32::MIN,
                near: f32::MIN,
                far: f32::MIN,
                operator_contact: f32::MIN,
                robot_contact: f32::MIN,
                speeds: [f32::MIN; MAX_JOINTS],
                tolerance: f32::MIN,
                directions: true,
            },
            servo_mode: ServoMode::Observer,
            acceleration: f32::MIN,
            max_sample_age: f32::MIN,
        };
        for (name, settings) in [("", FIVE_FINGERS), ("-longest", longest)] {
            let name = format!("enable-telexistence{name}");
            self.request(&name, Request::Enable(TaskConfig::Telexistence(settings)));
        }
        let mut command = |name: &str, command| {
            self.request(&format!("telexistence-{name}"), Request::Task(TaskCommand::Telexistence(command)));
        };
        command("follow", TelexistenceCommand::Follow(THUMB_AND_INDEX));
        let [position, velocity] = [[f32::MIN; 3]; 2];
        let tip = FingertipPoint { position, velocity, direction: Some([f32::MIN; 3]) };
        let longest = FingertipSample { number: u16::MAX, age: f32::MIN, tips: [Some(tip); 5] };
        command("follow-longest", TelexistenceCommand::Follow(longest));
        command("release", TelexistenceCommand::Release);
    }

    fn visual_approach(&mut self) {
        let gripper = GripperSettings {
            joint: u8::MAX,
            open: f32::MIN,
            closed: f32::MIN,
            speed: f32::MIN,
            torque: f32::MIN,
        };
        let longest = VisualApproachSettings {
            chain: u8::MAX,
            gripper,
            servo_mode: ServoMode::Observer,
            speed: f32::MIN,
            acceleration: f32::MIN,
            contact_force: f32::MIN,
            reach: f32::MIN,
        };
        for (name, settings) in [("", KNOB), ("-longest", longest)] {
            let name = format!("enable-visual-approach{name}");
            self.request(&name, Request::Enable(TaskConfig::VisualApproach(settings)));
        }
        let (position, longest) = ([0.75, -0.0625, 0.125], [f32::MIN; 3]);
        for (name, command) in [
            ("latch", VisualApproachCommand::Latch { number: 300 }),
            ("latch-longest", VisualApproachCommand::Latch { number: u16::MAX }),
            ("move", VisualApproachCommand::Move { position, speed: 0.0625 }),
            ("move-longest", VisualApproachCommand::Move { position: longest, speed: f32::MIN }),
            ("stand", VisualApproachCommand::Stand),
            ("open", VisualApproachCommand::Open),
            ("close", VisualApproachCommand::Close),
            ("acknowledge", VisualApproachCommand::Acknowledge),
        ] {
            let request = Request::Task(TaskCommand::VisualApproach(command));
            self.request(&format!("visual-approach-{name}"), request);
        }
    }

    fn impedance(&mut self) {
        let [mass, damping, stiffness] = [[f32::MIN; 6]; 3];
        let longest = ImpedanceSettings {
            impedance: Impedance {
                axes: ImpedanceAxes::Tool,
                coupling: Some(ImpedanceCoupling {
                    mass: [f32::MIN; 15],
                    damping: [f32::MIN; 15],
                    stiffness: [f32::MIN; 15],
                }),
                ..Impedance::diagonal(mass, damping, stiffness)
            },
            law: Law::Direct(DirectLaw { friction: f32::MIN, driven_term: true, null_space_damping: true }),
            redundancy: Redundancy::DrivenJoint { joint: u8::MAX },
            elbow_bandwidth: f32::MIN,
            force: ForceSource::Observer { bandwidth: f32::MIN },
            contact_force: f32::MIN,
            max_deviation: [f32::MIN; 2],
        };
        let direct = DirectLaw { friction: 0.75, driven_term: false, null_space_damping: true };
        let (law, redundancy) = (Law::Direct(direct), Redundancy::None);
        let mut coupling = ImpedanceCoupling::NONE;
        (coupling.mass[0], coupling.damping[14], coupling.stiffness[1]) = (0.25, 0.125, -100.0);
        let impedance =
            Impedance { axes: ImpedanceAxes::Tool, coupling: Some(coupling), ..YIELDING.impedance };
        let driven = Redundancy::DrivenJoint { joint: 2 };
        let force = ForceSource::Observer { bandwidth: 30.0 };
        for (name, settings) in [
            ("", YIELDING),
            ("-direct", ImpedanceSettings { law, redundancy, ..YIELDING }),
            ("-driven", ImpedanceSettings { redundancy: driven, ..YIELDING }),
            ("-observed", ImpedanceSettings { force, ..YIELDING }),
            ("-coupled", ImpedanceSettings { impedance, ..YIELDING }),
            ("-longest", longest),
        ] {
            let name = |what| format!("{what}{name}");
            self.request(&name("enable-impedance"), Request::Enable(TaskConfig::Impedance(settings)));
            let configure = TaskCommand::Impedance(ImpedanceCommand::Configure(settings));
            self.request(&name("impedance-configure"), Request::Task(configure));
        }
        let mut target = |name: &str, point, elbow| {
            let target = ImpedanceCommand::SetTarget { point, elbow };
            self.request(&format!("impedance-{name}"), Request::Task(TaskCommand::Impedance(target)));
        };
        let point = PosePoint {
            position: PUSHED.position,
            rotation: PUSHED.rotation,
            velocity: [0.125, 0.0, 0.0, 0.0, 0.0, 0.5],
            acceleration: [0.0; 6],
        };
        target("target", point, ElbowSetpoint { angle: 0.25, ..ElbowSetpoint::default() });
        let [velocity, acceleration] = [[f32::MIN; 6]; 2];
        let point = PosePoint { position: [f32::MIN; 3], rotation: [f32::MIN; 4], velocity, acceleration };
        let elbow = ElbowSetpoint { angle: f32::MIN, velocity: f32::MIN, acceleration: f32::MIN };
        target("target-longest", point, elbow);
    }
}
