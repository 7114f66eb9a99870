//! What a joint learns while the tool presses.

use super::fixture::{ArmFixture, POSTURES, SOFT, elbow_at_rest, track};
use crate::math::abs;
use crate::task::impedance::ArmMeasurement;

/// Asserts that the elbow of an arm that 9 N push against its spring learns a disturbance in just those ticks
/// in which it is faster than `limit` [rad/s], while the set-point moves at `speed` [m/s].
fn assert_learning_above(limit: f32, speed: f32) {
    let fixture = ArmFixture::new();
    let mut state = fixture.state(&SOFT, &POSTURES[0]);
    let mut point = fixture.point(&POSTURES[0]);
    point.velocity[1] = speed;
    let elbow = elbow_at_rest(&fixture, &state);
    let mut measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
    let (mut learnt, mut ticks) = (0.0, [0, 0]);
    for _ in 0..60 {
        state.set_target(&fixture.arm(), &point, &elbow).unwrap();
        measurement.wrench[0] = 9.0;
        let elbow_speed = abs(measurement.velocities[3]);
        let output = state.tick(&fixture.arm(), &measurement).unwrap();
        let learns = output.feedback[3] != learnt;
        learnt = output.feedback[3];
        assert_eq!(learns, elbow_speed >= limit, "{elbow_speed}");
        ticks[usize::from(learns)] += 1;
        measurement = track(&output);
        // An error within the dead band.
        measurement.angles[3] += 5e-5;
    }
    assert!(ticks.iter().all(|&count| count > 10), "{ticks:?}");
}

#[test]
fn against_a_set_point_at_rest_slow_joints_learn_nothing() {
    assert_learning_above(0.12, 0.0);
}

#[test]
fn against_a_moving_set_point_only_joints_at_rest_learn_nothing() {
    assert_learning_above(0.04, 2e-3);
}
