//! Faults and reactions.

use heapless::Vec;

use super::rig::{COUNTS_PER_RADIAN, Rig, model, refusal};
use crate::control::ServoMode;
use crate::fault::{FaultCause, MAX_FAULTS};
use crate::model::Reaction;
use crate::node::Node;
use crate::node::optional::Optional;
use crate::protocol::{Mode, Refusal, Reply, Request, SensorFlags, SensorFrame};
use crate::task::TaskConfig;

#[test]
fn an_encoder_jump_switches_the_outputs_off() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    rig.sensors.encoders[1] += 10_000;
    let output = rig.tick();
    let fault = *rig.node.faults().faults.last().unwrap();
    assert_eq!(
        (fault.cause, fault.joint, fault.tick),
        (FaultCause::EncoderJump, Some(1), rig.sensors.sequence)
    );
    // 10 000 counts of 65 536 per turn are 0.9587 rad; the limit is twice 8 rad/s · 10 ms and two counts.
    assert!((fault.value - 0.958_738).abs() < 1e-5 && (fault.limit - 0.160_192).abs() < 1e-5, "{fault:?}");
    assert!(!output.enabled && output.torques == [0.0; 3]);
}

/// The servo states that result from such a torque are not finite either, and are reset.
#[test]
fn a_torque_that_is_no_number_switches_the_outputs_off_in_its_tick() {
    let mut rig = Rig::enabled(&model());
    // In motion the servo adapts its friction.
    let mut ticks = 0;
    while rig.node.state.references[1].velocity < 0.06 {
        assert_eq!(rig.goal([0.0, 0.3, 0.0]), Reply::Done);
        rig.tick();
        rig.sensors.encoders[1] += (rig.node.state.references[1].velocity * 0.01 * COUNTS_PER_RADIAN) as i32;
        ticks += 1;
        assert!(ticks < 50 && rig.node.mode() != Mode::Fault, "{:?}", rig.node.faults());
    }
    rig.node.state.targets.joints[1].feedforward = f32::NAN;
    let output = rig.tick();
    assert!(!output.enabled && output.torques == [0.0; 3], "{output:?}");
    let fault = *rig.node.faults().faults.last().unwrap();
    assert_eq!((fault.cause, fault.joint), (FaultCause::NotFinite, Some(1)));
    rig.clear_faults();
    assert_eq!(rig.enable(), Reply::Done);
    for tick in 0..100 {
        let output = rig.tick();
        assert!(output.enabled, "{tick}: {:?}", rig.node.faults());
        assert_eq!(rig.goal([0.0; 3]), Reply::Done);
    }
}

#[test]
fn a_stuck_encoder_switches_the_outputs_off() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    let fault = rig.tick_until_fault([0.0, 0.0, 0.19], 400);
    assert_eq!((fault.cause, fault.joint), (FaultCause::EncoderStuck, Some(2)));
    // Twice the friction of 0.02 N·m and 8 % of 0.6 N·m.
    assert!(fault.value > fault.limit && (fault.limit - 0.088).abs() < 1e-6, "{fault:?}");
    assert!(!rig.tick().enabled);
}

#[test]
fn a_dead_encoder_that_the_robot_does_not_have_is_a_fault() {
    let mut rig = Rig::enabled(&model());
    rig.sensors.flags = SensorFlags(SensorFlags::of_dead_encoder(3));
    assert!(!rig.tick().enabled);
    let fault = *rig.node.faults().faults.last().unwrap();
    assert_eq!((fault.cause, fault.value, fault.limit), (FaultCause::SensorCount, 4.0, 3.0));
}

/// Joints may move while it is unknown which joints the counts belong to.
#[test]
fn nothing_is_homed_by_the_counts_before_a_frame_of_another_robot() {
    let mut rig = Rig::ready(&model());
    let positions = Vec::from_slice(&[0.0; 3]).unwrap();
    let counts = rig.sensors.encoders.clone();
    rig.sensors.encoders.truncate(2);
    rig.tick();
    assert_eq!(refusal(rig.ask(Request::Home { positions })), Refusal::NoSensors);
    rig.sensors.encoders = counts;
    rig.tick();
    assert_eq!(rig.enable(), Reply::Done);
}

