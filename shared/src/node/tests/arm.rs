//! An arm under impedance from outside: what is refused, what faults, and what the outputs do then.

use heapless::Vec;
use nalgebra::Vector3;

use super::bench::{Bench, COUNTS_PER_RADIAN, refusal};
use super::grasp::KEEP;
use crate::TICK;
use crate::fault::{Fault, FaultCause};
use crate::kinematics::{Chain, ElbowSetpoint, PosePoint};
use crate::model::{ForceSensor, MAX_CHAIN_JOINTS, MAX_JOINTS, RobotModel};
use crate::protocol::{Mode, Refusal, Reply, Request};
use crate::task::impedance::InvalidSettings;
use crate::task::impedance::tests::{SOFT, arm7};
use crate::task::impedance::{
    ForceSource, ImpedanceCommand, ImpedanceRefusal, ImpedanceSettings, ImpedanceTelemetry, Redundancy,
    SetpointError,
};
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig, TaskKind, TaskRefusal, TaskTelemetry};

/// Enables impedance control with these settings.
pub(super) fn enable(settings: ImpedanceSettings) -> Request {
    Request::Enable(TaskConfig::Impedance(settings))
}

pub(super) fn configure(settings: ImpedanceSettings) -> Request {
    Request::Task(TaskCommand::Impedance(ImpedanceCommand::Configure(settings)))
}

fn refused(refusal: ImpedanceRefusal) -> Refusal {
    Refusal::Task(TaskRefusal::Impedance(refusal))
}

/// Elbow bent by 90°, the rest a little.
pub(super) const ANGLES: [f32; MAX_CHAIN_JOINTS] = [0.3, 0.2, -0.1, 1.57, 0.1, 0.2, -0.1];

const SENSOR: ForceSensor = ForceSensor {
    force_resolution: 0.01,
    torque_resolution: 1e-3,
    saturation: 20_000,
    force_limit: 150.0,
    mass: 0.0,
    center_of_mass: [0.0; 3],
};

fn feeling() -> RobotModel {
    let mut model = arm7();
    model.chains[0].force_sensor = Some(SENSOR);
    model
}

/// Disarmed and not tared, without settings.
pub(super) fn bench(model: &RobotModel) -> Bench {
    let mut bench = Bench::new();
    bench.sensors.currents = [0; 7].into_iter().collect();
    bench.sensors.forces =
        model.chains.iter().filter_map(|chain| chain.force_sensor.map(|_| [0; 6])).collect();
    stand(&mut bench, &ANGLES);
    bench.command();
    assert_eq!(bench.push(model), Reply::Done);
    bench.tick();
    bench
}

fn armed() -> Bench {
    let mut bench = bench(&feeling());
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    assert_eq!(bench.ask(enable(SOFT)), Reply::Done);
    bench
}

pub(super) fn stand(bench: &mut Bench, angles: &[f32]) {
    bench.sensors.encoders =
        angles.iter().map(|angle| libm::roundf(angle * COUNTS_PER_RADIAN) as i32).collect();
}

/// A bench with a machine whose joints have the accelerations that they are to have.
struct Machine {
    bench: Bench,
    angles: [f32; 7],
    velocities: [f32; 7],
}

impl Machine {
    fn armed() -> Self {
        Self { bench: armed(), angles: ANGLES, velocities: [0.0; 7] }
    }

