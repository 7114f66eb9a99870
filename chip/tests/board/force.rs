//! A six-axis force sensor behind an ADS131M06, with the image of `board-weact`.

use tesaki::control::ServoMode;
use tesaki::fault::FaultCause;
use tesaki::model::{Field, Gauges, Problem, RobotModel};
use tesaki::protocol::{ForceSensorFault, Mode, Refusal, Reply, Request, Stream};
use tesaki::task::TaskConfig;
use tesaki::test_support::FORCE_SENSOR;
use tesaki_chip::SECOND;
use tesaki_chip::ads131m06::Defects;
use tesaki_chip::bench::Bench;
use tesaki_chip::mistake::Mistake;

use crate::links::run_with_full_lines;
use crate::rig::acceptance::demand;
use crate::rig::{MOTOR, Refused, Rig, model};

/// A sensor for 20 N and 0.16 N·m with three beams and two bridges on each, no two of them alike: the first
/// one of `tests/oracles/gauges.py`, rounded.
const CALIBRATION: [[f64; 6]; 6] = [
    [-1.26e-7, 4.82e-7, -2.52e-7, -5.0e-6, 2.67e-7, 6.93e-6],
    [5.32e-7, 6.4e-6, 5.75e-7, -3.53e-6, -7.63e-8, -3.86e-6],
    [7.9e-6, 4.22e-8, 7.71e-6, -1.75e-7, 5.89e-6, 5.67e-7],
    [-1.21e-9, 3.16e-9, 5.21e-8, -1.56e-10, -4.29e-8, 4.86e-9],
    [-5.58e-8, 7.62e-9, 3.43e-8, -2.03e-9, 2.52e-8, -4.14e-10],
    [-3.68e-9, 5.59e-8, 1.17e-9, 4.9e-8, -6.25e-9, 7.54e-8],
];
const GAINS: [u8; 6] = [128, 128, 64, 64, 32, 128];
/// Last joint of the chain.
const LAST: u8 = 2;

fn with_gauges() -> RobotModel {
    let mut model = model();
    model.chains[0].force_sensor = Some(FORCE_SENSOR);
    let calibration_matrix = CALIBRATION.map(|row| row.map(|value| value as f32));
    model.gauges = Some(Gauges { chain: 0, calibration_matrix, gains: GAINS });
    model
}

fn bench() -> Bench {
    let mut sensor = tesaki_chip::force_sensor::ForceSensor::new(&CALIBRATION, GAINS);
    sensor.offsets = [900.0, -700.0, 300.0, 500.0, -400.0, 100.0];
    let mut bench = Bench::new([MOTOR; 3], 1);
    bench.force_sensor = Some(sensor);
    bench
}

impl Rig {
    /// Returns a board with a sensor that has just started; the converter is set up 0.15 s after a push.
    fn with_sensor(mistakes: &[Mistake]) -> Self {
        Self::boot_image("weact", bench(), mistakes, with_gauges(), 0.15)
    }

    fn sensor(&mut self) -> &mut tesaki_chip::force_sensor::ForceSensor {
        self.machine.chip.bench.force_sensor.as_mut().unwrap()
    }

    /// Returns the error of the difference of two readings in an axis: noise and a count [N, N·m].
    fn tolerance(&mut self, axis: usize) -> f64 {
        let noise = self.sensor().noise;
        let gauges = CALIBRATION[axis].into_iter().zip(GAINS);
        let sum: f64 = gauges.map(|(value, gain)| value.abs() * noise * f64::from(gain)).sum();
        2.0 * sum + if axis < 3 { 1e-3 } else { 1e-5 }
    }

    fn defects(&mut self) -> &mut Defects {
        &mut self.sensor().converter.defects
    }
}