/// The board compares encoders with the back-EMF of the motors.
#[test]
fn an_encoder_that_the_board_finds_dead_switches_the_outputs_off_in_its_tick() {
    let mut rig = Rig::enabled(&model());
    rig.sensors.flags = SensorFlags(SensorFlags::of_dead_encoder(1));
    let output = rig.tick();
    let fault = *rig.node.faults().faults.last().unwrap();
    assert_eq!((fault.cause, fault.joint), (FaultCause::EncoderStuck, Some(1)));
    assert!(!output.enabled && output.torques == [0.0; 3], "{output:?}");
    // With the outputs off the board cannot compare.
    rig.sensors.flags = SensorFlags(0);
    rig.clear_faults();
    rig.tick();
    let Refusal::Unsafe(found) = refusal(rig.enable()) else { panic!() };
    assert_eq!((found.cause, found.joint), (fault.cause, fault.joint));
    assert_eq!((found.value, found.limit), (0.0, 0.0), "a drive that is off has no torque");
    rig.sensors.encoders[1] += 3;
    rig.tick();
    assert_eq!(rig.enable(), Reply::Done);
}

/// While the outputs are off, the angle of a joint with a dead encoder is unknown, and so is its gravity
/// torque: an arm would be enabled with the torque of another posture.
#[test]
fn a_joint_whose_encoder_was_found_dead_is_enabled_again_once_it_has_moved() {
    let mut model = model();
    model.joints[2].encoder.relative = true;
    let mut rig = Rig::ready(&model);
    let home = Request::Home { positions: Vec::from_slice(&[0.0; 3]).unwrap() };
    assert_eq!((rig.ask(home.clone()), rig.enable()), (Reply::Done, Reply::Done));
    rig.tick();
    let found = rig.tick_until_fault([0.0, 0.0, 0.19], 400);
    assert_eq!((found.cause, found.joint), (FaultCause::EncoderStuck, Some(2)));
    let refused = |rig: &mut Rig| {
        rig.tick();
        let Refusal::Unsafe(fault) = refusal(rig.enable()) else { panic!() };
        (fault.cause, fault.joint) == (found.cause, found.joint)
    };
    rig.clear_faults();
    // Its motion was not counted.
    assert_eq!(refusal(rig.enable()), Refusal::NotHomed { joint: 2 });
    assert_eq!(rig.ask(home.clone()), Reply::Done);
    assert!(refused(&mut rig));
    // A flickering count, silent sensors and a new zero are no motion.
    let silent = |rig: &mut Rig| {
        rig.sensors.flags = SensorFlags(SensorFlags::SILENT);
        rig.tick();
        rig.sensors.flags = SensorFlags(0);
        rig.tick();
    };
    rig.sensors.encoders[2] += 1;
    assert!(refused(&mut rig));
    silent(&mut rig);
    assert!(refused(&mut rig));
    assert_eq!(rig.ask(home.clone()), Reply::Done);
    assert!(refused(&mut rig));
    // Turned by hand, then homed, with silent sensors in between.
    rig.sensors.encoders[2] += 3;
    rig.tick();
    silent(&mut rig);
    assert_eq!((rig.ask(home), rig.enable()), (Reply::Done, Reply::Done));
    // Or the model is pushed again, if the joint cannot be turned.
    let mut rig = Rig::enabled(&self::model());
    rig.tick();
    rig.tick_until_fault([0.0, 0.0, 0.19], 400);
    rig.clear_faults();
    assert!(refused(&mut rig));
    assert_eq!(rig.push(&self::model()), Reply::Done);
    rig.tick();
    assert_eq!(rig.enable(), Reply::Done);
}

