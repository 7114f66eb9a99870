//! Goals and streams of joint positions.

use heapless::Vec;

use super::rig::{COUNTS_PER_RADIAN, Rig, model, refusal};
use crate::control::JointPoint;
use crate::protocol::{Refusal, Reply, Request};
use crate::robot::LimitRefusal;
use crate::task::joint_servo::{JointCommand, JointServoRefusal};
use crate::task::{TaskCommand, TaskRefusal};

#[test]
fn setpoints_beyond_limits_are_refused_by_joint_and_change_nothing() {
    let mut rig = Rig::enabled(&model());
    let before = rig.tick();
    assert_eq!(
        refusal(rig.goal([0.0, f32::NAN, 0.0])),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::NotFinite {
            joint: 1
        })))
    );
    assert_eq!(
        refusal(rig.goal([0.0, 0.0, 1.6])),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::OutsideLimits {
            joint: 2,
            value: 1.6,
            lower: -1.5,
            upper: 1.5
        })))
    );
    let short = Request::Task(TaskCommand::JointServo(JointCommand::Goal {
        positions: Vec::from_slice(&[0.0; 2]).unwrap(),
    }));
    assert_eq!(
        refusal(rig.ask(short)),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::JointCount {
            got: 2,
            expected: 3
        })))
    );
    let stream = |position, velocity| {
        let rest = JointPoint::default();
        let points =
            Vec::from_slice(&[rest, rest, JointPoint { position, velocity, acceleration: 0.0 }]).unwrap();
        Request::Task(TaskCommand::JointServo(JointCommand::Stream { points }))
    };
    let beyond = |limit| Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(limit)));
    assert_eq!(
        refusal(rig.ask(stream(0.5, 0.0))),
        beyond(LimitRefusal::Jump { joint: 2, value: 0.5, limit: 0.2 })
    );
    assert_eq!(
        refusal(rig.ask(stream(0.0, 9.0))),
        beyond(LimitRefusal::TooFast { joint: 2, value: 9.0, limit: 8.0 })
    );
    assert_eq!(refusal(rig.ask(stream(f32::INFINITY, 0.0))), beyond(LimitRefusal::NotFinite { joint: 2 }));
    let after = rig.tick();
    assert_eq!(before.torques, after.torques);
    assert!(rig.node.telemetry().joints.iter().all(|joint| joint.reference == 0.0));
}

/// Streams joint 1 to `position` at rest.
fn step_to(rig: &mut Rig, position: f32) -> Reply {
    let point = JointPoint { position, ..JointPoint::default() };
    let points = [JointPoint::default(), point, JointPoint::default()].into_iter().collect();
    rig.ask(Request::Task(TaskCommand::JointServo(JointCommand::Stream { points })))
}

/// Streams joint 1 by `steps` [rad], one per tick; `None` is a tick without a point. The joint follows.
/// Returns the first refused step and the reason.
fn stream_steps(steps: &[Option<f32>]) -> Option<(usize, Refusal)> {
    let mut model = model();
    (model.joints[1].limits.lower, model.joints[1].limits.upper) = (-100.0, 100.0);
    let mut rig = Rig::enabled(&model);
    let mut position = 0.0;
    for (index, step) in steps.iter().enumerate() {
        if let Some(step) = step {
            if let Reply::Refused(refusal) = step_to(&mut rig, position + step) {
                return Some((index, refusal));
            }
            position += step;
        } else {
            assert_eq!(rig.ask(Request::Keep), Reply::Done);
        }
        // Only the references are tested: a joint that followed such a step would cause a fault.
        rig.node.state.measured.positions[1] = position;
        rig.sensors.encoders[1] = libm::roundf(position * COUNTS_PER_RADIAN) as i32;
        rig.tick();
        assert_eq!(rig.node.faults().total, 0, "{index}: {:?}", rig.node.faults());
    }
    None
}

