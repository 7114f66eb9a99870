//! Set-points of the tool: shorter rotation, coasting, refusals.

use core::f32::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};

use super::fixture::{ArmFixture, POSTURES, SOFT, elbow_at_rest, track};
use crate::TICK;
use crate::kinematics::{COAST_TIME, ElbowSetpoint, PosePoint};
use crate::task::impedance::redundancy::JointVector;
use crate::task::impedance::{ArmMeasurement, ImpedanceSettings, Redundancy};

#[test]
fn the_orientation_error_is_the_shorter_rotation() {
    let fixture = ArmFixture::new();
    let settings = ImpedanceSettings { max_deviation: [0.1, 3.0], ..SOFT };
    let angles = POSTURES[0];
    for angle in [2.99_f32, -2.99] {
        for sign in [1.0, -1.0] {
            let mut state = fixture.state(&settings, &angles);
            let mut point = fixture.point(&angles);
            // Both quaternions of one orientation, rotated by `angle` about y.
            let rotated = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle)
                * UnitQuaternion::new_unchecked(nalgebra::Quaternion::from(point.rotation));
            point.rotation = (rotated.coords * sign).into();
            state.set_target(&fixture.arm(), &point, &elbow_at_rest(&fixture, &state)).unwrap();
            let measurement = ArmMeasurement { angles, ..ArmMeasurement::default() };
            state.tick(&fixture.arm(), &measurement).unwrap();
            let error = state
                .telemetry(&fixture.arm(), &measurement, &fixture.chain.posture(&measurement.angles))
                .error;
            assert!((error[4] + angle).abs() < 1e-4 && error[3].abs() < 1e-3, "{angle} {sign}: {error:?}");
        }
    }
}

#[test]
fn a_setpoint_without_a_successor_comes_to_rest() {
    let mut point = PosePoint {
        position: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
        velocity: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        acceleration: [5.0; 6],
    };
    let mut elbow = ElbowSetpoint { angle: 0.0, velocity: 1.0, acceleration: 5.0 };
    for _ in 0..100 {
        (point, elbow) = (point.coasted(), elbow.coasted());
    }
    // 10 ms · (1 + 0.8 + 0.8² + …) = 50 ms at the initial velocity.
    assert!(
        (point.position[0] - 0.05).abs() < 1e-6 && (elbow.angle - 0.05).abs() < 1e-6,
        "{point:?} {elbow:?}"
    );
    let rotation = UnitQuaternion::new_normalize(nalgebra::Quaternion::from(point.rotation));
    assert!((rotation.scaled_axis() - Vector3::new(0.0, 0.0, 0.05)).norm() < 1e-4, "{rotation}");
    assert!(point.velocity[0] < 1e-9 && point.acceleration == [0.0; 6] && elbow.acceleration == 0.0);
    let norm = point.rotation.iter().map(|part| part * part).sum::<f32>();
    assert!((norm - 1.0).abs() < 1e-5);
}

