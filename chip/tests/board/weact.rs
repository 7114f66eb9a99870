//! The image of `board-weact` on the modelled chip: what a driver must do, and a check that each seeded
//! mistake is found.

use tesaki::model::{Field, Problem};
use tesaki::protocol::{ClockSource, Mode, ResetCause};

use crate::rig::acceptance::accept;
use crate::rig::{Refused, Rig};

#[test]
fn boots_from_the_crystal() {
    let mut rig = Rig::greeted();
    let status = rig.status();
    assert_eq!(status.board.clock, ClockSource::Crystal);
    assert_eq!(status.board.reset, ResetCause::PowerOn);
    assert_eq!(status.node.mode, Mode::Disabled);
    assert_eq!(rig.machine.chip.rcc.hclk(), 168_000_000);
    let supply = status.node.supply;
    assert!((supply - 24.0).abs() < 0.05, "{supply}");
    assert_eq!(rig.machine.chip.unknown, Default::default());
}

/// Steps by at most 0.3 rad, for this many ticks. Returns the largest distance from the reference of the
/// trajectory filter, and the largest one from the goal after two seconds [rad]; the angle is that of the
/// motor, not of the encoder.
fn step(rig: &mut Rig, ticks: u32) -> (f64, f64) {
    let goals = [0.3_f32, -0.3, 0.15];
    rig.goal(goals);
    let (mut worst, mut late) = (0.0_f64, 0.0_f64);
    for tick in 1..=ticks {
        rig.run(0.01);
        rig.keep();
        let time = f64::from(tick) * 0.01;
        let reference = 1.0 - (1.0 + time / 0.2) * (-time / 0.2).exp();
        for (state, goal) in rig.machine.chip.bench.states.iter().zip(goals) {
            // The filter runs in ticks: the reference may be one earlier or later.
            let error = (state.angle - f64::from(goal) * reference).abs();
            worst = worst.max(error);
            if time > 2.0 {
                late = late.max((state.angle - f64::from(goal)).abs());
            }
        }
    }
    assert_eq!(rig.status().node.mode, Rig::running());
    assert_eq!(rig.faults(), []);
    (worst, late)
}

/// As in the servo's table: at most 5 mrad, and 1 mrad after a second; the observer mode has the paper's
/// values.
#[test]
fn joints_step_by_0_3_rad_through_the_registers() {
    let (worst, late) = step(&mut Rig::enabled(), 300);
    eprintln!("largest {worst:.5} rad, late {late:.5} rad");
    assert!(worst < 5e-3 && late < 1e-3, "{worst} {late}");
}

/// There must be no fault, such as a late tick. The table's 5 mrad are for motors that match the model: these
/// were up to 9.1 mrad off the reference.
#[test]
fn ten_boards_step_whose_motors_differ_from_the_model() {
    let errors: Vec<f64> = (1..=10).map(|seed| step(&mut Rig::deviating(seed), 60).0).collect();
    eprintln!("{errors:.4?}");
    assert!(errors.iter().all(|error| *error < 12e-3), "{errors:?}");
}

#[test]
fn the_board_does_all_that_it_must() {
    let mut rig = Rig::boot();
    accept(&mut rig).unwrap();
    let [adc, timer, control] = [16 + 18, 16 + 28, 16 + 6].map(|number| rig.machine.work[number]);
    eprintln!("ADC {adc:?}\nTIM2 {timer:?}\nEXTI0 {control:?}");
}

/// A model is refused at the push, by joint and field; then a robot that the board can drive is accepted.
#[test]
fn what_the_board_lacks_is_refused_at_the_push() {
    let mut rig = Rig::boot();
    let refusals: [Refused; 6] = [
        (
            |model| {
                let mut fourth = model.joints[2].clone();
                fourth.name = "fourth".try_into().unwrap();
                model.joints.push(fourth).unwrap();
                model.chains[0].joints = 4;
            },
            Some(3),
            Field::Joints,
            Problem::BoardLimit(3.0),
        ),
        (|model| model.joints[1].motor.resistance = None, Some(1), Field::MotorResistance, Problem::Missing),
        (|model| model.joints[2].motor.inductance = None, Some(2), Field::MotorInductance, Problem::Missing),
        (
            |model| model.joints[0].encoder.relative = false,
            Some(0),
            Field::EncoderRelative,
            Problem::NotSupported,
        ),
        (
            |model| model.joints[1].motor.current_limit = 2.6,
            Some(1),
            Field::CurrentLimit,
            Problem::BoardLimit(2.5),
        ),
        (|model| model.safety.supply_max = 40.0, None, Field::SupplyMax, Problem::BoardLimit(36.0)),
    ];
    rig.refuses(&refusals);
}
