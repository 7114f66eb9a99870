//! Limits under arbitrary requests and sensor values.

use heapless::Vec;
use proptest::prelude::*;

use super::grasp::{KEEP, in_front};
use super::rig::{Rig, model};
use super::stream_torques::stream_torques;
use crate::control::{JointPoint, ServoMode};
use crate::model::MAX_JOINTS;
use crate::protocol::{Item, Reply, Request, SCHEMA_KEY, SensorFlags, Stream};
use crate::task::grasping::GraspCommand;
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig};

fn any_request() -> impl Strategy<Value = Request> {
    let value = prop_oneof![
        4 => -1.5_f32..1.5, 1 => Just(f32::NAN), 1 => Just(f32::INFINITY), 1 => any::<f32>(), 3 => Just(0.0)
    ];
    let list = proptest::collection::vec(value.clone(), 0..5);
    let points = proptest::collection::vec((value.clone(), value.clone(), value), 3);
    let torques = proptest::collection::vec(prop_oneof![4 => -0.7_f32..0.7, 1 => any::<f32>()], 3);
    prop_oneof![
        Just(KEEP),
        Just(Request::ReadTask),
        Just(Request::Task(TaskCommand::Grasping(GraspCommand::Grasp(in_front())))),
        torques.prop_map(|torques| stream_torques([0.0; 3], &torques)),
        Just(Request::Hello { schema: SCHEMA_KEY }),
        Just(Request::Disable),
        Just(Request::Stop),
        Just(Request::ReadFaults),
        (0_u32..4).prop_map(|total| Request::ClearFaults { total }),
        any::<u16>().prop_map(|every| Request::SetRate { stream: Stream::Log, every }),
        any::<bool>().prop_map(|by_force| Request::TakeCommand { by_force }),
        Just(Request::ReleaseCommand),
        Just(Request::ModelCommit),
        Just(Request::Export(Item::State)),
        any::<u32>().prop_map(|offset| Request::ReadExport { offset }),
        (any::<u32>(), any::<u32>()).prop_map(|(length, checksum)| Request::ModelBegin { length, checksum }),
        Just(Request::Enable(TaskConfig::JointServo(ServoMode::Pid))),
        Just(Request::Enable(TaskConfig::JointServo(ServoMode::Observer))),
        list.clone().prop_map(|list| Request::Home { positions: Vec::from_slice(&list).unwrap() }),
        list.prop_map(|list| Request::Task(TaskCommand::JointServo(JointCommand::Goal {
            positions: Vec::from_slice(&list).unwrap()
        }))),
        points.prop_map(|points| {
            let points = points.iter().map(|&(position, velocity, acceleration)| JointPoint {
                position,
                velocity,
                acceleration,
            });
            Request::Task(TaskCommand::JointServo(JointCommand::Stream { points: points.collect() }))
        }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// For arbitrary requests and sensor values: no panic, and all torques finite and within their limits.
    #[test]
    fn torques_are_finite_and_within_limits(
        steps in proptest::collection::vec(
            (proptest::option::of(any_request()), -40_000_i32..40_000, any::<bool>(), any::<i16>(), 0_u8..30),
            1..120,
        )
    ) {
        let mut rig = Rig::enabled(&model());
        let mut last = [0.0_f32; MAX_JOINTS];
        for (request, count, wild, current, special) in steps {
            if let Some(request) = request {
                rig.ask(request);
            }
            rig.sensors.encoders[1] = if wild { count } else { count / 1000 };
            rig.sensors.currents[0] = if special == 0 { current } else { 0 };
            rig.sensors.flags = SensorFlags(u8::from(special == 1));
            rig.sensors.sequence += u32::from(special == 2);
            let output = rig.tick();
            for (index, &torque) in output.torques.iter().enumerate() {
                prop_assert!(torque.is_finite() && torque.abs() <= 0.6);
                // Torque rate 200 N·m/s, except to 0.
                prop_assert!(torque == 0.0 || (torque - last[index]).abs() <= 2.0 + 1e-5);
                prop_assert!(output.enabled || torque == 0.0);
                last[index] = torque;
            }
        }
    }
}

#[test]
fn homing_leaves_absolute_encoders_alone() {
    let mut model = model();
    model.joints[1].encoder.relative = true;
    let mut rig = Rig::ready(&model);
    rig.sensors.encoders = Vec::from_slice(&[100, 200, 300]).unwrap();
    rig.tick();
    let before = rig.node.telemetry().joints;
    let home = Request::Home { positions: Vec::from_slice(&[0.1, 0.2, 0.3]).unwrap() };
    assert_eq!(rig.ask(home), Reply::Done);
    let after = rig.node.telemetry().joints;
    assert_eq!([after[0].position, after[2].position], [before[0].position, before[2].position]);
    assert!((after[1].position - 0.2).abs() < 1e-4);
}
