//! What settings are refused, and what a change of them does.

use core::f32::consts::PI;

use nalgebra::Vector3;

use super::machine::{Machine, POSTURES, SOFT, accelerations, elbow, follow};
use crate::model::MAX_CHAIN_JOINTS;
use crate::task::impedance::redundancy::Joints;
use crate::task::impedance::{ArmOutput, ArmSense, ImpedanceSettings, InvalidSettings, Law, Redundancy};

#[test]
fn settings_that_make_no_sense_are_refused_by_name() {
    let refused = |change: fn(&mut ImpedanceSettings), text: &str| {
        let mut settings = SOFT;
        change(&mut settings);
        let error = settings.validate(7).unwrap_err();
        assert!(error.to_string().contains(text), "{error}");
    };
    refused(|s| s.impedance.mass[0] = 0.0, "the mass along x is 0 kg");
    refused(|s| s.impedance.mass[3] = -0.1, "the mass about x is -0.1 kg·m²");
    refused(|s| s.impedance.mass[1] = f32::MIN_POSITIVE / 2.0, "the mass along y");
    refused(|s| s.impedance.mass[1] = f32::MAX, "the mass along y");
    refused(|s| s.impedance.damping[2] = -1.0, "the damping along z is -1 N·s/m");
    refused(|s| s.impedance.stiffness[4] = -1.0, "the stiffness about y is -1 N·m/rad");
    refused(|s| s.impedance.stiffness[4] = f32::NAN, "the stiffness about y is NaN");
    refused(|s| s.redundancy = Redundancy::DrivenJoint { joint: 7 }, "joint 7 is to be driven by itself");
    refused(|s| s.elbow_bandwidth = 0.0, "the bandwidth of the elbow is 0 rad/s");
    refused(|s| s.elbow_bandwidth = f32::INFINITY, "50 rad/s at most");
    refused(|s| s.contact_force = f32::NAN, "the contact force is NaN N");
    refused(|s| s.reach[0] = -1.0, "the reach is -1");
    refused(|s| s.reach[1] = PI, "less than half a turn");
    assert_eq!(SOFT.validate(6).unwrap_err(), InvalidSettings::NoArmAngle);
    assert!(SOFT.validate(7).is_ok());
}

/// A tick with new settings differs from one without by a twentieth of the way to them: on each axis the
/// tool's acceleration by at most `|Δ(K/M)| e + |Δ(B/M)| v`, and the torques by what the mass matrix makes of
/// that.
#[test]
fn new_settings_do_not_step_the_torque() {
    let machine = Machine::new();
    let arm = machine.arm();
    let mut state = machine.state(&SOFT, &POSTURES[0]);
    let mut point = machine.point(&POSTURES[0]);
    point.position[0] += 0.05;
    let elbow = elbow(&machine, &state);
    state.set_target(&arm, &point, &elbow).unwrap();
    let mut sense = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
    for _ in 0..10 {
        sense = follow(&state.tick(&arm, &sense).unwrap());
    }
    let telemetry = state.telemetry(&arm, &sense, &machine.chain.posture(&sense.angles));
    let speed = machine.jacobian(&sense.angles) * Joints::from(sense.velocities);
    let mut firm = SOFT;
    firm.impedance.mass = [1.0, 1.0, 1.0, 0.05, 0.05, 0.05];
    firm.impedance.damping = [90.0, 90.0, 90.0, 1.0, 1.0, 1.0];
    firm.impedance.stiffness = [2000.0, 2000.0, 2000.0, 10.0, 10.0, 10.0];
    let mut other = state;
    other.configure(&arm, &firm).unwrap();
    let [own, new] = [&mut state, &mut other].map(|state| accelerations(&state.tick(&arm, &sense).unwrap()));
    let share = |goal: f32, own: f32| own + 0.05 * (goal - own);
    let mass = share(1.0, 1.5);
    let of_error = share(2000.0, 300.0) / mass - 300.0 / 1.5;
    let of_speed = share(90.0, 30.0) / mass - 30.0 / 1.5;
    let size = |values: &[f32]| Vector3::from_column_slice(values).norm();
    let tool = of_error * size(&telemetry.error[..3]) + of_speed * size(&speed.as_slice()[..3]);
    // ... which is what the tool sees of it, and less as torques: rotors of 0.03 kg·m² and what the links
    // weigh.
    let change = new - own;
    let of_tool = (machine.jacobian(&sense.angles) * change).norm();
    assert!(of_tool > 0.2 * tool && of_tool <= 1.05 * tool, "{of_tool} {tool}");
    let inertia = machine.chain.clone().with_rotor_inertia([0.03; 7]).mass_matrix(&sense.angles);
    let torque = (inertia * change).norm();
    assert!(torque < 0.6, "{torque} N·m");
    // All at once would be twenty times as much.
    let mut at_once = machine.state(&firm, &POSTURES[0]);
    at_once.set_target(&arm, &point, &elbow).unwrap();
    let start = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
    let step = accelerations(&at_once.tick(&arm, &start).unwrap());
    assert!(step.norm() > 5.0 * change.norm(), "{step}");
}

#[test]
fn another_law_forgets_what_the_observers_learnt() {
    let machine = Machine::new();
    let arm = machine.arm();
    let angles = POSTURES[0];
    let mut state = machine.state(&SOFT, &angles);
    // Joints that stand still although they are told to move.
    let mut point = machine.point(&angles);
    point.position[2] += 0.05;
    state.set_target(&arm, &point, &elbow(&machine, &state)).unwrap();
    let sense = ArmSense { angles, ..ArmSense::default() };
    for _ in 0..10 {
        state.tick(&arm, &sense).unwrap();
        state.applied(&arm, &[0.0; MAX_CHAIN_JOINTS], &[0.0; MAX_CHAIN_JOINTS]);
    }
    let most =
        |command: &ArmOutput| command.feedback.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
    let learnt = most(&state.tick(&arm, &sense).unwrap());
    state.configure(&arm, &ImpedanceSettings { law: Law::Direct, ..SOFT }).unwrap();
    assert_eq!(state.tick(&arm, &sense).unwrap().feedback, [0.0; MAX_CHAIN_JOINTS]);
    state.configure(&arm, &SOFT).unwrap();
    // From here on it is a joint that does not move for a tick, not one that has not for ten.
    assert!(most(&state.tick(&arm, &sense).unwrap()) < 0.3 * learnt);
}
