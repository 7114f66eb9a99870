//! Errors that stop the control.

use super::fixture::{ArmFixture, POSTURES, SOFT, track};
use crate::task::impedance::{ArmMeasurement, DirectLaw, ImpedanceSettings, Law, SetpointError};

#[test]
fn a_force_that_is_not_finite_stops_the_control() {
    let fixture = ArmFixture::new();
    for law in [Law::Direct(DirectLaw::CORRECTED), Law::ModelFollowing] {
        for value in [f32::NAN, f32::INFINITY] {
            let mut state = fixture.state(&ImpedanceSettings { law, ..SOFT }, &POSTURES[0]);
            let mut measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
            measurement.wrench[4] = value;
            assert_eq!(state.tick(&fixture.arm(), &measurement).unwrap_err(), SetpointError::NotFinite);
        }
    }
}

#[test]
fn a_tool_beyond_the_maximum_deviation_stops_the_control() {
    let fixture = ArmFixture::new();
    let pulled = |axis: usize, size: f32| {
        let mut state = fixture.state(&SOFT, &POSTURES[0]);
        let mut measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
        for _ in 0..500 {
            measurement.wrench = [0.0; 6];
            // A small force that causes contact.
            measurement.wrench[1] = 2.0;
            measurement.wrench[axis] = size;
            match state.tick(&fixture.arm(), &measurement) {
                Ok(output) => measurement = track(&output),
                Err(error) => panic!("{error}"),
            }
            if let Err(deviation) = state.check_deviation() {
                return Some(deviation);
            }
        }
        None
    };
    // On 300 N/m, 20 N displace by 67 mm, 40 N would by 133 mm.
    assert_eq!(pulled(0, 20.0), None);
    let Some(SetpointError::Distance { value, limit: 0.1 }) = pulled(0, 40.0) else { panic!() };
    assert!((0.1..0.12).contains(&value), "{value}");
    let Some(SetpointError::Rotation { value, limit: 1.0 }) = pulled(5, 12.0) else { panic!() };
    assert!((1.0..1.2).contains(&value), "{value}");
}
