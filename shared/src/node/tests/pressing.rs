//! Stops of joints that press on something.

use heapless::Vec;

use super::rig::{COUNTS_PER_RADIAN, Rig, model};
use super::stops::stream;
use crate::control::{JointPoint, ServoMode};
use crate::model::Reaction;
use crate::protocol::{Mode, Reply, Request};
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig};

/// The last joint presses on an obstacle with its integral action. The obstacle yields by one count per tick,
/// so the encoder does not look dead.
fn press(rig: &mut Rig) {
    for _ in 0..60 {
        rig.goal([0.0, 0.0, 0.15]);
        rig.tick();
        rig.sensors.encoders[2] += 1;
    }
}

/// The last joint, of 0.02 kg·m², presses, and will be damped.
fn damped_when_pressing() -> Rig {
    let mut model = model();
    model.safety.reaction = Reaction::Damp;
    model.joints[2].servo.observer.inertia = 0.02;
    model.joints[2].limits.following_error = 1.0;
    let mut rig = Rig::enabled(&model);
    press(&mut rig);
    rig
}

#[test]
fn a_damped_joint_forgets_a_torque_that_drives_it() {
    // The obstacle is removed, and the torque drives the joint.
    let mut rig = damped_when_pressing();
    rig.ask(Request::Stop);
    let pressed = rig.tick().torques[2];
    for tick in 1..=10 {
        // 1 rad/s.
        rig.sensors.encoders[2] += libm::roundf(0.01 * COUNTS_PER_RADIAN) as i32;
        let torque = rig.tick().torques[2];
        assert!(tick < 6 || torque < 0.05 * pressed, "tick {tick}: {torque} of {pressed} N·m");
    }
}

/// A push moves the joint back against its torque and ends: the joint then gains at most the energy that the
/// torque has taken out of its motion.
#[test]
fn a_damped_joint_gives_back_nothing_of_what_it_has_taken() {
    let mut rig = damped_when_pressing();
    rig.ask(Request::Stop);
    let mut advance = |speed: f32| {
        rig.sensors.encoders[2] += libm::roundf(0.01 * speed * COUNTS_PER_RADIAN) as i32;
        rig.tick();
        rig.node.state.targets.joints[2].feedforward
    };
    let pushed = [-0.4, -0.4, -0.4, -0.4, -0.3, -0.2, -0.1].map(&mut advance);
    assert!(pushed[6] > 0.03 && pushed[6] > 0.9 * 0.95 * pushed[5], "{pushed:?}");
    // Slower than the speed above which a robot always counts as driven.
    let driven = [0.05, 0.1, 0.15, 0.2, 0.25].map(&mut advance);
    assert!(driven[4] < 0.3 * pushed[6], "{pushed:?}, then {driven:?} N·m");
}

#[test]
fn what_a_damped_joint_has_pressed_with_fades() {
    // The obstacle moves the tip away.
    let mut model = model();
    model.safety.reaction = Reaction::Damp;
    let mut rig = Rig::enabled(&model);
    press(&mut rig);
    let pressed = rig.node.telemetry().joints[2].torque;
    assert!(pressed > 0.05, "{pressed} N·m");
    rig.ask(Request::Stop);
    let torques: std::vec::Vec<_> = (0..60).map(|_| rig.tick().torques[2]).collect();
    assert!(torques[0] > 0.7 * pressed && torques[0] <= pressed, "{torques:?} after {pressed} N·m");
    assert!(torques.iter().zip(&torques[1..]).all(|(before, after)| after <= before), "{torques:?}");
    assert!(torques[59] < 0.1 * pressed, "{torques:?}");
}

