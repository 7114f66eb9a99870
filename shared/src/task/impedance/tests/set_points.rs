//! Set-points of the tool: which way it goes, where it rests, what is refused.

use nalgebra::{UnitQuaternion, Vector3};

use super::machine::{Machine, POSTURES, SOFT, elbow};
use crate::kinematics::{ElbowSetpoint, PosePoint};
use crate::task::impedance::{ArmSense, ImpedanceSettings};

#[test]
fn the_orientation_takes_the_shorter_way() {
    let machine = Machine::new();
    let settings = ImpedanceSettings { reach: [0.1, 3.0], ..SOFT };
    let angles = POSTURES[0];
    for angle in [2.99_f32, -2.99] {
        for sign in [1.0, -1.0] {
            let mut state = machine.state(&settings, &angles);
            let mut point = machine.point(&angles);
            // Of both quaternions of an orientation, turned by so much about y.
            let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle)
                * UnitQuaternion::new_unchecked(nalgebra::Quaternion::from(point.rotation));
            point.rotation = (turn.coords * sign).into();
            state.set_target(&machine.arm(), &point, &elbow(&machine, &state)).unwrap();
            let sense = ArmSense { angles, ..ArmSense::default() };
            state.tick(&machine.arm(), &sense).unwrap();
            let error = state.telemetry(&machine.arm(), &sense, &machine.chain.posture(&sense.angles)).error;
            assert!((error[4] + angle).abs() < 1e-4 && error[3].abs() < 1e-3, "{angle} {sign}: {error:?}");
        }
    }
}

#[test]
fn a_set_point_without_a_successor_comes_to_rest() {
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
    // 10 ms · (1 + 0.8 + 0.8² + …) = 50 ms at the first speed.
    assert!(
        (point.position[0] - 0.05).abs() < 1e-6 && (elbow.angle - 0.05).abs() < 1e-6,
        "{point:?} {elbow:?}"
    );
    let turn = UnitQuaternion::new_normalize(nalgebra::Quaternion::from(point.rotation));
    assert!((turn.scaled_axis() - Vector3::new(0.0, 0.0, 0.05)).norm() < 1e-4, "{turn}");
    assert!(point.velocity[0] < 1e-9 && point.acceleration == [0.0; 6] && elbow.acceleration == 0.0);
    let norm = point.rotation.iter().map(|part| part * part).sum::<f32>();
    assert!((norm - 1.0).abs() < 1e-5);
}

#[test]
fn what_an_arm_cannot_follow_is_refused_by_name_and_the_aim_stays() {
    let machine = Machine::new();
    let mut state = machine.state(&SOFT, &POSTURES[0]);
    let (here, elbow) = (machine.point(&POSTURES[0]), elbow(&machine, &state));
    let [x, y, z] = here.position;
    let refused = |point: PosePoint, elbow: ElbowSetpoint, text: &str| {
        let mut state = state;
        let before = postcard::to_stdvec(&state).unwrap();
        let error = state.set_target(&machine.arm(), &point, &elbow).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
        assert_eq!(postcard::to_stdvec(&state).unwrap(), before);
    };
    refused(
        PosePoint { position: [x + 1.0, y, z], ..here },
        elbow,
        "m from the tool; at most 0.1 m is allowed",
    );
    let [i, j, k, w] = here.rotation;
    let turned = PosePoint { rotation: [w, k, -j, -i], ..here };
    refused(turned, elbow, "the set-point is rotated by 3.14");
    refused(PosePoint { position: [f32::NAN, y, z], ..here }, elbow, "not finite");
    refused(PosePoint { rotation: [i, j, k, w + 0.5], ..here }, elbow, "it must be 1");
    let still = [0.0; 6];
    let fast = |velocity: f32| [velocity, 0.0, 0.0, 0.0, 0.0, 0.0];
    for most in [20.0, 1e30, f32::MAX] {
        refused(PosePoint { velocity: fast(most), ..here }, elbow, "m from the tool");
        refused(PosePoint { acceleration: fast(100.0 * most.min(1e30)), ..here }, elbow, "m from the tool");
        let velocity = [0.0, 0.0, 0.0, 0.0, 0.0, 20.0 * most.min(1e30)];
        refused(PosePoint { velocity, ..here }, elbow, "rotated by");
        refused(here, ElbowSetpoint { angle: most, ..elbow }, "rad from the elbow; at most 1 rad is allowed");
        refused(here, ElbowSetpoint { velocity: 10.0 * most, ..elbow }, "");
    }
    let all = PosePoint { velocity: fast(1.0), acceleration: still, ..here };
    state.set_target(&machine.arm(), &all, &ElbowSetpoint { angle: elbow.angle + 0.9, ..elbow }).unwrap();
}
