//! A hand that puts an object down, or lets it go.

use super::grasp::{begin_grasp, hand, in_front, keep, paper_plan, seen, task};
use super::rig::{COUNTS_PER_RADIAN, Rig};
use crate::model::RobotModel;
use crate::protocol::Reply;
use crate::task::grasping::{Failure, GraspCommand, GraspPlan, InternalForce, JointTargets, Phase};

/// The plans of a grip along the normals, with and without feedback, and of the least grip.
fn plans() -> [GraspPlan; 3] {
    let servo = GraspPlan { joint_targets: JointTargets::ClosedForm, ..paper_plan() };
    [servo, GraspPlan { feedback: true, ..servo }, in_front()]
}

/// Size of the target force of finger 3 [N].
fn target(rig: &mut Rig) -> f32 {
    let [.., [x, y, z]] = seen(rig).target_forces;
    libm::sqrtf(x * x + y * y + z * z)
}

/// Runs a hand whose joints follow their references, and whose fingertips press with their target forces, or
/// with 0.5 N when they search for an object. Returns the last torque of the middle joint of finger 3 [N·m].
fn run(rig: &mut Rig, ticks: u32) -> f32 {
    let mut torque = 0.0;
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
                // The grip is as it was.
                Phase::Lower => {
                    counts[5] = 1 - counts[5];
                    continue;
                }
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
        torque = rig.tick().torques[7];
        keep(rig);
    }
    torque
}

/// A hand that grasps an object by `plan`, up to a phase.
fn grasping(model: RobotModel, plan: GraspPlan, phase: Phase) -> Rig {
    let mut rig = begin_grasp(model, plan, 200.0);
    for _ in 0..800 {
        if seen(&mut rig).phase == phase {
            break;
        }
        run(&mut rig, 1);
    }
    assert_eq!(seen(&mut rig).phase, phase, "{:?}", seen(&mut rig).failure);
    rig
}

fn holding(plan: GraspPlan) -> Rig {
    grasping(hand(), plan, Phase::Hold)
}

/// The forces fall within 30 ticks, by the same amount in each.
#[test]
fn a_hand_that_opens_presses_less_in_every_tick() {
    for plan in plans() {
        let mut rig = holding(plan);
        let (mut last, held) = (run(&mut rig, 200), target(&mut rig));
        assert!(held > 0.5, "{held}");
        assert_eq!(rig.ask(task(GraspCommand::Open)), Reply::Done);
        for tick in 1..=30_u8 {
            let torque = run(&mut rig, 1);
            assert!(torque.abs() < last.abs() + 1e-3, "{tick}: {torque} N·m after {last}");
            last = torque;
            let expected = held * (1.0 - f32::from(tick) / 30.0);
            let found = target(&mut rig);
            assert!((found - expected).abs() < 0.05 * held, "{tick}: {found}, not {expected} N");
        }
        assert_eq!(seen(&mut rig).phase, Phase::Open);
    }
}

/// A grip that is only half there is not doubled, and the force that probes the friction does not end in a
/// step.
#[test]
fn a_hand_that_opens_early_begins_with_the_forces_it_has() {
    let probing =
        GraspPlan { friction: None, internal: InternalForce::Normal { strength: 1.0 }, ..in_front() };
    for (plan, phase) in [(in_front(), Phase::Squeeze), (probing, Phase::ProbeFriction)] {
        let mut rig = grasping(hand(), plan, phase);
        run(&mut rig, 20);
        let before: [f32; 3] = seen(&mut rig).target_forces[0];
        assert_eq!(rig.ask(task(GraspCommand::Open)), Reply::Done);
        run(&mut rig, 1);
        let after: [f32; 3] = seen(&mut rig).target_forces[0];
        for (before, after) in before.into_iter().zip(after) {
            assert!((before - after).abs() < 0.1 * before.abs() + 0.01, "{phase}: {before}, then {after} N");
        }
    }
}

#[test]
fn an_object_that_is_released_in_motion_stops() {
    let mut rig = holding(in_front());
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

/// A weight below the sensors' noise does not tell whether a support carries it.
#[test]
fn noise_is_no_support_of_a_light_object() {
    let mut rig = holding(in_front());
    assert_eq!(rig.ask(task(GraspCommand::PutDown)), Reply::Done);
    run(&mut rig, 42);
    assert_eq!(seen(&mut rig).phase, Phase::Lower);
}

/// 1 mm inwards, as far as the grasp was from the end of the second joint's range: the way back from the
/// object, 2 mm, leads beyond that.
#[test]
fn fingers_that_cannot_move_back_stop_and_say_so() {
    let mut model = hand();
    model.joints[1].limits.lower = 0.49;
    let mut rig = grasping(model, in_front(), Phase::Hold);
    let motion = GraspCommand::Move { translation: [-0.001, 0.0, 0.0], rotation: [0.0; 3], duration: 1.0 };
    assert_eq!(rig.ask(task(motion)), Reply::Done);
    run(&mut rig, 110);
    assert_eq!(rig.ask(task(GraspCommand::Open)), Reply::Done);
    run(&mut rig, 100);
    let seen = seen(&mut rig);
    assert_eq!((seen.phase, seen.failure), (Phase::Ready, Some(Failure::OutOfReach { finger: 0 })));
}
