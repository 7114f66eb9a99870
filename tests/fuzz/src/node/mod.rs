//! A node of the control core under arbitrary requests and sensor readings.

pub mod machine;
pub mod rig;
mod seeds;

use std::collections::BTreeSet;

use tesaki::control::{ImpedanceAxes, ImpedanceCoupling, JointPoint, ServoMode};
use tesaki::kinematics::{ElbowSetpoint, PosePoint, TipPoint};
use tesaki::protocol::{Item, Reply, Request, RequestFrame};
use tesaki::task::grasping::{
    GraspCommand, GraspPlan, InternalForce, JointTargets, LoadSource, ObjectControl, ObjectFrame, WrenchGains,
};
use tesaki::task::impedance::{DirectLaw, ForceSource, ImpedanceCommand, ImpedanceSettings, Law, Redundancy};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig, TaskTelemetry};

use crate::input::Input;
use machine::{Machine, before_the_box, box_plan, follow, machines, soft, spoil};
use rig::Rig;

pub use seeds::seeds;

/// Maximum ticks of a run: a longer one is slow and reveals nothing more.
const MAX_TICKS: u32 = 1200;

/// Runs an input, whose first byte selects the robot and whether the run is repeated. Each step is a byte and
/// its arguments.
pub fn run(data: &[u8]) {
    walk(data, None).finish();
}

/// Runs an input. Returns the phases of a grasp, contacts of an arm, and faults that it reached.
pub fn reached(data: &[u8]) -> BTreeSet<String> {
    let mut rig = walk(data, Some(BTreeSet::new()));
    let reached = rig.reached.take().unwrap_or_default();
    rig.finish();
    reached
}

fn walk(data: &[u8], reached: Option<BTreeSet<String>>) -> Rig {
    let mut input = Input(data);
    let first = input.byte();
    let mut rig = start(first);
    rig.reached = reached;
    while !input.is_empty() && rig.ticks < MAX_TICKS {
        step(&mut rig, &machine(first).encoded, &mut input);
    }
    rig
}

fn machine(first: u8) -> &'static Machine {
    &machines()[usize::from(first & 3) % 3]
}

/// Creates a node, perhaps homed and tared.
fn start(first: u8) -> Rig {
    let mut rig = machine(first).rig(first & 4 != 0);
    if first & 8 != 0 {
        rig.tick();
        rig.tick();
        home(&mut rig, 0.0, &mut Input(&[]));
        let tared = rig.tare();
        assert_eq!(tared == Reply::Done, !rig.sensors.forces.is_empty(), "{tared:?}");
    }
    rig
}

fn step(rig: &mut Rig, encoded: &[u8], input: &mut Input<'_>) {
    match input.byte() % 16 {
        0 => {
            let how = input.byte();
            for tick in 0..1 + (how & 63) {
                follow(rig);
                if how & 64 != 0 && tick % 4 == 0 {
                    rig.ask(Request::Keep);
                }
                rig.tick();
            }
        }
        1 => {
            let mask = input.byte();
            let mut frame = rig.sensors.clone();
            spoil(&mut frame, mask, input);
            if mask & 128 != 0 {
                rig.sensors = frame.clone();
            }
            rig.tick_with(frame);
            rig.sensors.sequence = rig.sensors.sequence.wrapping_add(1);
        }
        2 => {
            for count in &mut rig.sensors.encoders {
                *count = count.wrapping_add(i32::from(input.signed()));
            }
            rig.tick();
        }
        3 => {
            let chain = input.below(rig.sensors.forces.len());
            if let Some(counts) = rig.sensors.forces.get_mut(chain) {
                *counts = [0; 6].map(|_| i32::from(input.signed()) * 16);
            }
            rig.tick();
        }
        4 => {
            if let Ok((request, rest)) = postcard::take_from_bytes::<Request>(input.0) {
                input.0 = rest;
                rig.ask(request);
            }
        }
        5 => {
            if let Ok((frame, rest)) = postcard::take_from_bytes::<RequestFrame>(input.0) {
                input.0 = rest;
                rig.send(frame);
            }
        }
        6 => {
            let task = task(rig, input);
            rig.ask(Request::Enable(task));
        }
        7 => {
            home(rig, 0.02, input);
            rig.tare();
        }
        8 => {
            rig.ask(Request::ReadFaults);
            let total = rig.node.faults().total;
            rig.ask(Request::ClearFaults { total });
        }
        9 => joint_command(rig, input),
        10 => {
            let command = grasp_command(input);
            rig.ask(Request::Task(TaskCommand::Grasping(command)));
        }
        11 => {
            let command = impedance_command(rig, input);
            rig.ask(Request::Task(TaskCommand::Impedance(command)));
        }
        12 => model(rig, encoded, input),
        13 => rig.export(if input.byte() & 1 == 0 { Item::State } else { Item::Model }),
        14 => {
            let home = before_the_box();
            if rig.sensors.encoders.len() == home.len() {
                rig.ask(Request::Home { positions: home.iter().copied().collect() });
                rig.tare();
            }
        }
        _ => {
            let requests = [
                Request::Disable,
                Request::Stop,
                Request::Keep,
                Request::TakeCommand { by_force: true },
                Request::ReleaseCommand,
                Request::ReadTask,
                Request::ReadStatus,
                Request::Tare,
            ];
            let request = requests[input.below(requests.len())].clone();
            rig.ask(request);
        }
    }
}

