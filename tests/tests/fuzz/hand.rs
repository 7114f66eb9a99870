//! A hand that grasps, with sensors that read roughly what they should.

use std::cell::RefCell;
use std::collections::BTreeSet;

use tesaki::control::{JointPoint, ServoMode};
use tesaki::kinematics::{Chain, Finger};
use tesaki::model::RobotModel;
use tesaki::node::Node;
use tesaki::protocol::{JointTelemetry, Mode, Refusal, Reply, Request, SensorFrame};
use tesaki::task::grasping::{GraspCommand, GraspPlan, Phase};
use tesaki::task::grasping::{GraspState, GraspTelemetry};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig, TaskKind, TaskRefusal, TaskTelemetry};

use super::random::Random;
use super::requests::{any_command, any_plan, any_request};
use super::rig::Rig;
use super::{box_plan, fuzz, model};

/// Runs in the checks, in which every phase of a grasp is reached.
const RUNS: u64 = 1200;

/// Angles with the tips some way in front of the contacts of [`box_plan`].
fn before_the_box(model: &RobotModel) -> heapless::Vec<f32, 16> {
    let plan = box_plan();
    let mut angles = heapless::Vec::new();
    for ((chain, range), contact) in model.chains.iter().zip(model.chain_ranges()).zip(&plan.contacts) {
        let joints = &model.joints[range];
        let limits = [0, 1, 2].map(|joint| (joints[joint].limits.lower, joints[joint].limits.upper));
        let finger = Finger::try_new(&Chain::new(joints, &chain.tip), limits).unwrap();
        let place = [0, 1, 2].map(|axis| contact.position[axis] - 0.03 * contact.normal[axis]);
        angles.extend(finger.nearest(&place.into(), &[0.0, 0.3, 0.7]).unwrap());
    }
    angles
}

/// What the encoders and the force sensors of a hand read whose joints do what they are told, roughly, and
/// whose force sensors read what the task expects, roughly and not always.
fn feel(
    random: &mut Random,
    node: &Node,
    (model, home): (&RobotModel, &[f32]),
    plan: &GraspPlan,
    sensors: &mut SensorFrame,
) {
    let joints = node.telemetry().joints;
    let mut angles = Vec::new();
    let all = sensors.encoders.iter_mut().zip(&joints).zip(&model.joints).zip(home);
    for (((count, joint), config), home) in all {
        let sign = if config.encoder.reversed { -1.0 } else { 1.0 };
        let expected =
            (joint.reference - home) / std::f32::consts::TAU * config.encoder.counts_per_turn * sign;
        *count = if random.one_in(2000) {
            random.next() as i32
        } else {
            expected as i32 + random.below(5) as i32 - 2
        };
        angles.push(joint.reference);
    }
    let tick = sensors.sequence;
    let grasp = grasp(node);
    let faint = random.one_in(100);
    for (finger, (counts, chain)) in sensors.forces.iter_mut().zip(&model.chains).enumerate() {
        let range = 3 * finger..3 * finger + 3;
        let posture = Chain::new(&model.joints[range.clone()], &chain.tip).posture(&angles[range]);
        let push = match grasp.phase {
            Phase::Ready | Phase::Approach => [0.0; 3],
            Phase::Touch if random.one_in(20) => plan.contacts[finger].normal.map(|axis| 3.0 * axis),
            Phase::Touch if tick % 100 > 50 => plan.contacts[finger].normal,
            Phase::Touch => [0.0; 3],
            _ if faint => [0.0; 3],
            _ => {
                grasp.target_forces[finger].map(|force| force * (1.0 + 0.05 * (random.below(3) as f32 - 1.0)))
            }
        };
        // The sensors read what acts on the tip.
        let force: [f32; 3] = posture.tip().rotation.inverse_transform_vector(&push.into()).into();
        for (count, force) in counts.iter_mut().zip(force) {
            *count = ((force * -1000.0) as i32).saturating_add(random.below(21) as i32 - 10);
        }
        if random.one_in(500) {
            counts[random.below(6)] = random.next() as i32;
        }
    }
}