/// The limit is 8 rad/s: 0.08 rad per tick. Steps of 0.2 rad, the following error, take 2.5 ticks at the
/// limit; each tick subtracts 1.1, and the stream may be 10 ticks ahead.
#[test]
fn a_stream_that_steps_faster_than_the_velocity_limit_is_refused() {
    let (index, refusal) = stream_steps(&[Some(0.199); 10]).unwrap();
    let LimitRefusal::TooFast { joint: 1, value, limit: 8.0 } = (match refusal {
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(refusal))) => refusal,
        other => panic!("{other}"),
    }) else {
        panic!("{refusal}")
    };
    assert_eq!(index, 6);
    // After six steps of 2.4875 ticks the points are 6 · (2.4875 − 1.1) = 8.325 ticks ahead: 1.675 remain.
    assert!((value - 8.0 * 2.4875 / 1.675).abs() < 1e-3, "{value}");
    // A constant excess of a fifth is refused in the end, too.
    assert!(stream_steps(&[Some(0.096); 1000]).is_some_and(|(index, _)| (80..100).contains(&index)));
}

/// Links deliver delayed points at once, and clocks differ.
#[test]
fn a_stream_within_the_velocity_limit_is_accepted_as_links_deliver_it() {
    let full = 0.08;
    // A clock that is 5 % fast.
    assert_eq!(stream_steps(&[Some(1.05 * full); 1000]), None);
    // Every third point is late and arrives with the next one; then two of three.
    assert_eq!(stream_steps(&[Some(full), None, Some(2.0 * full)].repeat(100)), None);
    assert_eq!(stream_steps(&[None, None, Some(2.99 * full / 1.2)].repeat(100)), None);
    // A slower stream with five points at once.
    assert_eq!(stream_steps(&[&[Some(0.04); 50][..], &[Some(0.199)], &[Some(0.04); 50]].concat()), None);
}

#[test]
fn a_stream_is_followed_exactly_and_a_goal_continues_without_a_jump() {
    let mut rig = Rig::enabled(&model());
    let mut position = 0.0;
    for _ in 0..20 {
        position += 0.01 * 0.5;
        let point = JointPoint { position, velocity: 0.5, acceleration: 0.0 };
        let points = Vec::from_slice(&[JointPoint::default(), point, JointPoint::default()]).unwrap();
        assert_eq!(
            rig.ask(Request::Task(TaskCommand::JointServo(JointCommand::Stream { points }))),
            Reply::Done
        );
        rig.sensors.encoders[1] = (position * COUNTS_PER_RADIAN) as i32;
        rig.tick();
        assert_eq!(rig.node.telemetry().joints[1].reference, position);
    }
    rig.goal([0.0, position, 0.0]);
    rig.tick();
    // The trajectory filter continues with the stream's velocity: 0.5 rad/s · 10 ms · e^(−0.05) in the first
    // tick.
    let step = rig.node.telemetry().joints[1].reference - position;
    assert!((step - 0.004_756).abs() < 1e-5, "{step}");
}

#[test]
fn a_goal_that_is_far_is_reached_within_the_velocity_limit() {
    let mut model = model();
    // With the filter alone the reference would reach 3 rad/(e · 0.05 s) = 22 rad/s; the limit is 8 rad/s.
    model.joints[2].servo.filter_time = 0.05;
    let mut rig = Rig::enabled(&model);
    assert_eq!(rig.goal([0.0, 0.0, -1.5]), Reply::Done);
    let [mut goal, mut before, mut fastest] = [-1.5, 0.0, 0.0_f32];
    for tick in 0..200 {
        for (count, joint) in rig.sensors.encoders.iter_mut().zip(rig.node.telemetry().joints) {
            *count = libm::roundf(joint.reference * COUNTS_PER_RADIAN) as i32;
        }
        if tick == 100 {
            goal = 1.5;
        }
        assert_eq!(rig.goal([0.0, 0.0, goal]), Reply::Done);
        rig.tick();
        let reference = rig.node.telemetry().joints[2].reference;
        fastest = fastest.max((reference - before).abs() / 0.01);
        before = reference;
        assert_eq!(rig.node.faults().total, 0, "{:?}", rig.node.faults());
        assert!(tick % 100 < 99 || (reference - goal).abs() < 1e-3, "{tick}: {reference}");
    }
    assert!(fastest > 0.75 * 8.0 && fastest < 0.85 * 8.0, "{fastest} rad/s");
}
