#![allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests")]

use super::*;

const SWITCHING: Switching =
    Switching { period: 50e-6, lag: 0.5, pulses: 1, resolution: 4200, max_duty: 0.9 };
const WINDING: Winding = Winding { resistance: 4.0, inductance: 1.6e-3, back_emf: 0.3 };
const SUPPLY: f64 = 12.0;
const SUPPLY_MAX: f32 = 15.0;

/// Power stages and windings. A duty takes effect in the middle of a period.
#[derive(Default)]
struct Rig {
    awake: bool,
    pulses_pass: bool,
    tripped: bool,
    outputs: [Output; 2],
    duty: [f64; 2],
    current: [f64; 2],
    velocity: [f64; 2],
    noise: u32,
    warm: bool,
    signed: bool,
    /// Above [`SUPPLY`] [V].
    excess: f64,
    /// Pulses that changed their direction while they lasted.
    glitches: u32,
}

impl PowerStages<2> for Rig {
    fn off(&mut self) {
        (self.awake, self.pulses_pass) = (false, false);
    }
    fn wake(&mut self) {
        self.awake = true;
    }
    fn enable_pulses(&mut self) {
        self.pulses_pass = true;
    }
    fn has_tripped(&self) -> bool {
        self.tripped
    }
    fn set(&mut self, outputs: &[Output; 2]) {
        for (last, next) in self.outputs.iter().zip(outputs) {
            self.glitches +=
                u32::from(self.pulses_pass && last.counts != 0 && last.positive != next.positive);
        }
        self.outputs = *outputs;
    }
}

impl Rig {
    /// Differs by a fifth from the motors' model.
    fn resistance(&self) -> f64 {
        if self.warm { 4.8 } else { 3.2 }
    }

    fn step(&mut self, motors: &mut Motors<2>) {
        // A converter with 0.72 mA per count and noise of ±2 counts; it cannot measure negative voltages.
        let signed = self.signed;
        let measured = self.current.map(|current| {
            self.noise = self.noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = f64::from(self.noise >> 24) / 64.0 - 2.0;
            let (current, offset) = if signed { (current, 2048.0) } else { (current.abs(), 0.0) };
            (((current / 0.72e-3 + noise + offset).round().clamp(0.0, 4095.0) - offset) * 0.72e-3) as f32
        });
        motors.update(&measured, (SUPPLY + self.excess) as f32, self);
        for index in 0..2 {
            let Output { positive, counts } = self.outputs[index];
            let duty = f64::from(counts) / 4200.0 * if positive { 1.0 } else { -1.0 };
            let before = std::mem::replace(&mut self.duty[index], duty);
            for step in 0..100 {
                let duty = if step < 50 { before } else { duty };
                let voltage = if self.pulses_pass { duty * SUPPLY } else { 0.0 };
                let emf = 0.3 * self.velocity[index];
                self.current[index] +=
                    0.5e-6 * (voltage - self.resistance() * self.current[index] - emf) / 1.3e-3;
            }
            if !self.awake {
                self.current[index] = 0.0;
            }
        }
    }
}

fn motors() -> Motors<2> {
    let motor = Motor { winding: WINDING, sensing: Sensing::Magnitude, trip: 1.25 };
    Motors::try_new(&[Some(motor); 2], SUPPLY_MAX, &SWITCHING, 1e-3).unwrap()
}

const fn command(currents: [f32; 2], velocities: [f32; 2]) -> Command<2> {
    Command { currents, velocities }
}

/// Runs some periods, with a command in each control period.
fn run(rig: &mut Rig, motors: &mut Motors<2>, command: &Command<2>, periods: u32) {
    for period in 0..periods {
        if period % 200 == 0 {
            motors.command(Some(command), rig);
        }
        rig.step(motors);
    }
}

