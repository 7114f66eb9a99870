//! Reactions to faults: controlled stops, and their supervision.

use heapless::Vec;

use super::rig::{COUNTS_PER_RADIAN, Rig, model, refusal};
use crate::TICK;
use crate::control::{JointPoint, ServoMode};
use crate::fault::FaultCause;
use crate::model::{Friction, Inertial, ObserverGains, PidGains, Reaction, RobotModel};
use crate::protocol::{Mode, Refusal, Reply, Request, SensorFlags};
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig};

pub(super) fn stream(position: f32, velocity: f32) -> Request {
    let rest = JointPoint::default();
    let points =
        Vec::from_slice(&[rest, rest, JointPoint { position, velocity, acceleration: 0.0 }]).unwrap();
    Request::Task(TaskCommand::JointServo(JointCommand::Stream { points }))
}

/// Ticks with joints that follow their references exactly.
fn tick_ideally(rig: &mut Rig) {
    for (count, joint) in rig.sensors.encoders.iter_mut().zip(rig.node.telemetry().joints) {
        *count = libm::roundf(joint.reference * COUNTS_PER_RADIAN) as i32;
    }
    rig.tick();
}

#[test]
fn a_stop_while_streaming_brakes_within_the_joint_limits() {
    let mut model = model();
    // 0.6 N·m give 0.02 kg·m² 30 rad/s².
    model.joints[2].servo.observer.inertia = 0.02;
    let mut rig = Rig::enabled(&model);
    let mut position = 0.0;
    while position < 1.38 {
        position += 0.02;
        assert_eq!(rig.ask(stream(position, 2.0)), Reply::Done);
        tick_ideally(&mut rig);
    }
    assert_eq!(rig.ask(Request::Stop), Reply::Done);
    // 2 rad/s within 0.1 rad: 20 rad/s², two thirds of the maximum, for 0.1 s, after the period that has
    // begun.
    let mut before = position;
    for tick in 0..20 {
        tick_ideally(&mut rig);
        let reference = rig.node.telemetry().joints[2].reference;
        assert!((before..1.500_01).contains(&reference), "{tick}: {reference}");
        assert_eq!(reference == before, tick > 9, "{tick}: {reference}");
        before = reference;
    }
    assert!(before > 1.48, "{before}");
    assert_eq!(rig.node.faults().total, 1);
}

/// A finger of three flywheels, which nothing couples, in closed loop.
struct Flywheels {
    rig: Rig,
    /// Angles [rad] and velocities [rad/s].
    angles: [f32; 3],
    velocities: [f32; 3],
}

impl Flywheels {
    const INERTIA: f32 = 2e-3;

    /// Streamed from rest until all joints move at 4 rad/s.
    fn moving(mode: ServoMode) -> Self {
        let mut model = model();
        model.safety.command_timeout = 0.5;
        for joint in &mut model.joints {
            joint.link = Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] };
            joint.friction = Friction { coulomb: 0.0, viscous: 0.0 };
            joint.motor.rotor_inertia = Self::INERTIA;
            (joint.motor.delay, joint.motor.bandwidth) = (0.0, 1e5);
            joint.servo.observer =
                ObserverGains { inertia: Self::INERTIA, bandwidth: 50.0, observer_bandwidth: 120.0 };
            joint.servo.pid = PidGains { proportional: 0.8, integral: 8.0, derivative: 0.15, cutoff: 30.0 };
            (joint.limits.lower, joint.limits.upper) = (-3.0, 3.0);
        }
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        let mut moving = Self { rig, angles: [0.0; 3], velocities: [0.0; 3] };
        let mut point = JointPoint::default();
        while point.velocity < 4.0 {
            point.acceleration = 10.0;
            let points = Vec::from_slice(&[point; 3]).unwrap();
            let stream = Request::Task(TaskCommand::JointServo(JointCommand::Stream { points }));
            assert_eq!(moving.rig.ask(stream), Reply::Done);
            moving.tick();
            point = point.next();
        }
        moving
    }

    /// A tick, and the motion until the next one. Returns the torques [N·m].
    fn tick(&mut self) -> [f32; 3] {
        for (count, angle) in self.rig.sensors.encoders.iter_mut().zip(self.angles) {
            *count = libm::roundf(angle * COUNTS_PER_RADIAN) as i32;
        }
        let torques = self.rig.tick().torques;
        for ((angle, velocity), torque) in self.angles.iter_mut().zip(&mut self.velocities).zip(&torques) {
            let acceleration = torque / Self::INERTIA;
            *angle += *velocity * TICK + 0.5 * acceleration * TICK * TICK;
            *velocity += acceleration * TICK;
        }
        [torques[0], torques[1], torques[2]]
    }
}