#[test]
fn frame_faults_are_named_with_value_limit_and_tick() {
    type Change = fn(&mut SensorFrame);
    let cases: &[(Change, FaultCause, f32, f32, bool)] = &[
        (|s| s.sequence += 2, FaultCause::LateTick, 3.0, 1.0, true),
        (|s| s.sequence -= 1, FaultCause::LateTick, 0.0, 1.0, true),
        (|s| s.supply = 19_000, FaultCause::SupplyLow, 19.0, 20.0, true),
        (|s| s.supply = 30_000, FaultCause::SupplyHigh, 30.0, 28.0, false),
        (|s| s.flags = SensorFlags(1), FaultCause::EmergencyStop, 1.0, 0.0, false),
        (|s| s.flags = SensorFlags(4), FaultCause::PowerStage, 1.0, 0.0, false),
        // The cause, not the trip that it causes.
        (|s| (s.flags, s.supply) = (SensorFlags(4), 28_001), FaultCause::SupplyHigh, 28.001, 28.0, false),
        (|s| s.currents[0] = 2000, FaultCause::OverCurrent, 2.0, 1.875, false),
        (|s| s.encoders.truncate(2), FaultCause::SensorCount, 2.0, 3.0, false),
        (|s| *s = SensorFrame::silent(s.sequence), FaultCause::SensorsSilent, 1.0, 0.0, false),
    ];
    for &(change, cause, value, limit, still_enabled) in cases {
        let mut rig = Rig::enabled(&model());
        rig.tick();
        change(&mut rig.sensors);
        let output = rig.tick();
        let fault = *rig.node.faults().faults.last().unwrap_or_else(|| panic!("{cause:?}"));
        assert_eq!((fault.cause, fault.value, fault.limit), (cause, value, limit));
        assert_eq!((fault.tick, output.enabled), (rig.sensors.sequence, still_enabled), "{cause:?}");
        if !still_enabled {
            assert!(output.torques.iter().all(|&torque| torque == 0.0));
        }
    }
}

/// The faults of a robot whose second joint moves at 9 rad/s, 8 rad/s permitted, with this supply from
/// tick `low` on [mV].
fn faults_of_a_push(low: u32, supply: u16) -> (u32, Vec<FaultCause, MAX_FAULTS>, Reaction) {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    for tick in 0..8 {
        rig.sensors.encoders[1] += libm::roundf(0.09 * COUNTS_PER_RADIAN) as i32;
        if tick >= low {
            rig.sensors.supply = supply;
        }
        rig.tick();
        if rig.node.mode() == Mode::Fault {
            rig.tick();
            let causes = rig.node.faults().faults.iter().map(|fault| fault.cause).collect();
            return (tick, causes, rig.node.state.reaction);
        }
    }
    panic!("no fault");
}

#[test]
fn a_low_supply_does_not_hide_a_joint_that_is_too_fast() {
    let (tick, causes, reaction) = faults_of_a_push(100, 0);
    assert_eq!((causes.as_slice(), reaction), ([FaultCause::VelocityLimit].as_slice(), Reaction::Hold));
    let both = faults_of_a_push(tick, 19_000);
    assert_eq!((both.0, both.1.as_slice(), both.2), (tick, causes.as_slice(), Reaction::Hold));
}

#[test]
fn a_node_whose_sensors_are_silent_cannot_be_enabled_and_reads_them_anew_when_they_are_back() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    let read = rig.sensors.clone();
    rig.sensors = SensorFrame::silent(rig.sensors.sequence);
    for _ in 0..3 {
        assert!(!rig.tick().enabled);
    }
    let log = rig.node.faults().clone();
    assert_eq!(log.faults.iter().filter(|fault| fault.cause == FaultCause::SensorsSilent).count(), 1);
    assert_eq!(rig.ask(Request::ReadFaults), Reply::Faults(log.clone()));
    assert_eq!(rig.ask(Request::ClearFaults { total: log.total }), Reply::Done);
    rig.tick();
    assert_eq!(refusal(rig.enable()), Refusal::NoSensors);
    // The joint was turned by hand in the meantime; that is no jump of its encoder.
    rig.sensors = SensorFrame { sequence: rig.sensors.sequence, ..read };
    rig.sensors.encoders[0] += libm::roundf(0.5 * COUNTS_PER_RADIAN) as i32;
    rig.tick();
    // It may still move as fast as it did on average.
    let Refusal::Unsafe(moving) = refusal(rig.enable()) else { panic!() };
    assert_eq!((moving.cause, moving.joint), (FaultCause::VelocityLimit, Some(0)));
    (0..10).for_each(|_| _ = rig.tick());
    assert_eq!(rig.enable(), Reply::Done);
    assert!(rig.tick().enabled);
    assert_eq!(rig.node.faults().total, log.total);
}

