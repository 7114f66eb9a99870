//! Current steps of three real motors, through the registers.

use tesaki::control::JointPoint;
use tesaki::model::{RobotModel, Safety};
use tesaki::protocol::{Request, Stream};
use tesaki::task::TaskCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki_chip::SECOND;
use tesaki_chip::bench::{Bench, Motor};

use crate::rig::{MOTOR, Rig, model};

/// A motor according to its data sheet: name, resistance [Ω], inductance [H], torque constant [N·m/A] at the
/// joint.
///
/// FAULHABER 1524 T 009 SR, coreless, behind 58.5:1: data sheet of the series 1524 … SR. Pololu micro metal
/// gearmotor HP 6 V 30:1 (N20, iron core): 1.5 A when stalled, 1000 min⁻¹ without load; no inductance is
/// published, 1 mH is assumed. Quanser SRV02 with its gear of 70: FAULHABER 2338 S 006, table 3.1 of the
/// SRV02 manual.
const MOTORS: [(&str, f64, f64, f64); 3] = [
    ("FAULHABER 1524 T 009 SR", 10.6, 0.23e-3, 0.5),
    ("Pololu N20 HP", 4.0, 1e-3, 0.0573),
    ("Quanser SRV02", 2.6, 0.18e-3, 0.5376),
];
/// The step [A], and the supply [V] with its resistance [Ω].
const STEP: f64 = 0.4;
const SUPPLY: (f64, f64) = (12.0, 0.3);
/// Time over which the current is averaged: a period of the loop [ps]. `PARTS` means are taken per window,
/// since it begins anywhere in a period.
const WINDOW: u64 = SECOND / 20_000;
const PARTS: usize = 10;

fn real_motors() -> RobotModel {
    let mut model = model();
    model.safety = Safety { supply_min: 8.0, supply_max: 16.0, ..model.safety };
    for (joint, (_, resistance, inductance, constant)) in model.joints.iter_mut().zip(MOTORS) {
        joint.motor.resistance = Some(resistance as f32);
        joint.motor.inductance = Some(inductance as f32);
        joint.motor.torque_constant = constant as f32;
    }
    model
}

/// Returns the currents around a step of the torques: means over a period of the loop, [`PARTS`] per period,
/// from the last one before the step [A].
fn step(resistance: f64, inductance: f64) -> Vec<[f64; 3]> {
    let motors = MOTORS.map(|(_, r, l, constant)| Motor {
        resistance: r * resistance,
        inductance: l * inductance,
        constant,
        blocked: true,
        ..MOTOR
    });
    let mut bench = Bench::new(motors, 1);
    (bench.supply, bench.supply_resistance) = SUPPLY;
    let mut rig = Rig::boot_on(bench, &[]);
    rig.enable_with(&real_motors()).unwrap();
    let point = JointPoint { position: 0.0, velocity: 0.0, acceleration: 0.0 };
    let command = JointCommand::StreamTorques {
        points: [point; 3].into_iter().collect(),
        torques: MOTORS.map(|(.., constant)| (STEP * constant) as f32).into_iter().collect(),
    };
    rig.client.send(&mut rig.machine, Request::Task(TaskCommand::JointServo(command)));
    let mut impulses = vec![rig.machine.chip.bench.states.map(|state| state.impulse)];
    let mut currents: Vec<[f64; 3]> = Vec::new();
    while currents.len() < 150 * PARTS {
        let until = rig.machine.now() + WINDOW / PARTS as u64;
        rig.machine.run(until).unwrap();
        rig.machine.pass(0);
        impulses.push(rig.machine.chip.bench.states.map(|state| state.impulse));
        let Some([before, .., now]) = impulses.rchunks(PARTS + 1).next() else { continue };
        let mean =
            |motor: usize| (now[motor] - before[motor]) / MOTORS[motor].3 / (WINDOW as f64 / SECOND as f64);
        let mean: [f64; 3] = std::array::from_fn(mean);
        if mean.iter().all(|current| *current < 0.02 * STEP) {
            currents.clear();
        }
        currents.push(mean);
    }
    currents
}

/// Windings as given and differing by a fifth, with noise of the converters and a supply that sags. A
/// bandwidth of 1 kHz means a rise to 63 % in 0.16 ms, after the period in which the command comes.
#[test]
fn currents_rise_as_with_a_kilohertz_and_overshoot_by_a_tenth_at_most() {
    for (resistance, inductance) in [(1.0, 1.0), (0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2)] {
        let currents = step(resistance, inductance);
        for (motor, (name, ..)) in MOTORS.into_iter().enumerate() {
            let course: Vec<f64> = currents.iter().map(|all| all[motor]).collect();
            let last = course[100 * PARTS..].iter().sum::<f64>() / (50 * PARTS) as f64;
            let overshoot = course.iter().fold(f64::MIN, |a, b| a.max(*b)) / last - 1.0;
            let first = |level: f64| course.iter().position(|current| *current > level * last).unwrap();
            let rise = (first(0.63) - first(0.02)) as f64 / PARTS as f64;
            println!(
                "{name}, R x {resistance}, L x {inductance}: {last:.3} A, overshoot {:.1} %, 63 % after {rise:.1} \
                 periods",
                100.0 * overshoot
            );
            assert!((last - STEP).abs() < 0.06 * STEP, "{name}: {last} A");
            // 0.16 ms and one part.
            assert!(rise < 3.35, "{name}: {rise:.1} periods of 50 µs");
            assert!(overshoot < 0.1, "{name}: {overshoot}");
        }
    }
}

/// Compares the mean torques of a coreless motor at each joint with those that the core has computed, while
/// the joints move and rest.
#[test]
fn torques_are_those_that_the_core_computes() {
    let (_, resistance, inductance, constant) = MOTORS[0];
    let motor = Motor { resistance, inductance, constant, ..MOTOR };
    let mut robot = model();
    for joint in &mut robot.joints {
        joint.motor.resistance = Some(resistance as f32);
        joint.motor.inductance = Some(inductance as f32);
    }
    let mut rig = Rig::boot_on(Bench::new([motor; 3], 1), &[]);
    rig.enable_with(&robot).unwrap();
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Log, every: 1 }).unwrap();
    rig.goal([0.3, -0.2, 0.1]);
    // Run until a millisecond after the instant of a period: the core has computed, and the loop has
    // followed.
    let next = rig.machine.entered[16 + 28] + 11 * SECOND / 1000;
    rig.machine.run(next).unwrap();
    let mut worst = 0.0_f64;
    for period in 0..150 {
        rig.client.receive(&mut rig.machine);
        let before = rig.machine.chip.bench.states.map(|state| state.impulse);
        rig.keep();
        let until = next + period * SECOND / 100 + SECOND / 125;
        rig.machine.run(until).unwrap();
        rig.machine.pass(0);
        let seconds = 8e-3;
        let made: [f64; 3] =
            std::array::from_fn(|m| (rig.machine.chip.bench.states[m].impulse - before[m]) / seconds);
        rig.client.receive(&mut rig.machine);
        let told = rig.client.actuators.clone().unwrap().torques;
        for (told, made) in told.iter().zip(made) {
            worst = worst.max((f64::from(*told) - made).abs());
        }
        rig.machine.run(next + (period + 1) * SECOND / 100).unwrap();
    }
    println!("torques are up to {:.2} mN·m beside those that the core computes", 1e3 * worst);
    assert!(worst < 1.5e-3, "{worst}");
}
