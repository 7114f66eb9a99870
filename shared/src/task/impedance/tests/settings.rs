//! Validation and changes of settings.

use core::f32::consts::PI;

use nalgebra::Vector3;

use super::fixture::{ArmFixture, POSTURES, SOFT, accelerations, elbow_at_rest, track};
use crate::model::MAX_CHAIN_JOINTS;
use crate::task::impedance::redundancy::JointVector;
use crate::task::impedance::{
    ArmMeasurement, ArmOutput, DirectLaw, ImpedanceRefusal, ImpedanceSettings, InvalidImpedanceSettings, Law,
    Redundancy, SetpointError, own_mass,
};

#[test]
fn invalid_settings_are_refused_by_name() {
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
    refused(|s| s.redundancy = Redundancy::DrivenJoint { joint: 7 }, "the driven joint is 7");
    refused(|s| s.elbow_bandwidth = 0.0, "the elbow bandwidth is 0 rad/s");
    refused(|s| s.elbow_bandwidth = f32::INFINITY, "at most 50 rad/s");
    refused(|s| s.contact_force = f32::NAN, "the contact force is NaN N");
    refused(|s| s.max_deviation[0] = -1.0, "the maximum deviation is -1");
    refused(|s| s.max_deviation[0] = 1.1, "at most 1 m");
    refused(|s| s.max_deviation[1] = PI, "3 rad");
    assert_eq!(SOFT.validate(6).unwrap_err(), InvalidImpedanceSettings::NoArmAngle);
    assert!(SOFT.validate(7).is_ok());
}

/// A tick blends in a twentieth of the new impedance. On each axis the tool's acceleration changes by at most
/// `|Δ(K/M)| e + |Δ(B/M)| v`, and the torques by the mass matrix times the joint accelerations.
#[test]
fn new_settings_do_not_step_the_torque() {
    let fixture = ArmFixture::new();
    let arm = fixture.arm();
    let mut state = fixture.state(&SOFT, &POSTURES[0]);
    let mut point = fixture.point(&POSTURES[0]);
    point.position[0] += 0.05;
    let elbow = elbow_at_rest(&fixture, &state);
    state.set_target(&arm, &point, &elbow).unwrap();
    let mut measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
    for _ in 0..10 {
        measurement = track(&state.tick(&arm, &measurement).unwrap());
    }
    let telemetry = state.telemetry(&arm, &measurement, &fixture.chain.posture(&measurement.angles));
    let velocity = fixture.jacobian(&measurement.angles) * JointVector::from(measurement.velocities);
    let mut firm = SOFT;
    firm.impedance.mass = [1.0, 1.0, 1.0, 0.05, 0.05, 0.05];
    firm.impedance.damping = [90.0, 90.0, 90.0, 1.0, 1.0, 1.0];
    firm.impedance.stiffness = [2000.0, 2000.0, 2000.0, 10.0, 10.0, 10.0];
    let mut changed = state;
    changed.configure(&arm, &firm).unwrap();
    let [old, new] =
        [&mut state, &mut changed].map(|state| accelerations(&state.tick(&arm, &measurement).unwrap()));
    let blend = |goal: f32, old: f32| old + 0.05 * (goal - old);
    let mass = blend(1.0, 1.5);
    let of_error = blend(2000.0, 300.0) / mass - 300.0 / 1.5;
    let of_velocity = blend(90.0, 30.0) / mass - 30.0 / 1.5;
    let size = |values: &[f32]| Vector3::from_column_slice(values).norm();
    let tool = of_error * size(&telemetry.error[..3]) + of_velocity * size(&velocity.as_slice()[..3]);
    // The tool acceleration that the joint accelerations cause.
    let change = new - old;
    let of_tool = (fixture.jacobian(&measurement.angles) * change).norm();
    assert!(of_tool > 0.2 * tool && of_tool <= 1.05 * tool, "{of_tool} {tool}");
    let inertia = fixture.chain.clone().with_rotor_inertia([0.03; 7]).mass_matrix(&measurement.angles);
    let torque = (inertia * change).norm();
    assert!(torque < 0.6, "{torque} N·m");
    // A step of the impedance would change the torques twenty times as much.
    let mut stepped = fixture.state(&firm, &POSTURES[0]);
    stepped.set_target(&arm, &point, &elbow).unwrap();
    let start = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
    let step = accelerations(&stepped.tick(&arm, &start).unwrap());
    assert!(step.norm() > 5.0 * change.norm(), "{step}");
}

