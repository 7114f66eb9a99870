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

#[test]
fn an_impact_that_the_angles_show_before_the_force_is_no_disturbance() {
    let fixture = ArmFixture::new();
    let mut state = fixture.state(&SOFT, &POSTURES[0]);
    let mut measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
    let mut tick = |force: f32, error: f32| {
        measurement.wrench[0] = force;
        measurement.angles[3] -= error;
        measurement = track(&state.tick(&fixture.arm(), &measurement).unwrap());
        state.disturbances()[3]
    };
    // A model error, learnt in free motion, remains.
    let learnt = (0..8).map(|_| tick(0.0, 1e-3)).last().unwrap();
    // The impact stops the joint; the force is measured two ticks later.
    let [.., impact] = [0.1, 0.9].map(|force| tick(force, 6e-3));
    assert!(learnt > 3.0 && impact > 4.0 * learnt, "{learnt} {impact}");
    let pressing = [9.0, 9.0, 9.0].map(|force| tick(force, 0.0));
    assert!(pressing.iter().all(|value| abs(value - learnt) < 0.2 * learnt), "{learnt} {pressing:?}");
}