    /// A tick later, while the world pushes the tool; whether the node is still armed.
    fn tick(&mut self, wrench: [f32; 6]) -> bool {
        let references = &self.bench.node.state.references;
        let joints = self.angles.iter_mut().zip(&mut self.velocities).zip(references);
        for ((angle, velocity), reference) in joints {
            let acceleration = reference.acceleration;
            *angle += TICK * (*velocity + 0.5 * TICK * acceleration);
            *velocity += TICK * acceleration;
        }
        stand(&mut self.bench, &self.angles);
        // The sensor has the axes of the tool. Noise keeps it alive.
        let model = arm7();
        let chain = Chain::new(&model.joints, &model.chains[0].tip);
        let turn = chain.posture(&self.angles).tip().rotation.inverse();
        let [fx, fy, fz, tx, ty, tz] = wrench;
        let force = turn * Vector3::new(fx, fy, fz) / SENSOR.force_resolution;
        let torque = turn * Vector3::new(tx, ty, tz) / SENSOR.torque_resolution;
        let noise = self.bench.sensors.sequence as i32 % 2;
        self.bench.sensors.forces[0] =
            [force.x, force.y, force.z, torque.x, torque.y, torque.z].map(|value| value as i32 + noise);
        self.bench.tick();
        matches!(self.bench.node.mode(), Mode::Enabled(_))
    }
}

pub(super) fn seen(bench: &mut Bench) -> ImpedanceTelemetry {
    let Reply::Task(report) = bench.ask(Request::ReadTask) else { panic!() };
    assert_eq!(Some(&report), bench.node.task_report().as_ref());
    let TaskTelemetry::Impedance(arm) = report.telemetry else { panic!() };
    arm
}

fn fault(bench: &Bench) -> Fault {
    *bench.node.faults().faults.last().unwrap()
}

fn pose(point: PosePoint, elbow: ElbowSetpoint) -> Request {
    Request::Task(TaskCommand::Impedance(ImpedanceCommand::SetTarget { point, elbow }))
}

/// The set-point where the tool is.
fn here(bench: &mut Bench) -> (PosePoint, ElbowSetpoint) {
    let ImpedanceTelemetry { position, rotation, elbow, .. } = seen(bench);
    let point = PosePoint { position, rotation, velocity: [0.0; 6], acceleration: [0.0; 6] };
    (point, ElbowSetpoint { angle: elbow, ..ElbowSetpoint::default() })
}

#[test]
fn impedance_control_needs_an_arm_valid_settings_and_a_tared_sensor() {
    let mut short = feeling();
    short.joints.truncate(5);
    short.chains[0].joints = 5;
    let mut bench = Bench::new();
    bench.command();
    assert_eq!(refusal(bench.ask(enable(SOFT))), Refusal::NoModel);
    assert_eq!(refusal(bench.ask(Request::ReadTask)), Refusal::NoTask);
    assert_eq!(bench.push(&short), Reply::Done);
    bench.sensors.encoders = [0; 5].into_iter().collect();
    bench.sensors.currents = [0; 5].into_iter().collect();
    bench.sensors.forces = [[0; 6]].into_iter().collect();
    bench.tick();
    assert_eq!(refusal(bench.ask(enable(SOFT))), refused(ImpedanceRefusal::NotAnArm));
    assert_eq!(
        refused(ImpedanceRefusal::NotAnArm).to_string(),
        "the robot is not an arm: a single chain of six or seven joints"
    );

    let mut bench = self::bench(&feeling());
    assert_eq!(refusal(bench.ask(enable(SOFT))), refused(ImpedanceRefusal::NotTared { chain: 0 }));
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    let invalid = ImpedanceSettings { contact_force: 0.0, ..SOFT };
    assert_eq!(
        refusal(bench.ask(enable(invalid))).to_string(),
        "the contact force is 0 N; it must be positive and finite"
    );
    assert_eq!(bench.node.mode(), Mode::Disabled);
    assert_eq!(bench.ask(enable(SOFT)), Reply::Done);
    assert_eq!(bench.node.mode(), Mode::Enabled(TaskKind::Impedance));
    assert_eq!(bench.node.mode().to_string(), "enabled (impedance control)");
    assert_eq!(refusal(bench.ask(enable(SOFT))), Refusal::WrongMode(Mode::Enabled(TaskKind::Impedance)));
    assert_eq!(
        refusal(bench.ask(configure(invalid))),
        refused(ImpedanceRefusal::Settings(InvalidSettings::ContactForce { value: 0.0 }))
    );
    let source = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, ..SOFT };
    assert_eq!(refusal(bench.ask(configure(source))), refused(ImpedanceRefusal::ForceSourceInUse));
}

