//! The oracle must detect unsafe behaviour.

#![allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use std::path::Path;

use tesaki::control::ServoMode;
use tesaki::fault::{Fault, FaultCause};
use tesaki::model::Reaction;
use tesaki::protocol::{Mode, Reply, Request};
use tesaki::task::{TaskConfig, TaskKind};
use tesaki_description::robot::RobotFolder;

use super::oracle::Oracle;
use super::sample::{Acting, Machine, Sample};
use super::*;

const ENABLED: Mode = Mode::Enabled(TaskKind::JointServo);
/// Kinetic energy of a robot that is not at rest [J].
const MOVING: f64 = 2e-4;

fn robots() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots"))
}

/// An oracle for the hand, which its commander, client 1, has enabled.
fn oracle() -> Oracle {
    oracle_with(0.02)
}

/// Such an oracle with a given true friction [N·m].
fn oracle_with(coulomb: f64) -> Oracle {
    let model = RobotFolder::load(&robots().join("hand3")).unwrap().model;
    let stops = model.joints.iter().map(|_| Some([-1.0, 1.0])).collect();
    let coulomb = vec![coulomb; model.joints.len()];
    let mut oracle = Oracle::new(Machine { model, stops, coulomb, mass: 0.5, force_noise: 0.5 });
    oracle.reply(1, 1, &Request::TakeCommand { by_force: false }, &Reply::Done, 0);
    oracle.reply(1, 2, &enable(), &Reply::Done, 0);
    oracle
}

fn enable() -> Request {
    Request::Enable(TaskConfig::JointServo(ServoMode::Pid))
}

/// A hand at rest, without weight, whose log holds a fault if it has stopped.
fn sample(tick: u32, mode: Mode, enabled: bool) -> Sample {
    let fault = Fault { cause: FaultCause::Stop, joint: None, value: 0.0, limit: 0.0, tick };
    let stopped = mode == Mode::Fault;
    Sample {
        tick,
        answered: true,
        mode,
        enabled,
        torques: vec![0.0; 9],
        counts: [vec![0; 9], vec![0; 9]],
        reaction: (Reaction::Off, false),
        total: stopped.into(),
        latest: stopped.then_some(fault),
        positions: vec![0.0; 9],
        drives: vec![0.0; 9],
        weight: vec![0.0; 9],
        load: vec![0.0; 9],
        energy: 0.0,
        velocities: vec![[0.0; 3]; 3],
        speed: 0.0,
        contact: 0.0,
        stiffness: 0.0,
        acting: Acting::default(),
    }
}

fn broken(oracle: &Oracle) -> Vec<(Rule, u32)> {
    oracle.violations().iter().map(|violation| (violation.rule, violation.tick)).collect()
}

#[test]
fn a_robot_that_stops_and_rests_is_safe() {
    let mut oracle = oracle();
    (0..50).for_each(|tick| oracle.tick(sample(tick, ENABLED, true)));
    (50..300).for_each(|tick| oracle.tick(sample(tick, Mode::Fault, true)));
    assert_eq!(broken(&oracle), []);
}

#[test]
fn torques_beyond_their_limits_are_unsafe() {
    // Limits of the hand: 0.6 N·m, and a change of 0.6 N·m per tick.
    let check = |before: f32, torque: f32, enabled: bool| {
        let mut oracle = oracle();
        for (tick, torque, enabled) in [(0, before, true), (1, torque, enabled)] {
            let mut next = sample(tick, if enabled { ENABLED } else { Mode::Fault }, enabled);
            next.torques[3] = torque;
            oracle.tick(next);
        }
        broken(&oracle)
    };
    assert_eq!(check(0.3, 0.59, true), []);
    assert_eq!(check(0.3, 0.61, true), [(Rule::Torque, 1)]);
    assert_eq!(check(0.3, -0.32, true), [(Rule::TorqueRate, 1)]);
    assert_eq!(check(0.3, f32::NAN, true), [(Rule::Torque, 1)]);
    assert_eq!(check(0.3, 0.0, false), []);
    assert_eq!(check(0.3, 0.1, false), [(Rule::Torque, 1)]);
}

