//! What faults, and what the outputs do then.

use super::bench::{Bench, model, refusal};
use crate::fault::FaultCause;
use crate::model::Reaction;
use crate::node::Node;
use crate::protocol::{Mode, Refusal, Reply, Request, SensorFlags, SensorFrame};

#[test]
fn a_jumping_encoder_switches_off() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    bench.sensors.encoders[1] += 10_000;
    let output = bench.tick();
    let fault = *bench.node.faults().faults.last().unwrap();
    assert_eq!(
        (fault.cause, fault.joint, fault.tick),
        (FaultCause::EncoderJump, Some(1), bench.sensors.sequence)
    );
    // 10 000 counts of 65 536 a turn are 0.9587 rad; the limit is twice 8 rad/s · 10 ms and two counts.
    assert!((fault.value - 0.958_738).abs() < 1e-5 && (fault.limit - 0.160_192).abs() < 1e-5, "{fault:?}");
    assert!(!output.enabled && output.torques == [0.0; 3]);
}

#[test]
fn a_stuck_encoder_switches_off() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    let fault = bench.tick_until_fault([0.0, 0.0, 0.19], 400);
    assert_eq!((fault.cause, fault.joint), (FaultCause::EncoderStuck, Some(2)));
    assert!(fault.value > fault.limit && (fault.limit - 0.1).abs() < 1e-6, "{fault:?}");
    assert!(!bench.tick().enabled);
}

#[test]
fn frame_faults_are_named_with_value_limit_and_tick() {
    type Spoil = fn(&mut SensorFrame);
    let cases: &[(Spoil, FaultCause, f32, f32, bool)] = &[
        (|s| s.sequence += 2, FaultCause::LateTick, 3.0, 1.0, true),
        (|s| s.sequence -= 1, FaultCause::LateTick, 0.0, 1.0, true),
        (|s| s.supply = 19_000, FaultCause::SupplyLow, 19.0, 20.0, true),
        (|s| s.supply = 30_000, FaultCause::SupplyHigh, 30.0, 28.0, false),
        (|s| s.flags = SensorFlags(1), FaultCause::EmergencyStop, 1.0, 0.0, false),
        (|s| s.currents[0] = 2000, FaultCause::OverCurrent, 2.0, 1.875, false),
        (|s| s.encoders.truncate(2), FaultCause::SensorCount, 2.0, 3.0, false),
    ];
    for &(spoil, cause, value, limit, still_enabled) in cases {
        let mut bench = Bench::armed(&model());
        bench.tick();
        spoil(&mut bench.sensors);
        let output = bench.tick();
        let fault = *bench.node.faults().faults.last().unwrap_or_else(|| panic!("{cause:?}"));
        assert_eq!((fault.cause, fault.value, fault.limit), (cause, value, limit));
        assert_eq!((fault.tick, output.enabled), (bench.sensors.sequence, still_enabled), "{cause:?}");
        if !still_enabled {
            assert!(output.torques.iter().all(|&torque| torque == 0.0));
        }
    }
}

#[test]
fn silence_of_the_supervisor_ends_in_the_configured_reaction() {
    for reaction in [Reaction::Off, Reaction::Damp, Reaction::Hold] {
        let mut model = model();
        model.safety.reaction = reaction;
        let mut bench = Bench::armed(&model);
        bench.goal([0.0, 0.05, 0.0]);
        // 100 ms of silence are allowed: the tenth tick is still armed, the eleventh is not.
        for _ in 0..10 {
            assert!(bench.tick().enabled);
            assert!(matches!(bench.node.mode(), Mode::Enabled(_)));
        }
        let output = bench.tick();
        let fault = *bench.node.faults().faults.last().unwrap();
        assert_eq!(fault.cause, FaultCause::CommandTimeout);
        assert!((fault.value - 0.11).abs() < 1e-6 && fault.limit == 0.1);
        assert_eq!(output.enabled, reaction != Reaction::Off);
        if reaction == Reaction::Hold {
            // The reference comes to rest short of the goal.
            for _ in 0..100 {
                bench.tick();
            }
            let telemetry = bench.node.telemetry();
            assert!(
                telemetry.joints[1].reference > 0.0 && telemetry.joints[1].reference < 0.03,
                "{telemetry:?}"
            );
        }
    }
}

#[test]
fn a_fault_stays_until_it_was_read() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    bench.ask(Request::Stop);
    assert_eq!(bench.node.mode(), Mode::Fault);
    assert_eq!(refusal(bench.arm()), Refusal::WrongMode(Mode::Fault));
    for total in [0, 1] {
        let clear = Request::ClearFaults { total };
        assert_eq!(refusal(bench.ask(clear)), Refusal::FaultsUnread { total: 1 }, "nobody has read them");
    }
    let Reply::Faults(log) = bench.ask(Request::ReadFaults) else { panic!() };
    assert_eq!(log.faults[0].cause, FaultCause::Stop);
    assert_eq!(bench.ask(Request::ClearFaults { total: log.total }), Reply::Done);
    assert_eq!(bench.node.mode(), Mode::Disabled);
    // After a reset the board gives the log back, and it is still there to be read.
    let mut reborn = Node::new();
    reborn.restore_faults(log.clone());
    assert_eq!(reborn.faults(), &log);
}

#[test]
fn disarm_puts_a_faulted_node_off_but_keeps_the_fault() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    bench.ask(Request::Stop);
    assert!(bench.tick().enabled, "the reaction is to hold");
    bench.ask(Request::Disable);
    assert!(!bench.tick().enabled);
    assert_eq!(bench.node.mode(), Mode::Fault);
}