/// Half of 0.6 N·m brakes 0.002 kg·m² with 150 rad/s²: from 4 rad/s within three ticks and 0.053 rad.
#[test]
fn a_joint_without_friction_is_braked_to_rest_and_stays_there() {
    for (mode, swing) in [(ServoMode::Observer, 1e-3), (ServoMode::Pid, 0.03)] {
        let mut joints = Flywheels::moving(mode);
        assert_eq!(joints.rig.ask(Request::Stop), Reply::Done);
        let [start, ..] = joints.angles;
        let mut farthest = start;
        for tick in 0..100 {
            let [torque, ..] = joints.tick();
            farthest = farthest.max(joints.angles[0]);
            if mode == ServoMode::Observer && tick < 2 {
                assert!((torque + 0.3).abs() < 0.01, "{tick}: {torque}");
            }
        }
        let back = farthest - joints.angles[0];
        assert!((0.04..0.11).contains(&(farthest - start)), "{mode:?}: {}", farthest - start);
        assert!(
            back < swing && joints.velocities[0].abs() < 0.01,
            "{mode:?}: {back} back, {:?}",
            joints.velocities
        );
        assert_eq!(joints.rig.node.faults().total, 1, "{mode:?}: {:?}", joints.rig.node.faults());
    }
}

#[test]
fn an_encoder_that_dies_during_a_stop_lets_the_servo_push_for_three_ticks_at_most() {
    for speed in [2.0, 4.0] {
        let mut model = model();
        model.joints[2].servo.observer.inertia = 0.02;
        let mut rig = Rig::enabled(&model);
        for step in 1..=20_u8 {
            assert_eq!(rig.ask(stream(0.01 * speed * f32::from(step), speed)), Reply::Done);
            tick_ideally(&mut rig);
        }
        assert_eq!(rig.ask(Request::Stop), Reply::Done);
        // From here on the count stands still while the reference brakes.
        let mut beyond_friction = 0;
        for _ in 0..60 {
            rig.tick();
            let effort = rig.node.state.joints[2].effort;
            beyond_friction += u32::from(effort.abs() > 0.1);
            assert!(beyond_friction <= 3, "{effort}");
        }
        let fault = rig.node.faults().faults.last().unwrap();
        assert_eq!((fault.cause, fault.joint), (FaultCause::EncoderStuck, Some(2)));
        assert_eq!((rig.node.faults().total, rig.node.state.reaction), (2, Reaction::Off));
    }
}

/// A held joint opposes a lasting displacement with a constant torque.
#[test]
fn a_held_joint_does_not_press_harder_with_time() {
    for mode in [ServoMode::Pid, ServoMode::Observer] {
        let mut rig = Rig::enabled(&model());
        rig.ask(Request::Disable);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        rig.tick();
        let lean = |rig: &mut Rig, ticks: u32| {
            // 10 mrad, more than the error at which a joint counts as resting.
            rig.sensors.encoders[0] = libm::roundf(0.01 * COUNTS_PER_RADIAN) as i32;
            (0..ticks).for_each(|_| _ = rig.tick());
            rig.node.telemetry().joints[0].torque
        };
        rig.ask(Request::Stop);
        (0..40).for_each(|_| _ = rig.tick());
        let (soon, later) = (lean(&mut rig, 20), lean(&mut rig, 200));
        assert_eq!(rig.node.faults().total, 1);
        assert!(soon < -1e-4 && (later / soon - 1.0).abs() < 0.01, "{mode:?}: {soon} {later}");
        // While enabled, the servo brings the joint back.
        let mut rig = Rig::enabled(&model());
        rig.ask(Request::Disable);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        rig.tick();
        let keep =
            |rig: &mut Rig, ticks: u32| (0..ticks).map(|_| (rig.ask(Request::Keep), lean(rig, 1)).1).last();
        let (soon, later) = (keep(&mut rig, 8).unwrap(), keep(&mut rig, 20).unwrap());
        assert!(later < 1.1 * soon, "{mode:?}: {soon} {later}");
    }
}

