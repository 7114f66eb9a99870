//! Faults while an arm presses on a wall: it slowly releases the contact and never presses harder.

use nalgebra::Vector3;

use super::arm::{SENSOR, enable, present_target, set_target};
use super::arm_closed_loop::{SimulatedArm, Wall};
use super::rig::refusal;
use crate::control::{JointPoint, ServoMode};
use crate::fault::FaultCause;
use crate::model::Reaction;
use crate::protocol::{ActuatorFrame, ForceSensorFault, Mode, Refusal, Reply, Request, SensorFlags};
use crate::task::impedance::tests::SOFT;
use crate::task::impedance::{ForceSource, ImpedanceSettings};
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig};

/// An arm that presses on a wall with about `force` [N].
fn pressing(force: f32, stiffness: f32) -> SimulatedArm {
    let settings = ImpedanceSettings { max_deviation: [0.6, 1.0], ..SOFT };
    let mut arm = SimulatedArm::enabled(&settings, Some(SENSOR));
    arm.run(50, Vector3::zeros());
    arm.wall = Some(Wall { x: arm.tool().x + 0.01, stiffness });
    let (mut point, elbow) = present_target(&mut arm.rig);
    let depth = 0.01 + force / stiffness + force / SOFT.impedance.stiffness[0];
    let start = point.position[0];
    for step in 1..=200_u8 {
        point.position[0] = start + depth * f32::from(step) / 200.0;
        assert_eq!(arm.rig.ask(set_target(point, elbow)), Reply::Done);
        arm.run(1, Vector3::zeros());
    }
    arm.run(150, Vector3::zeros());
    let pressed = arm.wall_force().norm();
    assert!((pressed - force).abs() < 0.1 * force, "{pressed} N");
    (arm.max_force, arm.max_speed) = (0.0, 0.0);
    arm
}

#[test]
fn a_stop_releases_what_the_arm_presses_on() {
    for (force, stiffness) in [(20.0, 2e3), (60.0, 2e3), (80.0, 20e3), (120.0, 20e3)] {
        let mut arm = pressing(force, stiffness);
        let before = arm.wall_force().norm();
        assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
        for _ in 0..800 {
            arm.tick(Vector3::zeros());
        }
        let (max, speed, after) = (arm.max_force, arm.max_speed, arm.wall_force().norm());
        assert!(max <= 1.05 * before, "{force} N on {stiffness} N/m: {max} of {before} N");
        assert!(speed <= 0.25, "{force} N on {stiffness} N/m: {speed} m/s");
        assert!(after < 5.0, "{force} N on {stiffness} N/m: {after} N remain");
        assert_eq!(arm.rig.node.state.reaction, Reaction::Hold, "{:?}", arm.rig.node.faults());
    }
}

#[test]
fn a_dead_force_sensor_does_not_let_the_arm_press_on() {
    for (force, stiffness) in [(20.0, 2e3), (60.0, 2e3), (80.0, 20e3)] {
        let mut arm = pressing(force, stiffness);
        let before = arm.wall_force().norm();
        arm.sense(arm.wall_force());
        for _ in 0..500 {
            let counts = arm.rig.sensors.forces.clone();
            arm.sense(Vector3::zeros());
            arm.rig.sensors.forces = counts;
            if let Mode::Enabled(_) = arm.rig.node.mode() {
                arm.rig.ask(Request::Keep);
            }
            let output = arm.rig.tick();
            arm.advance(Vector3::zeros(), &output);
        }
        assert_eq!(arm.rig.node.faults().faults.last().unwrap().cause, FaultCause::ForceStuck);
        assert_eq!(arm.rig.node.state.reaction, Reaction::Damp);
        let (max, speed) = (arm.max_force, arm.max_speed);
        assert!(max <= 1.05 * before, "{force} N on {stiffness} N/m: {max} of {before} N");
        assert!(speed <= 0.25, "{force} N on {stiffness} N/m: {speed} m/s");
    }
}

#[test]
fn force_sensors_are_not_tared_in_contact() {
    let mut arm = pressing(20.0, 2e3);
    assert!(matches!(refusal(arm.rig.ask(Request::Tare)), Refusal::WrongMode(Mode::Enabled(_))));
    assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
    assert_eq!(refusal(arm.rig.ask(Request::Tare)), Refusal::WrongMode(Mode::Fault));
}