/// Checks that the wrenches in the sensor frames are those on the tip, as are the core's values after a tare.
fn feels(rig: &mut Rig) -> Result<(), String> {
    let model = rig.model.clone();
    rig.client.push(&mut rig.machine, &model)?;
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Log, every: 1 })?;
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Tips, every: 1 })?;
    rig.try_run(0.3)?;
    let told = |rig: &Rig| -> Result<[f64; 6], String> {
        let sensors = rig.client.sensors.as_ref().ok_or("no log")?;
        demand!(sensors.flags.force_sensor().is_none(), "{:?}", sensors.flags.force_sensor());
        let counts = sensors.forces.first().ok_or("no forces")?;
        Ok(std::array::from_fn(|axis| f64::from(counts[axis]) * if axis < 3 { 1e-3 } else { 1e-5 }))
    };
    let unloaded = told(rig)?;
    demand!(unloaded.iter().any(|value| value.abs() > 0.01), "the gauges have no offset: {unloaded:?}");
    let positions = [0.0; 3].into_iter().collect();
    rig.client.demand(&mut rig.machine, Request::Home { positions })?;
    // A tare right after homing is refused: the filters still have the weight at the earlier angles.
    rig.try_run(1.05)?;
    rig.client.demand(&mut rig.machine, Request::Tare)?;
    for wrench in [
        [6.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, -5.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 7.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.04, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, -0.05, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.06],
        [1.5, 2.5, -3.5, 0.01, 0.02, -0.03],
    ] {
        rig.sensor().wrench = wrench;
        // The value reported for a period is that of its last millisecond.
        rig.try_run(0.03)?;
        let felt = told(rig)?;
        let tip = rig.client.tips.as_ref().and_then(|tips| tips.tips.first()).copied().ok_or("no tips")?;
        // At these joint angles the frames of base and tip have the same axes.
        let [fx, fy, fz] = tip.force.map(f64::from);
        let [mx, my, mz] = tip.torque.map(f64::from);
        for (axis, core) in [fx, fy, fz, mx, my, mz].into_iter().enumerate() {
            let board = felt[axis] - unloaded[axis];
            let expected = wrench[axis];
            for (who, value) in [("the board", board), ("the core", core)] {
                let error = value - expected;
                let tolerance = rig.tolerance(axis);
                demand!(error.abs() < tolerance, "{who} tells {value} of {wrench:?} in axis {axis}");
            }
        }
    }
    rig.sensor().wrench = [0.0; 6];
    demand!(rig.machine.chip.unknown.is_empty(), "unknown registers {:?}", rig.machine.chip.unknown);
    rig.machine.chip.violation().map_or(Ok(()), Err)
}

#[test]
fn the_wrench_on_the_tip_is_the_one_that_the_core_tells() {
    feels(&mut Rig::with_sensor(&[])).unwrap();
}

/// Description, address, mask, value.
const MISTAKES: &[(&str, u32, u32, u32)] = &[
    ("SPI1 CR1: mode 0", 0x4001_3000, 1, 0),
    ("SPI1 CR1: 42 MHz", 0x4001_3000, 7 << 3, 0),
    ("RCC: SPI1 without clock", 0x4002_3844, 1 << 12, 0),
    ("PB4 AF6", 0x4002_0420, 15 << 16, 6 << 16),
    ("PA15 an input: CS", 0x4002_0000, 3 << 30, 0),
    ("SYSCFG EXTICR2: DRDY at PA4", 0x4001_380C, 15, 0),
    ("EXTI FTSR: no falling edge", 0x4001_3C0C, 1 << 4, 0),
];

#[test]
fn mistakes_in_what_it_is_connected_with_are_found() {
    let mut missed = Vec::new();
    for &(name, address, mask, value) in MISTAKES {
        match feels(&mut Rig::with_sensor(&[Mistake { address, mask, value }])) {
            Ok(()) => missed.push(name),
            Err(found) => println!("{name}: {found}"),
        }
    }
    assert!(missed.is_empty(), "missed: {missed:?}");
}