/// A finger along x, with gravity perpendicular to it.
fn lying() -> RobotModel {
    let mut model = model();
    model.gravity = [0.0, -9.81, 0.0];
    model
}

#[test]
fn damping_compensates_gravity_and_lets_the_feedforward_fade() {
    let mut model = lying();
    model.safety.reaction = Reaction::Damp;
    let mut rig = Rig::enabled(&model);
    let points = Vec::from_slice(&[JointPoint::default(); 3]).unwrap();
    let torques = Vec::from_slice(&[0.0, 0.0, 0.1]).unwrap();
    assert_eq!(
        rig.ask(Request::Task(TaskCommand::JointServo(JointCommand::StreamTorques { points, torques }))),
        Reply::Done
    );
    (0..8).for_each(|_| _ = rig.tick());
    assert_eq!(rig.ask(Request::Stop), Reply::Done);
    let torques: std::vec::Vec<_> = (0..300).map(|_| rig.tick().torques).collect();
    // 20 g at 20 mm under 9.81 m/s² are 3.924 mN·m for each link that a joint carries.
    for (joint, links) in [(0, 3.0), (1, 2.0), (2, 1.0)] {
        assert!((torques[299][joint] - links * 3.924e-3).abs() < 2e-5 + 1e-3 * links, "{:?}", torques[299]);
    }
    // 0.1 N·m at the tip, 5 % less in each tick.
    assert!((torques[0][2] - 0.098_9).abs() < 2e-4 && (torques[1][2] - 0.094_2).abs() < 2e-4, "{torques:?}");
    // Moved at 1 rad/s for a while, it resists. 0.01 N·m would remove half of its speed in a tick; the
    // maximum is 0.3 of it.
    let inertia = model.joints[0].servo.observer.inertia;
    assert!(0.01 > 0.3 * inertia / 0.01);
    for step in 1..=60_u8 {
        rig.sensors.encoders[0] = libm::roundf(0.01 * f32::from(step) * COUNTS_PER_RADIAN) as i32;
        rig.tick();
    }
    let torque = rig.node.telemetry().joints[0].torque;
    // All links rotate with the first joint: cos 0.6. As they have risen, 60 % of the weight is compensated.
    assert!((torque - (0.6 * 3.0 * 3.924e-3 * 0.825_3 - 0.3 * inertia / 0.01)).abs() < 1e-4, "{torque}");
}

#[test]
fn a_damped_robot_that_is_lighter_than_its_model_does_not_rise() {
    let mut model = lying();
    model.safety.reaction = Reaction::Damp;
    let mut rig = Rig::enabled(&model);
    rig.ask(Request::Stop);
    let inertia = model.joints[0].servo.observer.inertia;
    let [mut positions, mut velocities] = [[0.0_f32; 3]; 2];
    for _ in 0..2000 {
        let torques = rig.tick().torques;
        // 70 % of the weight of the test above, without friction.
        for (joint, links) in [(0, 3.0), (1, 2.0), (2, 1.0)] {
            let weight = 0.7 * links * 3.924e-3;
            velocities[joint] += (torques[joint] - weight) / inertia * 0.01;
            positions[joint] += 0.01 * velocities[joint];
            rig.sensors.encoders[joint] = libm::roundf(positions[joint] * COUNTS_PER_RADIAN) as i32;
        }
    }
    assert!(velocities.iter().all(|velocity| velocity.abs() < 0.01), "{velocities:?} rad/s");
    assert!(positions.iter().all(|position| position.abs() < 0.3), "{positions:?} rad");
    assert_eq!(rig.node.state.reaction, Reaction::Damp, "{:?}", rig.node.faults());
}

