//! An arm under impedance, pushed by an arbitrary world.

use std::cell::RefCell;
use std::collections::BTreeSet;

use tesaki::fault::FaultCause;
use tesaki::kinematics::PosePoint;
use tesaki::node::{MAX_STATE, Node};
use tesaki::protocol::{Item, Mode, Reply, Request};
use tesaki::task::impedance::ImpedanceTelemetry;
use tesaki::task::{TaskConfig, TaskKind, TaskTelemetry};
use tesaki_tests::robot;

use super::fuzz;
use super::random::Random;
use super::requests::{REST, any_pose, any_request, any_settings, configure};
use super::rig::Rig;

/// The arm, once impedance control was enabled.
fn tool(node: &Node) -> Option<ImpedanceTelemetry> {
    match node.task_report()?.telemetry {
        TaskTelemetry::Impedance(tool) => Some(tool),
        _ => None,
    }
}

/// Runs in the checks, in which it touches, is free, and is refused.
const RUNS: u64 = 3000;

#[test]
fn an_arm_that_yields_keeps_its_limits_whatever_pushes_it() {
    let model = robot("arm7").model;
    let seen = RefCell::new(BTreeSet::new());
    let runs = fuzz("arm", RUNS, |seed| {
        let mut random = Random(seed);
        let mut rig = Rig::new(&model, 48_000, seed);
        // The machine: joints that go where their reference is, roughly, and what the sensor reads.
        let mut angles: Vec<f32> = (0..7).map(|_| random.below(1001) as f32 / 2000.0).collect();
        angles[3] += 1.0;
        let mut push = [0_i32; 6];
        for tick in 0..random.below(1000) {
            for ((count, angle), joint) in rig.sensors.encoders.iter_mut().zip(&angles).zip(&model.joints) {
                let counts = angle / std::f32::consts::TAU * joint.encoder.counts_per_turn;
                *count = if tick > 1 && random.one_in(5000) {
                    random.next() as i32
                } else {
                    (counts as i32).wrapping_add(random.below(3) as i32)
                };
            }
            if tick > 1 && random.one_in(50) {
                push = [0; 6].map(|_| if random.one_in(3) { random.below(4001) as i32 - 2000 } else { 0 });
            }
            rig.sensors.forces[0] = push.map(|count| count + random.below(11) as i32 - 5);
            if tick > 1 && random.one_in(1000) {
                rig.sensors.forces[0][random.below(6)] = random.next() as i32;
            }
            rig.sensors.sequence += 1;
            rig.tick(rig.sensors.clone());
            for (angle, joint) in angles.iter_mut().zip(&rig.node.telemetry().joints) {
                *angle = joint.reference;
            }
            if tick == 1 {
                let settings = any_settings(&mut random);
                let possible = settings.validate(7).is_ok();
                assert_eq!(rig.ask(Request::Tare), Reply::Done, "seed {seed}");
                let reply = rig.ask(Request::Enable(TaskConfig::Impedance(settings)));
                // Whether a mass is too small for the arm's own depends on the posture.
                let is_light = format!("{reply:?}").contains("MassInContact");
                assert_eq!(reply == Reply::Done, possible && !is_light, "seed {seed}: {reply:?}");
                seen.borrow_mut().extend(is_light.then(|| "a mass too small in contact".to_owned()));
            }
            let tool = tool(&rig.node);
            if rig.node.mode() == Mode::Enabled(TaskKind::Impedance) {
                seen.borrow_mut().insert(if tool.unwrap().contact { "contact" } else { "free" }.to_owned());
            }
            if let Some(fault) = rig.node.faults().faults.last() {
                seen.borrow_mut().insert(format!("{:?}", fault.cause));
                // What is accepted, an arm can follow without losing count.
                assert!(fault.cause != FaultCause::NotFinite, "seed {seed}: {fault}");
            }
            let place = tool.map_or(REST, |tool| PosePoint {
                position: tool.position,
                rotation: tool.rotation,
                ..REST
            });
            if tick < 2 {
                continue;
            }
            let request = match random.below(400) {
                0 => any_request(&mut random, &model, &[]),
                1..6 => configure(any_settings(&mut random)),
                6 => Request::Export(Item::State),
                7 => Request::Enable(TaskConfig::Impedance(any_settings(&mut random))),
                8..80 => any_pose(&mut random, &place),
                80..200 => Request::Keep,
                _ => continue,
            };
            if let Reply::Exported { length, .. } = rig.ask(request) {
                assert!(length <= MAX_STATE as u32, "seed {seed}: {length} bytes");
            }
        }
        rig.replay();
    });
    let seen = seen.into_inner();
    println!("arm: {seen:?}");
    let all = ["contact", "free", "ToolPositionError", "ToolOrientationError"];
    assert!(runs < RUNS || all.iter().all(|name| seen.contains(*name)), "{seen:?}");
}