#[test]
fn invalid_setpoints_are_refused_by_name_and_change_nothing() {
    let fixture = ArmFixture::new();
    let mut state = fixture.state(&SOFT, &POSTURES[0]);
    let (here, elbow) = (fixture.point(&POSTURES[0]), elbow_at_rest(&fixture, &state));
    let [x, y, z] = here.position;
    let refused = |point: PosePoint, elbow: ElbowSetpoint, text: &str| {
        let mut state = state;
        let before = postcard::to_stdvec(&state).unwrap();
        let error = state.set_target(&fixture.arm(), &point, &elbow).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
        assert_eq!(postcard::to_stdvec(&state).unwrap(), before);
    };
    refused(
        PosePoint { position: [x + 1.0, y, z], ..here },
        elbow,
        "m from the tool; at most 0.1 m is allowed",
    );
    let [i, j, k, w] = here.rotation;
    let rotated = PosePoint { rotation: [w, k, -j, -i], ..here };
    refused(rotated, elbow, "the set-point is rotated by 3.14");
    refused(PosePoint { position: [f32::NAN, y, z], ..here }, elbow, "not finite");
    refused(PosePoint { rotation: [i, j, k, w + 0.5], ..here }, elbow, "it must be 1");
    let still = [0.0; 6];
    let fast = |velocity: f32| [velocity, 0.0, 0.0, 0.0, 0.0, 0.0];
    // 2 m/s coast 0.1 m, as far as the tool may be away; 20 rad/s coast 1 rad.
    for speed in [2.1, 1e30, f32::MAX] {
        refused(PosePoint { velocity: fast(speed), ..here }, elbow, "m from the tool");
        refused(PosePoint { acceleration: fast(100.0 * speed.min(1e30)), ..here }, elbow, "m from the tool");
        let velocity = [0.0, 0.0, 0.0, 0.0, 0.0, 20.0 * speed.min(1e30)];
        refused(PosePoint { velocity, ..here }, elbow, "rotated by");
        refused(
            here,
            ElbowSetpoint { angle: (10.0 * speed).min(f32::MAX), ..elbow },
            "rad from the elbow; at most 1 rad is allowed",
        );
        refused(here, ElbowSetpoint { velocity: 10.0 * speed, ..elbow }, "");
    }
    // More than a revolution, which ends where a smaller rotation does.
    let [_, limit] = SOFT.max_deviation;
    let turning = |rate: f32| PosePoint { velocity: [0.0, 0.0, 0.0, 0.0, 0.0, rate], ..here };
    refused(turning(1.05 * limit / COAST_TIME), elbow, "rotated by");
    refused(turning(TAU / COAST_TIME), elbow, "rotated by");
    let valid = PosePoint { velocity: fast(1.0), acceleration: still, ..here };
    // The arm angle after two turns is the same.
    for turns in [0.0, 2.0, -2.0] {
        let angle = elbow.angle + 0.9 + turns * TAU;
        state.set_target(&fixture.arm(), &valid, &ElbowSetpoint { angle, ..elbow }).unwrap();
    }
    state.set_target(&fixture.arm(), &turning(0.95 * limit / COAST_TIME), &elbow).unwrap();
}

/// The inertial force of the tool's mass on its sensor is that of its true acceleration, also while the
/// joints have reached their speed limits.
#[test]
fn the_acceleration_of_the_tool_is_that_which_the_joint_limits_allow() {
    let mut fixture = ArmFixture::new();
    for joint in &mut fixture.model.joints {
        joint.limits.velocity = 0.5;
    }
    let settings = ImpedanceSettings { max_deviation: [0.3, 1.0], ..SOFT };
    let mut state = fixture.state(&settings, &POSTURES[0]);
    let mut point = fixture.point(&POSTURES[0]);
    point.position[0] += 0.25;
    state.set_target(&fixture.arm(), &point, &elbow_at_rest(&fixture, &state)).unwrap();
    let mut measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
    let tool_velocity = |measurement: &ArmMeasurement| {
        let jacobian = fixture.jacobian(&measurement.angles);
        (jacobian * JointVector::from(measurement.velocities)).fixed_rows::<3>(0).into_owned()
    };
    let mut fastest = 0.0_f32;
    for tick in 0..20 {
        let before = tool_velocity(&measurement);
        measurement = track(&state.tick(&fixture.arm(), &measurement).unwrap());
        let moved = (tool_velocity(&measurement) - before) / TICK;
        let told = state.acceleration();
        assert!((told - moved).norm() < 0.2, "{tick}: {told} {moved}");
        fastest = JointVector::from(measurement.velocities).amax().max(fastest);
    }
    // 0.6 of the limit; without it the elbow would move with 1 rad/s.
    assert!((fastest - 0.3).abs() < 1e-3, "{fastest}");
}

#[test]
fn an_elbow_setpoint_holds_that_follows_a_change_to_the_arm_angle() {
    let fixture = ArmFixture::new();
    let angles = POSTURES[0];
    let mut state = fixture.state(&ImpedanceSettings { redundancy: Redundancy::None, ..SOFT }, &angles);
    let mut measurement = ArmMeasurement { angles, ..ArmMeasurement::default() };
    measurement = track(&state.tick(&fixture.arm(), &measurement).unwrap());
    // Both requests arrive in the same tick.
    state.configure(&fixture.arm(), &SOFT).unwrap();
    let before = elbow_at_rest(&fixture, &state);
    let target = ElbowSetpoint { angle: before.angle + 0.1, ..before };
    state.set_target(&fixture.arm(), &fixture.point(&angles), &target).unwrap();
    for _ in 0..100 {
        measurement = track(&state.tick(&fixture.arm(), &measurement).unwrap());
    }
    let posture = fixture.chain.posture(&measurement.angles);
    let elbow = state.telemetry(&fixture.arm(), &measurement, &posture).elbow;
    assert!((elbow - target.angle).abs() < 0.01, "{elbow} instead of {}", target.angle);
}