/// Five periods between two reads, at most 16 rad/s in each. Beyond that a relative encoder has lost its
/// zero.
#[test]
fn a_leap_while_sensors_are_silent_is_an_encoder_error() {
    let mut model = model();
    model.joints[1].encoder.relative = true;
    let home = Request::Home { positions: Vec::from_slice(&[0.0; 3]).unwrap() };
    for (moved, leaps) in [(0.7, false), (0.9, true)] {
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(home.clone()), Reply::Done);
        for flags in [SensorFlags::SILENT; 4].into_iter().chain([0]) {
            rig.sensors.flags = SensorFlags(flags);
            if flags == 0 {
                rig.sensors.encoders[1] += libm::roundf(moved * COUNTS_PER_RADIAN) as i32;
            }
            rig.tick();
        }
        let Optional::Some(alarm) = rig.node.state.alarm else {
            assert!(!leaps);
            (0..10).for_each(|_| _ = rig.tick());
            assert_eq!(rig.enable(), Reply::Done, "{moved} rad");
            continue;
        };
        assert_eq!((alarm.cause, alarm.joint, leaps), (FaultCause::EncoderJump, Some(1), true), "{alarm:?}");
        (0..20).for_each(|_| _ = rig.tick());
        assert_eq!(refusal(rig.enable()), Refusal::NotHomed { joint: 1 });
    }
}

/// 3 rad/s, of which 1.6 rad/s are permitted: across a new model with the same encoder, and a silent tick.
#[test]
fn a_joint_that_moves_is_not_enabled_by_its_first_reading() {
    let mut model = model();
    model.joints[1].encoder.relative = true;
    for silent in [false, true] {
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(Request::Home { positions: Vec::from_slice(&[0.0; 3]).unwrap() }), Reply::Done);
        let step = libm::roundf(0.03 * COUNTS_PER_RADIAN) as i32;
        for _ in 0..20 {
            rig.sensors.encoders[1] += step;
            rig.tick();
        }
        if silent {
            let silence = SensorFrame::silent(rig.sensors.sequence);
            let read = core::mem::replace(&mut rig.sensors, silence);
            rig.tick();
            rig.sensors = SensorFrame { sequence: rig.sensors.sequence, ..read };
            rig.sensors.encoders[1] += step;
        } else {
            assert_eq!(rig.push(&model), Reply::Done);
        }
        rig.sensors.encoders[1] += step;
        rig.tick();
        let Refusal::Unsafe(moving) = refusal(rig.enable()) else { panic!("{silent}") };
        assert_eq!((moving.cause, moving.joint), (FaultCause::VelocityLimit, Some(1)), "{silent}");
        assert!((moving.value - 3.0).abs() < 0.1, "{silent}: {} rad/s", moving.value);
        (0..20).for_each(|_| _ = rig.tick());
        assert_eq!(rig.enable(), Reply::Done, "{silent}");
    }
}

/// No time has passed in which it could have moved.
#[test]
fn a_frame_that_comes_twice_around_a_silent_one_leaves_numbers() {
    let mut rig = Rig::ready(&model());
    rig.tick();
    let last = rig.sensors.sequence;
    let read = core::mem::replace(&mut rig.sensors, SensorFrame::silent(last));
    rig.tick();
    rig.sensors = SensorFrame { sequence: last - 1, ..read };
    rig.tick();
    let velocities = rig.node.state.measured.velocities;
    assert!(velocities.iter().all(|velocity| velocity.is_finite()), "{velocities:?}");
    (0..20).for_each(|_| _ = rig.tick());
    assert_eq!(rig.enable(), Reply::Done);
}

/// The velocity cannot be computed from the new angle.
#[test]
fn a_joint_that_moves_is_not_enabled_by_a_new_zero() {
    let mut model = model();
    model.joints[1].encoder.relative = true;
    let mut rig = Rig::ready(&model);
    for _ in 0..20 {
        rig.sensors.encoders[1] += libm::roundf(0.03 * COUNTS_PER_RADIAN) as i32;
        rig.tick();
    }
    assert_eq!(rig.ask(Request::Home { positions: Vec::from_slice(&[0.0; 3]).unwrap() }), Reply::Done);
    let Refusal::Unsafe(fault) = refusal(rig.enable()) else { panic!() };
    assert_eq!((fault.cause, fault.joint), (FaultCause::VelocityLimit, Some(1)));
}