#[test]
fn outputs_that_nobody_enabled_are_unsafe() {
    let disable =
        |oracle: &mut Oracle, sequence| oracle.reply(7, sequence, &Request::Disable, &Reply::Done, 5);
    // After a Disable from any client, in every mode.
    for mode in [ENABLED, Mode::Fault, Mode::Disabled] {
        let mut oracle = oracle();
        disable(&mut oracle, 1);
        oracle.tick(sample(6, mode, true));
        assert_eq!(broken(&oracle), [(Rule::Enabled, 6)], "{mode}");
    }
    // After a reset of the board.
    let mut reset = oracle();
    reset.reset();
    reset.tick(sample(6, ENABLED, true));
    assert_eq!(broken(&reset), [(Rule::Enabled, 6)]);
    // A repeated answer to an old Enable enables nothing.
    let mut repeated = oracle();
    disable(&mut repeated, 1);
    repeated.reply(1, 2, &enable(), &Reply::Done, 6);
    repeated.tick(sample(7, ENABLED, true));
    assert_eq!(broken(&repeated), [(Rule::Enabled, 7)]);
    // An Enable from a client without command, and one that was sent before a Disable.
    let mut other = oracle();
    disable(&mut other, 1);
    other.reply(8, 1, &enable(), &Reply::Done, 9);
    assert_eq!(broken(&other), [(Rule::Enabled, 9)]);
    let mut late = oracle();
    late.reply(1, 4, &Request::Disable, &Reply::Done, 5);
    late.reply(1, 3, &enable(), &Reply::Done, 6);
    assert_eq!(broken(&late), [(Rule::Enabled, 6)]);
}

#[test]
fn a_controller_that_keeps_pushing_after_a_fault_is_unsafe() {
    let mut oracle = oracle();
    oracle.tick(sample(0, ENABLED, true));
    for tick in 1..20 {
        let mut pushed = sample(tick, Mode::Fault, true);
        (pushed.torques[1], pushed.drives[1]) = (0.3, 0.3);
        pushed.positions[1] = 0.01 * f64::from(tick);
        oracle.tick(pushed);
    }
    // 0.003 J a tick, less friction, against the 0.016 J of 0.5 kg at 0.25 m/s.
    let found = broken(&oracle);
    assert!(matches!(found[..], [(Rule::Energy, 5..=12)]), "{found:?}");
}

/// 0.012 J for 0.1 rad at 0.12 N·m, twice: work lost to true friction accelerates nothing.
#[test]
fn leading_a_joint_against_its_true_friction_is_safe() {
    let found = |coulomb: f64| {
        let mut oracle = oracle_with(coulomb);
        oracle.tick(sample(0, ENABLED, true));
        for tick in 1..80 {
            let mut led = sample(tick, Mode::Fault, true);
            (led.torques[1], led.drives[1]) = (0.12, 0.12);
            led.positions[1] = 0.005 * f64::from(tick);
            oracle.tick(led);
        }
        broken(&oracle)
    };
    assert_eq!(found(0.12), []);
    assert!(matches!(found(0.02)[..], [(Rule::Energy, _)]), "{:?}", found(0.02));
}

#[test]
fn a_held_robot_that_does_not_rest_is_unsafe() {
    let mut oracle = oracle();
    oracle.tick(sample(0, ENABLED, true));
    for tick in 1..200 {
        oracle.tick(Sample { energy: MOVING, ..sample(tick, Mode::Fault, true) });
    }
    assert_eq!(broken(&oracle), [(Rule::Rest, 102)]);
}

#[test]
fn only_a_robot_that_has_lost_its_force_sensor_need_not_rest() {
    use FaultCause::{FollowingError, ForceLimit, ForceMismatch, ForceSaturated, ForceSilent, ForceStuck};
    let rests = |cause: FaultCause| {
        let mut oracle = oracle();
        oracle.tick(sample(0, ENABLED, true));
        for tick in 1..200 {
            let mut moving = sample(tick, Mode::Fault, true);
            (moving.energy, moving.latest) = (MOVING, moving.latest.map(|fault| Fault { cause, ..fault }));
            oracle.tick(moving);
        }
        !broken(&oracle).is_empty()
    };
    assert!([FollowingError, ForceLimit].into_iter().all(rests));
    assert!(![ForceSaturated, ForceStuck, ForceSilent, ForceMismatch].into_iter().any(rests));
}

#[test]
fn a_rising_force_and_a_fast_tool_are_unsafe() {
    let mut oracle = oracle();
    oracle.tick(Sample { contact: 4.0, ..sample(0, ENABLED, true) });
    // 1.05 × 4 N + 0.5 N.
    for (tick, contact, speed) in [(1, 4.0, 0.0), (2, 4.6, 0.24), (3, 4.8, 0.26)] {
        oracle.tick(Sample { contact, speed, energy: MOVING, ..sample(tick, Mode::Fault, true) });
    }
    assert_eq!(broken(&oracle), [(Rule::ContactForce, 3), (Rule::ToolSpeed, 3)]);
}

