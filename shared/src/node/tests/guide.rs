//! Set-points with torques beside them.

use super::bench::{Bench, model, near, refusal};
use crate::control::{JointPoint, ServoMode};
use crate::fault::FaultCause;
use crate::protocol::{Refusal, Reply, Request};
use crate::robot::LimitRefusal;
use crate::task::joint_servo::{JointCommand, JointServoRefusal};
use crate::task::{TaskCommand, TaskConfig, TaskRefusal};

pub fn guide(positions: [f32; 3], torques: &[f32]) -> Request {
    let points = positions.map(|position| JointPoint { position, ..JointPoint::default() });
    Request::Task(TaskCommand::JointServo(JointCommand::Guide {
        points: points.into_iter().collect(),
        torques: torques.iter().copied().collect(),
    }))
}

#[test]
fn a_guided_torque_is_added_and_stays_in_the_reaction_until_the_node_is_disarmed() {
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        // One of two nodes gets torques; the joints of both stand still.
        let mut benches = [(); 2].map(|()| {
            let mut bench = Bench::ready(&model());
            assert_eq!(bench.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
            bench.tick();
            bench
        });
        let added = |benches: &mut [Bench; 2]| {
            let [pressed, free] = benches.each_mut().map(|bench| bench.tick().torques);
            [0, 1, 2].map(|joint| pressed[joint] - free[joint])
        };
        assert_eq!(benches[0].ask(guide([0.0; 3], &[0.0, 0.25, -0.125])), Reply::Done);
        assert_eq!(benches[1].ask(guide([0.0; 3], &[0.0; 3])), Reply::Done);
        for _ in 0..10 {
            let added = added(&mut benches);
            assert!(near(added, [0.0, 0.25, -0.125], 1e-4), "{mode:?} {added:?}");
        }
        // Nobody commands any more.
        for _ in 0..50 {
            let added = added(&mut benches);
            assert!(near(added, [0.0, 0.25, -0.125], 1e-3), "{mode:?} {added:?}");
        }
        assert_eq!(benches[0].node.faults().faults.last().unwrap().cause, FaultCause::CommandTimeout);
        for bench in &mut benches {
            bench.ask(Request::Disable);
            assert_eq!(bench.tick().torques, [0.0; 3]);
            let Reply::Faults(log) = bench.ask(Request::ReadFaults) else { panic!() };
            assert_eq!(bench.ask(Request::ClearFaults { total: log.total }), Reply::Done);
            assert_eq!(bench.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        }
        assert!(near(added(&mut benches), [0.0; 3], 1e-6));
        // A set-point of another kind takes it off.
        assert_eq!(benches[0].ask(guide([0.0; 3], &[0.125; 3])), Reply::Done);
        assert!(near(added(&mut benches), [0.125; 3], 1e-4));
        let rest = [JointPoint::default(); 3].into_iter().collect();
        assert_eq!(
            benches[0].ask(Request::Task(TaskCommand::JointServo(JointCommand::Stream { points: rest }))),
            Reply::Done
        );
        assert!(near(added(&mut benches), [0.0; 3], 1e-4));
    }
}

#[test]
fn a_guide_that_is_refused_changes_neither_points_nor_torques() {
    let mut bench = Bench::armed(&model());
    assert_eq!(bench.ask(guide([0.0; 3], &[0.125; 3])), Reply::Done);
    bench.tick();
    let too_much =
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::TooMuchTorque {
            joint: 1,
            value: -0.7,
            limit: 0.6,
        })));
    let before = format!("{:?}", bench.node.state.joints);
    assert_eq!(refusal(bench.ask(guide([0.01; 3], &[0.0, -0.7, 0.0]))), too_much);
    assert_eq!(
        refusal(bench.ask(guide([0.01; 3], &[0.0, 0.0, f32::NAN]))),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::NotFinite {
            joint: 2
        })))
    );
    let jump = Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::Jump {
        joint: 0,
        value: 0.5,
        limit: 0.2,
    })));
    assert_eq!(refusal(bench.ask(guide([0.5; 3], &[0.0; 3]))), jump);
    let count = Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::JointCount {
        got: 2,
        expected: 3,
    })));
    assert_eq!(refusal(bench.ask(guide([0.01; 3], &[0.0; 2]))), count);
    let points = [JointPoint::default(); 2].into_iter().collect();
    let torques = [0.0; 3].into_iter().collect();
    assert_eq!(
        refusal(bench.ask(Request::Task(TaskCommand::JointServo(JointCommand::Guide { points, torques })))),
        count
    );
    assert_eq!(format!("{:?}", bench.node.state.joints), before);
    assert_eq!(bench.ask(guide([0.01; 3], &[0.6, -0.6, 0.0])), Reply::Done, "the limits themselves");
}

#[test]
fn a_joint_that_presses_on_an_object_is_not_taken_for_stuck() {
    for (torque, stuck) in [(0.0, true), (0.01, false)] {
        let mut bench = Bench::armed(&model());
        for _ in 0..100 {
            bench.tick();
            bench.ask(guide([0.0, 0.0, 0.19], &[0.0, 0.0, torque]));
        }
        let cause = bench.node.faults().faults.last().map(|fault| fault.cause);
        assert_eq!(cause, stuck.then_some(FaultCause::EncoderStuck));
    }
}
