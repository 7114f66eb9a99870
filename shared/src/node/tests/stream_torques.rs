//! Streams with feed-forward torques.

use super::rig::{Rig, model, near, refusal};
use crate::control::{JointPoint, ServoMode};
use crate::fault::FaultCause;
use crate::protocol::{Refusal, Reply, Request};
use crate::robot::LimitRefusal;
use crate::task::joint_servo::{JointCommand, JointServoRefusal};
use crate::task::{TaskCommand, TaskConfig, TaskRefusal};

pub fn stream_torques(positions: &[f32], torques: &[f32]) -> Request {
    let points = positions.iter().map(|&position| JointPoint { position, ..JointPoint::default() });
    Request::Task(TaskCommand::JointServo(JointCommand::StreamTorques {
        points: points.collect(),
        torques: torques.iter().copied().collect(),
    }))
}

#[test]
fn a_feedforward_torque_is_added_and_remains_in_the_reaction_until_disable() {
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        // Two nodes with joints at rest, one of them with torques.
        let mut rigs = [(); 2].map(|()| {
            let mut rig = Rig::ready(&model());
            assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
            rig.tick();
            rig
        });
        let added = |rigs: &mut [Rig; 2]| {
            let [loaded, free] = rigs.each_mut().map(|rig| rig.tick().torques);
            [0, 1, 2].map(|joint| loaded[joint] - free[joint])
        };
        assert_eq!(rigs[0].ask(stream_torques(&[0.0; 3], &[0.0, 0.25, -0.125])), Reply::Done);
        assert_eq!(rigs[1].ask(stream_torques(&[0.0; 3], &[0.0; 3])), Reply::Done);
        for _ in 0..10 {
            let added = added(&mut rigs);
            assert!(near(added, [0.0, 0.25, -0.125], 1e-4), "{mode:?} {added:?}");
        }
        // Command timeout, then reaction hold.
        for _ in 0..50 {
            let added = added(&mut rigs);
            assert!(near(added, [0.0, 0.25, -0.125], 1e-3), "{mode:?} {added:?}");
        }
        assert_eq!(rigs[0].node.faults().faults.last().unwrap().cause, FaultCause::CommandTimeout);
        for rig in &mut rigs {
            rig.ask(Request::Disable);
            assert_eq!(rig.tick().torques, [0.0; 3]);
            let Reply::Faults(log) = rig.ask(Request::ReadFaults) else { panic!() };
            assert_eq!(rig.ask(Request::ClearFaults { total: log.total }), Reply::Done);
            assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        }
        assert!(near(added(&mut rigs), [0.0; 3], 1e-6));
        // Another kind of set-point removes it.
        assert_eq!(rigs[0].ask(stream_torques(&[0.0; 3], &[0.125; 3])), Reply::Done);
        assert!(near(added(&mut rigs), [0.125; 3], 1e-4));
        let rest = [JointPoint::default(); 3].into_iter().collect();
        assert_eq!(
            rigs[0].ask(Request::Task(TaskCommand::JointServo(JointCommand::Stream { points: rest }))),
            Reply::Done
        );
        assert!(near(added(&mut rigs), [0.0; 3], 1e-4));
    }
}

/// A torque that was sent right before a stop was never applied, and one that was is not dropped.
#[test]
fn a_stop_keeps_the_torque_that_was_applied() {
    let goal = Request::Task(TaskCommand::JointServo(JointCommand::Goal {
        positions: [0.0; 3].into_iter().collect(),
    }));
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        for last in [stream_torques(&[0.0; 3], &[0.5; 3]), goal.clone()] {
            let mut rig = Rig::ready(&model());
            assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
            rig.tick();
            assert_eq!(rig.ask(stream_torques(&[0.0; 3], &[0.0, 0.25, -0.125])), Reply::Done);
            let before = rig.tick().torques;
            assert_eq!(rig.ask(last.clone()), Reply::Done);
            assert_eq!(rig.ask(Request::Stop), Reply::Done);
            for _ in 0..50 {
                let torques = rig.tick().torques;
                assert!(
                    near([0, 1, 2].map(|joint| torques[joint] - before[joint]), [0.0; 3], 1e-3),
                    "{mode:?} {torques:?}"
                );
            }
        }
    }
}

#[test]
fn a_refused_command_changes_neither_points_nor_torques() {
    let mut rig = Rig::enabled(&model());
    assert_eq!(rig.ask(stream_torques(&[0.0; 3], &[0.125; 3])), Reply::Done);
    rig.tick();
    let too_much =
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::TooMuchTorque {
            joint: 1,
            value: -0.7,
            limit: 0.6,
        })));
    let before = format!("{:?}", rig.node.state.joints);
    assert_eq!(refusal(rig.ask(stream_torques(&[0.01; 3], &[0.0, -0.7, 0.0]))), too_much);
    assert_eq!(
        refusal(rig.ask(stream_torques(&[0.01; 3], &[0.0, 0.0, f32::NAN]))),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::NotFinite {
            joint: 2
        })))
    );
    let jump = Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::Jump {
        joint: 0,
        value: 0.5,
        limit: 0.2,
    })));
    assert_eq!(refusal(rig.ask(stream_torques(&[0.5; 3], &[0.0; 3]))), jump);
    let count = Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::JointCount {
        got: 2,
        expected: 3,
    })));
    assert_eq!(refusal(rig.ask(stream_torques(&[0.01; 3], &[0.0; 2]))), count);
    let points = [JointPoint::default(); 2].into_iter().collect();
    let torques = [0.0; 3].into_iter().collect();
    assert_eq!(
        refusal(
            rig.ask(Request::Task(TaskCommand::JointServo(JointCommand::StreamTorques { points, torques })))
        ),
        count
    );
    assert_eq!(format!("{:?}", rig.node.state.joints), before);
    assert_eq!(rig.ask(stream_torques(&[0.01; 3], &[0.6, -0.6, 0.0])), Reply::Done, "the limits themselves");
}

#[test]
fn a_joint_at_rest_under_a_feedforward_torque_is_stuck_only_when_its_reference_moves_on() {
    for (torque, reference, stuck) in [(0.0, 0.1, true), (0.5, 0.0, false), (0.5, 0.1, true)] {
        let mut rig = Rig::enabled(&model());
        for _ in 0..100 {
            rig.tick();
            rig.ask(stream_torques(&[0.0, 0.0, reference], &[0.0, 0.0, torque]));
        }
        let cause = rig.node.faults().faults.last().map(|fault| fault.cause);
        assert_eq!(cause, stuck.then_some(FaultCause::EncoderStuck), "{torque} N·m, {reference} rad");
    }
}