#[test]
fn a_command_timeout_ends_in_the_configured_reaction() {
    for reaction in [Reaction::Off, Reaction::Damp, Reaction::Hold] {
        let mut model = model();
        model.safety.reaction = reaction;
        let mut rig = Rig::enabled(&model);
        rig.goal([0.0, 0.05, 0.0]);
        // Timeout 100 ms: the node is enabled in tick 10 and not in tick 11.
        for _ in 0..10 {
            assert!(rig.tick().enabled);
            assert!(matches!(rig.node.mode(), Mode::Enabled(_)));
        }
        let output = rig.tick();
        let fault = *rig.node.faults().faults.last().unwrap();
        assert_eq!(fault.cause, FaultCause::CommandTimeout);
        assert!((fault.value - 0.11).abs() < 1e-6 && fault.limit == 0.1);
        assert_eq!(output.enabled, reaction != Reaction::Off);
        if reaction == Reaction::Hold {
            // The reference comes to rest short of the goal.
            for _ in 0..100 {
                rig.tick();
            }
            let telemetry = rig.node.telemetry();
            assert!(
                telemetry.joints[1].reference > 0.0 && telemetry.joints[1].reference < 0.03,
                "{telemetry:?}"
            );
        }
    }
}

#[test]
fn a_fault_remains_until_it_was_read_and_cleared() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    rig.ask(Request::Stop);
    assert_eq!(rig.node.mode(), Mode::Fault);
    assert_eq!(refusal(rig.enable()), Refusal::WrongMode(Mode::Fault));
    for total in [0, 1] {
        let clear = Request::ClearFaults { total };
        assert_eq!(refusal(rig.ask(clear)), Refusal::FaultsUnread { total: 1 }, "not read yet");
    }
    let Reply::Faults(log) = rig.ask(Request::ReadFaults) else { panic!() };
    assert_eq!(log.faults[0].cause, FaultCause::Stop);
    assert_eq!(rig.ask(Request::ClearFaults { total: log.total }), Reply::Done);
    assert_eq!(rig.node.mode(), Mode::Disabled);
    // After a reset the board restores the log.
    let mut restarted = Node::new();
    restarted.restore_faults(log.clone(), 0);
    assert_eq!(restarted.faults(), &log);
}

/// A client that has read the first fault does not know of a later stop.
#[test]
fn a_stop_after_another_fault_is_read_of_before_the_robot_is_enabled() {
    let mut rig = Rig::enabled(&model());
    while rig.node.mode() != Mode::Fault {
        rig.tick();
    }
    let Reply::Faults(log) = rig.ask(Request::ReadFaults) else { panic!() };
    assert_eq!((log.total, log.faults[0].cause), (1, FaultCause::CommandTimeout));
    assert_eq!(rig.send(99, 1, Request::Stop), Reply::Done);
    assert_eq!(rig.send(99, 2, Request::Stop), Reply::Done, "nobody has read of the first one");
    assert_eq!(refusal(rig.ask(Request::ClearFaults { total: 1 })), Refusal::FaultsUnread { total: 2 });
    assert!(rig.tick().enabled, "it is still held");
    let Reply::Faults(log) = rig.ask(Request::ReadFaults) else { panic!() };
    assert_eq!(log.faults[1].cause, FaultCause::Stop);
    assert_eq!(rig.send(99, 3, Request::Stop), Reply::Done);
    assert_eq!(refusal(rig.ask(Request::ClearFaults { total: 2 })), Refusal::FaultsUnread { total: 3 });
    rig.clear_faults();
    assert_eq!(rig.enable(), Reply::Done);
}

#[test]
fn stops_that_are_read_of_one_by_one_leave_the_cause_in_the_log() {
    let mut rig = Rig::enabled(&model());
    while rig.node.mode() != Mode::Fault {
        rig.tick();
    }
    for sequence in 1..=2 * MAX_FAULTS as u16 {
        assert!(matches!(rig.ask(Request::ReadFaults), Reply::Faults(_)));
        assert_eq!(rig.send(99, sequence, Request::Stop), Reply::Done);
    }
    let log = rig.node.faults();
    let causes = log.faults.iter().map(|fault| fault.cause);
    assert!(causes.eq([FaultCause::CommandTimeout, FaultCause::Stop]), "{log:?}");
    assert_eq!(log.total, 1 + 2 * MAX_FAULTS as u32, "each has to be read of");
}

