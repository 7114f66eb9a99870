use core::f64::consts::TAU;
use std::path::Path;

use tesaki_description::robot::RobotFolder;

use crate::hand::{Hand, JOINTS, frame, largest};

const COUNT: f64 = TAU / 65536.0;
const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3");

#[test]
fn the_same_seed_gives_the_same_bits_and_another_does_not() {
    let run = |seed| {
        let mut plant = Hand::mismatched(seed).build();
        let mut read = Vec::new();
        for tick in 0..50 {
            read.push(plant.sensors(tick));
            let torque = if tick % 7 < 4 { 0.08 } else { -0.08 };
            plant.apply(&frame([torque; JOINTS])).unwrap();
        }
        let truth = plant.truth();
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        (read, bits(&truth.positions), bits(&truth.velocities))
    };
    let (one, two, other) = (run(7), run(7), run(8));
    assert_eq!(one, two);
    assert!(one.0 != other.0 && one.1 != other.1);
}

#[test]
fn factors_fill_their_range_and_nothing_differs_in_a_true_model() {
    let mut all = Vec::new();
    for seed in 0..100 {
        for f in Hand::mismatched(seed).build().factors() {
            all.extend([f.mass, f.inertia, f.rotor_inertia, f.coulomb, f.viscous, f.torque_constant]);
        }
    }
    let (low, high) = (all.iter().copied().fold(1.0, f64::min), all.iter().copied().fold(1.0, f64::max));
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    assert!(0.8 <= low && low < 0.801 && 1.199 < high && high <= 1.2, "{low} {high}");
    assert!((mean - 1.0).abs() < 0.005, "{mean}");
    let plant = Hand::exact().build();
    assert!(plant.factors().iter().all(|factors| *factors == tesaki_sim::plant::JointFactors::NONE));
}

#[test]
fn encoders_read_whole_counts_from_where_homing_believes_zero_to_be() {
    let mut hand = Hand::mismatched(3);
    hand.drives[1].encoder.reversed = true;
    hand.drives[2].encoder.zero = 12_345;
    let mut plant = hand.build();
    let counts = plant.sensors(0).encoders;
    let truth = plant.truth();
    assert!(largest(truth.homing_errors.clone()) <= 0.002 && largest(truth.homing_errors.clone()) > 0.0005);
    for (joint, (&count, believed)) in counts.iter().zip(plant.homed_positions()).enumerate() {
        let (sign, zero) = [(1.0, 0), (-1.0, 0), (1.0, 12_345)].get(joint).copied().unwrap_or((1.0, 0));
        let angle = sign * f64::from(count - zero) * COUNT;
        assert!((angle - believed).abs() <= 0.5 * COUNT + 1e-9, "joint {joint}: {angle} {believed}");
        assert!((believed - truth.positions[joint] - truth.homing_errors[joint]).abs() < 1e-12);
    }
}

#[test]
fn a_relative_encoder_starts_anywhere_and_counts_from_there() {
    let mut hand = Hand::mismatched(5).weightless();
    for drive in &mut hand.drives {
        drive.encoder.relative = true;
    }
    let mut plant = hand.build();
    let (before, start) = (plant.sensors(0).encoders, plant.truth().positions);
    assert!(before.iter().any(|count| count.abs() > 100_000), "{before:?}");
    for _ in 0..20 {
        plant.apply(&frame([0.05; JOINTS])).unwrap();
    }
    let (after, end) = (plant.sensors(20).encoders, plant.truth().positions);
    for joint in 0..JOINTS {
        let counted = f64::from(after[joint] - before[joint]) * COUNT;
        assert!((counted - (end[joint] - start[joint])).abs() <= COUNT, "joint {joint}");
        assert!(counted > 0.01);
    }
}

#[test]
fn current_is_the_nominal_torque_and_supply_reads_24_volts() {
    let mut plant = Hand::exact().build();
    plant.apply(&frame([0.1, -0.1, 0.0, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap();
    let frame = plant.sensors(1);
    assert_eq!(frame.supply, 24_000);
    // 0.5 N·m/A, 1 mA per count; an amplifier makes at most 0.6 N·m.
    assert_eq!(frame.currents[..4], [200, -200, 0, 1200]);
    plant.press_emergency_stop(true);
    assert!(plant.sensors(2).flags.emergency_stop());
}

#[test]
fn noise_has_its_size() {
    let mut plant = Hand::mismatched(1).build();
    let (mut currents, mut supplies) = (Vec::new(), Vec::new());
    for tick in 0..2000 {
        let frame = plant.sensors(tick);
        currents.push(f64::from(frame.currents[0]));
        supplies.push(f64::from(frame.supply) - 24_000.0);
    }
    let deviation = |values: &[f64]| (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt();
    assert!((deviation(&currents) - 5.0).abs() < 0.3, "{}", deviation(&currents));
    assert!((deviation(&supplies) - 50.0).abs() < 3.0, "{}", deviation(&supplies));
}

#[test]
fn torque_is_that_of_the_plants_own_motor() {
    let mut plant = Hand::mismatched(2).build();
    plant.apply(&frame([0.1; JOINTS])).unwrap();
    let truth = plant.truth();
    for (torque, factors) in truth.torques.iter().zip(plant.factors()) {
        assert!((torque / 0.1 - factors.torque_constant).abs() < 1e-6);
    }
}

/// Amplifiers with the true torque constants make the commanded torques of the same machine.
#[test]
fn amplifiers_make_a_current_by_the_models_torque_constants() {
    let mut model = RobotFolder::load(Path::new(ROBOT)).unwrap().model;
    let mut plant = Hand::mismatched(2).build();
    for (joint, factors) in model.joints.iter_mut().zip(plant.factors()) {
        joint.motor.torque_constant *= factors.torque_constant as f32;
    }
    plant.configure_amplifiers(&model);
    plant.apply(&frame([0.1; JOINTS])).unwrap();
    assert!(
        plant.truth().torques.iter().all(|torque| (torque / 0.1 - 1.0).abs() < 1e-6),
        "{:?}",
        plant.truth()
    );
}

#[test]
fn a_period_loses_delay_and_lag() {
    // A free joint reaches the speed of torque · (period − delay − time constant) / inertia, half a sub-step
    // before the end.
    let mut plant = Hand::exact().weightless().viscous(0.0).coulomb(0.0).build();
    let mut torques = [0.0; JOINTS];
    torques[0] = 0.01;
    plant.apply(&frame(torques)).unwrap();
    let speed = plant.truth().velocities[0];
    let lost = 0.0003 + 1.0 / (TAU * 300.0) + 0.0005;
    let expected = 0.01 * (0.01 - lost) / 2.3756e-4;
    assert!((speed / expected - 1.0).abs() < 0.003, "{speed} {expected}");
}

#[test]
fn a_held_hand_waits_for_its_drives() {
    let mut hand = Hand::exact().coulomb(0.0);
    hand.options.held_at_start = true;
    let mut plant = hand.build();
    let start = plant.truth().positions;
    let mut off = frame([0.0; JOINTS]);
    off.enabled = false;
    for _ in 0..10 {
        plant.apply(&off).unwrap();
    }
    assert_eq!(plant.truth().positions, start);
    plant.apply(&frame([0.0; JOINTS])).unwrap();
    plant.apply(&off).unwrap();
    assert!(largest(plant.truth().positions.iter().zip(&start).map(|(end, start)| end - start)) > 1e-4);
}