#[test]
fn a_stop_whose_ticks_are_missed_again_and_again_is_damped() {
    let mut rig = Rig::enabled(&model());
    rig.ask(Request::Stop);
    let mut damped_after = None;
    for number in 0..40 {
        rig.tick();
        rig.sensors.sequence += 2;
        rig.tick();
        if rig.node.state.reaction == Reaction::Damp {
            damped_after = damped_after.or(Some(number));
        }
    }
    assert_eq!(damped_after, Some(10), "{:?}", rig.node.faults());
}

#[test]
fn a_relative_encoder_that_jumps_has_lost_its_zero() {
    // Also when periods are missed.
    for (relative, missed) in [(true, 0), (false, 0), (true, 1), (false, 1), (true, 20)] {
        let mut model = model();
        model.joints[1].encoder.relative = relative;
        let mut rig = Rig::ready(&model);
        if relative {
            let positions = Vec::from_slice(&[0.0; 3]).unwrap();
            assert_eq!(rig.ask(Request::Home { positions }), Reply::Done);
        }
        assert_eq!(rig.enable(), Reply::Done);
        rig.tick();
        // 0.96 rad in each of them.
        rig.sensors.encoders[1] += 10_000 * (1 + missed);
        rig.sensors.sequence += missed.cast_unsigned();
        rig.tick();
        assert_eq!(rig.node.faults().faults[0].cause, FaultCause::EncoderJump, "{missed}");
        (0..50).for_each(|_| _ = rig.tick());
        let Reply::Faults(log) = rig.ask(Request::ReadFaults) else { panic!() };
        assert_eq!(rig.ask(Request::ClearFaults { total: log.total }), Reply::Done);
        let refused = matches!(rig.enable(), Reply::Refused(Refusal::NotHomed { .. }));
        assert_eq!(refused, relative);
    }
}

#[test]
fn a_joint_that_cannot_be_held_is_damped_and_the_first_cause_stays_in_the_log() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    rig.ask(Request::Stop);
    rig.tick();
    // A force that is stronger than the servo moves the tip within its velocity limit.
    for step in 1..=5_u8 {
        rig.sensors.encoders[2] = libm::roundf(0.06 * f32::from(step) * COUNTS_PER_RADIAN) as i32;
        rig.tick();
    }
    let causes: std::vec::Vec<_> = rig.node.faults().faults.iter().map(|fault| fault.cause).collect();
    assert_eq!(causes, [FaultCause::Stop, FaultCause::FollowingError]);
    assert_eq!(rig.node.state.reaction, Reaction::Damp);
    // Reactions only become weaker, and a lasting condition is recorded once.
    rig.sensors.flags = SensorFlags(1);
    (0..5).for_each(|_| _ = rig.tick());
    assert_eq!((rig.node.state.reaction, rig.node.faults().total), (Reaction::Off, 3));
    rig.sensors.flags = SensorFlags(0);
    assert!(!rig.tick().enabled);
}

#[test]
fn a_joint_that_left_its_reference_is_held_without_the_learnt_disturbance() {
    let mut model = model();
    model.joints[2].limits.following_error = 0.05;
    let mut rig = Rig::enabled(&model);
    // An obstacle that yields a little: the counts change, and the integral action grows.
    let (mut ticks, mut pressing) = (0, 0.0);
    while rig.node.mode() != Mode::Fault {
        pressing = rig.node.telemetry().joints[2].torque;
        rig.goal([0.0, 0.0, 0.5]);
        rig.sensors.encoders[2] += 1;
        rig.tick();
        ticks += 1;
        assert!(ticks < 200);
    }
    assert_eq!(rig.node.faults().faults[0].cause, FaultCause::FollowingError);
    rig.tick();
    let torque = rig.node.telemetry().joints[2].torque;
    // At most the Coulomb friction remains.
    assert!(pressing > 0.025 && torque.abs() < 0.021, "{pressing} {torque}");
}

#[test]
fn the_first_sensor_frame_is_checked_as_well() {
    type Change = fn(&mut Rig);
    let cases: [(Change, FaultCause); 3] = [
        (|rig| rig.sensors.flags = SensorFlags(1), FaultCause::EmergencyStop),
        (|rig| rig.sensors.supply = 50_000, FaultCause::SupplyHigh),
        (|rig| rig.sensors.encoders[1] = 20_000, FaultCause::PositionLimit),
    ];
    for (change, cause) in cases {
        let mut rig = Rig::new();
        rig.command();
        assert_eq!(rig.push(&model()), Reply::Done);
        change(&mut rig);
        rig.tick();
        let Refusal::Unsafe(fault) = refusal(rig.enable()) else { panic!("{cause:?}") };
        assert_eq!(fault.cause, cause);
    }
}