#[test]
fn stages_wake_before_the_first_pulse() {
    let (mut rig, mut motors) = (Rig::default(), motors());
    rig.step(&mut motors);
    assert!(!rig.awake);
    motors.command(Some(&command([0.5, -0.5], [0.0; 2])), &mut rig);
    // A millisecond is 20 periods.
    for _ in 0..21 {
        rig.step(&mut motors);
        assert!(rig.awake && !rig.pulses_pass && rig.outputs == [Output::default(); 2]);
    }
    rig.step(&mut motors);
    assert!(rig.pulses_pass);
    run(&mut rig, &mut motors, &command([0.5, -0.5], [0.0; 2]), 200);
    let [first, second] = rig.current;
    assert!((first - 0.5).abs() < 0.005 && (second + 0.5).abs() < 0.005, "{first} {second}");
}

/// Without a current, its sign is unknown: noise must not determine it for long.
#[test]
fn currents_around_zero_stay_there() {
    for warm in [false, true] {
        let (mut rig, mut motors) = (Rig { warm, ..Rig::default() }, motors());
        for (index, current) in [0.0, 0.002, -0.002, 0.01, -0.01, 0.0].into_iter().enumerate() {
            run(&mut rig, &mut motors, &command([current, -current], [0.0; 2]), 200);
            let mut worst = 0.0_f64;
            for _ in 0..10 {
                run(&mut rig, &mut motors, &command([current, -current], [0.0; 2]), 200);
                worst = worst.max((rig.current[0] - f64::from(current)).abs());
                worst = worst.max((rig.current[1] + f64::from(current)).abs());
            }
            assert!(worst < 0.008 && !motors.report(true).has_tripped, "{index} {warm}: {worst}");
        }
    }
}

/// A motor turns against its current, or is driven by its load, so that current and voltage differ in sign.
#[test]
fn currents_follow_in_all_four_quadrants_without_glitches() {
    let (mut rig, mut motors) = (Rig::default(), motors());
    run(&mut rig, &mut motors, &command([0.1; 2], [0.0; 2]), 400);
    for (current, velocity) in
        [(0.4, 12.0), (-0.4, 12.0), (0.4, -12.0), (-0.4, -12.0), (0.0, 12.0), (0.8, 0.0)]
    {
        rig.velocity = [velocity, -velocity].map(f64::from);
        let command = command([current, -current], [velocity, -velocity]);
        run(&mut rig, &mut motors, &command, 400);
        for (found, expected) in rig.current.into_iter().zip(command.currents) {
            assert!((found - f64::from(expected)).abs() < 0.01, "{found} {expected} at {velocity}");
        }
        assert!(!motors.report(true).has_tripped);
    }
    assert_eq!(rig.glitches, 0);
}

#[test]
fn a_step_overshoots_by_a_tenth_at_most() {
    let (mut rig, mut motors) = (Rig::default(), motors());
    run(&mut rig, &mut motors, &command([0.0; 2], [0.0; 2]), 200);
    motors.command(Some(&command([0.5, -0.5], [0.0; 2])), &mut rig);
    let mut highest = 0.0_f64;
    for _ in 0..100 {
        rig.step(&mut motors);
        highest = highest.max(rig.current[0]);
    }
    assert!(highest < 0.55 && highest > 0.499, "{highest}");
}

#[test]
fn a_current_beyond_the_trip_switches_off_in_the_same_period_until_told_to_be_off() {
    for broken in [1.3, f64::NAN] {
        let (mut rig, mut motors) = (Rig::default(), motors());
        run(&mut rig, &mut motors, &command([0.5; 2], [0.0; 2]), 400);
        rig.current[1] = broken;
        rig.step(&mut motors);
        assert!(!rig.awake && !rig.pulses_pass && motors.report(true).has_tripped);
        rig.current = [0.0; 2];
        run(&mut rig, &mut motors, &command([0.5; 2], [0.0; 2]), 400);
        assert!(!rig.awake && motors.report(true).has_tripped);
        motors.command(None, &mut rig);
        assert!(!motors.report(true).has_tripped);
        run(&mut rig, &mut motors, &command([0.5; 2], [0.0; 2]), 400);
        assert!(rig.pulses_pass && (rig.current[0] - 0.5).abs() < 0.01);
    }
}

