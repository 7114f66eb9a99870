//! Impedance control of an arm: refusals, faults, and the outputs after a fault.

use heapless::Vec;
use nalgebra::Vector3;

use super::grasp::KEEP;
use super::rig::{COUNTS_PER_RADIAN, Rig, refusal};
use crate::TICK;
use crate::fault::{Fault, FaultCause};
use crate::kinematics::{Chain, ElbowSetpoint, PosePoint};
use crate::model::{ForceSensor, MAX_CHAIN_JOINTS, Reaction, RobotModel};
use crate::node::optional::Optional;
use crate::node::state::Sensing;
use crate::protocol::{Mode, Refusal, Reply, Request};
use crate::task::impedance::InvalidImpedanceSettings;
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

/// Elbow near 90°, the other joints near 0.
pub(super) const ANGLES: [f32; MAX_CHAIN_JOINTS] = [0.3, 0.2, -0.1, 1.57, 0.1, 0.2, -0.1];

pub(super) const SENSOR: ForceSensor = ForceSensor {
    force_resolution: 0.01,
    torque_resolution: 1e-3,
    saturation: 20_000,
    force_limit: 150.0,
    mass: 0.0,
    center_of_mass: [0.0; 3],
};

pub(super) fn arm_with_force_sensor() -> RobotModel {
    let mut model = arm7();
    model.chains[0].force_sensor = Some(SENSOR);
    model
}

/// A disabled node with this model, sensors not tared.
pub(super) fn arm_rig(model: &RobotModel) -> Rig {
    let mut rig = Rig::new();
    rig.sensors.currents = [0; 7].into_iter().collect();
    rig.sensors.forces = model.chains.iter().filter_map(|chain| chain.force_sensor.map(|_| [0; 6])).collect();
    set_encoders(&mut rig, &ANGLES);
    rig.command();
    assert_eq!(rig.push(model), Reply::Done);
    rig.tick();
    rig
}

fn enabled() -> Rig {
    let mut rig = arm_rig(&arm_with_force_sensor());
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    assert_eq!(rig.ask(enable(SOFT)), Reply::Done);
    rig
}

pub(super) fn set_encoders(rig: &mut Rig, angles: &[f32]) {
    rig.sensors.encoders =
        angles.iter().map(|angle| libm::roundf(angle * COUNTS_PER_RADIAN) as i32).collect();
}

/// An arm whose joints track their reference accelerations exactly.
struct IdealArm {
    rig: Rig,
    angles: [f32; 7],
    velocities: [f32; 7],
}

impl IdealArm {
    fn enabled() -> Self {
        Self { rig: enabled(), angles: ANGLES, velocities: [0.0; 7] }
    }

    /// Advances by a tick under an external wrench on the tool. Returns whether the node is still enabled.
    fn tick(&mut self, wrench: [f32; 6]) -> bool {
        let references = &self.rig.node.state.references;
        for ((angle, velocity), reference) in self.angles.iter_mut().zip(&mut self.velocities).zip(references)
        {
            let acceleration = reference.acceleration;
            *angle += TICK * (*velocity + 0.5 * TICK * acceleration);
            *velocity += TICK * acceleration;
        }
        set_encoders(&mut self.rig, &self.angles);
        // The sensor measures in the axes of the tool. Noise: constant counts would be a fault.
        let model = arm7();
        let chain = Chain::new(&model.joints, &model.chains[0].tip);
        let to_tool = chain.posture(&self.angles).tip().rotation.inverse();
        let [fx, fy, fz, tx, ty, tz] = wrench;
        let force = to_tool * Vector3::new(fx, fy, fz) / SENSOR.force_resolution;
        let torque = to_tool * Vector3::new(tx, ty, tz) / SENSOR.torque_resolution;
        let noise = self.rig.sensors.sequence as i32 % 2;
        self.rig.sensors.forces[0] =
            [force.x, force.y, force.z, torque.x, torque.y, torque.z].map(|value| value as i32 + noise);
        self.rig.tick();
        matches!(self.rig.node.mode(), Mode::Enabled(_))
    }
}