/// A constant error of the estimate looks like a contact.
#[test]
fn in_contact_the_estimate_is_tared_and_the_force_sensor_is_not() {
    let observing = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, ..SOFT };
    let mut arm = SimulatedArm::enabled(&observing, Some(SENSOR));
    let push = Vector3::new(0.0, 0.0, 20.0);
    arm.run(100, Vector3::zeros());
    arm.run(60, push);
    let read = |arm: &SimulatedArm| Vector3::from(arm.rig.node.tips().tips[0].force);
    assert!((read(&arm) - push).norm() < 1.0, "{}", read(&arm));
    assert_eq!(arm.rig.ask(Request::Tare), Reply::Done);
    arm.run(1, push);
    assert!((read(&arm) - push).norm() < 1.0, "{}", read(&arm));
}

#[test]
fn an_arm_that_is_stopped_on_its_way_does_not_go_on() {
    let settings = ImpedanceSettings { max_deviation: [0.6, 1.0], ..SOFT };
    let mut arm = SimulatedArm::enabled(&settings, Some(SENSOR));
    arm.run(50, Vector3::zeros());
    let (mut point, elbow) = present_target(&mut arm.rig);
    point.position[0] += 0.15;
    for (ticks, max_travel) in [(1, 0.01), (20, 0.015)] {
        assert_eq!(arm.rig.ask(set_target(point, elbow)), Reply::Done);
        arm.max_speed = 0.0;
        arm.run(ticks, Vector3::zeros());
        let (start, speed) = (arm.tool(), arm.max_speed);
        arm.max_speed = 0.0;
        assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
        let mut farthest = 0.0_f32;
        for _ in 0..200 {
            arm.tick(Vector3::zeros());
            farthest = farthest.max((arm.tool() - start).norm());
        }
        assert_eq!(arm.rig.node.state.reaction, Reaction::Hold, "{:?}", arm.rig.node.faults());
        assert!(farthest < max_travel, "{farthest} m after {ticks} ticks");
        assert!((arm.tool() - start).norm() < 1e-3);
        assert!(arm.max_speed < 1.3 * speed + 0.02, "{} after {speed} m/s", arm.max_speed);
        let Reply::Faults(log) = arm.rig.ask(Request::ReadFaults) else { panic!() };
        assert_eq!(arm.rig.ask(Request::ClearFaults { total: log.total }), Reply::Done);
        assert_eq!(arm.rig.ask(enable(settings)), Reply::Done);
        let target = present_target(&mut arm.rig).0;
        point.position = [target.position[0] - 0.15, target.position[1], target.position[2]];
        point.rotation = target.rotation;
    }
}

#[test]
fn a_dead_encoder_under_impedance_control_switches_the_outputs_off() {
    // Elbow, shoulder and wrist, pushed by hand or moved by the set-point.
    for (joint, push, lead) in [(3, 10.0, 0.0), (0, 10.0, 0.0), (3, 0.0, 0.1), (5, 0.0, 0.1)] {
        let settings = ImpedanceSettings { max_deviation: [0.6, 1.0], ..SOFT };
        let mut arm = SimulatedArm::enabled(&settings, Some(SENSOR));
        arm.run(50, Vector3::zeros());
        let (mut point, elbow) = present_target(&mut arm.rig);
        let start = point.position[0];
        // The encoder dies in tick 30. This shows when the set-point moves, or from tick 50 on under the
        // push.
        let shown = if lead == 0.0 { 50 } else { 30 };
        let mut dead = None;
        let mut ticks = 0;
        arm.max_speed = 0.0;
        loop {
            let share = (f32::from(ticks) / 100.0).min(1.0);
            point.position[0] = start - lead * share * share * (3.0 - 2.0 * share);
            assert_eq!(arm.rig.ask(set_target(point, elbow)), Reply::Done);
            let force = Vector3::x() * if ticks >= 50 { push } else { 0.0 };
            arm.sense(force);
            if ticks >= 30 {
                arm.rig.sensors.encoders[joint] = *dead.get_or_insert(arm.rig.sensors.encoders[joint]);
            }
            let output = arm.rig.tick();
            if !output.enabled {
                break;
            }
            arm.advance(force, &output);
            ticks += 1_u16;
        }
        let fault = arm.rig.node.faults().faults.last().unwrap();
        assert_eq!((fault.cause, fault.joint.map(usize::from)), (FaultCause::EncoderStuck, Some(joint)));
        assert!(ticks <= shown + 4, "joint {joint} off {ticks} ticks after the start");
        assert!(arm.max_speed < 0.65, "joint {joint}: {} m/s", arm.max_speed);
    }
}

