//! Force sensors at the tips: taring and faults.

use heapless::Vec;

use super::fingertips::{ANGLES, TIPS, fingers};
use super::rig::{COUNTS_PER_RADIAN, Rig, model, near, refusal};
use crate::fault::{Fault, FaultCause};
use crate::model::{ForceSensor, Reaction};
use crate::node::force_sensor::TARE_DELAY;
use crate::protocol::{ForceSensorFault, Mode, Refusal, Reply, Request, SensorFlags};
use crate::task::TaskCommand;
use crate::task::joint_servo::JointCommand;

pub const SENSOR: ForceSensor = ForceSensor {
    force_resolution: 1e-3,
    torque_resolution: 1e-5,
    saturation: 20_000,
    force_limit: 5.0,
    mass: 0.01,
    center_of_mass: [0.0, 0.0, 0.02],
};

/// Two fingers with force sensors. Each tip has 10 g, with the centre of mass 20 mm along z; gravity along
/// −z.
pub fn fingers_with_force_sensors(counts: [[i32; 6]; 2]) -> Rig {
    let mut model = fingers();
    model.chains.iter_mut().for_each(|chain| chain.force_sensor = Some(SENSOR));
    let mut rig = Rig::new();
    rig.sensors.encoders = ANGLES.iter().map(|angle| (angle * COUNTS_PER_RADIAN) as i32).collect();
    rig.sensors.currents = [0; 6].into_iter().collect();
    rig.sensors.forces = counts.into_iter().collect();
    rig.command();
    assert_eq!(rig.push(&model), Reply::Done);
    rig.tick();
    rig
}

#[test]
fn weight_of_the_tip_and_offset_of_the_sensor_are_compensated() {
    // The first finger's last link is at 1.3 rad from z: gravity in the tip's frame is 9.81 (sin 1.3, 0, −cos
    // 1.3). The tip's weight of 98.1 mN reads (94.53, 0, −26.24) mN, with the moment 20 mm · 94.53 mN =
    // 1.8905 mN·m about y.
    let weight = [95, 0, -26, 0, 189, 0];
    let mut rig = fingers_with_force_sensors([weight, [0; 6]]);
    let tips = rig.node.tips();
    let [first, second] = tips.tips[..] else { panic!() };
    assert!(near(first.position, TIPS[0], 2e-5), "{first:?}");
    assert!(near(first.force, [0.0; 3], 1e-3) && near(first.torque, [0.0; 3], 2e-5), "{first:?}");
    assert!(!first.tared && second.force.iter().any(|force| force.abs() > 0.05), "{second:?}");
    // The tare removes an offset of 0.3 N along the tip's x. Then 1 N along its z has the direction of the
    // link.
    rig.sensors.forces = [[weight[0] + 300, 0, -26, 0, 189, 0], [300, 0, 0, 0, 0, 0]].into_iter().collect();
    for tick in 0..100 {
        rig.sensors.forces.iter_mut().for_each(|counts| counts[5] = tick % 2);
        rig.tick();
    }
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    rig.sensors.forces[0][2] += 1000;
    rig.tick();
    let tips = rig.node.tips();
    let expected = [0.958_745, 0.096_195, 0.267_499]; // sin 1.3 cos 0.1, sin 1.3 sin 0.1, cos 1.3
    assert!(near(tips.tips[0].force, expected, 3e-3), "{tips:?}");
    assert!(near(tips.tips[1].force, [0.0; 3], 3e-3) && tips.tips[1].tared, "{tips:?}");
}

#[test]
fn dead_saturated_and_overloaded_force_sensors_are_faults_by_name() {
    let enabled = || {
        let mut rig = fingers_with_force_sensors([[0; 6]; 2]);
        assert_eq!(rig.enable(), Reply::Done);
        rig.tick();
        rig
    };
    // Noise on the first sensor: constant counts would be a fault.
    let fault = |change: &dyn Fn(&mut Rig, i32), ticks: i32| {
        let mut rig = enabled();
        assert_eq!(rig.ask(Request::Tare), Reply::Done);
        for tick in 0..ticks {
            rig.sensors.forces[0][3] = tick % 2;
            change(&mut rig, tick);
            rig.tick();
            if rig.node.mode() == Mode::Fault {
                return *rig.node.faults().faults.last().unwrap();
            }
            let now = [0, 1, 2, 3, 4, 5].map(|joint| rig.node.state.measured.positions[joint]);
            let hold = Request::Task(TaskCommand::JointServo(JointCommand::Goal {
                positions: Vec::from_slice(&now).unwrap(),
            }));
            rig.ask(hold);
        }
        panic!("no fault")
    };
    let noise = |rig: &mut Rig, tick: i32| rig.sensors.forces[1][4] = tick % 3;
    let dead = fault(&|_, _| {}, 60);
    assert_eq!((dead.cause, dead.joint, dead.limit), (FaultCause::ForceStuck, Some(5), 50.0));
    let saturated = fault(
        &|rig, tick| {
            noise(rig, tick);
            rig.sensors.forces[1][0] = -20_000;
        },
        5,
    );
    assert_eq!(
        (saturated.cause, saturated.joint, saturated.value),
        (FaultCause::ForceSaturated, Some(5), 20_000.0)
    );
    let overload = fault(
        &|rig, tick| {
            noise(rig, tick);
            rig.sensors.forces[0][1] = 500 * tick;
        },
        20,
    );
    assert_eq!((overload.cause, overload.joint, overload.limit), (FaultCause::ForceLimit, Some(2), 5.0));
    assert!((overload.value - 5.5).abs() < 0.1, "{overload:?}");
    let missing = fault(&|rig, _| rig.sensors.forces.truncate(1), 2);
    assert_eq!((missing.cause, missing.value, missing.limit), (FaultCause::SensorCount, 1.0, 2.0));
    assert_eq!(refusal(Rig::ready(&model()).ask(Request::Tare)), Refusal::NoForceSensor);
}