#[test]
fn without_a_force_sensor_the_motors_tell_the_force() {
    let mut bench = bench(&arm7());
    assert_eq!(refusal(bench.ask(enable(SOFT))), refused(ImpedanceRefusal::NoForceSensor));
    let fast = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 60.0 }, ..SOFT };
    assert_eq!(
        refusal(bench.ask(enable(fast))).to_string(),
        "the bandwidth of the force observer is 60 rad/s; possible is 10 to 50 rad/s"
    );
    assert_eq!(refusal(bench.ask(Request::Tare)), Refusal::NoForceSensor);
    let observing = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, ..SOFT };
    assert_eq!(bench.ask(enable(observing)), Reply::Done);
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
}

#[test]
fn the_joints_of_an_arm_under_impedance_control_take_commands_of_no_other_task() {
    let mut bench = armed();
    let other = Refusal::OtherTask(TaskKind::Impedance);
    for command in [
        JointCommand::Goal { positions: Vec::from_slice(&[0.0; 7]).unwrap() },
        JointCommand::Stream { points: Vec::new() },
        JointCommand::Reach { tips: Vec::new() },
    ] {
        assert_eq!(refusal(bench.ask(Request::Task(TaskCommand::JointServo(command)))), other);
    }
    assert_eq!(other.to_string(), "the board runs another task: impedance control");
    assert_eq!(bench.ask(KEEP), Reply::Done);
    let (point, elbow) = here(&mut bench);
    assert_eq!(bench.ask(pose(point, elbow)), Reply::Done);
    // And its own commands are for no other task.
    bench.ask(Request::Disable);
    assert_eq!(refusal(bench.ask(pose(point, elbow))), Refusal::WrongMode(Mode::Disabled));
    assert_eq!(refusal(bench.ask(configure(SOFT))), Refusal::WrongMode(Mode::Disabled));
    bench.arm();
    assert_eq!(refusal(bench.ask(pose(point, elbow))), Refusal::OtherTask(TaskKind::JointServo));
    assert_eq!(refusal(bench.ask(configure(SOFT))), Refusal::OtherTask(TaskKind::JointServo));
    bench.ask(Request::Stop);
    assert_eq!(refusal(bench.ask(configure(SOFT))), Refusal::WrongMode(Mode::Fault));
}

#[test]
fn a_pose_that_jumps_is_refused_by_name_and_the_arm_stays() {
    let mut machine = Machine::armed();
    assert!(machine.tick([0.0; 6]));
    let (point, elbow) = here(&mut machine.bench);
    let [x, y, z] = point.position;
    let [i, j, k, w] = point.rotation;
    let far = PosePoint { position: [x, y, z + 1.0], ..point };
    let Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::Distance {
        value,
        limit: 0.1,
    }))) = refusal(machine.bench.ask(pose(far, elbow)))
    else {
        panic!()
    };
    assert!((value - 1.0).abs() < 1e-3);
    // Half a turn about x.
    let turned = PosePoint { rotation: [w, -k, j, -i], ..point };
    let text = refusal(machine.bench.ask(pose(turned, elbow))).to_string();
    assert!(
        text.starts_with("the set-point is rotated by 3.14") && text.ends_with("at most 1 rad is allowed"),
        "{text}"
    );
    let other = ElbowSetpoint { angle: elbow.angle + 3.0, ..elbow };
    assert!(matches!(
        refusal(machine.bench.ask(pose(point, other))),
        Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::Elbow { .. })))
    ));
    let spoilt = PosePoint { position: [x, f32::NAN, z], ..point };
    assert_eq!(
        refusal(machine.bench.ask(pose(spoilt, elbow))),
        Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::NotFinite)))
    );
    let long = PosePoint { rotation: [0.0, 0.0, 0.0, 2.0], ..point };
    assert_eq!(
        refusal(machine.bench.ask(pose(long, elbow))),
        Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::NotUnit {
            norm: 2.0
        })))
    );
    for _ in 0..9 {
        assert!(machine.tick([0.0; 6]));
    }
    let after = seen(&mut machine.bench);
    assert!(after.error.iter().all(|value| value.abs() < 2e-4), "{after:?}");
    // A refused pose is no sign of life.
    assert!(!machine.tick([0.0; 6]));
    assert_eq!(fault(&machine.bench).cause, FaultCause::CommandTimeout);
}

