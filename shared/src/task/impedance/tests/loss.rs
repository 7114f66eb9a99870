//! Release of the tool.

use super::fixture::{ArmFixture, POSTURES, SOFT, accelerations, elbow_at_rest};
use crate::TICK;
use crate::task::impedance::{ArmMeasurement, DirectLaw, ImpedanceSettings, Law};

/// Acceleration along x [m/s²] in the first tick without force, after the tool was held 3 cm off its
/// set-point, while the elbow turns at `speed` [rad/s].
fn first_acceleration(settings: &ImpedanceSettings, speed: f32) -> f32 {
    let fixture = ArmFixture::new();
    let mut state = fixture.state(settings, &POSTURES[0]);
    let mut point = fixture.point(&POSTURES[0]);
    point.position[0] -= 0.03;
    let elbow = elbow_at_rest(&fixture, &state);
    state.set_target(&fixture.arm(), &point, &elbow).unwrap();
    let mut measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
    let mut acceleration = f32::NAN;
    for force in [9.0, 9.0, 9.0, 0.0] {
        measurement.wrench[0] = force;
        measurement.angles[3] += speed * TICK;
        let output = state.tick(&fixture.arm(), &measurement).unwrap();
        acceleration = (fixture.jacobian(&POSTURES[0]) * accelerations(&output)).x;
    }
    acceleration
}

/// Velocity [m/s] after a `time` [s] in the exact solution of 1.5 kg, 30 N·s/m, 300 N/m, released at 3 cm.
fn exact_velocity(time: f32) -> f32 {
    // Decay 10/s, frequency 10/s.
    let (sine, _) = crate::math::sin_cos(10.0 * time);
    -0.03 * 20.0 * crate::math::exp(-10.0 * time) * sine
}

#[test]
fn a_tool_that_was_let_go_before_the_reading_gains_the_velocity_of_that_time() {
    let velocity = 0.01 * first_acceleration(&SOFT, 0.0);
    // Half a millisecond before the reading.
    assert!((velocity / exact_velocity(0.0105) - 1.0).abs() < 1e-2, "{velocity}");
    assert!((velocity / exact_velocity(0.01) - 1.0).abs() > 0.03, "{velocity}");
}

#[test]
fn a_tool_that_moved_as_it_was_let_go_gains_nothing() {
    let [out, back] = [0.1, -0.1].map(|speed| first_acceleration(&SOFT, speed));
    // The damping forces of both cancel.
    let velocity = 0.01 * f32::midpoint(out, back);
    assert!((velocity / exact_velocity(0.01) - 1.0).abs() < 1e-2, "{out} {back}");
}

#[test]
fn the_direct_law_gains_nothing() {
    let direct = ImpedanceSettings { law: Law::Direct(DirectLaw::CORRECTED), ..SOFT };
    let acceleration = first_acceleration(&direct, 0.0);
    assert!((acceleration + 300.0 * 0.03 / 1.5).abs() < 1e-2, "{acceleration}");
}