#[test]
fn a_trip_of_the_hardware_is_kept() {
    let (mut rig, mut motors) = (Rig::default(), motors());
    run(&mut rig, &mut motors, &command([0.5; 2], [0.0; 2]), 400);
    rig.tripped = true;
    rig.step(&mut motors);
    rig.tripped = false;
    assert!(!rig.awake && motors.report(true).has_tripped);
}

/// Motors that brake raise the supply faster than the control task would see it.
#[test]
fn a_high_supply_trips_after_four_samples_and_is_reported() {
    let (mut rig, mut motors) = (Rig::default(), motors());
    let drive = command([0.5; 2], [0.0; 2]);
    run(&mut rig, &mut motors, &drive, 400);
    for _ in 0..100 {
        rig.excess = 3.5;
        (0..3).for_each(|_| rig.step(&mut motors));
        rig.excess = 2.9;
        rig.step(&mut motors);
    }
    assert!(rig.pulses_pass && !motors.report(true).supply_tripped);
    for (excess, awake) in [(3.1, true), (3.2, true), (3.3, true), (3.5, false), (9.0, false), (0.0, false)] {
        rig.excess = excess;
        rig.step(&mut motors);
        assert_eq!(rig.awake, awake, "{excess}");
    }
    let measured = motors.report(true);
    assert!(measured.has_tripped && measured.supply_tripped && measured.supply == 15_501, "{measured:?}");
    // Motors that are off leave nothing to switch off, and none wake on a high supply.
    motors.command(None, &mut rig);
    rig.excess = 3.5;
    (0..10).for_each(|_| rig.step(&mut motors));
    assert!(!motors.report(true).has_tripped && !motors.report(true).supply_tripped);
    run(&mut rig, &mut motors, &drive, 400);
    assert!(!rig.awake && motors.report(true).supply_tripped);
    motors.command(None, &mut rig);
    rig.excess = 0.0;
    run(&mut rig, &mut motors, &drive, 400);
    assert!(rig.pulses_pass && (rig.current[0] - 0.5).abs() < 0.01);
}

#[test]
fn without_commands_the_motors_are_shorted_after_two_ticks_and_then_off() {
    let (mut rig, mut motors) = (Rig::default(), motors());
    run(&mut rig, &mut motors, &command([0.5; 2], [0.0; 2]), 201);
    // The last command is one period old; 20 ms are 400 periods, and 100 ms of braking are 2000.
    for _ in 1..400 {
        rig.step(&mut motors);
    }
    assert!(rig.outputs[0].counts > 0);
    rig.step(&mut motors);
    assert!(rig.awake && rig.outputs[0].counts == 0);
    for _ in 0..2000 {
        assert!(rig.awake);
        rig.step(&mut motors);
    }
    assert!(!rig.awake && !motors.report(true).has_tripped);
}

#[test]
fn totals_give_the_mean_current() {
    let (mut rig, mut motors) = (Rig::default(), motors());
    run(&mut rig, &mut motors, &command([0.5, -0.25], [0.0; 2]), 600);
    let before = motors.totals;
    run(&mut rig, &mut motors, &command([0.5, -0.25], [0.0; 2]), 200);
    let after = motors.totals;
    assert_eq!(after.periods - before.periods, 200);
    for (index, expected) in [0.5, -0.25].into_iter().enumerate() {
        let mean = f64::from(after.currents[index] - before.currents[index]) * 1e-4 / 200.0;
        assert!((mean - expected).abs() < 0.003, "{mean}");
    }
}

#[test]
fn a_power_stage_without_motor_stays_without_pulses() {
    let motor = Motor { winding: WINDING, sensing: Sensing::Magnitude, trip: 1.25 };
    let mut motors = Motors::try_new(&[Some(motor), None], SUPPLY_MAX, &SWITCHING, 1e-3).unwrap();
    let mut rig = Rig::default();
    run(&mut rig, &mut motors, &command([0.5; 2], [0.0; 2]), 400);
    assert!(rig.outputs[0].counts > 0 && rig.outputs[1].counts == 0);
}