#[test]
fn an_arm_follows_its_set_point_and_yields_to_a_push() {
    let mut machine = Machine::armed();
    assert!(machine.tick([0.0; 6]));
    let (mut point, elbow) = here(&mut machine.bench);
    point.position[0] += 0.03;
    let start = seen(&mut machine.bench).position;
    for _ in 0..200 {
        assert_eq!(machine.bench.ask(pose(point, elbow)), Reply::Done);
        assert!(machine.tick([0.0; 6]), "{:?}", machine.bench.node.faults());
    }
    let there = seen(&mut machine.bench);
    assert!((there.position[0] - start[0] - 0.03).abs() < 1e-3 && !there.contact, "{there:?}");
    assert!((there.elbow - elbow.angle).abs() < 5e-3, "{there:?}");
    for _ in 0..300 {
        assert_eq!(machine.bench.ask(KEEP), Reply::Done);
        assert!(machine.tick([0.0, 15.0, 0.0, 0.0, 0.0, 0.0]));
    }
    // 15 N on 300 N/m.
    let pushed = seen(&mut machine.bench);
    assert!(pushed.contact && (pushed.error[1] - 0.05).abs() < 3e-3, "{pushed:?}");
    assert!((pushed.wrench[1] - 15.0).abs() < 0.1, "{pushed:?}");
    for _ in 0..300 {
        assert_eq!(machine.bench.ask(KEEP), Reply::Done);
        assert!(machine.tick([0.0; 6]));
    }
    let back = seen(&mut machine.bench);
    assert!(!back.contact && back.error[..3].iter().all(|value| value.abs() < 1e-3), "{back:?}");
}

/// Pulled until it faults.
fn pulled_away(wrench: [f32; 6]) -> Machine {
    let mut machine = Machine::armed();
    let narrow = ImpedanceSettings { reach: [0.1, 0.3], ..SOFT };
    assert_eq!(machine.bench.ask(configure(narrow)), Reply::Done);
    assert!((0..500).any(|_| {
        machine.bench.ask(KEEP);
        !machine.tick(wrench)
    }));
    machine
}

/// The torques of the first tick and of the hundredth after the fault, with a joint displaced by so much, and
/// the sensor pushed.
fn held(wrench: [f32; 6], joint: usize, displacement: f32, push: [i32; 6]) -> [Vec<f32, MAX_JOINTS>; 2] {
    let Machine { mut bench, .. } = pulled_away(wrench);
    bench.sensors.encoders[joint] += libm::roundf(displacement * COUNTS_PER_RADIAN) as i32;
    let mut tick = || {
        // Noise keeps the sensor alive.
        let noise = bench.sensors.sequence as i32 % 2;
        bench.sensors.forces[0] = push.map(|count| count + noise);
        let output = bench.tick();
        assert!(output.enabled && bench.node.mode() == Mode::Fault);
        output.torques
    };
    let first = tick();
    [first, (0..99).map(|_| tick()).last().unwrap()]
}