#[test]
fn a_change_of_the_law_resets_the_disturbance_observers() {
    let fixture = ArmFixture::new();
    let arm = fixture.arm();
    let angles = POSTURES[0];
    let mut state = fixture.state(&SOFT, &angles);
    // The joints do not move under their commands.
    let mut point = fixture.point(&angles);
    point.position[2] += 0.05;
    state.set_target(&arm, &point, &elbow_at_rest(&fixture, &state)).unwrap();
    let measurement = ArmMeasurement { angles, ..ArmMeasurement::default() };
    for _ in 0..10 {
        state.tick(&arm, &measurement).unwrap();
        state.applied(&arm, &[0.0; MAX_CHAIN_JOINTS], &[0.0; MAX_CHAIN_JOINTS]);
    }
    let max_feedback =
        |output: &ArmOutput| output.feedback.iter().fold(0.0_f32, |max, value| max.max(value.abs()));
    let before = max_feedback(&state.tick(&arm, &measurement).unwrap());
    state.configure(&arm, &ImpedanceSettings { law: Law::Direct(DirectLaw::CORRECTED), ..SOFT }).unwrap();
    assert_eq!(state.tick(&arm, &measurement).unwrap().feedback, [0.0; MAX_CHAIN_JOINTS]);
    state.configure(&arm, &SOFT).unwrap();
    // The tracking error is that of one tick without motion, not of ten.
    assert!(max_feedback(&state.tick(&arm, &measurement).unwrap()) < 0.3 * before);
}

/// The arm's own mass includes the rotors of the motors.
#[test]
fn a_mass_far_below_the_arms_own_is_not_configured() {
    let fixture = ArmFixture::new();
    let mut state = fixture.state(&SOFT, &POSTURES[0]);
    let mut light = SOFT;
    (light.impedance.mass[0], light.impedance.damping[0]) = (0.2, 10.0);
    let refused = state.configure(&fixture.arm(), &light).unwrap_err();
    let inertia = fixture.chain.clone().with_rotor_inertia([0.03; 7]).mass_matrix(&POSTURES[0]);
    let jacobian = fixture.jacobian(&POSTURES[0]);
    let own = 1.0 / (jacobian * inertia.try_inverse().unwrap() * jacobian.transpose())[(0, 0)];
    let ImpedanceRefusal::Settings(InvalidImpedanceSettings::MassInContact {
        axis: 0,
        own: found,
        limit,
        ..
    }) = refused
    else {
        panic!("{refused}");
    };
    assert!((found / own - 1.0).abs() < 1e-3 && (limit / found - 0.25).abs() < 1e-6, "{refused} {own}");
    assert!(own > 1.0, "{own}");
    light.impedance.mass[0] = 1.01 * limit;
    assert_eq!(state.configure(&fixture.arm(), &light), Ok(()));
}

/// A straight arm hangs down: no joint moves its tool along z, so its own mass there has the limit, five
/// times the mean.
#[test]
fn an_arm_that_has_moved_to_a_singular_posture_keeps_its_mass() {
    let (fixture, straight) = (ArmFixture::new(), [0.0; MAX_CHAIN_JOINTS]);
    let arm = fixture.arm();
    let own = own_mass(arm.chain, arm.joints, &straight, SOFT.impedance.axes);
    assert!(SOFT.check_mass(&own).is_err(), "{own:?}");
    let mut state = fixture.state(&SOFT, &straight);
    let mut stiffer = SOFT;
    stiffer.impedance.stiffness[2] = 400.0;
    assert_eq!(state.configure(&arm, &stiffer), Ok(()));
    // Any other mass, even a larger one, is checked against the arm in its present posture.
    stiffer.impedance.mass[0] = 1.01 * SOFT.impedance.mass[0];
    assert!(matches!(
        state.configure(&arm, &stiffer),
        Err(ImpedanceRefusal::Settings(InvalidImpedanceSettings::MassInContact { axis: 2, .. }))
    ));
}

/// The tool is 30 mm from its set-point.
#[test]
fn a_maximum_deviation_that_is_exceeded_already_is_refused() {
    let fixture = ArmFixture::new();
    let arm = fixture.arm();
    let mut state = fixture.state(&SOFT, &POSTURES[0]);
    let mut point = fixture.point(&POSTURES[0]);
    point.position[0] += 0.03;
    state.set_target(&arm, &point, &elbow_at_rest(&fixture, &state)).unwrap();
    state.tick(&arm, &ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() }).unwrap();
    let narrow = |distance| ImpedanceSettings { max_deviation: [distance, 1.0], ..SOFT };
    let refused = state.configure(&arm, &narrow(0.02)).unwrap_err();
    assert!(
        matches!(refused, ImpedanceRefusal::Setpoint(SetpointError::Distance { value, limit: 0.02 })
            if (value - 0.03).abs() < 1e-4),
        "{refused}"
    );
    assert_eq!(state.configure(&arm, &narrow(0.04)), Ok(()));
}
