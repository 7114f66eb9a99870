//! An arm under impedance from outside: what is refused, what faults, and what the outputs do then.

use heapless::Vec;
use nalgebra::Vector3;

use super::bench::{Bench, COUNTS_PER_RADIAN, refusal};
use super::grasp::KEEP;
use crate::TICK;
use crate::arm::tests::{SOFT, arm7};
use crate::arm::{ArmError, ArmSettings, ArmTelemetry, ElbowPoint, ForceSource, PosePoint, Redundancy};
use crate::kinematics::Chain;
use crate::model::{ForceSensor, MAX_CHAIN_JOINTS, MAX_JOINTS, RobotModel};
use crate::protocol::{Fault, FaultCause, Mode, Refusal, Reply, Request, SetPoint, Task};

pub(super) const ARM: Request = Request::Arm { task: Task::Impedance };
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
    assert_eq!(bench.ask(Request::Impedance(SOFT)), Reply::Done);
    assert_eq!(bench.ask(ARM), Reply::Done);
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
        let joints = self.angles.iter_mut().zip(&mut self.velocities).zip(&self.bench.node.state.joints);
        for ((angle, velocity), joint) in joints {
            let acceleration = joint.reference.acceleration;
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
        matches!(self.bench.node.mode(), Mode::Armed(_))
    }
}

pub(super) fn seen(bench: &mut Bench) -> ArmTelemetry {
    let Reply::Arm(arm) = bench.ask(Request::ReadArm) else { panic!() };
    assert_eq!(Some(arm), bench.node.tool());
    arm
}

fn fault(bench: &Bench) -> Fault {
    *bench.node.faults().faults.last().unwrap()
}

fn pose(point: PosePoint, elbow: ElbowPoint) -> Request {
    Request::SetPoint(SetPoint::Pose { point, elbow })
}

/// The set-point where the tool is.
fn here(bench: &mut Bench) -> (PosePoint, ElbowPoint) {
    let ArmTelemetry { position, rotation, elbow, .. } = seen(bench);
    let point = PosePoint { position, rotation, velocity: [0.0; 6], acceleration: [0.0; 6] };
    (point, ElbowPoint { angle: elbow, ..ElbowPoint::default() })
}

#[test]
fn arming_for_impedance_needs_an_arm_with_settings_and_a_tared_sensor() {
    let mut short = feeling();
    short.joints.truncate(5);
    short.chains[0].joints = 5;
    let mut bench = Bench::new();
    bench.command();
    assert_eq!(refusal(bench.ask(Request::Impedance(SOFT))), Refusal::NotAnArm);
    assert_eq!(refusal(bench.ask(Request::ReadArm)), Refusal::NotAnArm);
    assert_eq!(bench.push(&short), Reply::Done);
    bench.sensors.encoders = [0; 5].into_iter().collect();
    bench.sensors.currents = [0; 5].into_iter().collect();
    bench.sensors.forces = [[0; 6]].into_iter().collect();
    bench.tick();
    assert_eq!(refusal(bench.ask(ARM)), Refusal::NotAnArm);
    assert_eq!(
        Refusal::NotAnArm.to_string(),
        "the robot is not an arm: a single chain of six or seven joints"
    );

    let mut bench = self::bench(&feeling());
    assert_eq!(refusal(bench.ask(ARM)), Refusal::NotTared { chain: 0 });
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    assert_eq!(refusal(bench.ask(ARM)), Refusal::Arm(ArmError::NoSettings));
    let bad = ArmSettings { contact_force: 0.0, ..SOFT };
    assert_eq!(
        refusal(bench.ask(Request::Impedance(bad))).to_string(),
        "the contact force is 0 N; it must be positive and finite"
    );
    assert_eq!(refusal(bench.ask(ARM)), Refusal::Arm(ArmError::NoSettings));
    assert_eq!(bench.ask(Request::Impedance(SOFT)), Reply::Done);
    assert_eq!(bench.ask(ARM), Reply::Done);
    assert_eq!(bench.node.mode(), Mode::Armed(Task::Impedance));
    assert_eq!(bench.node.mode().to_string(), "armed (impedance)");
    assert_eq!(refusal(bench.ask(ARM)), Refusal::WrongMode(Mode::Armed(Task::Impedance)));

    // Settings outlast the arming, not the model.
    bench.ask(Request::Disarm);
    assert_eq!(bench.ask(ARM), Reply::Done);
    bench.ask(Request::Disarm);
    assert_eq!(bench.push(&arm7()), Reply::Done);
    bench.sensors.forces.clear();
    bench.tick();
    assert_eq!(refusal(bench.ask(ARM)), Refusal::Arm(ArmError::NoSettings));
    // Without a sensor there is nothing to tare, but the motors can be asked.
    assert_eq!(refusal(bench.ask(Request::Impedance(SOFT))), Refusal::NoForceSensor);
    let deaf = ArmSettings { force: ForceSource::Observer { bandwidth: 60.0 }, ..SOFT };
    assert_eq!(
        refusal(bench.ask(Request::Impedance(deaf))).to_string(),
        "the bandwidth of the force observer is 60 rad/s; possible is 10 to 50 rad/s"
    );
    let observing = ArmSettings { force: ForceSource::Observer { bandwidth: 30.0 }, ..SOFT };
    assert_eq!(bench.ask(Request::Impedance(observing)), Reply::Done);
    assert_eq!(refusal(bench.ask(Request::Tare)), Refusal::NoForceSensor);
    assert_eq!(bench.ask(ARM), Reply::Done);
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
}