/// A force that caused the fault lasts while the robot is held: it is no sign that holding fails.
#[test]
fn a_stop_while_a_robot_is_held_leaves_it_held() {
    let mut rig = fingers_with_force_sensors([[0; 6]; 2]);
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    assert_eq!(rig.enable(), Reply::Done);
    rig.tick();
    rig.sensors.forces[0][1] = 5500;
    for tick in 0..10 {
        rig.sensors.forces.iter_mut().for_each(|counts| counts[3] = tick % 2);
        assert!(rig.tick().enabled);
        assert_eq!(rig.node.reaction().0, Reaction::Hold, "{tick}");
        if tick == 4 {
            rig.ask(Request::Stop);
        }
    }
    let causes: std::vec::Vec<_> = rig.node.faults().faults.iter().map(|fault| fault.cause).collect();
    assert_eq!(causes, [FaultCause::ForceLimit, FaultCause::Stop]);
}

/// After a reset the log still has the faults of before, in ticks that are yet to come.
#[test]
fn a_fault_from_before_a_reset_is_not_the_one_that_a_stop_reacts_to() {
    let mut rig = fingers_with_force_sensors([[0; 6]; 2]);
    let earlier =
        Fault { cause: FaultCause::ForceLimit, joint: Some(2), value: 6.0, limit: 5.0, tick: 360_000 };
    rig.node.state.faults.record(earlier);
    let Reply::Faults(_) = rig.ask(Request::ReadFaults) else { panic!() };
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    assert_eq!(rig.enable(), Reply::Done);
    rig.tick();
    rig.ask(Request::Stop);
    assert_eq!(rig.node.reaction().0, Reaction::Hold);
    rig.sensors.forces[0][1] = 5500;
    for tick in 0..10 {
        rig.sensors.forces.iter_mut().for_each(|counts| counts[3] = tick % 2);
        rig.tick();
    }
    assert_eq!(rig.node.reaction().0, Reaction::Damp);
}

#[test]
fn what_the_board_finds_wrong_with_gauges_is_a_fault_by_name_and_a_hold() {
    for (told, cause, value, limit) in [
        (ForceSensorFault::Silent, FaultCause::ForceSilent, 1.0, 0.0),
        (ForceSensorFault::Damaged, FaultCause::ForceSilent, 2.0, 0.0),
        (ForceSensorFault::Restarted, FaultCause::ForceSilent, 3.0, 0.0),
        (ForceSensorFault::Stuck(4), FaultCause::ForceStuck, 1.0, 0.0),
        (ForceSensorFault::Saturated(1), FaultCause::ForceSaturated, 8_388_607.0, 8_388_607.0),
    ] {
        let mut rig = fingers_with_force_sensors([[300, 0, 0, 0, 0, 0], [0; 6]]);
        assert_eq!(rig.enable(), Reply::Done);
        rig.tick();
        let felt = rig.node.tips().tips[0].force;
        // The counts that come with the fault are invalid.
        rig.sensors.flags = SensorFlags(0).with_force_sensor(told);
        rig.sensors.forces[0] = [-900, 800, 700, 0, 0, 0];
        let frame = rig.tick();
        let fault = *rig.node.faults().faults.last().unwrap();
        assert_eq!((fault.cause, fault.joint), (cause, Some(2)));
        assert_eq!((fault.value, fault.limit), (value, limit));
        assert_eq!(rig.node.mode(), Mode::Fault);
        assert!(frame.enabled, "{told:?}: it can be held");
        assert_eq!(rig.node.tips().tips[0].force, felt);
    }
}

