//! Limits under arbitrary requests and sensor values.

use std::sync::LazyLock;

use heapless::Vec;
use proptest::prelude::*;

use super::arm::{arm_rig, arm_with_force_sensor, configure};
use super::grasp::{KEEP, in_front, paper_plan, slow_holding_hand, wrench_plan};
use super::rig::{Rig, model};
use super::stream_torques::stream_torques;
use crate::control::{JointPoint, ServoMode};
use crate::protocol::{Item, Reply, Request, SCHEMA_KEY, SensorFlags, Stream};
use crate::robot::Actuation;
use crate::task::grasping::{GraspCommand, GraspPlan};
use crate::task::impedance::tests::SOFT;
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig};

/// Requests for a robot of `joints` joints, of any task.
fn any_request(joints: usize) -> impl Strategy<Value = Request> {
    let value = prop_oneof![
        8 => -1.5_f32..1.5, 8 => -0.05_f32..0.05, 1 => Just(f32::NAN), 1 => Just(f32::INFINITY),
        1 => any::<f32>(), 3 => Just(0.0)
    ];
    let small = [(); 3].map(|()| -0.01_f32..0.01);
    let list = proptest::collection::vec(value.clone(), joints - 1..joints + 2);
    let points = proptest::collection::vec((value.clone(), value.clone(), value.clone()), joints);
    let torques = proptest::collection::vec(prop_oneof![8 => -0.7_f32..0.7, 1 => any::<f32>()], joints);
    let enable = |config: TaskConfig| Just(Request::Enable(config));
    let grasp = |command: GraspCommand| Request::Task(TaskCommand::Grasping(command));
    let stream =
        |points: std::vec::Vec<JointPoint>| JointCommand::Stream { points: points.into_iter().collect() };
    let servo = |command: JointCommand| Request::Task(TaskCommand::JointServo(command));
    let ordinary = prop_oneof![
        Just(Request::ReadTask),
        Just(Request::Hello { schema: SCHEMA_KEY }),
        Just(Request::Disable),
        Just(Request::Stop),
        Just(Request::ReadFaults),
        Just(Request::Tare),
        (0_u32..4).prop_map(|total| Request::ClearFaults { total }),
        any::<u16>().prop_map(|every| Request::SetRate { stream: Stream::Log, every }),
        any::<bool>().prop_map(|by_force| Request::TakeCommand { by_force }),
        Just(Request::ReleaseCommand),
        Just(Request::ModelCommit),
        Just(Request::Export(Item::State)),
        any::<u32>().prop_map(|offset| Request::ReadExport { offset }),
        (any::<u32>(), any::<u32>()).prop_map(|(length, checksum)| Request::ModelBegin { length, checksum }),
        list.clone().prop_map(|list| Request::Home { positions: list.into_iter().collect() }),
    ];
    let enabling = prop_oneof![
        enable(TaskConfig::JointServo(ServoMode::Pid)),
        enable(TaskConfig::JointServo(ServoMode::Observer)),
        enable(TaskConfig::JointServo(ServoMode::BarePid)),
        enable(TaskConfig::Grasping(())),
        enable(TaskConfig::Impedance(SOFT)),
    ];
    let commands = prop_oneof![
        torques.prop_map(move |torques| stream_torques(&std::vec![0.0; joints], &torques)),
        list.prop_map(move |list| servo(JointCommand::Goal { positions: list.into_iter().collect() })),
        points.prop_map(move |points| {
            let point = |(position, velocity, acceleration)| JointPoint { position, velocity, acceleration };
            servo(stream(points.into_iter().map(point).collect()))
        }),
        Just(grasp(GraspCommand::Grasp(in_front()))),
        Just(grasp(GraspCommand::Grasp(paper_plan()))),
        Just(grasp(GraspCommand::Open)),
        Just(grasp(GraspCommand::PutDown)),
        small.prop_map(move |translation| {
            grasp(GraspCommand::Move { translation, rotation: [0.0; 3], duration: 1.0 })
        }),
        value.prop_map(|mass| {
            let mut settings = SOFT;
            settings.impedance.mass[0] = mass;
            configure(settings)
        }),
    ];
    prop_oneof![4 => ordinary, 1 => enabling, 4 => commands]
}