#[test]
fn disable_switches_the_outputs_off_but_keeps_the_fault() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    rig.ask(Request::Stop);
    assert!(rig.tick().enabled, "reaction: hold");
    rig.ask(Request::Disable);
    assert!(!rig.tick().enabled);
    assert_eq!(rig.node.mode(), Mode::Fault);
}

#[test]
fn an_error_of_the_model_that_holds_a_joint_where_it_stands_is_no_dead_encoder() {
    let mut rig = Rig::enabled(&model());
    let breakaway = rig.node.robot().unwrap().joints()[2].thresholds.breakaway;
    // The servo adapts to a torque beyond the model while the angle changes slowly.
    let mut ticks = 0;
    while rig.node.telemetry().joints[2].torque < 2.5 * breakaway {
        rig.goal([0.0, 0.0, 0.15]);
        rig.tick();
        rig.sensors.encoders[2] += 1;
        ticks += 1;
        assert!(ticks < 400 && rig.node.mode() != Mode::Fault, "{:?}", rig.node.faults());
    }
    // The reference reaches the joint, which then stands still under the adapted torque.
    for tick in 0..130 {
        rig.goal([0.0; 3]);
        rig.tick();
        assert_ne!(rig.node.mode(), Mode::Fault, "{tick}: {:?}", rig.node.faults());
        if tick < 100 {
            rig.sensors.encoders[2] -= 1;
        }
    }
    assert!(rig.node.telemetry().joints[2].torque > breakaway);
}

/// A joint of 0.02 kg·m² with Coulomb friction, without weight.
struct Rubbing {
    friction: f32,
    position: f32,
    velocity: f32,
}

impl Rubbing {
    /// Moves for a period under the torque of the last tick.
    fn step(&mut self, rig: &mut Rig) {
        self.step_of(rig, 0.02);
    }

    /// As [`step`](Self::step), with another inertia [kg·m²].
    fn step_of(&mut self, rig: &mut Rig, inertia: f32) {
        let torque = rig.node.telemetry().joints[2].torque;
        for _ in 0..20 {
            let free = self.velocity + torque / inertia * 5e-4;
            let lost = self.friction / inertia * 5e-4;
            self.velocity = free - free.clamp(-lost, lost);
            self.position += self.velocity * 5e-4;
        }
        rig.sensors.encoders[2] = libm::roundf(self.position * COUNTS_PER_RADIAN) as i32;
    }
}

#[test]
fn a_dead_encoder_that_flickers_by_a_count_is_found() {
    for every in [1, 3] {
        let mut rig = Rig::enabled(&model());
        rig.tick();
        for tick in 0..400 {
            rig.goal([0.0, 0.0, 0.19]);
            rig.tick();
            // The encoder dies after some counts.
            if tick < 4 {
                rig.sensors.encoders[2] += 1;
            } else if tick % every == 0 {
                rig.sensors.encoders[2] ^= 1;
            }
            if rig.node.mode() == Mode::Fault {
                break;
            }
        }
        let fault = rig.node.faults().faults.last().expect("a fault");
        assert_eq!((fault.cause, fault.joint), (FaultCause::EncoderStuck, Some(2)), "{every}");
        assert!(fault.value.abs() < 1.2 * fault.limit, "{every}: {fault:?}");
    }
}

#[test]
fn moving_means_the_same_speed_for_a_fine_and_a_coarse_encoder() {
    let moving = |counts_per_turn: f32| {
        let mut model = model();
        model.joints[2].encoder.counts_per_turn = counts_per_turn;
        Rig::ready(&model).node.robot().unwrap().joints()[2].thresholds.moving
    };
    assert_eq!((moving(65_536.0), moving(262_144.0)), (7.67e-4, 7.67e-4));
    // 2 of 4096 counts.
    assert!((moving(4096.0) - 3.067_96e-3).abs() < 1e-7);
}

