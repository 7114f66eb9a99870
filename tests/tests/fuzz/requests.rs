//! Arbitrary requests, most of them nearly possible.

use tesaki::control::{Coupling, Impedance, ImpedanceAxes, JointPoint, ServoMode};
use tesaki::kinematics::{ElbowSetpoint, PosePoint, TipPoint};
use tesaki::model::RobotModel;
use tesaki::protocol::codec::checksum;
use tesaki::protocol::{Item, MODEL_CHUNK, Request, SCHEMA_KEY, Stream};
use tesaki::task::grasping::{
    FINGERS, GraspCommand, GraspPlan, InternalForce, JointTargets, LoadSource, ObjectControl, ObjectFrame,
    WrenchGains,
};
use tesaki::task::impedance::{DirectLaw, ForceSource, ImpedanceCommand, ImpedanceSettings, Law, Redundancy};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};

use super::box_plan;
use super::random::Random;

pub fn any_request(random: &mut Random, model: &RobotModel, pushed: &[u8]) -> Request {
    let count = if random.one_in(10) { random.below(17) } else { model.joints.len() };
    let list = |random: &mut Random| (0..count).map(|_| random.value()).collect::<heapless::Vec<f32, 16>>();
    match random.below(27) {
        0 => Request::Hello { schema: if random.one_in(5) { random.next() } else { SCHEMA_KEY } },
        1 => {
            let length = if random.one_in(4) { random.next() as u32 } else { pushed.len() as u32 };
            Request::ModelBegin { length, checksum: checksum(pushed) }
        }
        2 | 3 => {
            let offset = random.below(pushed.len() + 1).min(random.below(4) * MODEL_CHUNK);
            let end = pushed.len().min(offset + random.below(MODEL_CHUNK + 1));
            let data = heapless::Vec::from_slice(pushed.get(offset..end).unwrap_or_default()).unwrap();
            Request::ModelChunk { offset: offset as u32, data }
        }
        4 => Request::ModelCommit,
        5 => Request::Home { positions: list(random) },
        6 | 7 => {
            let task = match random.below(6) {
                0 | 1 => TaskConfig::Grasping(()),
                2 => TaskConfig::Impedance(any_settings(random)),
                3 => TaskConfig::JointServo(ServoMode::Pid),
                4 => TaskConfig::JointServo(ServoMode::BarePid),
                _ => TaskConfig::JointServo(ServoMode::Observer),
            };
            Request::Enable(task)
        }
        8 => Request::Disable,
        9..12 => Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions: list(random) })),
        12 | 13 => {
            Request::Task(TaskCommand::JointServo(JointCommand::Stream { points: points(random, count) }))
        }
        14 if random.one_in(2) => {
            let axes = |random: &mut Random, scale: f32| [0; 3].map(|_| random.value() * scale);
            let tip = |random: &mut Random| TipPoint {
                position: axes(random, 0.05),
                velocity: axes(random, 0.1),
                acceleration: axes(random, 1.0),
            };
            let tips = 1 + random.below(4);
            Request::Task(TaskCommand::JointServo(JointCommand::StreamTips {
                tips: (0..tips).map(|_| tip(random)).collect(),
            }))
        }
        14 => Request::Stop,
        15 if random.one_in(2) => Request::Tare,
        21 => Request::Keep,
        22 => {
            let torques = list(random).iter().map(|value| value * 0.4).collect();
            Request::Task(TaskCommand::JointServo(JointCommand::StreamTorques {
                points: points(random, count),
                torques,
            }))
        }
        23 if random.one_in(4) => Request::ReadTask,
        24 if random.one_in(4) => Request::ReadTask,
        24 => configure(any_settings(random)),
        25 => any_pose(random, &REST),
        23 => Request::Task(TaskCommand::Grasping(any_command(random))),
        15 => Request::ReadStatus,
        16 => Request::ReadFaults,
        17 => Request::ClearFaults { total: random.below(5) as u32 },
        18 => Request::SetRate {
            stream: Stream::ALL[random.below(Stream::ALL.len())],
            every: random.next() as u16,
        },
        19 => Request::TakeCommand { by_force: random.one_in(2) },
        20 => Request::Export(if random.one_in(2) { Item::Model } else { Item::State }),
        _ if random.one_in(3) => Request::ReleaseCommand,
        _ => Request::ReadExport { offset: random.below(5000) as u32 },
    }
}

/// Other settings for an arm under impedance control.
pub fn configure(settings: ImpedanceSettings) -> Request {
    Request::Task(TaskCommand::Impedance(ImpedanceCommand::Configure(settings)))
}

pub fn points(random: &mut Random, count: usize) -> heapless::Vec<JointPoint, 16> {
    let point = |random: &mut Random| JointPoint {
        position: random.value() / 20.0,
        velocity: random.value(),
        acceleration: random.value(),
    };
    (0..count).map(|_| point(random)).collect()
}

pub fn any_command(random: &mut Random) -> GraspCommand {
    let wild = random.one_in(4);
    let axes = |random: &mut Random, scale: f32| {
        [0; 3].map(|_| if wild { random.value() } else { (random.below(201) as f32 - 100.0) / 100.0 * scale })
    };
    match random.below(12) {
        0..5 => GraspCommand::Grasp(any_plan(random)),
        5..10 => GraspCommand::Move {
            translation: axes(random, 0.01),
            rotation: axes(random, 0.1),
            duration: if random.one_in(6) { random.value() } else { 1.0 + random.value().abs() },
        },
        10 => GraspCommand::PutDown,
        _ => GraspCommand::Open,
    }
}