/// A tick: a request before it, and the sensor values, most often those of the start.
#[derive(Clone, Debug)]
struct Step {
    request: Option<Request>,
    /// Whether the client sends a `Keep`.
    keeps: bool,
    count: i32,
    force: i16,
    current: i16,
    /// 0: a current that may be too high; 1: the emergency stop; 2: a missing frame; 3: a jump of the
    /// encoder.
    special: u8,
}

fn any_steps(joints: usize) -> impl Strategy<Value = std::vec::Vec<Step>> {
    let request = proptest::option::of(any_request(joints));
    let sensors = (-40_i32..40, -2000_i16..2000, any::<i16>());
    let step = (request, proptest::bool::weighted(0.8), sensors, 0_u8..120);
    let step = step.prop_map(|(request, keeps, (count, force, current), special)| Step {
        request,
        keeps,
        count,
        force,
        current,
        special,
    });
    proptest::collection::vec(step, 1..120)
}

/// Runs the ticks; [`Rig::tick`] checks the torques.
fn run(mut rig: Rig, steps: std::vec::Vec<Step>) {
    let before = rig.sensors.clone();
    for (tick, step) in (0..).zip(steps) {
        if step.keeps {
            rig.ask(KEEP);
        }
        if let Some(request) = step.request {
            rig.ask(request);
        }
        let leap = if step.special == 3 { 1000 } else { 1 };
        rig.sensors.encoders[1] = before.encoders[1] + step.count * leap;
        rig.sensors.currents[0] = if step.special == 0 { step.current } else { 0 };
        rig.sensors.flags = SensorFlags(u8::from(step.special == 1));
        rig.sensors.sequence += u32::from(step.special == 2);
        for (counts, before) in rig.sensors.forces.iter_mut().zip(&before.forces) {
            // Constant counts would be a fault.
            (counts[0], counts[3]) = (before[0] + i32::from(step.force) / 10, before[3] + tick % 2);
        }
        rig.tick();
    }
}

/// An enabled finger with a torque rate of 20 mN·m per tick.
fn finger() -> Rig {
    let mut model = model();
    model.joints.iter_mut().for_each(|joint| joint.limits.torque_rate = 2.0);
    Rig::enabled(&model)
}

/// An arm under impedance control, with a torque rate of 0.5 N·m per tick.
fn arm() -> Rig {
    let mut model = arm_with_force_sensor();
    model.joints.iter_mut().for_each(|joint| joint.limits.torque_rate = 50.0);
    let mut rig = arm_rig(&model);
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    assert_eq!(rig.ask(Request::Enable(TaskConfig::Impedance(SOFT))), Reply::Done);
    rig.tick();
    assert!(matches!(rig.node.state.targets.actuation, Actuation::Acceleration { .. }));
    rig
}

/// A hand that holds an object, with a torque rate of 1 mN·m per tick.
fn hand(plan: GraspPlan) -> Rig {
    let mut rig = slow_holding_hand(plan, 0.1);
    assert_eq!(rig.ask(KEEP), Reply::Done);
    rig
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// For arbitrary requests and sensor values there is no panic, and all torques are finite, within their
    /// limits and within their rates.
    #[test]
    fn torques_of_joint_servos_are_within_limits(steps in any_steps(3)) {
        static RIG: LazyLock<Rig> = LazyLock::new(finger);
        run(RIG.clone(), steps);
    }

    #[test]
    fn torques_of_a_hand_that_holds_by_servos_are_within_limits(steps in any_steps(9)) {
        static RIG: LazyLock<Rig> = LazyLock::new(|| hand(paper_plan()));
        run(RIG.clone(), steps);
    }

    #[test]
    fn torques_of_a_hand_that_holds_by_torques_are_within_limits(steps in any_steps(9)) {
        static RIG: LazyLock<Rig> = LazyLock::new(|| hand(wrench_plan()));
        assert!(matches!(RIG.node.state.targets.actuation, Actuation::Torque { .. }));
        run(RIG.clone(), steps);
    }

    #[test]
    fn torques_of_an_arm_are_within_limits(steps in any_steps(7)) {
        static RIG: LazyLock<Rig> = LazyLock::new(arm);
        run(RIG.clone(), steps);
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