fn home(rig: &mut Rig, step: f32, input: &mut Input<'_>) -> Reply {
    let positions = rig.sensors.encoders.iter().map(|_| if step > 0.0 { input.number(step) } else { 0.0 });
    let positions = positions.collect();
    rig.ask(Request::Home { positions })
}

fn task(rig: &Rig, input: &mut Input<'_>) -> TaskConfig {
    match input.below(5) {
        0 => TaskConfig::JointServo(ServoMode::Pid),
        1 => TaskConfig::JointServo(ServoMode::Observer),
        2 => TaskConfig::Grasping(()),
        3 => TaskConfig::Impedance(soft()),
        _ => TaskConfig::Impedance(settings(rig.sensors.encoders.len(), input)),
    }
}

/// Reads a point for each joint, not far from its reference.
fn points(rig: &Rig, input: &mut Input<'_>) -> heapless::Vec<JointPoint, 16> {
    let joints = rig.node.telemetry().joints;
    let point = |position: f32, input: &mut Input<'_>| JointPoint {
        position: position + input.number(5e-4),
        velocity: input.number(0.01),
        acceleration: input.number(0.1),
    };
    joints.iter().map(|joint| point(joint.reference, input)).collect()
}

fn joint_command(rig: &mut Rig, input: &mut Input<'_>) {
    let command = match input.below(4) {
        0 => {
            let joints = rig.node.telemetry().joints;
            let positions = joints.iter().map(|joint| joint.reference + input.number(0.01)).collect();
            JointCommand::Goal { positions }
        }
        1 => JointCommand::Stream { points: points(rig, input) },
        2 => {
            let points = points(rig, input);
            let torques = points.iter().map(|_| input.number(0.01)).collect();
            JointCommand::StreamTorques { points, torques }
        }
        _ => {
            let tips = rig.node.tips().tips;
            let tip = |place: [f32; 3], input: &mut Input<'_>| {
                let change = input.axes(1e-4);
                TipPoint {
                    position: [0, 1, 2].map(|axis| place[axis] + change[axis]),
                    velocity: input.axes(1e-3),
                    acceleration: input.axes(0.01),
                }
            };
            JointCommand::StreamTips { tips: tips.iter().map(|place| tip(place.position, input)).collect() }
        }
    };
    rig.ask(Request::Task(TaskCommand::JointServo(command)));
}

fn grasp_command(input: &mut Input<'_>) -> GraspCommand {
    match input.below(6) {
        0 => GraspCommand::Grasp(box_plan()),
        1 | 2 => GraspCommand::Grasp(plan(input)),
        3 => GraspCommand::Move {
            translation: input.axes(2e-4),
            rotation: input.axes(2e-3),
            duration: 1.0 + input.number(0.05),
        },
        4 => GraspCommand::PutDown,
        _ => GraspCommand::Open,
    }
}

/// Reads a variant of the grasp of a box.
fn plan(input: &mut Input<'_>) -> GraspPlan {
    let mut plan = box_plan();
    let what = input.byte();
    plan.feedback = what & 1 == 0;
    if what & 2 != 0 {
        plan.friction = Some(input.number(0.02));
    }
    if what & 4 != 0 {
        plan.touch_force = 0.1 + input.number(0.01);
    }
    if what & 8 != 0 {
        plan.force_limit += input.number(0.1);
        plan.clearance += input.number(1e-3);
    }
    plan.internal = match what >> 4 & 3 {
        0 => InternalForce::Normal { strength: 1.0 + input.number(0.02) },
        1 => InternalForce::Pairwise { strengths: input.axes(0.02) },
        _ => plan.internal,
    };
    plan.control = match what >> 6 {
        0 => ObjectControl::Differential(if what & 2 == 0 { ServoMode::Pid } else { ServoMode::BarePid }),
        1 => ObjectControl::Wrench(WrenchGains {
            position: [input.number(1.0), input.number(5.0)],
            orientation: [input.number(0.01), input.number(0.01)],
            damping: input.number(1e-3),
            compensated: what & 1 == 0,
        }),
        _ => plan.control,
    };
    if what & 4 != 0 {
        plan.object_frame = ObjectFrame::Triangle;
        plan.load = LoadSource::Constant { mass: 0.02 + input.number(1e-3) };
        plan.joint_targets = JointTargets::Accumulated;
    }
    let contact = &mut plan.contacts[input.below(3)];
    let (position, normal) = (input.axes(1e-4), input.axes(0.005));
    for axis in 0..3 {
        contact.position[axis] += position[axis];
        contact.normal[axis] += normal[axis];
    }
    plan
}

