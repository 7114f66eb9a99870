//! Requests of faulty programs: a second commander, and invalid requests.

use tesaki::control::{JointPoint, ServoMode};
use tesaki::protocol::{Item, Request, SCHEMA_KEY, Stream};
use tesaki::task::grasping::GraspCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::telexistence::{
    FingertipPoint, FingertipSample, TelexistenceCommand, TelexistenceSettings,
};
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_rng::Rng;

/// Draws a request of a second program that tries to command `joints` joints.
pub fn second(rng: &mut Rng, joints: usize) -> Request {
    match rng.below(17) {
        0..=2 => Request::Hello { schema: SCHEMA_KEY },
        3 | 4 => Request::TakeCommand { by_force: true },
        5 => Request::TakeCommand { by_force: false },
        6 | 7 => Request::Enable(TaskConfig::JointServo(ServoMode::Pid)),
        8 => Request::Enable(TaskConfig::Grasping(())),
        9 | 10 => goal(rng, joints, 0.3),
        11 => Request::Keep,
        12 => Request::ReadFaults,
        13 => Request::ClearFaults { total: rng.below(3) },
        14 if rng.chance(0.2) => Request::Disable,
        14 => Request::ReleaseCommand,
        15 => Request::Enable(TaskConfig::Telexistence(TelexistenceSettings::DEFAULT)),
        _ if rng.chance(0.2) => Request::Stop,
        _ => Request::ReadStatus,
    }
}

/// Draws an invalid request. A board must refuse it, or it must do no harm.
pub fn nonsense(rng: &mut Rng, joints: usize) -> Request {
    const WILD: [f32; 6] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -1e30, 1e9];
    let wild = WILD[usize::try_from(rng.below(6)).unwrap_or(0)];
    let any = rng.next_u64() as u32;
    let point = JointPoint { position: wild, velocity: wild, acceleration: wild };
    match rng.below(17) {
        0 => Request::Home { positions: (0..joints).map(|_| wild).collect() },
        1 => Request::Home { positions: (0..rng.below(17)).map(|_| 0.0).collect() },
        2 => command(JointCommand::Goal { positions: (0..joints).map(|_| wild).collect() }),
        3 => command(JointCommand::Goal { positions: (0..rng.below(17)).map(|_| 0.0).collect() }),
        4 => command(JointCommand::Stream { points: (0..joints).map(|_| point).collect() }),
        5 => command(JointCommand::StreamTorques {
            points: (0..joints).map(|_| JointPoint::default()).collect(),
            torques: (0..joints).map(|_| wild).collect(),
        }),
        6 => Request::Task(TaskCommand::Grasping(GraspCommand::Move {
            translation: [wild; 3],
            rotation: [wild; 3],
            duration: wild,
        })),
        7 => Request::Enable(TaskConfig::Grasping(())),
        8 => Request::ModelBegin { length: any, checksum: any },
        9 => Request::ModelChunk { offset: any, data: (0..rng.below(192)).map(|byte| byte as u8).collect() },
        10 => Request::ModelCommit,
        11 => Request::ClearFaults { total: any },
        12 => Request::Hello { schema: any.into() },
        13 => Request::SetRate { stream: Stream::Telemetry, every: any as u16 },
        14 => Request::Task(TaskCommand::Telexistence(TelexistenceCommand::Follow(FingertipSample {
            number: any as u16,
            age: if rng.chance(0.5) { wild } else { 0.0 },
            tips: [Some(FingertipPoint { position: [wild; 3], velocity: [wild; 3], direction: None }); 5],
        }))),
        15 => Request::Export(if rng.chance(0.5) { Item::Model } else { Item::State }),
        _ => Request::ReadExport { offset: any },
    }
}

fn command(command: JointCommand) -> Request {
    Request::Task(TaskCommand::JointServo(command))
}

fn goal(rng: &mut Rng, joints: usize, size: f64) -> Request {
    command(JointCommand::Goal { positions: (0..joints).map(|_| (size * rng.symmetric()) as f32).collect() })
}