#[test]
fn an_enable_that_a_disable_or_a_stop_overtook_enables_nothing() {
    for overtaking in [Request::Disable, Request::Stop] {
        let mut rig = Rig::ready(&model());
        let late = rig.sequence + 1;
        rig.sequence += 1;
        rig.ask(overtaking.clone());
        let enable = Request::Enable(TaskConfig::JointServo(ServoMode::Pid));
        let latest = rig.sequence;
        assert_eq!(refusal(rig.send(7, late, enable)), Refusal::Stale { latest });
        assert!(!rig.tick().enabled);
        if overtaking == Request::Stop {
            rig.clear_faults();
        }
        assert_eq!(rig.enable(), Reply::Done, "a new request");
    }
}

#[test]
fn a_stop_of_a_disabled_board_by_another_client_is_known_before_it_is_enabled() {
    let mut rig = Rig::ready(&model());
    assert_eq!(rig.send(99, 1, Request::Stop), Reply::Done);
    assert_eq!(refusal(rig.enable()), Refusal::WrongMode(Mode::Fault));
    assert!(!rig.tick().enabled);
    assert_eq!(rig.node.faults().faults.last().unwrap().cause, FaultCause::Stop);
    // A second stop is no second fault.
    assert_eq!(rig.send(99, 2, Request::Stop), Reply::Done);
    assert_eq!(rig.node.faults().total, 1);
    rig.clear_faults();
    assert_eq!(rig.enable(), Reply::Done);
}

#[test]
fn a_late_tick_is_no_jump_and_its_velocity_counts_all_periods() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    // 0.2 rad in five periods is more than a joint can move in one. From rest at constant acceleration: 8
    // rad/s at the end, 6.4 rad/s one period before, a mean of 7.2 rad/s in between; the filter passes 63 %
    // of the step.
    rig.sensors.encoders[0] = libm::roundf(0.2 * COUNTS_PER_RADIAN) as i32;
    rig.sensors.sequence += 4;
    assert!(rig.tick().enabled);
    let fault = rig.node.faults().faults[0];
    assert_eq!((fault.cause, fault.value), (FaultCause::LateTick, 5.0));
    assert!((rig.node.state.measured.velocities[0] - 6.9).abs() < 0.02);
}

#[test]
fn after_missed_ticks_a_joint_is_stopped_where_it_is() {
    let modes = [ServoMode::Pid, ServoMode::Observer];
    for (mode, stopped) in modes.into_iter().flat_map(|mode| [(mode, false), (mode, true)]) {
        let mut rig = Rig::ready(&model());
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        rig.tick();
        if stopped {
            rig.ask(Request::Stop);
            rig.tick();
        }
        // The drives were off for five periods, and the joint fell by 0.1 rad; then it rests. For one tick
        // the torque opposes the velocity of a falling joint.
        rig.sensors.encoders[0] = libm::roundf(0.1 * COUNTS_PER_RADIAN) as i32;
        rig.sensors.sequence += 4;
        let torques: std::vec::Vec<f32> = (0..10).map(|_| rig.tick().torques[0]).collect();
        let cause = if stopped { FaultCause::Stop } else { FaultCause::LateTick };
        assert_eq!(rig.node.faults().faults[0].cause, cause);
        assert!(torques[0].abs() < 0.1, "{mode:?}, {cause:?}: {torques:?}");
        assert!(torques[1..].iter().all(|torque| torque.abs() < 0.03), "{mode:?}, {cause:?}: {torques:?}");
    }
}

