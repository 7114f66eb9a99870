//! Behaviour of the box when one of the boards stops.

use tesaki::fault::FaultCause;
use tesaki::protocol::Mode;
use tesaki_supervisor::hand::HandError;

use super::rig::{Rig, Trouble, distance, natives};

/// Lifts the box, and perhaps turns it; then disturbs board `index`: all boards must stop in time, and hold
/// the box if all can.
fn lose(index: usize, moving: bool, trouble: Trouble) {
    let mut rig = Rig::new(3, natives());
    rig.grasp();
    rig.go(0.01, 0.0);
    rig.wait(150);
    if moving {
        rig.go(0.01, 0.1);
        rig.wait(40);
    }
    let before = rig.box_now().position;
    rig.hand().boards_mut()[index].cut = trouble == Trouble::CutLink;
    rig.trouble = Some((index, trouble));
    let (mut told, mut all_stopped) = (None, None);
    // The command timeout of 0.1 s and two more ticks; then one second.
    for tick in 1..=112 {
        rig.machine();
        if told.is_none() {
            told = rig.hand().step().err().map(|error| (tick, error));
        }
        if rig.hand().boards().iter().all(|cable| cable.board.node().mode() == Mode::Fault) {
            all_stopped = all_stopped.or(Some(tick));
        }
    }
    let (told, error) = told.unwrap();
    let case = format!("board {index}, moving {moving}, {trouble:?}");
    assert!(all_stopped.unwrap() <= 12, "{case}: {all_stopped:?}");
    let name = format!("finger{}_tip", index + 1);
    match &error {
        HandError::Stale { board, .. } => assert!(trouble == Trouble::CutLink && *board == name, "{error}"),
        HandError::Fault { board, fault } => {
            let cause = trouble.cause().description();
            assert!(*board == name && fault.as_ref().unwrap().contains(cause), "{error}");
        }
        _ => panic!("{case}: {error}"),
    }
    for (other, cable) in rig.hand().boards().iter().enumerate() {
        // The hand then stops all boards, including the disturbed one.
        let cause = cable.board.node().faults().faults.first().unwrap().cause;
        assert_eq!(cause, if other == index { trouble.cause() } else { FaultCause::Stop }, "{case}");
        // The model's reaction is to hold.
        let off = other == index && trouble == Trouble::EmergencyStop;
        assert_eq!(cable.actuators.enabled, !off, "{case}: board {other}");
    }
    let moved = distance(rig.box_now().position, before);
    let normals: Vec<f64> = rig.plant.contacts().iter().map(|contact| contact.normal_force()).collect();
    println!(
        "{case}: told after {told} ticks ({error}), all stopped after {}; a second later the box has moved {:.2} mm, \
         normal forces {normals:.2?} N",
        all_stopped.unwrap(),
        1e3 * moved
    );
    if trouble != Trouble::EmergencyStop {
        assert!(
            moved < 0.002 && normals.iter().all(|force| *force > 0.05),
            "{case}: {moved} m, {normals:?} N"
        );
    }
    assert!(matches!(rig.hand().step(), Err(HandError::NotEnabled)));
}

#[test]
fn a_cut_link_stops_all_boards_and_the_box_stays_in_the_hand() {
    lose(1, false, Trouble::CutLink);
    lose(2, true, Trouble::CutLink);
}

#[test]
fn a_board_in_fault_stops_the_others_and_the_box_stays_in_the_hand() {
    lose(0, false, Trouble::LowSupply);
    lose(2, true, Trouble::LowSupply);
    lose(1, false, Trouble::EmergencyStop);
}
