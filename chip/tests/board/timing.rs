//! Execution times of the image's handlers, while three joints move and both directions of the supervisor's
//! line are full.

use crate::links::run_with_full_lines;
use crate::rig::Rig;

/// Frequency of the CPU [MHz], and assumed cycles per instruction.
const CLOCK: f64 = 168.0;
const CYCLES: f64 = 1.5;

/// Time of a byte of the UARTs, which wait while handlers of a higher priority run [µs].
const BYTE: f64 = 10.8;
const INSTANT: usize = 16 + 28;
const LOOPS: usize = 16 + 18;
/// Name, number of the exception, and the longest time that the firmware promises [µs].
const HANDLERS: [(&str, usize, f64); 5] = [
    ("TIM2: instant of the period", INSTANT, 1.5),
    ("ADC: current loops", LOOPS, 8.0),
    // Must fit between two bytes.
    ("USART1: supervisor's line", 16 + 37, BYTE),
    ("EXTI0: control", 16 + 6, 5000.0),
    ("EXTI1: supervisor", 16 + 7, f64::INFINITY),
];

/// The instant lies where neither conversions nor current loops run, in each period: 18 to 19.5 µs after a
/// trigger of the converters, of which the conversions take 2.6 and 3.2 µs.
#[test]
fn the_instant_of_a_period_does_not_meet_the_current_loops() {
    for (board, pulse, conversion) in [("weact", 25.0, 2.57), ("odrive", 50.0, 3.19)] {
        let mut rig = if board == "weact" { Rig::boot() } else { Rig::odrive(&[]) };
        for _ in 0..30 {
            let last = rig.machine.entered[INSTANT];
            while rig.machine.entered[INSTANT] == last {
                rig.run(2e-6);
            }
            let since = (rig.machine.entered[INSTANT] - rig.machine.entered[LOOPS]) as f64 * 1e-6;
            let after = (since + conversion) % pulse;
            assert!((18.0..19.5).contains(&after), "{board}: {after:.2} µs after a trigger");
        }
    }
}

#[test]
fn timing_of_the_handlers() {
    let mut rig = Rig::enabled();
    // The loops have just taken over a model.
    let taking_over = rig.machine.work[LOOPS].longest;
    rig.goal([0.3, -0.3, 0.15]);
    rig.machine.work.iter_mut().for_each(|work| *work = Default::default());
    run_with_full_lines(&mut rig, 1000, |_, _| {});
    assert_eq!(rig.status().node.mode, Rig::running());
    println!("instructions: mean, longest; time of the longest; runs a second; share of {CLOCK} MHz");
    let mut all = 0.0;
    for (name, number, limit) in HANDLERS {
        let work = rig.machine.work[number];
        let longest = work.longest as f64 * CYCLES / CLOCK;
        let share = work.instructions as f64 * CYCLES / (CLOCK * 1e6);
        all += share;
        let mean = work.instructions as f64 / work.times as f64;
        println!(
            "{mean:>8.0} {:>8} {longest:>8.1} µs {:>8} {:>6.1} %  {name}",
            work.longest,
            work.times,
            100.0 * share
        );
        assert!(work.times > 0 && longest < limit, "{name}: {longest} µs");
    }
    println!("{:>44.1} %  in all", 100.0 * all);
    // Both can follow each other at once, together with an edge on a line.
    let [instant, loops] = [INSTANT, LOOPS].map(|number| rig.machine.work[number].longest);
    let waits = (instant + loops.max(taking_over)) as f64 * CYCLES / CLOCK;
    println!("{waits:.1} µs until a byte is taken, of {BYTE}");
    assert!(waits < BYTE - 1.0, "{waits} µs");
    assert!(all < 0.8, "{all}");
}