/// The grasp; of another task, or of none, one that has not begun.
fn grasp(node: &Node) -> GraspTelemetry {
    match node.task_report().map(|report| report.telemetry) {
        Some(TaskTelemetry::Grasping(grasp)) => grasp,
        _ => GraspState::NONE.telemetry(),
    }
}

#[test]
fn a_hand_that_grasps_keeps_its_limits_whatever_it_feels() {
    let model = model();
    let home = before_the_box(&model);
    let phases = RefCell::new(BTreeSet::new());
    let runs = fuzz("hand", RUNS, |seed| {
        let mut random = Random(seed);
        let mut rig = Rig::new(&model, 24_000, seed);
        let plan = if random.one_in(4) { any_plan(&mut random) } else { box_plan() };
        for tick in 0..random.below(1500) {
            feel(&mut random, &rig.node, (&model, &home), &plan, &mut rig.sensors);
            if tick < 2 {
                rig.sensors.encoders.iter_mut().for_each(|count| *count = 0);
                rig.sensors.forces.iter_mut().for_each(|counts| *counts = [0; 6]);
            }
            rig.sensors.sequence += 1;
            rig.tick(rig.sensors.clone());
            if tick == 1 {
                let home = Request::Home { positions: home.clone() };
                // Some are one board of several that hold an object together.
                let guided = random.one_in(4);
                let task = if guided {
                    TaskConfig::JointServo(ServoMode::Observer)
                } else {
                    TaskConfig::Grasping(())
                };
                let arm = Request::Enable(task);
                for request in [
                    home,
                    Request::Tare,
                    arm,
                    Request::Task(TaskCommand::Grasping(GraspCommand::Grasp(plan))),
                ] {
                    let reply = rig.ask(request);
                    let begun = matches!(
                        reply,
                        Reply::Done | Reply::Refused(Refusal::Task(TaskRefusal::Grasping(_)))
                    );
                    assert!(begun || guided, "seed {seed}: {reply:?}");
                }
            }
            let grasp = grasp(&rig.node);
            let numbers =
                [&grasp.position[..], &grasp.orientation, &grasp.load, grasp.target_forces.as_flattened()];
            assert!(numbers.concat().iter().all(|number| number.is_finite()), "seed {seed}: {grasp:?}");
            phases.borrow_mut().insert(format!("{:?}", grasp.phase));
            if tick < 1 {
                continue;
            }
            let request = match random.below(400) {
                0 => any_request(&mut random, &model, &[]),
                1 if grasp.phase == Phase::Hold => {
                    Request::Task(TaskCommand::Grasping(GraspCommand::PutDown))
                }
                1..8 => Request::Task(TaskCommand::Grasping(any_command(&mut random))),
                8..80 if rig.node.mode() == Mode::Enabled(TaskKind::JointServo) => {
                    let small = |random: &mut Random| random.below(201) as f32 / 1000.0 - 0.1;
                    let near = |joint: &JointTelemetry| JointPoint {
                        position: joint.reference + 0.05 * small(&mut random),
                        velocity: small(&mut random),
                        acceleration: small(&mut random),
                    };
                    let points = rig.node.telemetry().joints.iter().map(near).collect();
                    let mut torques: heapless::Vec<f32, 16> =
                        home.iter().map(|_| 6.0 * small(&mut random)).collect();
                    if random.one_in(4) {
                        torques[random.below(home.len())] = random.value();
                    }
                    Request::Task(TaskCommand::JointServo(JointCommand::StreamTorques { points, torques }))
                }
                8..200 => Request::Keep,
                _ => continue,
            };
            rig.ask(request);
        }
        rig.replay();
    });
    let phases = phases.into_inner();
    println!("hand: {phases:?}");
    // A single seed does not come far.
    assert!(runs < RUNS || phases.len() == 9, "{phases:?}");
}
