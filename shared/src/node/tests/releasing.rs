//! A hand that lets an object go.

use super::grasp::{begin_grasp, hand, in_front, keep, seen, task};
use super::rig::{COUNTS_PER_RADIAN, Rig};
use crate::model::RobotModel;
use crate::protocol::Reply;
use crate::task::grasping::{Failure, GraspCommand, Phase};

/// Runs a hand whose joints follow their references, and whose fingertips press with their target forces, or
/// with 0.5 N when they search for an object.
fn run(rig: &mut Rig, ticks: u32) {
    for _ in 0..ticks {
        let state = seen(rig);
        let references = rig.node.state.references;
        for (count, reference) in rig.sensors.encoders.iter_mut().zip(&references) {
            *count = libm::roundf(reference.position * COUNTS_PER_RADIAN) as i32;
        }
        for (finger, counts) in rig.sensors.forces.iter_mut().enumerate() {
            let push = if finger == 2 { -0.5 } else { 0.5 };
            let [x, y, z] = match state.phase {
                Phase::Ready | Phase::Approach => [0.0; 3],
                Phase::Touch => [push, 0.0, 0.0],
                _ => state.target_forces[finger],
            };
            let (sin, cos) = crate::math::sin_cos(
                references[3 * finger + 1].position + references[3 * finger + 2].position,
            );
            let noise = 1 - counts[5];
            // The object pushes back. Noise of one count: constant counts would be a fault.
            *counts = [z * sin - x * cos, -y, -x * sin - z * cos, 0.0, 0.0, 0.0]
                .map(|part| libm::roundf(1e3 * part) as i32);
            counts[5] = noise;
        }
        rig.tick();
        keep(rig);
    }
}

/// A hand of this model that holds an object.
fn holding(model: RobotModel) -> Rig {
    let mut rig = begin_grasp(model, in_front(), 200.0);
    for _ in 0..800 {
        if seen(&mut rig).phase == Phase::Hold {
            break;
        }
        run(&mut rig, 1);
    }
    assert_eq!(seen(&mut rig).phase, Phase::Hold, "{:?}", seen(&mut rig).failure);
    rig
}

#[test]
fn an_object_that_is_released_in_motion_stops() {
    let mut rig = holding(hand());
    let translation = [0.0, 0.0, -0.01];
    let motion = GraspCommand::Move { translation, rotation: [0.0; 3], duration: 0.2 };
    assert_eq!(rig.ask(task(motion)), Reply::Done);
    run(&mut rig, 10);
    let speed = |rig: &Rig| {
        rig.node.state.references.iter().fold(0.0, |max, joint| f32::max(max, joint.velocity.abs()))
    };
    assert!(speed(&rig) > 0.5, "{} rad/s", speed(&rig));
    assert_eq!(rig.ask(task(GraspCommand::Open)), Reply::Done);
    for _ in 0..25 {
        run(&mut rig, 1);
        assert!(speed(&rig) < 1e-6, "{} rad/s", speed(&rig));
    }
}

/// 1 mm inwards, as far as the grasp was from the end of the second joint's range: the way back from the
/// object, 2 mm, leads beyond that.
#[test]
fn fingers_that_cannot_move_back_stop_and_say_so() {
    let mut model = hand();
    model.joints[1].limits.lower = 0.49;
    let mut rig = holding(model);
    let motion = GraspCommand::Move { translation: [-0.001, 0.0, 0.0], rotation: [0.0; 3], duration: 1.0 };
    assert_eq!(rig.ask(task(motion)), Reply::Done);
    run(&mut rig, 110);
    assert_eq!(rig.ask(task(GraspCommand::Open)), Reply::Done);
    run(&mut rig, 100);
    let seen = seen(&mut rig);
    assert_eq!((seen.phase, seen.failure), (Phase::Ready, Some(Failure::OutOfReach { finger: 0 })));
}