#[test]
fn an_invalid_winding_is_refused_by_its_motor() {
    let good = Motor { winding: WINDING, sensing: Sensing::Magnitude, trip: 1.0 };
    let bad = Motor { winding: Winding { resistance: 0.0, ..WINDING }, ..good };
    let (index, error) = Motors::try_new(&[Some(good), Some(bad)], SUPPLY_MAX, &SWITCHING, 1e-3).unwrap_err();
    assert_eq!((index, error.field), (1, CurrentLoopField::Resistance));
}

/// Closed form of the current of a winding under pulses, which is shorted between them.
#[test]
fn the_mean_current_follows_from_a_sample_between_pulses() {
    let winding = Winding { resistance: 10.6, inductance: 0.23e-3, back_emf: 0.5 };
    let switching = Switching { pulses: 2, ..SWITCHING };
    let ripple = f64::from(ripple(&winding, &switching).unwrap());
    let (period, time_constant) = (25e-6, 0.23e-3 / 10.6);
    for duty in [0.01, 0.1, 0.3] {
        let decays = |time: f64| libm::exp(-time / time_constant);
        let (on, off) = (decays(duty * period), decays((1.0 - duty) * period));
        // As fractions of the current that the supply drives through the winding at standstill, so the mean
        // is the duty.
        let peak = (1.0 - on) / (1.0 - on * off);
        let sample = peak * decays(0.5 * (1.0 - duty) * period);
        assert!((ripple * sample / duty - 1.0).abs() < 0.006, "{duty}: {}", ripple * sample / duty);
    }
    let fast = Winding { inductance: 0.1e-3, ..winding };
    let refused = Motors::<1>::try_new(
        &[Some(Motor { winding: fast, sensing: Sensing::Magnitude, trip: 1.0 })],
        SUPPLY_MAX,
        &switching,
        1e-3,
    );
    let (index, refused) = refused.unwrap_err();
    assert_eq!((index, refused.field), (0, CurrentLoopField::Inductance));
    assert!((refused.min - 0.1325e-3).abs() < 1e-7, "{refused}");
}

/// The sign is measured, too, with an offset that the model of the winding does not include.
#[test]
fn a_signed_current_is_taken_as_it_is() {
    let motor = Motor { winding: WINDING, sensing: Sensing::Signed, trip: 1.25 };
    let mut motors = Motors::try_new(&[Some(motor); 2], SUPPLY_MAX, &SWITCHING, 1e-3).unwrap();
    let mut rig = Rig { signed: true, ..Rig::default() };
    for velocity in [0.0, 12.0, -12.0] {
        rig.velocity = [velocity, -velocity].map(f64::from);
        run(&mut rig, &mut motors, &command([0.4, -0.8], [velocity, -velocity]), 400);
        let [first, second] = rig.current;
        assert!((first - 0.4).abs() < 0.01 && (second + 0.8).abs() < 0.01, "{first} {second}");
    }
    assert_eq!(rig.glitches, 0);
    // The trip acts on the magnitude.
    rig.current[1] = -1.3;
    rig.step(&mut motors);
    assert!(!rig.pulses_pass && motors.report(true).has_tripped);
}

#[test]
fn voltages_are_added_up_while_the_motors_are_driven() {
    let (mut rig, mut motors) = (Rig { signed: true, ..Rig::default() }, motors());
    rig.step(&mut motors);
    assert_eq!(motors.totals, Totals { periods: 1, supply: 12_000, ..Totals::new() });
    let command = command([0.5, -0.5], [0.0; 2]);
    run(&mut rig, &mut motors, &command, 400);
    let before = motors.totals;
    run(&mut rig, &mut motors, &command, 200);
    let after = motors.totals;
    assert_eq!((after.periods - before.periods, after.driven - before.driven), (200, 200));
    assert_eq!(after.supply - before.supply, 200 * 12_000);
    // 0.5 A through 3.2 Ω.
    for (index, expected) in [1.6, -1.6].into_iter().enumerate() {
        let mean = f64::from(after.voltages[index] - before.voltages[index]) * 1e-3 / 200.0;
        assert!((mean - expected).abs() < 0.02, "{mean} V");
    }
}
