//! The image of `board-odrive` on the modelled chip.

use tesaki::model::{Field, Problem};
use tesaki::protocol::{ClockSource, Mode};
use tesaki_chip::SECOND;
use tesaki_chip::bench::{Bench, Motor};
use tesaki_chip::mistake::Mistake;

use crate::rig::odrive::{LARGE, TRIP_TIME, accept};
use crate::rig::{Refused, Rig};

#[test]
fn it_answers_on_its_line_and_refuses_what_it_lacks() {
    let mut rig = Rig::odrive(&[]);
    let refusals: [Refused; 3] = [
        (|model| *model = crate::rig::model(), Some(2), Field::Joints, Problem::BoardLimit(2.0)),
        (
            |model| model.joints[1].motor.current_limit = 26.0,
            Some(1),
            Field::CurrentLimit,
            Problem::BoardLimit(25.0),
        ),
        (|model| model.safety.supply_max = 50.0, None, Field::SupplyMax, Problem::BoardLimit(48.0)),
    ];
    rig.refuses(&refusals);
    let status = rig.status();
    assert_eq!((status.board.clock, status.node.mode), (ClockSource::Crystal, Mode::Disabled));
}

/// Moves both joints by 0.3 rad, for this many ticks. Returns the largest distance from the reference and the
/// largest one from the goal after two seconds [rad].
fn step(rig: &mut Rig, ticks: u32) -> (f64, f64) {
    let goals = [0.3_f32, -0.3];
    rig.goal(goals);
    let (mut worst, mut late) = (0.0_f64, 0.0_f64);
    for tick in 1..=ticks {
        rig.run(0.01);
        rig.keep();
        let time = f64::from(tick) * 0.01;
        let reference = 1.0 - (1.0 + time / 0.2) * (-time / 0.2).exp();
        for (state, goal) in rig.machine.chip.bench.states.iter().zip(goals) {
            worst = worst.max((state.angle - f64::from(goal) * reference).abs());
            if time > 2.0 {
                late = late.max((state.angle - f64::from(goal)).abs());
            }
        }
    }
    assert_eq!(rig.status().node.mode, Rig::running());
    assert_eq!(rig.faults(), []);
    assert_eq!(rig.machine.chip.violation(), None);
    (worst, late)
}

/// As in the servo's table: at most 5 mrad, and 1 mrad after a second.
#[test]
fn two_joints_step_by_0_3_rad_through_the_registers() {
    let mut rig = Rig::odrive(&[]);
    rig.enable().unwrap();
    rig.machine.work.iter_mut().for_each(|work| *work = Default::default());
    let (worst, late) = step(&mut rig, 250);
    println!("board-odrive: largest {:.2} mrad, late {:.2} mrad", 1e3 * worst, 1e3 * late);
    assert!(worst < 5e-3 && late < 1e-3, "{worst} {late}");
    // Name, exception, and what the firmware promises [µs].
    for (name, number, limit) in [
        ("TIM2: instant of the period", 16 + 28, 1.5),
        ("ADC: current loops", 16 + 18, 8.0),
        ("UART4: supervisor's line", 16 + 52, 10.8),
        ("EXTI0: control", 16 + 6, 5000.0),
    ] {
        let work = rig.machine.work[number];
        let longest = work.longest as f64 * 1.5 / 168.0;
        println!("{:>8} instructions, {longest:>6.1} µs  {name}", work.longest);
        assert!(work.times > 0 && longest < limit, "{name}: {longest} µs");
    }
}

/// Windings, inertia and friction differ from the model by up to a fifth, the torque constant by a twentieth.
#[test]
fn four_odrives_step_whose_motors_differ_from_the_model() {
    for (seed, signs) in [(1, [1.0, 1.0]), (2, [1.0, -1.0]), (3, [-1.0, 1.0]), (4, [-1.0, -1.0])] {
        let motors = signs.map(|sign: f64| Motor {
            resistance: LARGE.resistance * (1.0 + 0.2 * sign),
            inductance: LARGE.inductance * (1.0 - 0.2 * sign),
            constant: LARGE.constant * (1.0 + 0.05 * sign),
            inertia: LARGE.inertia * (1.0 - 0.2 * sign),
            coulomb: LARGE.coulomb * (1.0 + 0.2 * sign),
            ..LARGE
        });
        let mut rig = Rig::odrive_on(Bench::with_odrive(motors, seed), &[]);
        rig.enable().unwrap();
        let (worst, _) = step(&mut rig, 60);
        println!("board-odrive, machine {seed}: largest {:.2} mrad", 1e3 * worst);
        assert!(worst < 12e-3, "{worst}");
    }
}