/// With a reversed encoder the servo drives the joint away from the reference.
#[test]
fn a_reversed_encoder_is_named_before_anything_holds_by_it() {
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        let mut model = model();
        model.joints[2].servo.observer.inertia = 0.02;
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        let mut joint = Rubbing { friction: 0.02, position: 0.0, velocity: 0.0 };
        let mut ticks = 0;
        while rig.node.mode() != Mode::Fault {
            rig.goal([0.0, 0.0, 0.5]);
            rig.tick();
            joint.step(&mut rig);
            rig.sensors.encoders[2] = -rig.sensors.encoders[2];
            ticks += 1;
            assert!(ticks < 40, "{mode:?}");
        }
        let faults = rig.node.faults();
        assert_eq!((faults.total, faults.faults[0].cause), (1, FaultCause::Runaway), "{mode:?}: {faults:?}");
        assert!(!rig.tick().enabled && joint.position < 0.15, "{mode:?}: {} rad", joint.position);
    }
}

/// Friction beyond the model that a motion has needed also holds the joint against the opposite torque, even
/// if its count has gone back by one since.
#[test]
fn a_count_that_goes_back_hides_no_friction() {
    // The model has 0.02 N·m.
    for friction in [0.088, 0.096] {
        let mut model = model();
        model.joints[2].servo.observer.inertia = 0.02;
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(ServoMode::Observer))), Reply::Done);
        let mut joint = Rubbing { friction, position: 0.0, velocity: 0.0 };
        for tick in 0..400 {
            rig.goal([0.0, 0.0, if tick < 200 { 0.1 } else { 0.0 }]);
            rig.tick();
            joint.step(&mut rig);
            if tick >= 198 && joint.velocity == 0.0 {
                rig.sensors.encoders[2] -= 1;
            }
            assert_ne!(rig.node.mode(), Mode::Fault, "{friction} N·m, tick {tick}: {:?}", rig.node.faults());
        }
        assert!(joint.position < 0.05, "it went back: {} rad", joint.position);
    }
}

#[test]
fn a_reversed_encoder_is_named_also_where_the_reference_rests() {
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        let mut model = model();
        model.joints[2].servo.observer.inertia = 0.02;
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        // The joint is in contact.
        let mut joint = Rubbing { friction: 0.02, position: 0.0, velocity: 0.5 };
        let mut ticks = 0;
        while rig.node.mode() != Mode::Fault {
            rig.goal([0.0; 3]);
            rig.tick();
            joint.step(&mut rig);
            rig.sensors.encoders[2] = -rig.sensors.encoders[2];
            ticks += 1;
            assert!(ticks < 40, "{mode:?}");
        }
        let faults = rig.node.faults();
        assert_eq!((faults.total, faults.faults[0].cause), (1, FaultCause::Runaway), "{mode:?}: {faults:?}");
        assert!(!rig.tick().enabled && joint.position < 0.3, "{mode:?}: {} rad", joint.position);
    }
}

/// The effort of a joint that coasts to rest is smaller than its friction.
#[test]
fn friction_that_stops_a_coasting_joint_is_no_dead_encoder() {
    // Friction [N·m], 4.25 to 5 times the model's; inertia [kg·m²]; ticks between the goals; goal beside 0
    // [rad].
    for (mode, friction, inertia, wait, goal) in [
        (ServoMode::Pid, 0.085, 0.02, 200, 0.1),
        (ServoMode::Pid, 0.09, 0.005, 60, 0.3),
        (ServoMode::Pid, 0.095, 0.005, 100, 0.3),
        (ServoMode::Pid, 0.1, 0.005, 60, 0.3),
        (ServoMode::Observer, 0.1, 0.02, 35, 0.1),
    ] {
        let mut model = model();
        model.joints[2].servo.observer.inertia = inertia;
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        let mut joint = Rubbing { friction, position: 0.0, velocity: 0.0 };
        for tick in 0..500 {
            rig.goal([0.0, 0.0, if tick / wait % 2 == 0 { goal } else { 0.0 }]);
            rig.tick();
            joint.step_of(&mut rig, inertia);
            // A following error is permitted.
            let faults = &rig.node.faults().faults;
            let dead = faults.iter().any(|fault| fault.cause == FaultCause::EncoderStuck);
            assert!(!dead, "{mode:?}, {friction} N·m, {inertia} kg·m², tick {tick}: {faults:?}");
        }
    }
}