/// A tare with invalid readings would be an error of every later force.
#[test]
fn a_sensor_that_gives_no_wrench_is_not_tared() {
    let mut rig = fingers_with_force_sensors([[300, 0, 0, 0, 0, 0], [0; 6]]);
    rig.sensors.flags = SensorFlags(0).with_force_sensor(ForceSensorFault::Restarted);
    rig.tick();
    let Refusal::Unsafe(fault) = refusal(rig.ask(Request::Tare)) else { panic!() };
    assert_eq!(fault.cause, FaultCause::ForceSilent);
    // Another fault that masks that one, and one that comes with an outdated wrench.
    rig.sensors.flags = SensorFlags(SensorFlags::EMERGENCY_STOP).with_force_sensor(ForceSensorFault::Silent);
    rig.tick();
    let Refusal::Unsafe(fault) = refusal(rig.ask(Request::Tare)) else { panic!() };
    assert_eq!(fault.cause, FaultCause::EmergencyStop);
    rig.sensors.flags = SensorFlags(0).with_force_sensor(ForceSensorFault::Stuck(2));
    rig.tick();
    let Refusal::Unsafe(fault) = refusal(rig.ask(Request::Tare)) else { panic!() };
    assert_eq!(fault.cause, FaultCause::ForceStuck);
    assert!(rig.node.tips().tips.iter().all(|tip| !tip.tared));
    rig.sensors.flags = SensorFlags(0);
    rig.tick();
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
}

/// 200 g on the sensor of a finger with a wrong zero: the weight for one posture would be subtracted from the
/// readings in another.
#[test]
fn a_sensor_is_tared_in_a_posture_that_is_known() {
    let mut model = fingers();
    for chain in &mut model.chains {
        chain.force_sensor = Some(ForceSensor { mass: 0.2, ..SENSOR });
    }
    model.joints[1].encoder.relative = true;
    let mut rig = fingers_with_force_sensors([[0; 6]; 2]);
    assert_eq!(rig.push(&model), Reply::Done);
    rig.tick();
    assert_eq!(refusal(rig.ask(Request::Tare)), Refusal::NotHomed { joint: 1 });
    let home =
        |angle| Request::Home { positions: Vec::from_slice(&[0.0, angle, 0.0, 0.0, 0.0, 0.0]).unwrap() };
    assert_eq!(rig.ask(home(0.0)), Reply::Done);
    let settle = |rig: &mut Rig| {
        for tick in 0..TARE_DELAY {
            assert_eq!(refusal(rig.ask(Request::Tare)), Refusal::NoSensors, "{tick}");
            // Constant counts would be a fault.
            rig.sensors.forces.iter_mut().for_each(|counts| counts[5] = i32::from(tick & 1));
            rig.tick();
        }
    };
    settle(&mut rig);
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    assert!(rig.node.tips().tips.iter().all(|tip| tip.tared));
    // After a new zero the earlier tare is invalid, and the filter forgets the earlier readings.
    assert_eq!(rig.ask(home(0.5)), Reply::Done);
    assert!(rig.node.tips().tips.iter().all(|tip| !tip.tared));
    settle(&mut rig);
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    rig.tick();
    let force = rig.node.tips().tips[0].force;
    // 0.2 % of 2 N, the weight.
    assert!(force.iter().all(|value| value.abs() < 4e-3), "{force:?}");
}

/// The counts alone show the faults that the board reports.
#[test]
fn a_dead_or_saturated_sensor_is_not_tared() {
    let mut rig = fingers_with_force_sensors([[300, 0, 0, 0, 0, 0], [0; 6]]);
    for tick in 0..60 {
        rig.sensors.forces[1][5] = tick % 2;
        rig.tick();
    }
    let Refusal::Unsafe(fault) = refusal(rig.ask(Request::Tare)) else { panic!() };
    assert_eq!((fault.cause, fault.joint), (FaultCause::ForceStuck, Some(2)));
    rig.sensors.forces[0][0] = 20_000;
    rig.tick();
    let Refusal::Unsafe(fault) = refusal(rig.ask(Request::Tare)) else { panic!() };
    assert_eq!((fault.cause, fault.joint), (FaultCause::ForceSaturated, Some(2)));
    rig.sensors.forces[0][0] = 301;
    rig.tick();
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
}

/// A fault of gauges is ignored for a robot without force sensor.
#[test]
fn a_robot_without_force_sensors_ignores_what_is_told_of_gauges() {
    let mut rig = Rig::ready(&model());
    assert_eq!(rig.enable(), Reply::Done);
    rig.sensors.flags = SensorFlags(0).with_force_sensor(ForceSensorFault::Silent);
    rig.tick();
    assert_eq!(rig.node.mode(), Mode::Enabled(crate::task::TaskKind::JointServo));
}