#[test]
fn a_reversed_drive_under_impedance_control_switches_the_outputs_off() {
    // The shoulder: the counts of lighter joints jump before these have run away for three ticks.
    let settings = ImpedanceSettings { max_deviation: [0.6, 1.0], ..SOFT };
    let mut arm = SimulatedArm::enabled(&settings, Some(SENSOR));
    arm.run(50, Vector3::zeros());
    let mut ticks = 0;
    loop {
        arm.rig.ask(Request::Keep);
        arm.sense(Vector3::zeros());
        let mut output = arm.rig.tick();
        if !output.enabled {
            break;
        }
        output.torques[0] = -output.torques[0];
        arm.advance(Vector3::zeros(), &output);
        ticks += 1_u8;
    }
    let fault = arm.rig.node.faults().faults.last().unwrap();
    assert_eq!((fault.cause, fault.joint, arm.rig.node.faults().total), (FaultCause::Runaway, Some(0), 1));
    assert!(ticks <= 6, "{ticks} ticks");
}

#[test]
fn a_force_sensor_that_reads_nothing_lets_the_wall_push_the_arm_back_slowly() {
    let mut arm = pressing(3.0, 2e3);
    let mut before = 0.0;
    for _ in 0..500 {
        if let Mode::Enabled(_) = arm.rig.node.mode() {
            (before, arm.max_force, arm.max_speed) = (arm.wall_force().norm(), 0.0, 0.0);
            arm.rig.ask(Request::Keep);
        }
        arm.sense(Vector3::zeros());
        arm.rig.sensors.forces[0] = [0; 6];
        let output = arm.rig.tick();
        arm.advance(Vector3::zeros(), &output);
    }
    assert_eq!(arm.rig.node.faults().faults.last().unwrap().cause, FaultCause::ForceMismatch);
    assert_eq!(arm.rig.node.state.reaction, Reaction::Damp);
    assert!(before < 25.0, "{before} N");
    assert!(arm.max_force <= 1.05 * before, "{} of {before} N", arm.max_force);
    assert!(arm.max_speed <= 0.25, "{} m/s", arm.max_speed);
}

#[test]
fn a_force_sensor_that_reads_too_little_is_found_by_what_the_tracking_makes_up_for() {
    for share in [0.0, 0.1] {
        let mut arm = pressing(10.0, 2e3);
        let mut before = 0.0;
        for tick in 0..500 {
            if let Mode::Enabled(_) = arm.rig.node.mode() {
                (before, arm.max_force) = (arm.wall_force().norm(), 0.0);
                arm.rig.ask(Request::Keep);
            }
            arm.sense(arm.wall_force() * share);
            // Noise: constant counts would be a fault.
            arm.rig.sensors.forces[0][2] += tick % 2;
            let output = arm.rig.tick();
            arm.advance(Vector3::zeros(), &output);
        }
        let faults = &arm.rig.node.faults().faults;
        assert_eq!(faults.last().map(|fault| fault.cause), Some(FaultCause::ForceMismatch));
        assert_eq!(arm.rig.node.state.reaction, Reaction::Damp);
        // Without a stop the force would reach 77 N, or 44 N. The momentum presses for some further ticks.
        assert!(before < 40.0 && arm.max_force < 1.2 * before, "{before} N, then {} N", arm.max_force);
        assert!(arm.wall_force().norm() < 5.0, "{} N remain", arm.wall_force().norm());
    }
}

#[test]
fn a_stop_begins_anew_after_missed_ticks() {
    let mut arm = pressing(40.0, 2e3);
    assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
    (0..10).for_each(|_| arm.tick(Vector3::zeros()));
    // The board misses eight ticks: the drives keep their torques for two of them and are then off.
    let kept = arm.rig.node.telemetry().joints.iter().map(|joint| joint.torque).collect();
    let mut frame = ActuatorFrame { sequence: 0, enabled: true, torques: kept };
    for missed in 0..8 {
        if missed == 2 {
            frame.torques.fill(0.0);
        }
        arm.advance(Vector3::zeros(), &frame);
    }
    arm.rig.sensors.sequence += 8;
    let speed = arm.speed();
    arm.max_speed = 0.0;
    (0..300).for_each(|_| arm.tick(Vector3::zeros()));
    assert!(arm.max_speed < 1.3 * speed, "{} after {speed} m/s", arm.max_speed);
    assert!(arm.speed() < 0.01, "{} m/s", arm.speed());
    assert_eq!(arm.rig.node.state.reaction, Reaction::Hold, "{:?}", arm.rig.node.faults());
}