/// Description, failure, fault, and value of the fault.
type Failure = (&'static str, fn(&mut Rig), FaultCause, f32);

const FAILURES: [Failure; 6] = [
    ("frames are damaged", |rig| rig.defects().damaged = true, FaultCause::ForceSilent, 2.0),
    (
        "it restarts",
        |rig| {
            let now = rig.machine.now();
            rig.sensor().converter.restart(now);
        },
        FaultCause::ForceSilent,
        3.0,
    ),
    ("its clock stops", |rig| rig.defects().stopped = true, FaultCause::ForceSilent, 1.0),
    ("it is unplugged", |rig| rig.defects().unplugged = true, FaultCause::ForceSilent, 1.0),
    ("gauge 3 stands", |rig| rig.defects().standing = Some(2), FaultCause::ForceStuck, 1.0),
    ("gauge 6 is at its end", |rig| rig.defects().beyond = Some(5), FaultCause::ForceSaturated, 8_388_607.0),
];

/// Each failure while joints move gives the named fault within two control periods, the joints come to rest
/// and are held, and once the failure is repaired the board continues.
#[test]
fn what_goes_wrong_with_it_is_a_fault_by_name_and_a_controlled_stop() {
    let mut rig = Rig::with_sensor(&[]);
    rig.enable().unwrap();
    for (name, fail, cause, value) in FAILURES {
        rig.goal([0.3, -0.3, 0.15]);
        rig.run(0.1);
        let moved = rig.machine.chip.bench.states.map(|state| state.velocity);
        assert!(moved.iter().any(|velocity| velocity.abs() > 0.1), "{name}: {moved:?}");
        assert_eq!(rig.status().node.mode, Rig::running(), "{name}: {:?}", rig.faults());
        fail(&mut rig);
        // The period in which it happens may still have all its values.
        rig.run(0.025);
        let fault = *rig.faults().last().unwrap();
        assert_eq!((fault.cause, fault.joint, fault.value), (cause, Some(LAST), value), "{name}");
        assert_eq!(rig.status().node.mode, Mode::Fault, "{name}");
        assert!(rig.machine.chip.bench.is_awake(), "{name}: not held");
        rig.run(0.45);
        let states = rig.machine.chip.bench.states;
        assert!(states.iter().all(|state| state.velocity.abs() < 1e-3), "{name}: {states:?}");
        // It is reported for as long as it lasts; a restart is over by now.
        if name != "it restarts" {
            let refused = rig.recover().unwrap_err();
            assert!(refused.contains("Unsafe"), "{name}: {refused}");
        }
        *rig.defects() = Defects::default();
        rig.run(0.2);
        rig.recover().unwrap_or_else(|error| panic!("{name}: {error}"));
        rig.goal([0.0; 3]);
        for _ in 0..50 {
            rig.keep();
            rig.run(0.01);
        }
    }
}

/// Frames that are damaged occasionally are left out.
#[test]
fn a_disturbed_line_is_no_fault() {
    let mut rig = Rig::with_sensor(&[]);
    rig.enable().unwrap();
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Log, every: 1 }).unwrap();
    rig.keep();
    rig.run(0.05);
    let unloaded = rig.client.sensors.clone().unwrap().forces[0][2];
    rig.sensor().wrench = [0.0, 0.0, 5.0, 0.0, 0.0, 0.0];
    for _ in 0..60 {
        rig.defects().damaged = true;
        rig.run(1.3e-3);
        rig.defects().damaged = false;
        rig.keep();
        rig.run(2.9e-3);
    }
    assert_eq!((rig.status().node.mode, rig.faults()), (Rig::running(), vec![]));
    let told = f64::from(rig.client.sensors.clone().unwrap().forces[0][2] - unloaded) * 1e-3;
    assert!((told - 5.0).abs() < rig.tolerance(2), "{told}");
}