#[test]
fn a_tool_that_is_pulled_away_is_a_fault_and_the_arm_holds() {
    let cases = [
        ([0.0, 0.0, 40.0, 0.0, 0.0, 0.0], FaultCause::ToolAway, 0.1),
        ([0.0, 2.0, 0.0, 0.0, 0.0, 4.0], FaultCause::ToolTurned, 0.3),
    ];
    for (wrench, cause, limit) in cases {
        let mut machine = pulled_away(wrench);
        let found = fault(&machine.bench);
        assert_eq!((found.cause, found.joint, found.limit), (cause, None, limit));
        assert!(found.value > limit && found.value < 1.3 * limit, "{found}");
        assert!(found.to_string().contains(cause.description()), "{found}");
        assert_eq!(machine.bench.node.mode(), Mode::Fault);
        // It no longer yields: however the tool is pushed, the torques are the same.
        let still = held(wrench, 0, 0.0, [0; 6]);
        assert_eq!(held(wrench, 0, 0.0, [3000, -2000, 4000, 0, 500, -500]), still);
        // It holds where it is: a joint that is displaced is pushed back, no less than by a spring of the
        // servo's bandwidth, at once by no more than brings it back within a period, and harder when that
        // does not help.
        let observer = arm7().joints[0].servo.observer;
        let least = observer.inertia * observer.bandwidth * observer.bandwidth;
        for (joint, displacement) in [(0, 0.02), (1, -0.02), (3, 0.02), (3, -0.02), (6, 0.02)] {
            let displaced = held(wrench, joint, displacement, [0; 6]);
            let back = |at: usize| (still[at][joint] - displaced[at][joint]) / displacement;
            let (first, last) = (back(0), back(1));
            let most = observer.inertia / (TICK * TICK);
            assert!((least..=most).contains(&first) && last > first, "{joint}: {first} {last}");
        }
        let Reply::Faults(log) = machine.bench.ask(Request::ReadFaults) else { panic!() };
        assert_eq!(machine.bench.ask(Request::ClearFaults { total: log.total }), Reply::Done);
        assert_eq!(machine.bench.ask(enable(SOFT)), Reply::Done);
        assert!(seen(&mut machine.bench).error.iter().all(|value| value.abs() < 1e-6));
    }
}

#[test]
fn silence_ends_in_the_reaction() {
    let mut machine = Machine::armed();
    (0..10).for_each(|_| assert!(machine.tick([0.0; 6])));
    assert_eq!(machine.bench.ask(configure(SOFT)), Reply::Done);
    (0..10).for_each(|_| assert!(machine.tick([0.0; 6])));
    assert!(!machine.tick([0.0; 6]));
    assert_eq!(fault(&machine.bench).cause, FaultCause::CommandTimeout);
    assert!(machine.bench.tick().enabled);
}

#[test]
fn a_disabled_arm_still_shows_where_it_is() {
    let mut bench = bench(&feeling());
    assert_eq!(refusal(bench.ask(Request::ReadTask)), Refusal::NoTask);
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    let redundancy = Redundancy::DrivenJoint { joint: 2 };
    assert_eq!(bench.ask(enable(ImpedanceSettings { redundancy, ..SOFT })), Reply::Done);
    let first = seen(&mut bench);
    assert!(!first.contact && (first.elbow - ANGLES[2]).abs() < 1e-4);
    bench.ask(Request::Disable);
    // Led by hand, and pushed.
    let mut moved = ANGLES;
    moved[3] += 0.1;
    stand(&mut bench, &moved);
    bench.sensors.forces[0][0] = 500;
    bench.tick();
    let after = seen(&mut bench);
    assert!((after.position[2] - first.position[2]).abs() > 0.01, "{after:?}");
    assert!(after.wrench[..3].iter().map(|force| force * force).sum::<f32>() > 24.0, "{after:?}");
    // With the model goes what was known of the task.
    assert_eq!(bench.push(&feeling()), Reply::Done);
    assert_eq!(refusal(bench.ask(Request::ReadTask)), Refusal::NoTask);
}