/// The drives of a robot at rest cause no rise of a force if they press no harder than at the fault.
#[test]
fn only_drives_that_press_or_a_robot_in_motion_make_a_force_rise() {
    let found = |torque: f64, energy: f64| {
        let mut oracle = oracle();
        for (tick, mode, contact, torque, energy) in [
            (0, ENABLED, 2.0, 0.2, 0.0),
            (1, Mode::Fault, 2.0, 0.2, 0.0),
            (9, Mode::Fault, 3.0, torque, energy),
        ] {
            let mut next = Sample { contact, energy, ..sample(tick, mode, true) };
            (next.torques[1], next.drives[1]) = (torque as f32, torque);
            oracle.tick(next);
        }
        broken(&oracle)
    };
    assert_eq!(found(0.2, 0.0), []);
    assert_eq!(found(0.22, 0.0), []);
    assert_eq!(found(0.24, 0.0), [(Rule::ContactForce, 9)]);
    // In the opposite direction it did not press before.
    assert_eq!(found(-0.2, 0.0), [(Rule::ContactForce, 9)]);
    assert_eq!(found(0.2, MOVING), [(Rule::ContactForce, 9)]);
}

/// A force that rises by 1 N in a tick reaches 6 N before the torques fade: 6.8 N are allowed until then, and
/// 4.7 N later.
#[test]
fn a_force_rises_on_for_two_ticks() {
    let found = |[first, second, last]: [f64; 3]| {
        let mut oracle = oracle();
        for (tick, contact) in [(0, 3.0), (1, 4.0)] {
            oracle.tick(Sample { contact, ..sample(tick, ENABLED, true) });
        }
        for (tick, contact) in [(2, 5.0), (3, first), (4, second), (5, last)] {
            oracle.tick(Sample { contact, energy: MOVING, ..sample(tick, Mode::Fault, true) });
        }
        broken(&oracle)
    };
    assert_eq!(found([6.7, 6.7, 4.6]), []);
    assert_eq!(found([6.9, 6.7, 4.6]), [(Rule::ContactForce, 3)]);
    assert_eq!(found([6.7, 6.7, 4.8]), [(Rule::ContactForce, 5)]);
}

/// A tool that swings back, first at −0.8, then at −0.3 m/s: the same acceleration takes it to 0.7 m/s in two
/// ticks.
#[test]
fn a_tool_goes_on_with_its_acceleration_for_two_ticks() {
    let found = |reached: f64| {
        let mut oracle = oracle();
        let moving = |velocity: f64, sample: Sample| {
            let velocities = vec![[0.0, velocity, 0.0]];
            Sample { velocities, speed: velocity.abs(), contact: 4.0, ..sample }
        };
        for (tick, velocity) in [(0, -0.8), (1, -0.3)] {
            oracle.tick(moving(velocity, sample(tick, ENABLED, true)));
        }
        for (tick, velocity) in [(2, 0.2), (3, reached)] {
            oracle.tick(moving(velocity, sample(tick, Mode::Fault, true)));
        }
        broken(&oracle)
    };
    assert_eq!(found(0.73), []);
    assert_eq!(found(0.74), [(Rule::ToolSpeed, 3)]);
}

#[test]
fn a_joint_beyond_its_stop_is_unsafe() {
    let mut oracle = oracle();
    for (tick, angle) in [(0, 1.0), (1, 1.015), (2, 1.03)] {
        let mut beyond = sample(tick, ENABLED, true);
        beyond.positions[4] = angle;
        oracle.tick(beyond);
    }
    assert_eq!(broken(&oracle), [(Rule::Stops, 2)]);
}

#[test]
fn a_lost_cause_is_unsafe() {
    let mut silent = oracle();
    silent.tick(sample(0, ENABLED, true));
    silent.tick(Sample { total: 0, latest: None, ..sample(1, Mode::Fault, true) });
    assert_eq!(broken(&silent), [(Rule::Cause, 1)]);
    // A reset must keep the log.
    let mut forgetful = oracle();
    forgetful.tick(sample(0, ENABLED, true));
    forgetful.tick(sample(1, Mode::Fault, true));
    forgetful.reset();
    forgetful.tick(sample(2, Mode::Disabled, false));
    assert_eq!(broken(&forgetful), [(Rule::Cause, 2)]);
}

#[test]
fn pushing_a_joint_with_a_dead_encoder_is_unsafe() {
    let found = |motion: f64, load: f64| {
        let mut oracle = oracle();
        for tick in 0..12_u8 {
            let mut dead = sample(tick.into(), ENABLED, true);
            dead.torques[2] = 0.4;
            // The true count changes; the count that is read does not.
            dead.counts[1][2] = 50 * i32::from(tick);
            dead.positions[2] = motion * f64::from(tick);
            dead.load[2] = load;
            oracle.tick(dead);
        }
        broken(&oracle).contains(&(Rule::DeadEncoder, 4))
    };
    assert!(found(5e-3, 0.0));
    // Something else moves it: against its torque, then with it.
    assert!(!found(-5e-3, 0.0));
    assert!(found(5e-3, 0.3));
    // A load that balances the 0.4 N·m up to 0.05 N·m, which friction can hold; then one that leaves 0.15
    // N·m.
    assert!(!found(5e-3, -0.35));
    assert!(found(5e-3, -0.25));
}