/// Mostly possible: the grasp of a box in another way.
pub fn any_plan(random: &mut Random) -> GraspPlan {
    let mut plan = box_plan();
    plan.friction = [None, Some(0.5), Some(random.value().abs())][random.below(3)];
    plan.feedback = !random.one_in(4);
    plan.touch_force = if random.one_in(2) { 0.1 } else { random.value().abs() };
    plan.internal = match random.below(4) {
        0 => InternalForce::Normal { strength: 2.0 * random.value().abs() },
        1 => InternalForce::Pairwise { strengths: [0; 3].map(|_| 2.0 * random.value().abs()) },
        _ => plan.internal,
    };
    plan.control = match random.below(3) {
        0 => ObjectControl::Differential(ServoMode::Pid),
        1 => ObjectControl::Wrench(WrenchGains {
            position: [100.0 * random.value().abs(), 500.0 * random.value().abs()],
            orientation: [random.value().abs(), random.value().abs()],
            damping: 0.1 * random.value().abs(),
            compensated: random.one_in(2),
        }),
        _ => plan.control,
    };
    if random.one_in(3) {
        plan.object_frame = ObjectFrame::Triangle;
        plan.load = LoadSource::Constant { mass: random.value().abs() };
        plan.joint_targets = JointTargets::Accumulated;
    }
    if random.one_in(8) {
        let contact = &mut plan.contacts[random.below(FINGERS)];
        contact.position[random.below(3)] += 0.02 * random.value();
        contact.normal[random.below(3)] += 0.5 * random.value();
    }
    plan
}

pub const REST: PosePoint = PosePoint {
    position: [0.0; 3],
    rotation: [0.0, 0.0, 0.0, 1.0],
    velocity: [0.0; 6],
    acceleration: [0.0; 6],
};

/// Mostly possible.
pub fn any_settings(random: &mut Random) -> ImpedanceSettings {
    let wild = random.one_in(4);
    let between = |random: &mut Random, least: f32, most: f32| {
        if wild && random.one_in(4) {
            random.value()
        } else {
            // Small ones more often.
            let share = random.below(1001) as f32 / 1000.0;
            least + (most - least) * share * share * share
        }
    };
    let mut impedance = Impedance::diagonal([0.0; 6], [0.0; 6], [0.0; 6]);
    for axis in 0..6 {
        let mass = between(random, 0.001, 10.0);
        impedance.mass[axis] = mass;
        impedance.damping[axis] = mass * between(random, 0.1, 100.0);
        impedance.stiffness[axis] = mass * between(random, 1.0, 2500.0);
    }
    if random.one_in(3) {
        impedance.axes = ImpedanceAxes::Tool;
    }
    if random.one_in(3) {
        let mut coupling = Coupling::NONE;
        for matrix in [&mut coupling.mass, &mut coupling.damping, &mut coupling.stiffness] {
            matrix.iter_mut().for_each(|value| *value = between(random, -1e-3, 1e-3));
        }
        impedance.coupling = Some(coupling);
    }
    ImpedanceSettings {
        impedance,
        law: if random.one_in(3) {
            let [driven_term, null_space_damping] = [(); 2].map(|()| random.one_in(2));
            Law::Direct(DirectLaw { friction: between(random, 0.0, 1.0), driven_term, null_space_damping })
        } else {
            Law::ModelFollowing
        },
        redundancy: [
            Redundancy::None,
            Redundancy::DrivenJoint { joint: random.below(8) as u8 },
            Redundancy::ArmAngle,
        ][random.below(3)],
        elbow_bandwidth: between(random, 0.1, 50.0),
        force: if random.one_in(3) {
            ForceSource::Observer { bandwidth: between(random, 10.0, 50.0) }
        } else {
            ForceSource::Sensor
        },
        contact_force: between(random, 0.1, 100.0),
        max_deviation: [between(random, 0.01, 1.0), between(random, 0.1, 3.0)],
    }
}

/// Mostly near `place`, at a speed.
pub fn any_pose(random: &mut Random, place: &PosePoint) -> Request {
    let wild = random.one_in(4);
    let mut spoil = |value: f32, scale: f32| {
        if wild && random.one_in(8) {
            random.value()
        } else {
            value + scale * (random.below(2001) as f32 / 1000.0 - 1.0)
        }
    };
    let mut rotation = place.rotation.map(|part| spoil(part, 0.02));
    let norm = tesaki::math::sqrt(rotation.iter().map(|part| part * part).sum());
    rotation.iter_mut().for_each(|part| *part /= norm);
    let point = PosePoint {
        position: place.position.map(|place| spoil(place, 0.02)),
        rotation,
        velocity: [0; 6].map(|_| spoil(0.0, 0.3)),
        acceleration: [0; 6].map(|_| spoil(0.0, 3.0)),
    };
    let elbow =
        ElbowSetpoint { angle: spoil(0.0, 0.2), velocity: spoil(0.0, 0.5), acceleration: spoil(0.0, 3.0) };
    Request::Task(TaskCommand::Impedance(ImpedanceCommand::SetTarget { point, elbow }))
}