pub(super) fn telemetry(rig: &mut Rig) -> ImpedanceTelemetry {
    let Reply::Task(report) = rig.ask(Request::ReadTask) else { panic!() };
    assert_eq!(Some(&report), rig.node.task_report().as_ref());
    let TaskTelemetry::Impedance(telemetry) = report.telemetry else { panic!() };
    telemetry
}

fn fault(rig: &Rig) -> Fault {
    *rig.node.faults().faults.last().unwrap()
}

pub(super) fn set_target(point: PosePoint, elbow: ElbowSetpoint) -> Request {
    Request::Task(TaskCommand::Impedance(ImpedanceCommand::SetTarget { point, elbow }))
}

/// Set-points at the present pose and elbow angle.
pub(super) fn present_target(rig: &mut Rig) -> (PosePoint, ElbowSetpoint) {
    let ImpedanceTelemetry { position, rotation, elbow, .. } = telemetry(rig);
    let point = PosePoint { position, rotation, velocity: [0.0; 6], acceleration: [0.0; 6] };
    (point, ElbowSetpoint { angle: elbow, ..ElbowSetpoint::default() })
}

#[test]
fn impedance_control_needs_an_arm_valid_settings_and_a_tared_sensor() {
    let mut short = arm_with_force_sensor();
    short.joints.truncate(5);
    short.chains[0].joints = 5;
    let mut rig = Rig::new();
    rig.command();
    assert_eq!(refusal(rig.ask(enable(SOFT))), Refusal::NoModel);
    assert_eq!(refusal(rig.ask(Request::ReadTask)), Refusal::NoTask);
    assert_eq!(rig.push(&short), Reply::Done);
    rig.sensors.encoders = [0; 5].into_iter().collect();
    rig.sensors.currents = [0; 5].into_iter().collect();
    rig.sensors.forces = [[0; 6]].into_iter().collect();
    rig.tick();
    assert_eq!(refusal(rig.ask(enable(SOFT))), refused(ImpedanceRefusal::NotAnArm));
    assert_eq!(
        refused(ImpedanceRefusal::NotAnArm).to_string(),
        "the robot is not an arm: a single chain of six or seven joints, each with a motor"
    );

    let mut rig = arm_rig(&arm_with_force_sensor());
    assert_eq!(refusal(rig.ask(enable(SOFT))), refused(ImpedanceRefusal::NotTared { chain: 0 }));
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    let invalid = ImpedanceSettings { contact_force: 0.0, ..SOFT };
    assert_eq!(
        refusal(rig.ask(enable(invalid))).to_string(),
        "the contact force is 0 N; it must be positive and finite"
    );
    assert_eq!(rig.node.mode(), Mode::Disabled);
    assert_eq!(rig.ask(enable(SOFT)), Reply::Done);
    assert_eq!(rig.node.mode(), Mode::Enabled(TaskKind::Impedance));
    assert_eq!(rig.node.mode().to_string(), "enabled (impedance control)");
    assert_eq!(refusal(rig.ask(enable(SOFT))), Refusal::WrongMode(Mode::Enabled(TaskKind::Impedance)));
    assert_eq!(
        refusal(rig.ask(configure(invalid))),
        refused(ImpedanceRefusal::Settings(InvalidImpedanceSettings::ContactForce { value: 0.0 }))
    );
    let source = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, ..SOFT };
    assert_eq!(refusal(rig.ask(configure(source))), refused(ImpedanceRefusal::ForceSourceInUse));
}

#[test]
fn without_a_force_sensor_the_motor_torques_give_the_force() {
    let mut rig = arm_rig(&arm7());
    assert_eq!(refusal(rig.ask(enable(SOFT))), refused(ImpedanceRefusal::NoForceSensor));
    let fast = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 60.0 }, ..SOFT };
    assert_eq!(
        refusal(rig.ask(enable(fast))).to_string(),
        "the bandwidth of the force observer is 60 rad/s; it must be between 10 and 50 rad/s"
    );
    assert_eq!(refusal(rig.ask(Request::Tare)), Refusal::NoForceSensor);
    let observing = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, ..SOFT };
    assert_eq!(rig.ask(enable(observing)), Reply::Done);
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
}