#[test]
fn the_odrive_does_all_that_it_must() {
    accept(&mut Rig::odrive(&[])).unwrap();
}

/// Measures the time from the edge to the last gate, wherever it interrupts the CPU. There is no other path:
/// without instructions nothing switches off.
#[test]
fn a_trip_takes_some_instructions() {
    for name in ["emergency stop", "nFAULT"] {
        let (mut most, mut longest) = (0, 0);
        let mut rig = Rig::odrive(&[]);
        rig.enable().unwrap();
        for round in 0..24 {
            // The sampling has a period of 50 µs, and the control task takes some 100 µs of each 10 ms.
            let next = rig.machine.entered[16 + 28] + 2 * SECOND / 100 + round * 9_300_000;
            rig.keep();
            rig.machine.run(next).unwrap();
            let (begin, executed) = (rig.machine.now(), rig.machine.instructions);
            if name == "nFAULT" {
                rig.stages().drivers[1].overload(0);
            } else {
                rig.machine.chip.bench.stop = true;
            }
            rig.machine.pass(0);
            assert!(rig.stages().is_any_gate_on(), "{name}: nothing happens without an instruction");
            while rig.machine.chip.bench.is_awake() || rig.stages().is_any_gate_on() {
                let until = rig.machine.now() + 9_000;
                rig.machine.run(until).unwrap();
                rig.machine.pass(0);
            }
            most = most.max(rig.machine.instructions - executed);
            longest = longest.max(rig.machine.now() - begin);
            rig.machine.chip.bench.stop = false;
            rig.run(0.2);
            rig.recover().unwrap();
        }
        // The model omits the twelve cycles of interrupt entry.
        let handler = rig.machine.work[if name == "nFAULT" { 16 + 8 } else { 16 + 10 }].longest;
        let time = longest as f64 * 1e-6;
        println!(
            "{name}: gates off after {most} instructions at most, {time:.2} µs; handler {handler} instructions"
        );
        assert!(longest as f64 / SECOND as f64 <= TRIP_TIME, "{name}: {longest} ps");
    }
}

/// Description, address, mask, value.
const MISTAKES: &[(&str, u32, u32, u32)] = &[
    ("TIM1 BDTR: no dead time", 0x4001_0044, 0xFF, 0),
    ("TIM8 BDTR: AOE", 0x4001_0444, 1 << 14, 1 << 14),
    ("TIM8 CCER: no CC3NE", 0x4001_0420, 1 << 10, 0),
    ("TIM8 CCER: CC2NP", 0x4001_0420, 1 << 7, 1 << 7),
    ("TIM8 CR1: no CEN", 0x4001_0400, 1, 0),
    ("TIM8 ARR: half", 0x4001_042C, 0xFFFF, 2100),
    ("ADC2 JSQR: M1 and M0 exchanged", 0x4001_2138, 0x3FF << 10, 11 << 10 | 13 << 15),
    ("ADC1 JSQR: another channel for the supply", 0x4001_2038, 31 << 15, 5 << 15),
    ("SPI3 CR1: mode 0", 0x4000_3C00, 1, 0),
    ("SPI3 CR1: 21 MHz", 0x4000_3C00, 7 << 3, 0),
    ("EXTI FTSR: no falling edges", 0x4001_3C0C, u32::MAX, 0),
    ("EXTI IMR: nFAULT masked", 0x4001_3C00, 1 << 2, 0),
    ("SYSCFG EXTICR1: line 2 is port A", 0x4001_3808, 15 << 8, 0),
    ("EXTI IMR: PVD masked", 0x4001_3C00, 1 << 16, 0),
    ("PB12 an input", 0x4002_0400, 3 << 24, 0),
    ("PC14 an input", 0x4002_0800, 3 << 28, 0),
    ("PA1 AF7", 0x4002_0020, 15 << 4, 7 << 4),
    ("RCC: TIM8 without clock", 0x4002_3844, 1 << 1, 0),
    ("RCC: SYSCFG without clock", 0x4002_3844, 1 << 14, 0),
];

#[test]
fn every_seeded_mistake_of_the_odrive_is_found() {
    let mut missed = Vec::new();
    for &(name, address, mask, value) in MISTAKES {
        match accept(&mut Rig::odrive(&[Mistake { address, mask, value }])) {
            Ok(()) => missed.push(name),
            Err(found) => println!("{name}: {found}"),
        }
    }
    assert!(missed.is_empty(), "missed: {missed:?}");
}