#[test]
fn a_damped_arm_is_no_longer_stopped_by_its_task() {
    let mut arm = SimulatedArm::enabled(&SOFT, Some(SENSOR));
    arm.run(50, Vector3::zeros());
    assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
    arm.tick(Vector3::zeros());
    assert_eq!(arm.rig.node.reaction(), (Reaction::Hold, true));
    arm.rig.sensors.flags = SensorFlags(0).with_force_sensor(ForceSensorFault::Silent);
    arm.tick(Vector3::zeros());
    assert_eq!(arm.rig.node.reaction(), (Reaction::Damp, false));
}

#[test]
fn a_stopped_arm_is_no_lighter_than_it_is() {
    let settings = ImpedanceSettings { max_deviation: [0.6, 1.0], ..SOFT };
    let mut arm = SimulatedArm::enabled(&settings, Some(SENSOR));
    arm.run(50, Vector3::zeros());
    assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
    (0..50).for_each(|_| arm.tick(Vector3::zeros()));
    // Along the axis in which the arm is heaviest; the impedance has 1.5 kg.
    let jacobian = arm.chain.posture(arm.angles.as_slice()).jacobian().fixed_rows::<3>(0).into_owned();
    let mass = arm.chain.mass_matrix(arm.angles.as_slice()).cholesky().unwrap();
    let mobility = jacobian * mass.solve(&jacobian.transpose());
    let axis = mobility.diagonal().imin();
    assert!(mobility[(axis, axis)] < 0.7 / 1.5, "{mobility}");
    let mut push = Vector3::zeros();
    push[axis] = 40.0;
    arm.max_speed = 0.0;
    (0..4).for_each(|_| arm.tick(push));
    // The velocity of the arm alone after 40 ms under 40 N; damping reduces it.
    let free = (mobility * push).norm() * 0.04;
    assert!(arm.max_speed < 1.1 * free, "{} m/s, the arm alone {free} m/s", arm.max_speed);
    assert_eq!(arm.rig.node.state.reaction, Reaction::Hold, "{:?}", arm.rig.node.faults());
}

#[test]
fn a_stopped_arm_presses_no_harder_with_time() {
    let settings = ImpedanceSettings { max_deviation: [0.6, 1.0], ..SOFT };
    let mut arm = SimulatedArm::enabled(&settings, Some(SENSOR));
    arm.run(50, Vector3::zeros());
    assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
    (0..100).for_each(|_| arm.tick(Vector3::zeros()));
    // An obstacle holds the shoulder 2 mrad from its position.
    arm.angles[0] += 2e-3;
    let held = |arm: &mut SimulatedArm, ticks: u32| {
        (0..ticks).for_each(|_| {
            arm.sense(Vector3::zeros());
            arm.rig.tick();
        });
        arm.rig.node.telemetry().joints[0].torque
    };
    let weight = arm.rig.node.telemetry().joints[0].torque;
    let (soon, later) = (held(&mut arm, 30) - weight, held(&mut arm, 300) - weight);
    assert_eq!(arm.rig.node.faults().total, 1);
    assert!(soon < -0.01 && (later / soon - 1.0).abs() < 0.02, "{soon} then {later} N·m");
}