#[test]
fn a_tare_that_is_refused_changes_nothing() {
    let observing = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, ..SOFT };
    let mut rig = arm_rig(&arm_with_force_sensor());
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    assert_eq!(rig.ask(enable(observing)), Reply::Done);
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    for tick in 0..200 {
        // Once the observer has tared itself at rest, the arm moves a little.
        rig.sensors.encoders[3] += if tick > 180 { 2 } else { 0 };
        rig.sensors.forces[0][0] = tick % 2;
        rig.tick();
        assert_eq!(rig.ask(KEEP), Reply::Done);
    }
    let state = |rig: &Rig| format!("{:?}", rig.node.state.task);
    let (before, mut tared) = (state(&rig), rig.clone());
    assert_eq!(tared.ask(Request::Tare), Reply::Done);
    assert_ne!(state(&tared), before);
    let silent = Fault { cause: FaultCause::ForceSilent, joint: Some(6), value: 1.0, limit: 0.0, tick: 9 };
    rig.node.state.alarm = Optional::Some(silent);
    rig.node.state.force_sensors[0].lose();
    assert_eq!(refusal(rig.ask(Request::Tare)), Refusal::Unsafe(silent));
    assert_eq!(state(&rig), before);
    (rig.node.state.alarm, rig.node.state.sensing) = (Optional::None, Sensing::None);
    assert_eq!(refusal(rig.ask(Request::Tare)), Refusal::NoSensors);
    assert_eq!(state(&rig), before);
}

#[test]
fn impedance_control_refuses_commands_to_other_tasks() {
    let mut rig = enabled();
    let other = Refusal::OtherTask(TaskKind::Impedance);
    for command in [
        JointCommand::Goal { positions: Vec::from_slice(&[0.0; 7]).unwrap() },
        JointCommand::Stream { points: Vec::new() },
        JointCommand::StreamTips { tips: Vec::new() },
    ] {
        assert_eq!(refusal(rig.ask(Request::Task(TaskCommand::JointServo(command)))), other);
    }
    assert_eq!(other.to_string(), "the board runs another task: impedance control");
    assert_eq!(rig.ask(KEEP), Reply::Done);
    let (point, elbow) = present_target(&mut rig);
    assert_eq!(rig.ask(set_target(point, elbow)), Reply::Done);
    // Other tasks refuse its commands.
    rig.ask(Request::Disable);
    assert_eq!(refusal(rig.ask(set_target(point, elbow))), Refusal::WrongMode(Mode::Disabled));
    assert_eq!(refusal(rig.ask(configure(SOFT))), Refusal::WrongMode(Mode::Disabled));
    rig.enable();
    assert_eq!(refusal(rig.ask(set_target(point, elbow))), Refusal::OtherTask(TaskKind::JointServo));
    assert_eq!(refusal(rig.ask(configure(SOFT))), Refusal::OtherTask(TaskKind::JointServo));
    rig.ask(Request::Stop);
    assert_eq!(refusal(rig.ask(configure(SOFT))), Refusal::WrongMode(Mode::Fault));
}