#[test]
fn a_robot_that_is_enabled_out_of_a_stop_keeps_the_torque_rate() {
    let mut model = model();
    model.joints[2].limits.torque_rate = 1.0;
    let mut rig = Rig::enabled(&model);
    press(&mut rig);
    rig.ask(Request::Stop);
    let held = rig.tick().torques[2];
    assert!(held > 0.05, "{held} N·m");
    // Cleared and enabled between two ticks: the outputs are never off.
    let Reply::Faults(log) = rig.ask(Request::ReadFaults) else { panic!() };
    assert_eq!(rig.ask(Request::ClearFaults { total: log.total }), Reply::Done);
    assert_eq!(rig.enable(), Reply::Done);
    let torque = rig.tick().torques[2];
    assert!((torque - held).abs() <= 0.01 + 1e-6, "{held} then {torque} N·m, 1 N·m/s");
}

#[test]
fn what_a_damped_joint_presses_with_is_kept_while_the_obstacle_slows_it_down() {
    let mut rig = damped_when_pressing();
    let advance = |rig: &mut Rig, step: f32| {
        rig.sensors.encoders[2] += libm::roundf(step * COUNTS_PER_RADIAN) as i32;
        rig.tick();
        rig.node.state.targets.joints[2].feedforward
    };
    // It still moves into the obstacle, initially at 1 rad/s.
    for _ in 0..4 {
        rig.ask(Request::Keep);
        advance(&mut rig, 0.01);
    }
    rig.ask(Request::Stop);
    advance(&mut rig, 0.009);
    rig.node.state.targets.joints[2].feedforward = 0.03;
    let first = advance(&mut rig, 0.007);
    let last = [0.005, 0.004, 0.003, 0.002, 0.001, 0.0005].map(|step| advance(&mut rig, step))[5];
    assert_eq!(rig.node.state.reaction, Reaction::Damp, "{:?}", rig.node.faults());
    // 5 % less in each tick.
    assert!(first > 0.0 && (last / first - 0.735_09).abs() < 1e-3, "{first} then {last} N·m");
}

/// The last joint, of 0.02 kg·m², and an obstacle of 20 N·m/rad at 0.1 rad.
struct Obstructed {
    position: f32,
    velocity: f32,
}

impl Obstructed {
    fn force(&self) -> f32 {
        20.0 * (self.position - 0.1).max(0.0)
    }

    fn step(&mut self, rig: &mut Rig) {
        let torque = rig.tick().torques[2];
        for _ in 0..20 {
            let friction = 0.02 * (self.velocity / 1e-3).clamp(-1.0, 1.0);
            let net = torque - self.force() - 0.05 * self.velocity - friction;
            self.velocity += net / 0.02 * 5e-4;
            self.position += self.velocity * 5e-4;
        }
        rig.sensors.encoders[2] = libm::roundf(self.position * COUNTS_PER_RADIAN) as i32;
    }
}

#[test]
fn a_held_joint_presses_on_an_obstacle_no_harder_than_before() {
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        for speed in [0.1, 0.3] {
            let mut model = model();
            model.joints[2].servo.observer.inertia = 0.02;
            let mut rig = Rig::ready(&model);
            assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
            let mut joint = Obstructed { position: 0.0, velocity: 0.0 };
            let mut reference = 0.0;
            while joint.force() < 0.1 {
                reference += 0.01 * speed;
                assert_eq!(rig.ask(stream(reference, speed)), Reply::Done);
                joint.step(&mut rig);
                assert!(reference < 1.0 && rig.node.mode() != Mode::Fault, "{:?}", rig.node.faults());
            }
            let before = rig.node.telemetry().joints[2].torque.max(joint.force());
            let energy = 0.01 * joint.velocity * joint.velocity;
            rig.ask(Request::Stop);
            let mut most = 0.0_f32;
            for _ in 0..300 {
                joint.step(&mut rig);
                most = most.max(joint.force());
            }
            assert_eq!((rig.node.faults().total, rig.node.state.reaction), (1, Reaction::Hold));
            // The kinetic energy compresses the obstacle's spring; 0.02 N·m are the friction.
            let limit = 1.05 * libm::sqrtf(before * before + 2.0 * 20.0 * energy) + 0.02;
            assert!(most < limit, "{mode:?} at {speed} rad/s: {most} N·m, {before} N·m before");
            assert!(joint.velocity.abs() < 1e-2, "{} rad/s", joint.velocity);
        }
    }
}