#[test]
fn the_joints_of_an_arm_that_yields_are_led_by_nobody_else() {
    let mut bench = armed();
    let armed = Refusal::WrongMode(Mode::Armed(Task::Impedance));
    let goal = || SetPoint::Goal { positions: Vec::from_slice(&[0.0; 7]).unwrap() };
    assert_eq!(refusal(bench.ask(Request::SetPoint(goal()))), armed);
    assert_eq!(refusal(bench.ask(Request::SetPoint(SetPoint::Stream { points: Vec::new() }))), armed);
    assert_eq!(refusal(bench.ask(Request::SetPoint(SetPoint::Reach { tips: Vec::new() }))), armed);
    assert_eq!(bench.ask(KEEP), Reply::Done);
    let (point, elbow) = here(&mut bench);
    assert_eq!(bench.ask(pose(point, elbow)), Reply::Done);
    // And a pose is for nobody else, settings neither.
    bench.ask(Request::Disarm);
    assert_eq!(refusal(bench.ask(pose(point, elbow))), Refusal::WrongMode(Mode::Disarmed));
    bench.arm();
    let servo = bench.node.mode();
    assert_eq!(refusal(bench.ask(pose(point, elbow))), Refusal::WrongMode(servo));
    assert_eq!(refusal(bench.ask(Request::Impedance(SOFT))), Refusal::WrongMode(servo));
    bench.ask(Request::Stop);
    assert_eq!(refusal(bench.ask(Request::Impedance(SOFT))), Refusal::WrongMode(Mode::Fault));
}

#[test]
fn a_pose_that_jumps_is_refused_by_name_and_the_arm_stays() {
    let mut machine = Machine::armed();
    assert!(machine.tick([0.0; 6]));
    let (point, elbow) = here(&mut machine.bench);
    let [x, y, z] = point.position;
    let [i, j, k, w] = point.rotation;
    let far = PosePoint { position: [x, y, z + 1.0], ..point };
    let Refusal::Arm(ArmError::Distance { value, limit: 0.1 }) = refusal(machine.bench.ask(pose(far, elbow)))
    else {
        panic!()
    };
    assert!((value - 1.0).abs() < 1e-3);
    // Half a turn about x.
    let turned = PosePoint { rotation: [w, -k, j, -i], ..point };
    let text = refusal(machine.bench.ask(pose(turned, elbow))).to_string();
    assert!(
        text.starts_with("the set-point is turned by 3.14") && text.ends_with("at most 1 rad is allowed"),
        "{text}"
    );
    let other = ElbowPoint { angle: elbow.angle + 3.0, ..elbow };
    assert!(matches!(refusal(machine.bench.ask(pose(point, other))), Refusal::Arm(ArmError::Elbow { .. })));
    let spoilt = PosePoint { position: [x, f32::NAN, z], ..point };
    assert_eq!(refusal(machine.bench.ask(pose(spoilt, elbow))), Refusal::Arm(ArmError::NotFinite));
    let long = PosePoint { rotation: [0.0, 0.0, 0.0, 2.0], ..point };
    assert_eq!(refusal(machine.bench.ask(pose(long, elbow))), Refusal::Arm(ArmError::NotAUnit { norm: 2.0 }));
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
    let narrow = ArmSettings { reach: [0.1, 0.3], ..SOFT };
    assert_eq!(machine.bench.ask(Request::Impedance(narrow)), Reply::Done);
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
        assert_eq!(machine.bench.ask(ARM), Reply::Done);
        assert!(seen(&mut machine.bench).error.iter().all(|value| value.abs() < 1e-6));
    }
}

#[test]
fn silence_ends_in_the_reaction() {
    let mut machine = Machine::armed();
    (0..10).for_each(|_| assert!(machine.tick([0.0; 6])));
    assert_eq!(machine.bench.ask(Request::Impedance(SOFT)), Reply::Done);
    (0..10).for_each(|_| assert!(machine.tick([0.0; 6])));
    assert!(!machine.tick([0.0; 6]));
    assert_eq!(fault(&machine.bench).cause, FaultCause::CommandTimeout);
    assert!(machine.bench.tick().enabled);
}

#[test]
fn a_disarmed_arm_shows_where_it_is() {
    let mut bench = bench(&feeling());
    let first = seen(&mut bench);
    assert!((first.elbow, first.contact) == (0.0, false));
    let redundancy = Redundancy::Driven { joint: 2 };
    assert_eq!(bench.ask(Request::Impedance(ArmSettings { redundancy, ..SOFT })), Reply::Done);
    assert!((seen(&mut bench).elbow - ANGLES[2]).abs() < 1e-4);
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    assert_eq!(bench.ask(ARM), Reply::Done);
    let armed = seen(&mut bench);
    assert_eq!((armed.position, armed.rotation), (first.position, first.rotation));
    bench.ask(Request::Disarm);
    // Led by hand, and pushed.
    let mut moved = ANGLES;
    moved[3] += 0.1;
    stand(&mut bench, &moved);
    bench.sensors.forces[0][0] = 500;
    bench.tick();
    let after = seen(&mut bench);
    assert!((after.position[2] - first.position[2]).abs() > 0.01, "{after:?}");
    assert!(after.wrench[..3].iter().map(|force| force * force).sum::<f32>() > 24.0, "{after:?}");
}
