//! How soon the motors are off after each kind of failure.

use tesaki::control::JointPoint;
use tesaki::fault::FaultCause;
use tesaki::protocol::{Request, Stream};
use tesaki::task::TaskCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki_chip::SECOND;
use tesaki_chip::bench::{Bench, Motor};

use crate::rig::{MOTOR, Rig, model};

const MICROSECOND: u64 = SECOND / 1_000_000;

/// Returns the time until `is_off`, in steps [ps]; `None`: not within `limit`.
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

/// The cable of an encoder is unplugged while its joint moves at 0.3 to 0.55 rad/s: the back-EMF is large
/// enough for the board to see that the motor still turns.
#[test]
fn a_dead_encoder_in_motion_is_named_and_off_within_2_periods() {
    let mut worst = 0;
    for joint in 0..3 {
        for delay in [0.05, 0.153, 0.306] {
            let mut rig = Rig::enabled();
            rig.goal([0.3, -0.3, 0.3]);
            rig.run(delay);
            rig.machine.chip.bench.unplugged[joint] = true;
            let mut periods = 0;
            while !sleeps(&rig) && periods < 50 {
                rig.keep();
                rig.run(0.01);
                periods += 1;
            }
            let fault = *rig.faults().last().unwrap();
            assert_eq!((fault.cause, fault.joint), (FaultCause::EncoderStuck, Some(joint as u8)));
            println!("dead encoder of joint {joint}, {delay} s after a goal: off within {periods} periods");
            worst = worst.max(periods);
        }
    }
    assert!(worst <= 2, "{worst}");
}

/// The wire of a current sense breaks while its motor presses on a stop: the loop sees no current and drives
/// with all the voltage that it has, which no current explains.
#[test]
fn a_blind_current_sense_is_off_within_4_periods() {
    let mut worst = 0;
    for motor in 0..3 {
        let blocked = Motor { blocked: true, ..MOTOR };
        let mut rig = Rig::boot_on(Bench::new([blocked; 3], 1), &[]);
        rig.enable_with(&model()).unwrap();
        let point = JointPoint { position: 0.0, velocity: 0.0, acceleration: 0.0 };
        let command = JointCommand::StreamTorques {
            points: [point; 3].into_iter().collect(),
            torques: [0.05; 3].into_iter().collect(),
        };
        let press = |rig: &mut Rig| {
            rig.client.send(&mut rig.machine, Request::Task(TaskCommand::JointServo(command.clone())));
            rig.run(0.01);
        };
        (0..10).for_each(|_| press(&mut rig));
        assert_eq!(rig.faults(), []);
        rig.machine.chip.bench.blind[motor] = true;
        let periods = (1..=50).find(|_| {
            press(&mut rig);
            sleeps(&rig)
        });
        println!("blind current sense of motor {motor}: off within {periods:?} periods");
        assert_eq!(rig.faults().last().unwrap().cause, FaultCause::PowerStage);
        worst = worst.max(periods.unwrap());
    }
    assert!(worst <= 4, "{worst}");
}

/// The microcontroller's supply falls by 10 mV a microsecond: the power stages sleep before it is so low that
/// the CPU reads wrong instructions, also where the detector's threshold is the lowest of its tolerance, 80
/// mV less.
#[test]
fn a_falling_supply_of_the_chip_is_off_in_microseconds() {
    let mut worst = 0.0_f64;
    for round in 0..8 {
        let mut rig = Rig::enabled();
        rig.run(0.01 + f64::from(round) * 6.3e-6);
        while !sleeps(&rig) {
            rig.machine.chip.supply.volts -= 1e-3;
            let until = rig.machine.now() + MICROSECOND / 10;
            rig.machine.run(until).unwrap();
            assert_eq!(rig.machine.chip.violation(), None);
        }
        worst = worst.max(2.93 - rig.machine.chip.supply.volts);
    }
    println!("falling supply of the chip: off {:.1} µs after the threshold", worst * 100.0);
    assert!(worst < 0.03, "{worst} V");
}

/// Emergency stop and nFAULT end the pulses while the CPU executes nothing.
#[test]
fn pulses_end_without_an_instruction() {
    for name in ["emergency stop", "nFAULT"] {
        let mut rig = Rig::enabled();
        // A load, which keeps the stage driving.
        rig.machine.chip.bench.motors[0].load = 0.1;
        rig.run(0.1);
        let before = rig.machine.chip.bench.last_driven;
        let executed = rig.machine.instructions;
        let Bench { stop, fault, .. } = &mut rig.machine.chip.bench;
        *(if name == "nFAULT" { fault } else { stop }) = true;
        let pressed = rig.machine.now();
        // The inputs change now, not at the next event.
        rig.machine.pass(0);
        rig.machine.pass(SECOND / 1000);
        assert_eq!(rig.machine.instructions, executed);
        let bench = &rig.machine.chip.bench;
        assert!(pressed - before < SECOND / 20_000, "{name}: it did not drive");
        println!("{name}: last pulse ended {} ps after it", bench.last_driven.saturating_sub(pressed));
        assert!(bench.last_driven <= pressed, "{name}");
    }
}