/// The model is accepted, as with disconnected encoders: the board answers but cannot be enabled.
#[test]
fn a_board_without_the_converter_cannot_be_enabled() {
    let mut rig = Rig::boot_image("weact", Bench::new([MOTOR; 3], 1), &[], with_gauges(), 0.15);
    let model = rig.model.clone();
    rig.client.push(&mut rig.machine, &model).unwrap();
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Log, every: 1 }).unwrap();
    rig.run(0.5);
    rig.client.demand(&mut rig.machine, Request::Home { positions: [0.0; 3].into_iter().collect() }).unwrap();
    let reply = rig.ask(Request::Enable(TaskConfig::JointServo(ServoMode::Observer)));
    let Reply::Refused(Refusal::Unsafe(fault)) = reply else { panic!("{reply:?}") };
    assert_eq!((fault.cause, fault.joint, fault.value), (FaultCause::ForceSilent, Some(LAST), 1.0));
    let flags = rig.client.sensors.as_ref().unwrap().flags;
    assert_eq!(flags.force_sensor(), Some(ForceSensorFault::Silent));
    assert!(!rig.machine.chip.bench.is_awake() || rig.machine.chip.bench.last_driven == 0);
}

#[test]
fn what_the_board_lacks_for_a_force_sensor_is_refused_at_the_push() {
    let mut rig = Rig::with_sensor(&[]);
    let refusals: [Refused; 2] = [
        (|model| model.gauges = None, Some(LAST), Field::Gauges, Problem::Missing),
        (
            |model| {
                let mut second = model.chains[0].clone();
                second.name = "second".try_into().unwrap();
                (model.chains[0].joints, second.joints) = (1, 2);
                model.chains.push(second).unwrap();
            },
            Some(LAST),
            Field::ForceResolution,
            Problem::BoardLimit(1.0),
        ),
    ];
    rig.refuses(&refusals);
    let mut odrive = Rig::odrive(&[]);
    let refusals: [Refused; 2] = [
        (
            |model| {
                let with_gauges = with_gauges();
                model.chains[0].force_sensor = with_gauges.chains[0].force_sensor;
                model.gauges = with_gauges.gauges;
            },
            Some(1),
            Field::Gauges,
            Problem::NotSupported,
        ),
        (
            |model| model.chains[0].force_sensor = with_gauges().chains[0].force_sensor,
            Some(1),
            Field::ForceResolution,
            Problem::BoardLimit(0.0),
        ),
    ];
    odrive.refuses(&refusals);
}

/// The frames are exchanged between the control periods, and delay nothing that must not wait.
#[test]
fn timing_with_a_force_sensor() {
    const MICROSECONDS: f64 = 1.5 / 168.0;
    let mut rig = Rig::with_sensor(&[]);
    rig.enable().unwrap();
    rig.goal([0.3, -0.3, 0.15]);
    // Two frames at once: the first one after the start.
    let started = rig.machine.work[16 + 9].longest as f64 * MICROSECONDS;
    println!("EXTI3: {started:.1} µs after the start");
    rig.machine.work.iter_mut().for_each(|work| *work = Default::default());
    let begin = rig.machine.now();
    run_with_full_lines(&mut rig, 300, |_, _| {});
    assert_eq!((rig.status().node.mode, rig.faults()), (Rig::running(), vec![]));
    assert_eq!(rig.machine.chip.supervisor().lost, 0);
    let seconds = (rig.machine.now() - begin) as f64 / SECOND as f64;
    let limits = [
        ("TIM2: instant of the period", 28, 1.5),
        ("ADC: current loops", 18, 8.0),
        ("EXTI4: a value is ready", 10, 1.0),
        // It polls the bus: the clocks of 24 bytes take 18 µs.
        ("EXTI3: a frame of the converter", 9, 35.0),
        ("EXTI0: control", 6, 5000.0),
    ];
    for (name, number, limit) in limits {
        let work = rig.machine.work[16 + number];
        let longest = work.longest as f64 * MICROSECONDS;
        let mean = work.instructions as f64 / work.times as f64 * MICROSECONDS;
        let rate = work.times as f64 / seconds;
        println!("{name}: {mean:.1} µs, {longest:.1} µs at most, {rate:.0} a second");
        assert!(longest < limit, "{name}: {longest} µs");
    }
    assert!(started < 70.0, "{started}");
    let rate = rig.machine.work[16 + 9].times as f64 / seconds;
    assert!((rate - 1000.0).abs() < 20.0, "{rate}");
}