/// The bare PID gets no torque of the model: its integrator carries the weight on, with which the PID with a
/// feed-forward begins anew.
#[test]
fn a_bare_pid_that_restarts_does_not_drop_the_weight() {
    let mut model = model();
    model.gravity = [0.0, -9.81, -9.81];
    let torques = [ServoMode::Pid, ServoMode::BarePid].map(|mode| {
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        rig.tick();
        rig.sensors.sequence += 4;
        (0..10).for_each(|_| assert!(rig.tick().enabled));
        assert_eq!(rig.node.faults().faults[0].cause, FaultCause::LateTick);
        rig.tick().torques
    });
    let [with_model, bare] = &torques;
    assert!(with_model.iter().any(|torque| torque.abs() > 0.01), "{with_model:?}");
    for (one, other) in with_model.iter().zip(bare) {
        assert!((one - other).abs() < 1e-4, "{torques:?}");
    }
}

#[test]
fn a_joint_beyond_its_limit_is_held_and_is_one_fault() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    // 1.75 rad, where 1.5 rad plus a following error of 0.2 rad is allowed, at 5 rad/s.
    for step in 1..=35_u8 {
        rig.sensors.encoders[1] = libm::roundf(0.05 * f32::from(step) * COUNTS_PER_RADIAN) as i32;
        let points = [0.0, 0.05 * f32::from(step), 0.0]
            .map(|position: f32| JointPoint { position: position.min(1.5), ..JointPoint::default() });
        let points = Vec::from_slice(&points).unwrap();
        assert_eq!(
            rig.ask(Request::Task(TaskCommand::JointServo(JointCommand::Stream { points }))),
            Reply::Done
        );
        rig.tick();
        if rig.node.mode() == Mode::Fault {
            break;
        }
    }
    (0..20).for_each(|_| assert!(rig.tick().enabled));
    let faults = rig.node.faults();
    assert_eq!((faults.total, faults.faults[0].cause), (1, FaultCause::PositionLimit), "{faults:?}");
    assert_eq!(rig.node.state.reaction, Reaction::Hold);
}

#[test]
fn a_lasting_fault_hides_no_dead_encoder() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    rig.sensors.supply = 19_000;
    assert!(rig.tick().enabled);
    rig.sensors.encoders[2] += 10_000;
    assert!(!rig.tick().enabled);
    let causes: std::vec::Vec<_> = rig.node.faults().faults.iter().map(|fault| fault.cause).collect();
    assert_eq!(causes, [FaultCause::SupplyLow, FaultCause::EncoderJump]);
}

#[test]
fn a_joint_that_gains_speed_against_its_torque_is_switched_off() {
    let mut model = model();
    model.joints[2].servo.observer.inertia = 0.02;
    for mode in [ServoMode::Observer] {
        let mut rig = Rig::ready(&model);
        assert_eq!(rig.ask(Request::Enable(TaskConfig::JointServo(mode))), Reply::Done);
        let [mut position, mut velocity] = [0.0, 0.0];
        while rig.tick().enabled {
            rig.goal([0.0, 0.0, 0.5]);
            // The drive is reversed: 0.02 kg·m² gain speed away from the goal.
            let torque = rig.node.telemetry().joints[2].torque;
            velocity -= torque / 0.02 * 0.01;
            position += velocity * 0.01;
            rig.sensors.encoders[2] = libm::roundf(position * COUNTS_PER_RADIAN) as i32;
        }
        let fault = rig.node.faults().faults.last().unwrap();
        assert_eq!((fault.cause, fault.joint), (FaultCause::Runaway, Some(2)), "{mode:?}");
        assert!(velocity.abs() < 0.5 * model.joints[2].limits.velocity, "{mode:?}: {velocity} rad/s");
    }
}

#[test]
fn a_damped_joint_that_its_torque_still_drives_does_not_run_away() {
    let mut model = model();
    model.safety.reaction = Reaction::Damp;
    model.safety.damping = 0.5;
    model.joints[2].servo.observer.inertia = 0.02;
    model.joints[2].motor.rotor_inertia = 0.02;
    model.joints[2].servo.filter_time = 0.1;
    // 0.6 N·m fall to 0 in four ticks.
    model.joints[2].limits.torque_rate = 15.0;
    let mut rig = Rig::enabled(&model);
    let [mut position, mut velocity] = [0.0_f32; 2];
    for tick in 0..60 {
        if tick < 5 {
            rig.goal([0.0, 0.0, 1.2]);
        } else if tick == 5 {
            assert_eq!(rig.ask(Request::Stop), Reply::Done);
        }
        rig.sensors.encoders[2] = libm::roundf(position * COUNTS_PER_RADIAN) as i32;
        let frame = rig.tick();
        assert!(frame.enabled, "{tick}: {velocity} rad/s, {:?}", rig.node.faults());
        velocity += frame.torques[2] / 0.02 * TICK;
        position += velocity * TICK;
    }
    assert_eq!(rig.node.faults().total, 1, "{:?}", rig.node.faults());
    assert!(velocity.abs() < 0.05, "{velocity} rad/s");
}

