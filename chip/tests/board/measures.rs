//! How soon the motors are off, by what happens.

use tesaki::fault::FaultCause;
use tesaki_chip::SECOND;

use crate::rig::Rig;

const MICROSECOND: u64 = SECOND / 1_000_000;

/// Time until `is_off`, in steps [ps]; `None`: not within `limit`.
fn time_until(rig: &mut Rig, step: u64, limit: u64, is_off: impl Fn(&Rig) -> bool) -> Option<u64> {
    let begin = rig.machine.now();
    while rig.machine.now() - begin < limit {
        if is_off(rig) {
            return Some(rig.machine.now() - begin);
        }
        let until = rig.machine.now() + step;
        rig.machine.run(until).unwrap();
        rig.client.receive(&mut rig.machine);
    }
    None
}

fn sleeps(rig: &Rig) -> bool {
    !rig.machine.chip.bench.is_awake()
}

/// A current beyond its limit: the power stages sleep within 100 µs, whatever the phase of the sampling.
#[test]
fn a_high_current_is_off_within_100_microseconds() {
    let mut rig = Rig::enabled();
    let mut worst = 0;
    for round in 0..12 {
        let motor = round as usize % 3;
        // The sampling has a period of 50 µs.
        rig.run(0.02 + f64::from(round) * 4.3e-6);
        rig.machine.chip.bench.leak[motor] = 2.0;
        worst = worst.max(time_until(&mut rig, MICROSECOND, 200 * MICROSECOND, sleeps).unwrap());
        rig.machine.chip.bench.leak[motor] = 0.0;
        rig.run(0.03);
        assert_eq!(rig.faults().last().unwrap().cause, FaultCause::PowerStage);
        rig.recover().unwrap();
    }
    println!("high current: off within {:.1} µs", worst as f64 / MICROSECOND as f64);
    assert!(worst <= 100 * MICROSECOND, "{worst} ps");
}

/// An encoder whose count stays while its joint moves or should: the ticks until the power stages sleep. Two would be the
/// aim; the core takes an encoder for dead only when a torque beyond friction moves nothing for some ticks.
#[test]
fn a_dead_encoder_is_off() {
    let mut worst = Vec::new();
    for joint in 0..3 {
        for delay in [0.05, 0.15, 0.3] {
            let mut rig = Rig::enabled();
            rig.goal([0.3, -0.3, 0.3]);
            rig.run(delay);
            rig.machine.chip.bench.unplugged[joint] = true;
            let mut ticks = 0;
            while !sleeps(&rig) && ticks < 50 {
                rig.keep();
                rig.run(0.01);
                ticks += 1;
            }
            let moved = rig.machine.chip.bench.states[joint].angle;
            worst.push((joint, delay, ticks, moved, rig.faults().last().copied()));
        }
    }
    for row in &worst {
        println!("{row:?}");
    }
}