#[test]
fn a_setpoint_that_jumps_is_refused_by_name_and_the_arm_holds() {
    let mut arm = IdealArm::enabled();
    assert!(arm.tick([0.0; 6]));
    let (point, elbow) = present_target(&mut arm.rig);
    let [x, y, z] = point.position;
    let [i, j, k, w] = point.rotation;
    let far = PosePoint { position: [x, y, z + 1.0], ..point };
    let Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::Distance {
        value,
        limit: 0.1,
    }))) = refusal(arm.rig.ask(set_target(far, elbow)))
    else {
        panic!()
    };
    assert!((value - 1.0).abs() < 1e-3);
    // Rotated by π about x.
    let rotated = PosePoint { rotation: [w, -k, j, -i], ..point };
    let text = refusal(arm.rig.ask(set_target(rotated, elbow))).to_string();
    assert!(
        text.starts_with("the set-point is rotated by 3.14") && text.ends_with("at most 1 rad is allowed"),
        "{text}"
    );
    let other = ElbowSetpoint { angle: elbow.angle + 3.0, ..elbow };
    assert!(matches!(
        refusal(arm.rig.ask(set_target(point, other))),
        Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::Elbow { .. })))
    ));
    // A turn in each period ends where it begins.
    for turn in [628.32, -628.32, 1e15] {
        let other = ElbowSetpoint { velocity: turn, ..elbow };
        assert!(matches!(
            refusal(arm.rig.ask(set_target(point, other))),
            Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::Elbow { .. })))
        ));
        let turning = PosePoint { velocity: [0.0, 0.0, 0.0, turn, 0.0, 0.0], ..point };
        assert!(matches!(
            refusal(arm.rig.ask(set_target(turning, elbow))),
            Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::Rotation { .. })))
        ));
    }
    let not_finite = PosePoint { position: [x, f32::NAN, z], ..point };
    assert_eq!(
        refusal(arm.rig.ask(set_target(not_finite, elbow))),
        Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::NotFinite)))
    );
    let not_unit = PosePoint { rotation: [0.0, 0.0, 0.0, 2.0], ..point };
    assert_eq!(
        refusal(arm.rig.ask(set_target(not_unit, elbow))),
        Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(SetpointError::NotUnit {
            norm: 2.0
        })))
    );
    for _ in 0..9 {
        assert!(arm.tick([0.0; 6]));
    }
    let after = telemetry(&mut arm.rig);
    assert!(after.error.iter().all(|value| value.abs() < 2e-4), "{after:?}");
    // A refused set-point does not reset the command timeout.
    assert!(!arm.tick([0.0; 6]));
    assert_eq!(fault(&arm.rig).cause, FaultCause::CommandTimeout);
}

/// Gravity along the line from shoulder to wrist: the set-point of the elbow is ignored, that of the tool is
/// not.
#[test]
fn an_undefined_arm_angle_refuses_no_set_point_of_the_tool() {
    let mut model = arm_with_force_sensor();
    let posture = Chain::new(&model.joints, &model.chains[0].tip).posture(&ANGLES);
    let line = posture.joint(5).unwrap().1 - posture.joint(0).unwrap().1;
    for (gravity, undefined) in [(line.normalize() * 9.81, true), (Vector3::new(0.0, 0.0, -9.81), false)] {
        model.gravity = gravity.into();
        let mut rig = arm_rig(&model);
        assert_eq!(rig.ask(Request::Tare), Reply::Done);
        let settings = ImpedanceSettings { redundancy: Redundancy::ArmAngle, ..SOFT };
        assert_eq!(rig.ask(enable(settings)), Reply::Done);
        rig.tick();
        let (point, elbow) = present_target(&mut rig);
        let away = ElbowSetpoint { angle: elbow.angle + 2.0, ..elbow };
        let reply = rig.ask(set_target(point, away));
        assert_eq!(reply == Reply::Done, undefined, "{reply:?}");
    }
}

#[test]
fn an_arm_follows_its_setpoint_and_yields_to_a_force() {
    let mut arm = IdealArm::enabled();
    assert!(arm.tick([0.0; 6]));
    let (mut point, elbow) = present_target(&mut arm.rig);
    point.position[0] += 0.03;
    let start = telemetry(&mut arm.rig).position;
    for _ in 0..200 {
        assert_eq!(arm.rig.ask(set_target(point, elbow)), Reply::Done);
        assert!(arm.tick([0.0; 6]), "{:?}", arm.rig.node.faults());
    }
    let reached = telemetry(&mut arm.rig);
    assert!((reached.position[0] - start[0] - 0.03).abs() < 1e-3 && !reached.contact, "{reached:?}");
    assert!((reached.elbow - elbow.angle).abs() < 5e-3, "{reached:?}");
    for _ in 0..300 {
        assert_eq!(arm.rig.ask(KEEP), Reply::Done);
        assert!(arm.tick([0.0, 15.0, 0.0, 0.0, 0.0, 0.0]));
    }
    // 15 N on a spring of 300 N/m.
    let pushed = telemetry(&mut arm.rig);
    assert!(pushed.contact && (pushed.error[1] - 0.05).abs() < 3e-3, "{pushed:?}");
    assert!((pushed.wrench[1] - 15.0).abs() < 0.1, "{pushed:?}");
    for _ in 0..300 {
        assert_eq!(arm.rig.ask(KEEP), Reply::Done);
        assert!(arm.tick([0.0; 6]));
    }
    let back = telemetry(&mut arm.rig);
    assert!(!back.contact && back.error[..3].iter().all(|value| value.abs() < 1e-3), "{back:?}");
}