#[test]
fn a_robot_that_moves_is_not_enabled() {
    let mut rig = Rig::ready(&model());
    let limit = 0.2 * model().joints[1].limits.velocity;
    for (speed, enabled) in [(1.2 * limit, false), (0.8 * limit, true)] {
        for step in 1..=10_u8 {
            let position = 0.01 * speed * f32::from(step);
            rig.sensors.encoders[1] = libm::roundf(position * COUNTS_PER_RADIAN) as i32;
            rig.tick();
        }
        match rig.enable() {
            Reply::Done => assert!(enabled, "{speed} rad/s"),
            Reply::Refused(Refusal::Unsafe(fault)) => {
                assert!(!enabled, "{speed} rad/s");
                assert_eq!(
                    (fault.cause, fault.joint, fault.limit),
                    (FaultCause::VelocityLimit, Some(1), limit)
                );
            }
            other => panic!("{other:?}"),
        }
        rig.sensors.encoders[1] = 0;
        (0..20).for_each(|_| _ = rig.tick());
    }
}

#[test]
fn a_stop_that_gains_energy_is_weakened() {
    for (noise, causes, reaction) in [
        (2, [FaultCause::Stop].as_slice(), Reaction::Hold),
        (1000, &[FaultCause::Stop, FaultCause::EnergyGained, FaultCause::EnergyGained], Reaction::Off),
    ] {
        let mut model = model();
        model.joints[2].servo.observer.inertia = 0.02;
        let mut rig = Rig::enabled(&model);
        assert_eq!(rig.ask(Request::Stop), Reply::Done);
        // As if it had pressed with its maximum torque.
        rig.node.state.joints[2].pressed = 0.6;
        // 0.02 kg·m² with a noisy encoder: the servo acts against an error that changes in every tick.
        let [mut position, mut velocity] = [0.0_f32; 2];
        let mut random = 1_u32;
        for _ in 0..100 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let error = (random >> 16) as i32 % (2 * noise + 1) - noise;
            rig.sensors.encoders[2] = libm::roundf(position * COUNTS_PER_RADIAN) as i32 + error;
            velocity += rig.tick().torques[2] / 0.02 * 0.01;
            position += velocity * 0.01;
        }
        let found: std::vec::Vec<_> = rig.node.faults().faults.iter().map(|fault| fault.cause).collect();
        assert_eq!((found.as_slice(), rig.node.state.reaction), (causes, reaction), "{noise} counts");
    }
}

#[test]
fn a_leap_beyond_the_velocity_limit_is_an_encoder_error() {
    let mut model = model();
    // 0.6 N·m give 0.02 kg·m² 30 rad/s²: 0.3 rad/s in a tick.
    model.joints[2].servo.observer.inertia = 0.02;
    model.joints[2].limits.following_error = 1.0;
    for (steps, cause) in [(4_u8, FaultCause::EncoderJump), (80, FaultCause::VelocityLimit)] {
        let mut rig = Rig::enabled(&model);
        rig.tick();
        let [mut position, mut velocity] = [0.0_f32; 2];
        // To 15 rad/s, where 8 rad/s are permitted and 16 rad/s in a tick are a jump.
        while rig.node.mode() != Mode::Fault {
            velocity = (velocity + 15.0 / f32::from(steps)).min(15.0);
            position += 0.01 * velocity;
            rig.sensors.encoders[2] = libm::roundf(position * COUNTS_PER_RADIAN) as i32;
            let points =
                [0.0, 0.0, position].map(|position: f32| JointPoint { position, ..JointPoint::default() });
            _ = rig.ask(Request::Task(TaskCommand::JointServo(JointCommand::Stream {
                points: Vec::from_slice(&points).unwrap(),
            })));
            rig.tick();
        }
        let fault = rig.node.faults().faults[0];
        assert_eq!((fault.cause, fault.joint), (cause, Some(2)), "{steps} steps: {fault:?}");
    }
}