#[test]
fn an_arm_that_is_stopped_on_its_way_into_a_wall_presses_only_with_its_momentum() {
    let settings = ImpedanceSettings { max_deviation: [0.6, 1.0], ..SOFT };
    let mut arm = SimulatedArm::enabled(&settings, Some(SENSOR));
    arm.run(50, Vector3::zeros());
    arm.wall = Some(Wall { x: arm.tool().x + 0.005, stiffness: 2e3 });
    // A set-point 60 mm behind the surface.
    let (mut point, elbow) = present_target(&mut arm.rig);
    let start = point.position[0];
    let mut ticks = 0_u16;
    while arm.wall_force().norm() < 3.0 {
        ticks += 1;
        point.position[0] = start + 0.065 * (f32::from(ticks) / 20.0).min(1.0);
        assert_eq!(arm.rig.ask(set_target(point, elbow)), Reply::Done);
        arm.run(1, Vector3::zeros());
        assert!(ticks < 200);
    }
    let (before, speed) = (arm.wall_force().norm(), arm.speed());
    arm.max_force = 0.0;
    assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
    (0..300).for_each(|_| arm.tick(Vector3::zeros()));
    // 3.4 kg along x; 2 N for the delay of one tick.
    let limit = 1.05 * libm::sqrtf(before * before + 2e3 * 3.4 * speed * speed) + 2.0;
    assert!(arm.max_force < limit, "{} N of {limit} N; {before} N at {speed} m/s", arm.max_force);
    assert!(arm.wall_force().norm() < 5.0 && arm.speed() < 1e-2);
}

/// The disturbance estimates, which compensate model errors, remain valid after a missed tick.
#[test]
fn a_missed_tick_does_not_let_the_arm_sag() {
    let settings = ImpedanceSettings { max_deviation: [0.6, 1.0], ..SOFT };
    let mut arm = SimulatedArm::enabled(&settings, Some(SENSOR));
    arm.disturbance[3] = 2.0;
    arm.run(300, Vector3::zeros());
    let start = arm.tool();
    let kept = arm.rig.node.telemetry().joints.iter().map(|joint| joint.torque).collect();
    arm.advance(Vector3::zeros(), &ActuatorFrame { sequence: 0, enabled: true, torques: kept });
    arm.rig.sensors.sequence += 1;
    let mut farthest = 0.0_f32;
    for _ in 0..50 {
        arm.tick(Vector3::zeros());
        farthest = farthest.max((arm.tool() - start).norm());
    }
    assert_eq!(arm.rig.node.faults().faults.last().unwrap().cause, FaultCause::LateTick);
    assert_eq!(arm.rig.node.state.reaction, Reaction::Hold);
    assert!(farthest < 1e-3, "{farthest} m");
}

/// The supply sags and the force sensor is saturated in the same tick: the stop does not rely on the force.
#[test]
fn a_low_supply_hides_no_saturated_force_sensor() {
    let mut arm = pressing(20.0, 2e3);
    arm.sense(arm.wall_force());
    arm.rig.sensors.forces[0][0] = 32_767;
    arm.rig.sensors.supply = 1_000;
    assert!(arm.rig.tick().enabled);
    assert_eq!(arm.rig.node.faults().faults.last().unwrap().cause, FaultCause::ForceSaturated);
    assert_eq!(arm.rig.node.state.reaction, Reaction::Damp);
}

/// All joints brake at the same time; each must withstand the inertial torques of the others.
#[test]
fn an_arm_that_is_held_gains_no_energy_as_its_joints_brake() {
    for speed in [0.3_f32, 0.6] {
        let mut arm = SimulatedArm::enabled(&SOFT, Some(SENSOR));
        assert_eq!(arm.rig.ask(Request::Disable), Reply::Done);
        assert_eq!(arm.rig.ask(Request::Enable(TaskConfig::JointServo(ServoMode::Observer))), Reply::Done);
        let mut position = super::arm::ANGLES;
        for tick in 1..=60_u8 {
            let velocity = -speed * (f32::from(tick) / 40.0).min(1.0);
            position.iter_mut().for_each(|position| *position += 0.01 * velocity);
            let points =
                position.iter().map(|&position| JointPoint { position, velocity, acceleration: 0.0 });
            let stream = JointCommand::Stream { points: points.collect() };
            assert_eq!(arm.rig.ask(Request::Task(TaskCommand::JointServo(stream))), Reply::Done);
            arm.tick(Vector3::zeros());
            assert!(matches!(arm.rig.node.mode(), Mode::Enabled(_)), "{:?}", arm.rig.node.faults());
        }
        let before = arm.energy();
        assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
        let energies: Vec<f32> = (0..6)
            .map(|_| {
                arm.tick(Vector3::zeros());
                arm.energy()
            })
            .collect();
        let most = energies.iter().fold(0.0_f32, |most, energy| most.max(*energy));
        assert!(most < 1.1 * before, "{speed} rad/s: {before} J, then {energies:?}");
    }
}
