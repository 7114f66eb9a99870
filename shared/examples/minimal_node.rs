//! A node that moves one joint: push a model, enable the joint servo, send a goal, tick.
//! [`run`] is the whole of it; [`model`] is what a robot folder would hold.
//! Run it with `cargo run --release -p tesaki --example minimal_node`.

use heapless::Vec;
use tesaki::control::ServoMode;
use tesaki::model::*;
use tesaki::node::{MAX_MODEL, Node};
use tesaki::protocol::*;
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};

/// A rotor of 2·10⁻⁴ kg·m² without friction, its axis vertical, and the drive that moves it.
fn model() -> Option<RobotModel> {
    let joint = JointModel {
        name: "joint".try_into().ok()?,
        origin: Pose::IDENTITY,
        axis: [0.0, 0.0, 1.0],
        link: Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] },
        motor: Motor {
            rotor_inertia: 2e-4,
            torque_constant: 0.5,
            current_limit: 2.0,
            current_resolution: 1e-3,
            bandwidth: 300.0,
            delay: 0.0,
            resistance: None,
            inductance: None,
        },
        friction: Friction { coulomb: 0.0, viscous: 0.0 },
        encoder: Encoder { counts_per_turn: 65536.0, reversed: false, zero: 0, relative: false },
        limits: JointLimits {
            lower: -1.5,
            upper: 1.5,
            velocity: 8.0,
            torque: 0.6,
            torque_rate: 200.0,
            following_error: 0.2,
        },
        servo: ServoGains {
            filter_time: 0.2,
            pid: PidGains { proportional: 0.08, integral: 0.8, derivative: 0.015, cutoff: 30.0 },
            observer: ObserverGains { inertia: 2e-4, bandwidth: 50.0, observer_bandwidth: 100.0 },
            rest_error: 0.0,
        },
    };
    let chain = ChainModel {
        name: "tip".try_into().ok()?,
        joints: 1,
        tip: Pose::IDENTITY,
        tip_radius: 0.0,
        force_sensor: None,
    };
    let (reaction, damping) = (Reaction::Hold, 0.01);
    Some(RobotModel {
        name: "one-joint".try_into().ok()?,
        gravity: [0.0, 0.0, -9.81],
        chains: Vec::from_slice(&[chain]).ok()?,
        joints: Vec::from_slice(&[joint]).ok()?,
        mimics: Vec::new(),
        gauges: None,
        safety: Safety { command_timeout: 0.1, reaction, damping, supply_min: 20.0, supply_max: 28.0 },
    })
}

/// Moves the joint to 0.5 rad in 3 s and says where it is. `None` if the node refuses a request.
pub fn run() -> Option<String> {
    let (mut node, mut sequence) = (Box::new(Node::new()), 0);
    let mut ask = |node: &mut Node, request| {
        sequence += 1;
        let frame = RequestFrame { client: 1, sequence, request };
        match node.handle(&frame, &BoardStatus::default()).reply {
            Reply::Refused(refusal) => {
                eprintln!("{refusal}");
                None
            }
            reply => Some(reply),
        }
    };
    let mut buffer = [0; MAX_MODEL];
    let bytes = postcard::to_slice(&model()?, &mut buffer).ok()?;
    let length = u32::try_from(bytes.len()).ok()?;
    ask(&mut node, Request::Hello { schema: SCHEMA_KEY })?;
    ask(&mut node, Request::TakeCommand { by_force: false })?;
    ask(&mut node, Request::ModelBegin { length, checksum: codec::checksum(bytes) })?;
    for (offset, data) in (0..).step_by(MODEL_CHUNK).zip(bytes.chunks(MODEL_CHUNK)) {
        ask(&mut node, Request::ModelChunk { offset, data: Vec::from_slice(data).ok()? })?;
    }
    ask(&mut node, Request::ModelCommit)?;

    let (mut angle, mut velocity) = (0.0, 0.0);
    let mut sensors = SensorFrame { supply: 24_000, ..SensorFrame::default() };
    sensors.currents.push(0).ok()?;
    let positions = Vec::from_slice(&[0.5]).ok()?;
    for tick in 1..=300 {
        sensors.sequence = tick;
        #[expect(clippy::cast_possible_truncation, reason = "an encoder counts whole steps")]
        let count = (angle * 65536.0 / core::f32::consts::TAU) as i32;
        sensors.encoders = Vec::from_slice(&[count]).ok()?;
        let actuators = node.tick(&sensors);
        // The machine until the next tick: a rotor that the torque accelerates.
        let acceleration = actuators.torques.first()? / 2e-4;
        angle += velocity * tesaki::TICK + 0.5 * acceleration * tesaki::TICK * tesaki::TICK;
        velocity += acceleration * tesaki::TICK;
        if tick == 1 {
            ask(&mut node, Request::Enable(TaskConfig::JointServo(ServoMode::Pid)))?;
            let positions = positions.clone();
            ask(&mut node, Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions })))?;
        }
        ask(&mut node, Request::Keep)?;
    }
    Some(format!("tick {}: {}, joint at {angle:.3} rad", node.last_tick(), node.mode()))
}

fn main() {
    println!("{}", run().unwrap_or_default());
}