/// Three cases: an encoder jumps by no more than a push could move the joint, and returns in the next tick; a
/// pushed joint keeps moving; a joint that has accelerated gradually stops at once, as at a wall.
#[test]
fn a_leap_that_ends_at_once_is_an_encoder_error() {
    let mut model = model();
    // 0.6 N·m change the velocity of 1 g·m² by 6 rad/s in a tick.
    model.joints[2].servo.observer.inertia = 1e-3;
    model.joints[2].limits.following_error = 1.0;
    let velocity = FaultCause::VelocityLimit;
    let (spike, push): (&[f32], &[f32]) = (&[0.14, -0.14], &[0.14, 0.11]);
    let crash: &[f32] = &[0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.0];
    let cases =
        [(spike, &[velocity, FaultCause::EncoderJump][..]), (push, &[velocity]), (crash, &[velocity])];
    for (changes, causes) in cases {
        let mut rig = Rig::enabled(&model);
        rig.tick();
        let mut position = 0.0_f32;
        for change in changes {
            position += change;
            rig.sensors.encoders[2] = libm::roundf(position * COUNTS_PER_RADIAN) as i32;
            rig.tick();
        }
        let found: std::vec::Vec<_> = rig.node.faults().faults.iter().map(|fault| fault.cause).collect();
        assert_eq!(found, causes, "{changes:?}: {:?}", rig.node.faults().faults);
    }
}

/// Two encoders jump by 0.1 rad each, where 0.08 rad is the velocity limit and 0.16 rad a jump: to the
/// previous angle of the other joint, or not.
#[test]
fn swapped_encoders_are_found_in_their_tick() {
    for (read, cause) in [([0.1, 0.0], Some(FaultCause::EncoderJump)), ([0.1, 0.2], None)] {
        let counts = |angle: f32| libm::roundf(angle * COUNTS_PER_RADIAN) as i32;
        let mut rig = Rig::ready(&model());
        rig.sensors.encoders[2] = counts(0.1);
        (0..30).for_each(|_| _ = rig.tick());
        assert_eq!(rig.enable(), Reply::Done);
        rig.tick();
        (rig.sensors.encoders[1], rig.sensors.encoders[2]) = (counts(read[0]), counts(read[1]));
        let enabled = rig.tick().enabled;
        let found = rig.node.faults().faults.last().map(|fault| fault.cause);
        assert_eq!((found, enabled), (cause, cause.is_none()), "{read:?}");
    }
}

/// For a model without masses the tolerated energy is that of the joints: a flickering count is no gain of
/// energy.
#[test]
fn a_robot_of_links_without_mass_stays_held() {
    let mut model = model();
    for joint in &mut model.joints {
        (joint.link.mass, joint.link.inertia) = (0.0, [0.0; 6]);
        (joint.friction.coulomb, joint.friction.viscous) = (0.0, 0.0);
    }
    let mut rig = Rig::enabled(&model);
    rig.sensors.encoders[1] += 40;
    rig.tick();
    assert_eq!(rig.ask(Request::Stop), Reply::Done);
    for tick in 0..3000 {
        rig.sensors.encoders[1] += if tick % 2 == 0 { 1 } else { -1 };
        assert!(rig.tick().enabled);
    }
    assert_eq!((rig.node.faults().total, rig.node.state.reaction), (1, Reaction::Hold));
}

#[test]
fn a_low_supply_hides_no_missed_ticks() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    rig.sensors.supply = 19_000;
    rig.sensors.sequence += 4;
    assert!(rig.tick().enabled);
    assert_eq!(rig.node.faults().faults[0].cause, FaultCause::LateTick);
    let Reply::Refused(Refusal::Unsafe(alarm)) = ({
        let Reply::Faults(log) = rig.ask(Request::ReadFaults) else { panic!() };
        rig.tick();
        assert_eq!(rig.ask(Request::ClearFaults { total: log.total }), Reply::Done);
        rig.enable()
    }) else {
        panic!("enabled with a low supply")
    };
    assert_eq!(alarm.cause, FaultCause::SupplyLow);
}
