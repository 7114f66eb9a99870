//! Force sensors at the tips: taring and faults.

use heapless::Vec;

use super::bench::{Bench, COUNTS_PER_RADIAN, model, near, refusal};
use super::fingertips::{ANGLES, TIPS, fingers};
use crate::fault::FaultCause;
use crate::model::ForceSensor;
use crate::protocol::{Mode, Refusal, Reply, Request};
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

/// Two fingers whose tips, 10 g each with their centre 20 mm along z, stand on force sensors; gravity along
/// −z.
pub fn feeling_fingers(counts: [[i32; 6]; 2]) -> Bench {
    let mut model = fingers();
    model.chains.iter_mut().for_each(|chain| chain.force_sensor = Some(SENSOR));
    let mut bench = Bench::new();
    bench.sensors.encoders = ANGLES.iter().map(|angle| (angle * COUNTS_PER_RADIAN) as i32).collect();
    bench.sensors.currents = [0; 6].into_iter().collect();
    bench.sensors.forces = counts.into_iter().collect();
    bench.command();
    assert_eq!(bench.push(&model), Reply::Done);
    bench.tick();
    bench
}

#[test]
fn the_weight_of_a_tip_and_the_offset_of_its_sensor_are_not_taken_for_contact() {
    // The first finger's links stand 1.3 rad off z, after 0.1 rad about z: gravity in the tip's frame is
    // 9.81 (sin 1.3, 0, −cos 1.3); the tip's 98.1 mN read (94.53, 0, −26.24) mN, and at its centre they turn
    // by 20 mm · 94.53 mN = 1.8905 mN·m about y.
    let weight = [95, 0, -26, 0, 189, 0];
    let mut bench = feeling_fingers([weight, [0; 6]]);
    let tips = bench.node.tips();
    let [first, second] = tips.tips[..] else { panic!() };
    assert!(near(first.position, TIPS[0], 2e-5), "{first:?}");
    assert!(near(first.force, [0.0; 3], 1e-3) && near(first.torque, [0.0; 3], 2e-5), "{first:?}");
    assert!(!first.tared && second.force.iter().any(|force| force.abs() > 0.05), "{second:?}");
    // An offset of 0.3 N along the tip's x on both: tared it is gone, and 1 N along its z points where the
    // link points.
    bench.sensors.forces = [[weight[0] + 300, 0, -26, 0, 189, 0], [300, 0, 0, 0, 0, 0]].into_iter().collect();
    (0..100).for_each(|_| drop(bench.tick()));
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    bench.sensors.forces[0][2] += 1000;
    bench.tick();
    let tips = bench.node.tips();
    let expected = [0.958_745, 0.096_195, 0.267_499]; // sin 1.3 cos 0.1, sin 1.3 sin 0.1, cos 1.3
    assert!(near(tips.tips[0].force, expected, 3e-3), "{tips:?}");
    assert!(near(tips.tips[1].force, [0.0; 3], 3e-3) && tips.tips[1].tared, "{tips:?}");
}

#[test]
fn force_sensors_that_are_dead_saturated_or_overloaded_are_faults_by_name() {
    let armed = || {
        let mut bench = feeling_fingers([[0; 6]; 2]);
        assert_eq!(bench.arm(), Reply::Done);
        bench.tick();
        bench
    };
    // Noise keeps the first one alive.
    let fault = |change: &dyn Fn(&mut Bench, i32), ticks: i32| {
        let mut bench = armed();
        assert_eq!(bench.ask(Request::Tare), Reply::Done);
        for tick in 0..ticks {
            bench.sensors.forces[0][3] = tick % 2;
            change(&mut bench, tick);
            bench.tick();
            if bench.node.mode() == Mode::Fault {
                return *bench.node.faults().faults.last().unwrap();
            }
            let now = [0, 1, 2, 3, 4, 5].map(|joint| bench.node.state.measured.positions[joint]);
            let hold = Request::Task(TaskCommand::JointServo(JointCommand::Goal {
                positions: Vec::from_slice(&now).unwrap(),
            }));
            bench.ask(hold);
        }
        panic!("no fault")
    };
    let noise = |bench: &mut Bench, tick: i32| bench.sensors.forces[1][4] = tick % 3;
    let dead = fault(&|_, _| {}, 60);
    assert_eq!((dead.cause, dead.joint, dead.limit), (FaultCause::ForceStuck, Some(5), 50.0));
    let saturated = fault(
        &|bench, tick| {
            noise(bench, tick);
            bench.sensors.forces[1][0] = -20_000;
        },
        5,
    );
    assert_eq!(
        (saturated.cause, saturated.joint, saturated.value),
        (FaultCause::ForceSaturated, Some(5), 20_000.0)
    );
    let overload = fault(
        &|bench, tick| {
            noise(bench, tick);
            bench.sensors.forces[0][1] = 500 * tick;
        },
        20,
    );
    assert_eq!((overload.cause, overload.joint, overload.limit), (FaultCause::ForceLimit, Some(2), 5.0));
    assert!((overload.value - 5.5).abs() < 0.1, "{overload:?}");
    let missing = fault(&|bench, _| bench.sensors.forces.truncate(1), 2);
    assert_eq!((missing.cause, missing.value, missing.limit), (FaultCause::SensorCount, 1.0, 2.0));
    assert_eq!(refusal(Bench::ready(&model()).ask(Request::Tare)), Refusal::NoForceSensor);
}
