//! What stops an arm.

use super::machine::{Machine, POSTURES, SOFT, follow};
use crate::task::impedance::{ArmSense, ImpedanceSettings, Law, SetpointError};

#[test]
fn a_force_that_is_no_number_stops_the_arm() {
    let machine = Machine::new();
    for law in [Law::Direct, Law::ModelFollowing] {
        for value in [f32::NAN, f32::INFINITY] {
            let mut state = machine.state(&ImpedanceSettings { law, ..SOFT }, &POSTURES[0]);
            let mut sense = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
            sense.wrench[4] = value;
            assert_eq!(state.tick(&machine.arm(), &sense).unwrap_err(), SetpointError::NotFinite);
        }
    }
}

#[test]
fn a_tool_that_is_pulled_beyond_its_reach_stops_the_arm() {
    let machine = Machine::new();
    let pulled = |axis: usize, size: f32| {
        let mut state = machine.state(&SOFT, &POSTURES[0]);
        let mut sense = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
        for _ in 0..500 {
            sense.wrench = [0.0; 6];
            // A push, too small to go far, that makes it a contact.
            sense.wrench[1] = 2.0;
            sense.wrench[axis] = size;
            match state.tick(&machine.arm(), &sense) {
                Ok(command) => sense = follow(&command),
                Err(error) => return Some(error),
            }
        }
        None
    };
    // 20 N hold 67 mm of 300 N/m; 40 N would hold 133.
    assert_eq!(pulled(0, 20.0), None);
    let Some(SetpointError::Distance { value, limit: 0.1 }) = pulled(0, 40.0) else { panic!() };
    assert!((0.1..0.12).contains(&value), "{value}");
    let Some(SetpointError::Rotation { value, limit: 1.0 }) = pulled(5, 12.0) else { panic!() };
    assert!((1.0..1.2).contains(&value), "{value}");
}