/// The supply at the last sample of each period is disturbed, beyond `supply_max`: no fault, as the mean of
/// the period counts. A supply that stays there is a fault.
#[test]
fn a_disturbed_sample_of_the_supply_is_no_fault() {
    let mut rig = Rig::enabled();
    let normal = rig.machine.chip.bench.supply;
    let high = f64::from(rig.model.safety.supply_max) + 4.0;
    for _ in 0..10 {
        let instant = rig.machine.entered[16 + 28] + SECOND / 100;
        rig.machine.run(instant - 60 * MICROSECOND).unwrap();
        rig.machine.chip.bench.supply = high;
        rig.machine.run(instant + MICROSECOND).unwrap();
        rig.machine.chip.bench.supply = normal;
        rig.keep();
        rig.run(0.002);
    }
    assert_eq!(rig.faults(), []);
    rig.machine.chip.bench.supply = high;
    rig.run(0.03);
    assert_eq!(rig.faults().last().unwrap().cause, FaultCause::SupplyHigh);
}

/// For half a millisecond the supply is too high, as braking motors make it: the mean of the period stays
/// within the limit.
#[test]
fn a_short_overvoltage_switches_off_at_the_fourth_sample() {
    let mut rig = Rig::enabled();
    let normal = rig.machine.chip.bench.supply;
    let high = f64::from(rig.model.safety.supply_max) + 0.5;
    let instant = rig.machine.entered[16 + 28];
    rig.machine.run(instant + 4 * SECOND / 1000).unwrap();
    rig.machine.chip.bench.supply = high;
    let until = time_until(&mut rig, MICROSECOND, SECOND / 1000, sleeps).unwrap();
    println!("overvoltage: off after {} µs", until / MICROSECOND);
    assert!((150..=205).contains(&(until / MICROSECOND)), "{} µs", until / MICROSECOND);
    rig.machine.run(instant + 9 * SECOND / 2000).unwrap();
    rig.machine.chip.bench.supply = normal;
    rig.run(0.02);
    let fault = rig.faults()[0];
    assert!(
        fault.cause == FaultCause::SupplyHigh && (f64::from(fault.value) - high).abs() < 0.1,
        "{fault:?}"
    );
    assert_eq!(rig.faults().len(), 1);
}

/// The control task is late by five periods: it goes on with the last sample, not with one that waited.
#[test]
fn a_late_control_task_takes_the_last_sample() {
    let mut rig = Rig::enabled();
    let tick = rig.status().node.tick;
    let before = rig.machine.work[16 + 28].times;
    rig.stop_control();
    rig.run(0.055);
    rig.machine.chip.nvic.enabled[0] |= 1 << 6;
    rig.run(0.001);
    let late: Vec<_> = rig.faults().iter().map(|fault| (fault.cause, fault.value)).collect();
    let missed = rig.machine.work[16 + 28].times - before;
    println!("from tick {tick}: {missed} instants, {late:?}");
    let [(FaultCause::LateTick, value)] = late[..] else { panic!("{late:?}") };
    assert!((5.0..=6.0).contains(&value), "{value}");
}

/// The control task is late by five periods while the encoders count a million a second: counters of 16 bits
/// go around meanwhile.
#[test]
fn a_late_control_task_loses_no_counts() {
    for mut rig in [Rig::boot(), Rig::odrive(&[])] {
        rig.enable().unwrap();
        rig.ask(Request::SetRate { stream: Stream::Log, every: 1 });
        let joints = rig.model.joints.len();
        let miscounted = |rig: &mut Rig| -> Vec<i64> {
            rig.run(0.03);
            let told = rig.client.sensors.as_ref().unwrap().encoders.iter();
            told.zip(0..)
                .map(|(told, joint)| i64::from(*told) - rig.machine.chip.bench.counts(joint))
                .collect()
        };
        let before = miscounted(&mut rig);
        rig.stop_control();
        for joint in 0..joints {
            let bench = &mut rig.machine.chip.bench;
            (bench.motors[joint].inertia, bench.motors[joint].constant) = (f64::INFINITY, 0.0);
            bench.states[joint].velocity = std::f64::consts::TAU * 1e6 / bench.motors[joint].counts;
        }
        rig.run(0.055);
        for state in &mut rig.machine.chip.bench.states {
            state.velocity = 0.0;
        }
        rig.machine.chip.nvic.enabled[0] |= 1 << 6;
        let after = miscounted(&mut rig);
        assert_eq!((before.len(), after.len()), (joints, joints));
        for (before, after) in before.iter().zip(&after) {
            assert!((before - after).abs() < 100, "{before}, then {after} counts beside the encoder's");
        }
        assert!(rig.machine.resets.is_empty(), "{:?}", rig.machine.resets);
    }
}

/// A request hangs: nothing could stop the robot by a request any more, although the control task goes on.
#[test]
fn a_hanging_request_resets_the_board_within_a_second() {
    let mut rig = Rig::enabled();
    rig.hang(7);
    rig.keep();
    let limit = SECOND;
    let until = time_until(&mut rig, SECOND / 1000, limit, sleeps).unwrap();
    println!("a hanging request: off within {:.2} s", until as f64 / SECOND as f64);
    assert_eq!(rig.machine.resets, ["watchdog"]);
}

/// The control task is dead, but the timer continues: the loops brake after two periods without a command.
#[test]
fn a_dead_control_task_is_off_within_20_ms() {
    let mut rig = Rig::enabled();
    rig.machine.chip.bench.motors[0].load = 0.05;
    rig.run(0.1);
    let before = rig.machine.now();
    rig.stop_control();
    rig.run(0.05);
    let driven = rig.machine.chip.bench.last_driven.saturating_sub(before);
    println!("dead control task: no voltage after {:.2} ms", driven as f64 / 1e9);
    assert!(driven > 0 && driven <= SECOND / 50, "{driven} ps");
}