#[test]
fn a_late_drive_goes_on_with_what_it_was_told_before() {
    let found = |late: u32| {
        let mut oracle = oracle();
        oracle.tick(Sample { contact: 4.0, ..sample(0, ENABLED, true) });
        for tick in 1..40 {
            let acting = Acting { drives: true, late, ..Acting::default() };
            oracle.tick(Sample { contact: 4.0, speed: 0.3, acting, ..sample(tick, Mode::Fault, true) });
        }
        broken(&oracle)
    };
    // From the second tick on: more than six ticks, plus the delay.
    assert_eq!(found(0), [(Rule::ToolSpeed, 8)]);
    assert_eq!(found(5), [(Rule::ToolSpeed, 13)]);
}

/// A command of 0.2 N·m that is still on its way to a drive with four ticks of delay moves a joint by 0.1 rad
/// in each of them: 0.08 J, where 0.016 J are tolerated, and 0.025 J for friction.
#[test]
fn what_is_on_its_way_to_a_late_drive_fades_later() {
    let found = |late: usize| {
        let mut oracle = oracle();
        let acting = Acting { drives: true, late: 4, late_drives: vec![late], ..Acting::default() };
        let told = vec![0.2; 9];
        oracle.tick(Sample { torques: told.clone(), acting: acting.clone(), ..sample(0, ENABLED, true) });
        for tick in 1..20 {
            let mut moved = Sample { torques: vec![0.0; 9], ..sample(tick, Mode::Fault, true) };
            moved.acting.clone_from(&acting);
            moved.drives[1] = if tick <= 4 { 0.2 } else { 0.0 };
            moved.positions[1] = 0.1 * f64::from(tick.min(5));
            oracle.tick(moved);
        }
        broken(&oracle)
    };
    assert_eq!(found(1), []);
    assert!(matches!(found(0)[..], [(Rule::Energy, _)]), "{:?}", found(0));
}

#[test]
fn a_lie_that_ended_before_the_stop_is_still_to_be_found() {
    let found = |end: u32| {
        let mut oracle = oracle();
        for tick in 0..10 {
            let acting = Acting { encoders: tick < end, ..Acting::default() };
            oracle.tick(Sample { contact: 4.0, acting, ..sample(tick, ENABLED, true) });
        }
        for tick in 10..20 {
            oracle.tick(Sample { contact: 4.0, speed: 0.3, ..sample(tick, Mode::Fault, true) });
        }
        broken(&oracle)
    };
    // In tick 7, and for six ticks longer.
    assert_eq!(found(8), [(Rule::ToolSpeed, 13)]);
    assert_eq!(found(3), [(Rule::ToolSpeed, 11)]);
}

/// In the seventh tick the board detects the fault that has violated a rule since tick 2: from then on, the
/// oracle compares with the motion at that time.
#[test]
fn what_is_found_in_the_last_tick_is_found() {
    let found = |total: u32| {
        let mut oracle = oracle();
        oracle.tick(Sample { contact: 4.0, ..sample(0, ENABLED, true) });
        for tick in 1..14 {
            let acting = Acting { encoders: true, ..Acting::default() };
            let fast = Sample { contact: 4.0, speed: 0.3, acting, ..sample(tick, Mode::Fault, true) };
            oracle.tick(Sample { total: if tick < 8 { 1 } else { total }, ..fast });
        }
        broken(&oracle)
    };
    assert_eq!(found(2), []);
    assert_eq!(found(1), [(Rule::ToolSpeed, 8)]);
}

/// Seeds of schedules in which stopping safely is difficult.
#[test]
fn hard_schedules_break_no_rule() {
    let seeds = [
        [818, 2166, 2966, 3011, 4102, 4434],
        [6142, 6422, 6785, 8471, 9864, 40588],
        [30888, 30963, 30329, 30483, 40249, 40406],
        [40529, 4452, 2470, 7410, 750, 13],
    ];
    for seed in seeds.into_iter().flatten() {
        let report = run(&Schedule::draw(seed), robots()).unwrap();
        assert_eq!((report.violations, report.error), (vec![], None), "{seed}");
    }
}

#[test]
fn a_schedule_runs_the_same_twice() {
    for seed in [6, 13, 14] {
        let schedule = Schedule::draw(seed);
        let (first, second) = (run(&schedule, robots()).unwrap(), run(&schedule, robots()).unwrap());
        assert_eq!(first, second);
        assert!(first.ticks[0] > 100 && first.error.is_none(), "{first:?}");
    }
}