/// An arm that a force displaced until a fault.
fn fault_by_force(wrench: [f32; 6]) -> IdealArm {
    let mut arm = IdealArm::enabled();
    let narrow = ImpedanceSettings { max_deviation: [0.1, 0.3], ..SOFT };
    assert_eq!(arm.rig.ask(configure(narrow)), Reply::Done);
    assert!((0..500).any(|_| {
        arm.rig.ask(KEEP);
        !arm.tick(wrench)
    }));
    arm
}

#[test]
fn a_deviation_beyond_the_maximum_is_a_fault_and_the_arm_comes_to_rest() {
    let cases = [
        ([0.0, 0.0, 40.0, 0.0, 0.0, 0.0], FaultCause::ToolPositionError, 0.1),
        ([0.0, 2.0, 0.0, 0.0, 0.0, 4.0], FaultCause::ToolOrientationError, 0.3),
    ];
    for (wrench, cause, limit) in cases {
        let mut arm = fault_by_force(wrench);
        let found = fault(&arm.rig);
        assert_eq!((found.cause, found.joint, found.limit), (cause, None, limit));
        assert!(found.value > limit && found.value < 1.3 * limit, "{found}");
        assert!(found.to_string().contains(cause.description()), "{found}");
        assert_eq!(arm.rig.node.mode(), Mode::Fault);
        // The task brings the arm to rest: the tool reaches a set-point near it and stays there.
        (0..600).for_each(|_| assert!(!arm.tick([0.0; 6])));
        assert_eq!(arm.rig.node.state.reaction, Reaction::Hold, "{:?}", arm.rig.node.faults());
        let rest = telemetry(&mut arm.rig);
        assert!(rest.error[..3].iter().all(|value| value.abs() < 0.012), "{rest:?}");
        let Reply::Faults(log) = arm.rig.ask(Request::ReadFaults) else { panic!() };
        assert_eq!(arm.rig.ask(Request::ClearFaults { total: log.total }), Reply::Done);
        assert_eq!(arm.rig.ask(enable(SOFT)), Reply::Done);
        assert!(telemetry(&mut arm.rig).error.iter().all(|value| value.abs() < 1e-6));
    }
}

#[test]
fn a_command_timeout_ends_in_the_reaction() {
    let mut arm = IdealArm::enabled();
    (0..10).for_each(|_| assert!(arm.tick([0.0; 6])));
    assert_eq!(arm.rig.ask(configure(SOFT)), Reply::Done);
    (0..10).for_each(|_| assert!(arm.tick([0.0; 6])));
    assert!(!arm.tick([0.0; 6]));
    assert_eq!(fault(&arm.rig).cause, FaultCause::CommandTimeout);
    assert!(arm.rig.tick().enabled);
}

#[test]
fn telemetry_of_a_disabled_arm_shows_its_pose() {
    let mut rig = arm_rig(&arm_with_force_sensor());
    assert_eq!(refusal(rig.ask(Request::ReadTask)), Refusal::NoTask);
    assert_eq!(rig.ask(Request::Tare), Reply::Done);
    let redundancy = Redundancy::DrivenJoint { joint: 2 };
    assert_eq!(rig.ask(enable(ImpedanceSettings { redundancy, ..SOFT })), Reply::Done);
    let first = telemetry(&mut rig);
    assert!(!first.contact && (first.elbow - ANGLES[2]).abs() < 1e-4);
    rig.ask(Request::Disable);
    // Moved by hand, under a force.
    let mut moved = ANGLES;
    moved[3] += 0.1;
    set_encoders(&mut rig, &moved);
    rig.sensors.forces[0][0] = 500;
    rig.tick();
    let after = telemetry(&mut rig);
    assert!((after.position[2] - first.position[2]).abs() > 0.01, "{after:?}");
    assert!(after.wrench[..3].iter().map(|force| force * force).sum::<f32>() > 24.0, "{after:?}");
    // A new model discards the telemetry of the task.
    assert_eq!(rig.push(&arm_with_force_sensor()), Reply::Done);
    assert_eq!(refusal(rig.ask(Request::ReadTask)), Refusal::NoTask);
}