#[test]
fn a_hold_that_begins_anew_after_missed_ticks_keeps_its_torques() {
    let mut rig = Rig::enabled(&model());
    let points = Vec::from_slice(&[JointPoint::default(); 3]).unwrap();
    let torques = Vec::from_slice(&[0.0, 0.0, 0.2]).unwrap();
    let pressing = JointCommand::StreamTorques { points, torques };
    assert_eq!(rig.ask(Request::Task(TaskCommand::JointServo(pressing))), Reply::Done);
    rig.tick();
    rig.ask(Request::Stop);
    // The obstacle yields by one count per tick, and the servo adapts to the remaining force.
    for _ in 0..25 {
        rig.sensors.encoders[2] += 20;
        rig.tick();
    }
    let before = rig.node.telemetry().joints[2].torque;
    rig.sensors.sequence += 3;
    let after = rig.tick().torques[2];
    assert_eq!(rig.node.state.reaction, Reaction::Hold, "{:?}", rig.node.faults());
    // The friction of the motion that the count seems to show is fed forward.
    let tolerance = 0.01 + model().joints[2].friction.coulomb;
    assert!(before < 0.18 && (after - before).abs() < tolerance, "{before} then {after} N·m");
}

#[test]
fn a_held_joint_whose_encoder_drifts_away_from_an_obstacle_presses_no_harder() {
    let mut model = model();
    model.joints[2].servo.observer.inertia = 0.02;
    let mut rig = Rig::ready(&model);
    assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(ServoMode::Observer))), Reply::Done);
    let mut joint = Obstructed { position: 0.0, velocity: 0.0 };
    let mut reference = 0.0;
    while joint.force() < 0.1 {
        reference += 0.001;
        assert_eq!(rig.ask(stream(reference, 0.1)), Reply::Done);
        joint.step(&mut rig);
    }
    let pressed = rig.node.telemetry().joints[2].torque;
    rig.ask(Request::Stop);
    (0..40).for_each(|_| joint.step(&mut rig));
    // 0.2 rad/s: for the servo the joint seems to yield.
    for drift in 1..80 {
        joint.step(&mut rig);
        rig.sensors.encoders[2] -= 20 * drift;
        let torque = rig.node.telemetry().joints[2].torque;
        assert!(torque < pressed + 0.04, "{torque} N·m after {drift} ticks, {pressed} N·m before");
    }
    assert_eq!((rig.node.faults().total, rig.node.state.reaction), (1, Reaction::Hold));
}

/// The encoder of a joint dies under a torque that friction might balance. The servo, which estimates the
/// error as a disturbance, must not increase that torque, except where a force is fed forward.
#[test]
fn a_stop_does_not_press_on_with_a_joint_that_stands() {
    for grips in [false, true] {
        let mut rig = Rig::ready(&model());
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(ServoMode::Observer))), Reply::Done);
        rig.tick();
        for step in 1..=4_u8 {
            assert_eq!(rig.ask(stream(1e-3 * f32::from(step), 0.1)), Reply::Done);
            rig.tick();
        }
        rig.node.state.targets.joints[2].feedforward = if grips { 1e-6 } else { 0.0 };
        assert_eq!(rig.ask(Request::Stop), Reply::Done);
        let torques: std::vec::Vec<f32> = (0..60).map(|_| rig.tick().torques[2]).collect();
        assert_eq!((rig.node.faults().total, rig.node.state.reaction), (1, Reaction::Hold));
        let lowest = torques.iter().fold(f32::INFINITY, |lowest, torque| lowest.min(torque.abs()));
        assert!(torques[59] > 1e-4, "{torques:?}");
        assert_eq!(torques[59] > lowest + 1e-5, grips, "{lowest} N·m, then {torques:?}");
    }
}