fn impedance_command(rig: &Rig, input: &mut Input<'_>) -> ImpedanceCommand {
    if input.byte() & 3 == 0 {
        return ImpedanceCommand::Configure(settings(rig.sensors.encoders.len(), input));
    }
    let report = rig.node.task_report().map(|report| report.telemetry);
    let (place, rotation) = match report {
        Some(TaskTelemetry::Impedance(tool)) => (tool.position, tool.rotation),
        _ => ([0.0; 3], [0.0, 0.0, 0.0, 1.0]),
    };
    let change = input.axes(2e-4);
    let rotation = rotation.map(|part| part + input.number(1e-4));
    let norm = tesaki::math::sqrt(rotation.iter().map(|part| part * part).sum());
    ImpedanceCommand::SetTarget {
        point: PosePoint {
            position: [0, 1, 2].map(|axis| place[axis] + change[axis]),
            rotation: rotation.map(|part| part / norm),
            velocity: [0; 6].map(|_| input.number(2e-3)),
            acceleration: [0; 6].map(|_| input.number(0.02)),
        },
        elbow: ElbowSetpoint {
            angle: input.number(2e-3),
            velocity: input.number(5e-3),
            acceleration: input.number(0.02),
        },
    }
}

/// Reads a variant of the soft impedance.
fn settings(joints: usize, input: &mut Input<'_>) -> ImpedanceSettings {
    let mut settings = soft();
    let what = input.byte();
    let axis = input.below(6);
    let impedance = &mut settings.impedance;
    for (value, bit) in
        [&mut impedance.mass, &mut impedance.damping, &mut impedance.stiffness].into_iter().zip(0..)
    {
        if what >> bit & 1 != 0 {
            value[axis] *= 1.0 + input.number(1.0 / 128.0);
        }
    }
    if what & 0x8f == 0x8f {
        impedance.axes = ImpedanceAxes::Tool;
        let mut coupling = ImpedanceCoupling::NONE;
        let place = input.below(coupling.mass.len());
        for matrix in [&mut coupling.mass, &mut coupling.damping, &mut coupling.stiffness] {
            matrix[place] = input.number(0.1);
        }
        impedance.coupling = Some(coupling);
    }
    settings.law = if what & 8 == 0 { Law::Direct(direct(input)) } else { Law::ModelFollowing };
    settings.redundancy = match what >> 4 & 3 {
        0 => Redundancy::None,
        #[expect(clippy::cast_possible_truncation, reason = "at most 17")]
        1 => Redundancy::DrivenJoint { joint: input.below(joints + 1) as u8 },
        _ => Redundancy::ArmAngle,
    };
    if what & 64 != 0 {
        settings.force = ForceSource::Observer { bandwidth: 30.0 + input.number(0.2) };
    }
    if what & 128 != 0 {
        settings.elbow_bandwidth += input.number(0.1);
        settings.contact_force += input.number(0.05);
        settings.max_deviation[0] += input.number(0.01);
        settings.max_deviation[1] += input.number(0.01);
    }
    settings
}

/// Reads options of the direct law.
fn direct(input: &mut Input<'_>) -> DirectLaw {
    let what = input.byte();
    let friction = 0.25 * f32::from(what & 7);
    DirectLaw { friction, driven_term: what & 8 != 0, null_space_damping: what & 16 != 0 }
}

/// Pushes the model with some of its bytes changed, often with one number set to another.
fn model(rig: &mut Rig, encoded: &[u8], input: &mut Input<'_>) {
    let mut bytes = encoded.to_vec();
    for _ in 0..input.below(4) {
        let at = usize::from(u16::from_le_bytes(input.bytes())) % bytes.len();
        let how = input.byte();
        let number: [u8; 4] = match how % 4 {
            0 => {
                bytes[at] = input.byte();
                continue;
            }
            1 => input.bytes(),
            2 => {
                let numbers = [0.0, 1e-30, 1e-6, 1e6, 1e18, 1e30, f32::MAX, -1.0];
                numbers[usize::from(how >> 2) % numbers.len()].to_le_bytes()
            }
            _ => (1.0 + 0.5 * input.number(1.0)).to_le_bytes(),
        };
        bytes.iter_mut().skip(at).zip(number).for_each(|(byte, other)| *byte = other);
    }
    rig.push(&bytes);
}
