//! A hand that grasps.

use heapless::Vec;

use super::fingertips::{fingers, references};
use super::force_sensors::{SENSOR, fingers_with_force_sensors as feeling_fingers};
use super::rig::{COUNTS_PER_RADIAN, Rig as Bench, model, refusal};
use crate::control::{JointPoint, ServoMode};
use crate::fault::{Fault, FaultCause};
use crate::kinematics::TipPoint;
use crate::model::{ChainModel, JointModel, MAX_JOINTS, RobotModel};
use crate::protocol::{Mode, Refusal, Reply, Request};
use crate::robot::{Actuation, Concerns, LimitRefusal};
use crate::task::grasping::{
    Failure, GraspCommand, GraspPlan, GraspRefusal, GraspTelemetry, InternalForce, InvalidPlan, JointTargets,
    LoadSource, ObjectControl, ObjectFrame, Phase, PlanField, PlannedContact, WrenchGains,
};
use crate::task::joint_servo::{JointCommand, JointServoRefusal};
use crate::task::{TaskCommand, TaskConfig, TaskKind, TaskRefusal, TaskTelemetry};

/// Three such fingers; the third is opposite the midpoint between the others.
pub fn hand() -> RobotModel {
    let mut model = fingers();
    for (index, name) in ["g", "h", "i"].into_iter().enumerate() {
        let mut joint = model.joints[index].clone();
        joint.name = name.try_into().unwrap();
        model.joints.push(joint).unwrap();
    }
    model.joints[6].origin.translation = [0.3, 0.05, 0.0];
    model.chains.push(ChainModel { name: "third".try_into().unwrap(), ..model.chains[0].clone() }).unwrap();
    for chain in &mut model.chains {
        (chain.tip_radius, chain.force_sensor) = (0.008, Some(SENSOR));
    }
    model
}

/// The hand, not tared yet, bent so that its tips are at x = ±71.9466 mm from its roots and at z = 93.2199
/// mm.
fn untared_hand() -> Bench {
    hand_of_model_at([0.0, 0.5, 0.8, 0.0, 0.5, 0.8, 0.0, -0.5, -0.8], &hand())
}

/// A hand at these angles, not tared yet.
fn hand_of_model_at(angles: [f32; 9], model: &RobotModel) -> Bench {
    let mut bench = Bench::new();
    bench.sensors.encoders = angles.iter().map(|angle| (angle * COUNTS_PER_RADIAN) as i32).collect();
    bench.sensors.currents = [0; 9].into_iter().collect();
    bench.sensors.forces = [[0; 6]; 3].into_iter().collect();
    bench.command();
    assert_eq!(bench.push(model), Reply::Done);
    bench.tick();
    bench
}

/// The hand, ready to be enabled for a grasp.
fn tared_hand() -> Bench {
    let mut bench = untared_hand();
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    bench
}

const GRASP: Request = Request::Enable(TaskConfig::Grasping(()));

pub const KEEP: Request = Request::Keep;

/// An object 2 mm in front of the tips of [`untared_hand`].
pub fn in_front() -> GraspPlan {
    let contact = |x: f32, y: f32, normal: f32| PlannedContact {
        position: [x, y, 0.093_219_9],
        normal: [normal, 0.0, 0.0],
    };
    // The radius of the tips, 8 mm, and 2 mm of distance.
    let near = 0.071_946_6 + 0.01;
    GraspPlan {
        contacts: [contact(near, 0.0, 1.0), contact(near, 0.1, 1.0), contact(0.3 - near, 0.05, -1.0)],
        clearance: 0.002,
        touch_force: 0.1,
        friction: Some(0.5),
        internal: InternalForce::LeastGrip { margin: 0.2, capacity_at_rest: 0.3, capacity_in_motion: 1.0 },
        force_limit: 4.0,
        feedback: true,
        control: ObjectControl::Differential(ServoMode::Pid),
        object_frame: ObjectFrame::Rolling,
        load: LoadSource::Measured,
        joint_targets: JointTargets::ClosedForm,
    }
}

pub fn seen(bench: &mut Bench) -> GraspTelemetry {
    let Reply::Task(report) = bench.ask(Request::ReadTask) else { panic!() };
    assert_eq!(Some(&report), bench.node.task_report().as_ref());
    let TaskTelemetry::Grasping(grasp) = report.telemetry else { panic!() };
    grasp
}

#[test]
fn enabling_a_grasp_needs_a_hand_with_tared_sensors() {
    assert_eq!(
        refusal(Bench::ready(&model()).ask(GRASP)),
        Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotAHand))
    );
    assert_eq!(
        refusal(feeling_fingers([[0; 6]; 2]).ask(GRASP)),
        Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotAHand))
    );
    let mut bench = untared_hand();
    let mut without_sensor = hand();
    without_sensor.chains[1].force_sensor = None;
    assert_eq!(bench.push(&without_sensor), Reply::Done);
    bench.sensors.forces.truncate(2);
    bench.tick();
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    assert_eq!(refusal(bench.ask(GRASP)), Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotAHand)));

    let mut bench = untared_hand();
    assert_eq!(
        refusal(bench.ask(GRASP)),
        Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotTared { chain: 0 }))
    );
    assert_eq!(bench.node.mode(), Mode::Disabled);
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    assert_eq!(bench.ask(GRASP), Reply::Done);
    assert_eq!(bench.node.mode(), Mode::Enabled(TaskKind::Grasping));
    assert_eq!(refusal(bench.ask(GRASP)), Refusal::WrongMode(Mode::Enabled(TaskKind::Grasping)));
    assert_eq!(bench.node.mode().to_string(), "enabled (grasping)");
    // Another model may have other sensors.
    bench.ask(Request::Disable);
    assert_eq!(bench.push(&hand()), Reply::Done);
    bench.tick();
    assert_eq!(
        refusal(bench.ask(GRASP)),
        Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotTared { chain: 0 }))
    );
}

#[test]
fn keep_keeps_an_enabled_node_alive_whatever_its_task() {
    let servo = |mode| Request::Enable(TaskConfig::JointServo(mode));
    for enable in [servo(ServoMode::Pid), servo(ServoMode::Observer), GRASP] {
        let mut bench = tared_hand();
        assert_eq!(refusal(bench.ask(KEEP)), Refusal::WrongMode(Mode::Disabled));
        assert_eq!(bench.ask(enable), Reply::Done);
        let before = references(&bench);
        let tick = |bench: &mut Bench| {
            // Noise keeps the force sensors alive.
            bench.sensors.forces.iter_mut().for_each(|counts| counts[3] = 1 - counts[3]);
            bench.tick();
            matches!(bench.node.mode(), Mode::Enabled(_))
        };
        for _ in 0..100 {
            assert!(tick(&mut bench));
            assert_eq!(bench.ask(KEEP), Reply::Done);
        }
        assert_eq!(references(&bench), before);
        (0..10).for_each(|_| assert!(tick(&mut bench)));
        assert!(!tick(&mut bench));
        assert_eq!(bench.node.faults().faults.last().unwrap().cause, FaultCause::CommandTimeout);
        assert_eq!(refusal(bench.ask(KEEP)), Refusal::WrongMode(Mode::Fault));
    }
}

#[test]
fn the_joints_of_a_hand_that_grasps_take_commands_of_no_other_task() {
    let mut bench = tared_hand();
    let command = || Request::Task(TaskCommand::Grasping(GraspCommand::Grasp(in_front())));
    assert_eq!(refusal(bench.ask(command())), Refusal::WrongMode(Mode::Disabled));
    assert_eq!(bench.enable(), Reply::Done);
    for command in [command(), Request::Task(TaskCommand::Grasping(GraspCommand::Open))] {
        assert_eq!(refusal(bench.ask(command)), Refusal::OtherTask(TaskKind::JointServo));
    }
    bench.ask(Request::Disable);
    assert_eq!(bench.ask(GRASP), Reply::Done);
    bench.tick();
    let before = bench.node.telemetry();
    let points: Vec<JointPoint, MAX_JOINTS> = before
        .joints
        .iter()
        .map(|joint| JointPoint { position: joint.position, ..JointPoint::default() })
        .collect();
    let tips = [TipPoint::default(); 3].into_iter().collect();
    for set_point in [
        Request::Task(TaskCommand::JointServo(JointCommand::Goal {
            positions: points.iter().map(|point| point.position).collect(),
        })),
        Request::Task(TaskCommand::JointServo(JointCommand::Stream { points: points.clone() })),
        Request::Task(TaskCommand::JointServo(JointCommand::StreamTips { tips })),
        Request::Task(TaskCommand::JointServo(JointCommand::StreamTorques {
            torques: [0.0; 9].into_iter().collect(),
            points,
        })),
    ] {
        let refused = refusal(bench.ask(set_point));
        assert_eq!(refused, Refusal::OtherTask(TaskKind::Grasping));
    }
    assert_eq!(bench.node.telemetry(), before);
}

pub fn task(command: GraspCommand) -> Request {
    Request::Task(TaskCommand::Grasping(command))
}

fn grasp(plan: GraspPlan) -> Request {
    task(GraspCommand::Grasp(plan))
}

fn grasp_refusal(reply: Reply) -> GraspRefusal {
    let Refusal::Task(TaskRefusal::Grasping(refusal)) = refusal(reply) else { panic!() };
    refusal
}

#[test]
fn commands_that_are_not_possible_leave_the_hand_ready() {
    let mut bench = tared_hand();
    assert_eq!(bench.ask(GRASP), Reply::Done);
    assert_eq!(seen(&mut bench).phase, Phase::Ready);
    for command in [
        GraspCommand::PutDown,
        GraspCommand::Open,
        GraspCommand::Move { translation: [0.0; 3], rotation: [0.0; 3], duration: 1.0 },
    ] {
        assert_eq!(grasp_refusal(bench.ask(task(command))), GraspRefusal::Busy(Phase::Ready));
    }
    let invalid = GraspPlan { clearance: 0.5, ..in_front() };
    assert_eq!(
        grasp_refusal(bench.ask(grasp(invalid))),
        GraspRefusal::Plan(InvalidPlan::Value {
            field: PlanField::Clearance,
            value: 0.5,
            lower: 0.001,
            upper: 0.05
        })
    );
    let mut far = in_front();
    far.contacts[2].position[0] = 0.15;
    let refused = grasp_refusal(bench.ask(grasp(far)));
    assert!(matches!(refused, GraspRefusal::OutOfReach { finger: 2, .. }), "{refused}");
    // Joint 1 of the second finger would be at 1.54 rad or, over the axis, at −1.60 rad.
    let mut sideways = in_front();
    sideways.contacts[1].position = [0.012_215, 0.171_912, 0.093_219_9];
    let refused = grasp_refusal(bench.ask(grasp(sideways)));
    let GraspRefusal::Limit(LimitRefusal::OutsideLimits { joint: 3, value, lower: -1.5, upper: 1.5 }) =
        refused
    else {
        panic!("{refused}")
    };
    assert!((value.abs() - 1.57).abs() < 0.05, "{refused}");
    assert_eq!(seen(&mut bench).phase, Phase::Ready);
}

/// At (±1.1, 0.1, 0.8) rad the first tip is 45.1545 mm from the axis of its first joint, at z = 116.960 mm.
/// It is led along y from (20.482, 40.242) to (20.482, −40.242) mm within 1.709 s, in the middle at 88.30
/// mm/s, where the joint turns at 4.311 rad/s.
#[test]
fn a_path_past_the_axis_of_a_joint_is_refused_with_its_speed() {
    let mut plan = in_front();
    // As there, 10 mm behind the tip's centre.
    plan.contacts[0].position = [0.030_482, -0.040_242, 0.116_960];
    for (velocity, refused) in [(5.2, true), (5.5, false)] {
        let mut model = hand();
        model.joints[0].limits.velocity = velocity;
        let mut bench = hand_of_model_at([1.1, 0.1, 0.8, 0.0, 0.5, 0.8, 0.0, -0.5, -0.8], &model);
        assert_eq!(bench.ask(Request::Tare), Reply::Done);
        assert_eq!(bench.ask(GRASP), Reply::Done);
        let reply = bench.ask(grasp(plan));
        if !refused {
            assert_eq!(reply, Reply::Done);
            continue;
        }
        let GraspRefusal::Limit(LimitRefusal::TooFast { joint: 0, value, limit }) = grasp_refusal(reply)
        else {
            panic!()
        };
        // 80 % of the velocity limit.
        assert!((limit - 4.16).abs() < 1e-5 && limit < value && value < 4.311, "{value}, {limit}");
        assert_eq!(seen(&mut bench).phase, Phase::Ready);
    }
}

#[test]
fn an_obstacle_stops_the_approach_and_an_open_command_turns_it_back() {
    let mut bench = tared_hand();
    assert_eq!(bench.ask(GRASP), Reply::Done);
    // A grasp command resets the command timeout: with the tick before, eleven ticks without another.
    bench.tick();
    assert_eq!(bench.ask(grasp(in_front())), Reply::Done);
    assert_eq!(seen(&mut bench).phase, Phase::Approach);
    assert_eq!(grasp_refusal(bench.ask(grasp(in_front()))), GraspRefusal::Busy(Phase::Approach));
    for _ in 0..10 {
        bench.tick();
        assert_eq!(bench.node.mode(), Mode::Enabled(TaskKind::Grasping));
    }
    assert_eq!(bench.ask(KEEP), Reply::Done);
    // 0.5 N are more than three times the touch force.
    bench.sensors.forces[2][1] += 500;
    bench.tick();
    let stopped = seen(&mut bench);
    let Some(Failure::Obstructed { finger: 2, force }) = stopped.failure else { panic!("{stopped:?}") };
    assert!((force - 0.5).abs() < 1e-3 && stopped.phase == Phase::Ready, "{stopped:?}");
    assert_eq!(bench.node.mode(), Mode::Enabled(TaskKind::Grasping), "a failure is no fault");
    assert_eq!(grasp_refusal(bench.ask(task(GraspCommand::Open))), GraspRefusal::Busy(Phase::Ready));
    assert_eq!(seen(&mut bench).failure, stopped.failure);
    assert_eq!(bench.ask(grasp(in_front())), Reply::Done);
    assert_eq!(seen(&mut bench).failure, None);

    bench.sensors.forces[2][1] -= 500;
    bench.tick();
    assert_eq!(bench.ask(task(GraspCommand::Open)), Reply::Done);
    assert_eq!(seen(&mut bench).phase, Phase::Open);
    bench.tick();
    assert_eq!(seen(&mut bench).phase, Phase::Open);
}

/// Runs a hand whose joints follow their references exactly, or do not move, with an object that presses on a
/// tip with 1 N once it is touched. Returns the last torques [N·m].
#[allow(clippy::disallowed_methods, reason = "the independent formula")]
fn run_pressed(bench: &mut Bench, ticks: u32, follows: bool) -> Vec<f32, MAX_JOINTS> {
    let mut torques = Vec::new();
    for tick in 0..ticks {
        let phase = seen(bench).phase;
        let references = bench.node.state.references;
        if follows {
            for (count, reference) in bench.sensors.encoders.iter_mut().zip(&references) {
                *count = (reference.position * COUNTS_PER_RADIAN).round() as i32;
            }
        }
        let presses = if phase == Phase::Approach { 0.0 } else { 1000.0 };
        for finger in 0..3 {
            let angle = references[3 * finger + 1].position + references[3 * finger + 2].position;
            let push = if finger == 2 { presses } else { -presses };
            // Noise of one count: constant counts would be a fault.
            let noise = (tick % 2) as i32;
            bench.sensors.forces[finger][0] = (push * angle.cos()) as i32 + noise;
            bench.sensors.forces[finger][2] = (push * angle.sin()) as i32;
        }
        torques = bench.tick().torques;
        keep(bench);
    }
    torques
}

pub fn keep(bench: &mut Bench) {
    assert_eq!(bench.ask(KEEP), Reply::Done, "{:?}", bench.node.faults());
}

/// A hand that holds an object by `plan`.
fn holding_hand(plan: GraspPlan) -> Bench {
    hand_that_grasps(plan, Phase::Hold, 200.0)
}

/// As [`holding_hand`], with this torque rate [N·m/s].
pub fn slow_holding_hand(plan: GraspPlan, torque_rate: f32) -> Bench {
    hand_that_grasps(plan, Phase::Hold, torque_rate)
}

/// A hand with this torque rate [N·m/s] that grasps an object by `plan`, up to a phase.
fn hand_that_grasps(plan: GraspPlan, phase: Phase, torque_rate: f32) -> Bench {
    hand_of_model_that_grasps(hand(), plan, phase, torque_rate)
}

/// As [`hand_that_grasps`], for this model.
fn hand_of_model_that_grasps(model: RobotModel, plan: GraspPlan, phase: Phase, torque_rate: f32) -> Bench {
    let mut bench = begin_grasp(model, plan, torque_rate);
    for _ in 0..100 {
        run_pressed(&mut bench, 10, true);
        if seen(&mut bench).phase == phase {
            break;
        }
    }
    assert_eq!(seen(&mut bench).phase, phase, "{:?}", seen(&mut bench).failure);
    bench
}

/// A hand of this model, with this torque rate [N·m/s], that begins to grasp an object by `plan`.
pub fn begin_grasp(mut model: RobotModel, plan: GraspPlan, torque_rate: f32) -> Bench {
    for JointModel { limits, .. } in &mut model.joints {
        // Under torque control the joints do not follow their targets.
        (limits.following_error, limits.torque_rate) = (1.0, torque_rate);
    }
    let mut bench = untared_hand();
    assert_eq!(bench.push(&model), Reply::Done);
    bench.tick();
    assert_eq!(bench.ask(Request::Tare), Reply::Done);
    assert_eq!(bench.ask(GRASP), Reply::Done);
    bench.tick();
    assert_eq!(bench.ask(grasp(plan)), Reply::Done);
    bench
}

/// The plan of the Hand3 paper.
pub fn paper_plan() -> GraspPlan {
    GraspPlan {
        internal: InternalForce::Normal { strength: 1.0 },
        feedback: false,
        object_frame: ObjectFrame::Triangle,
        joint_targets: JointTargets::Accumulated,
        ..in_front()
    }
}

/// Forces that rise against dry friction move an object on its support. A motion of 0.1 mm along x requires
/// (0, 2.92, −4.21) mrad of the joints of each finger: of `x = 46 sin b + 51.78 sin(b + c)` and
/// `z = 46 cos b + 51.78 cos(b + c)` [mm] the first grows and the second is constant, at
/// `(b, c) = (0.5, 0.8)` and `(−0.5, −0.8)`.
#[test]
fn forces_without_feedback_are_as_commanded_wherever_the_object_has_moved_while_they_rose() {
    let torques_after = |[bend, curl]: [f32; 2]| {
        let plan = GraspPlan {
            control: ObjectControl::Differential(ServoMode::Observer),
            joint_targets: JointTargets::ClosedForm,
            ..paper_plan()
        };
        let mut bench = hand_that_grasps(plan, Phase::Squeeze, 200.0);
        run_pressed(&mut bench, 20, false);
        for finger in bench.sensors.encoders.chunks_exact_mut(3) {
            finger[1] += (bend * COUNTS_PER_RADIAN) as i32;
            finger[2] += (curl * COUNTS_PER_RADIAN) as i32;
        }
        let torques = run_pressed(&mut bench, 280, false);
        assert_eq!(seen(&mut bench).phase, Phase::Hold);
        torques
    };
    let (at_rest, moved) = (torques_after([0.0; 2]), torques_after([0.002_92, -0.004_21]));
    for (joint, (at_rest, moved)) in at_rest.iter().zip(&moved).enumerate() {
        // Levers that are longer by 0.1 mm change the torque of 1 N by 0.1 mN·m; the gravity torques of the
        // links change as little.
        assert!((moved - at_rest).abs() < 1e-3, "{joint}: {moved}, not {at_rest}");
    }
}

/// Joint angles before a motion of the object, and their changes after it, from
/// `tests/oracles/accumulated_targets.py` (SciPy: the integral of equation (25) with `D_F`, `J_F` and `D_o`
/// by difference quotients).
#[allow(clippy::excessive_precision, reason = "written by a script")]
const ACCUMULATED: [[f32; 9]; 2] = include!("../../../../tests/oracles/data/accumulated_targets.in");

/// The accumulated joint targets move the contact points, 8 mm from the centres of the tips, with an object
/// that is translated and rotated.
#[test]
fn accumulated_joint_targets_move_the_contacts_with_the_object() {
    let mut bench = holding_hand(paper_plan());
    let angles =
        |bench: &Bench| [0, 1, 2, 3, 4, 5, 6, 7, 8].map(|joint| bench.node.state.references[joint].position);
    let before = angles(&bench);
    let (translation, rotation) = ([0.002, 0.001, 0.003], [0.0, 0.06, 0.03]);
    let motion = task(GraspCommand::Move { translation, rotation, duration: 1.0 });
    assert_eq!(bench.ask(motion.clone()), Reply::Done);
    run_pressed(&mut bench, 50, true);
    // From here another motion would begin with a jump of the velocity.
    let busy = TaskRefusal::Grasping(GraspRefusal::Busy(Phase::Move));
    assert_eq!(refusal(bench.ask(motion)), Refusal::Task(busy));
    run_pressed(&mut bench, 60, true);
    let [start, changes] = ACCUMULATED;
    for (joint, (before, after)) in before.into_iter().zip(angles(&bench)).enumerate() {
        assert!((before - start[joint]).abs() < 2e-3, "{joint}: begins at {before}, not {}", start[joint]);
        let moved = after - before;
        // Point contacts at the centres, or closed-form targets, would differ by up to 0.15 rad.
        assert!((moved - changes[joint]).abs() < 3e-3, "{joint}: {moved}, not {}", changes[joint]);
    }
}

/// The tip of a finger whose second joint is at `b` and whose third one turns from 0.8 to 1.2 rad moves by
/// 51.78 mm · (sin(b + 1.2) − sin(b + 0.8), cos(b + 1.2) − cos(b + 0.8)). On the straight line the second
/// joint must move back by 26 mrad in between.
#[test]
fn a_motion_through_what_is_out_of_reach_ends_where_it_was_and_the_hand_can_open() {
    let servo = GraspPlan { joint_targets: JointTargets::ClosedForm, ..paper_plan() };
    for plan in [servo, wrench_plan(), paper_plan()] {
        let mut model = hand();
        model.joints[1].limits.lower = 0.495;
        let mut bench = hand_of_model_that_grasps(model, plan, Phase::Hold, 200.0);
        let translation = [0.001_455, 0.0, -0.020_52];
        let request =
            |translation| task(GraspCommand::Move { translation, rotation: [0.0; 3], duration: 1.0 });
        assert_eq!(bench.ask(request(translation)), Reply::Done);
        run_pressed(&mut bench, 110, true);
        let stopped = seen(&mut bench);
        assert_eq!((stopped.phase, stopped.failure), (Phase::Hold, Some(Failure::OutOfReach { finger: 0 })));
        let angle = |bench: &Bench| bench.node.state.references[1].position;
        assert!((angle(&bench) - 0.495).abs() < 2e-3, "{}", angle(&bench));
        // Back, which is no failure, and open.
        assert_eq!(bench.ask(request([0.0, 0.0, 0.002])), Reply::Done);
        run_pressed(&mut bench, 110, true);
        assert_eq!((seen(&mut bench).phase, seen(&mut bench).failure), (Phase::Hold, None));
        assert_eq!(bench.ask(task(GraspCommand::Open)), Reply::Done);
        run_pressed(&mut bench, 100, true);
        assert_eq!(seen(&mut bench).phase, Phase::Ready);
    }
}

/// As [`paper_plan`], with the torques of the printed control of the object.
pub fn wrench_plan() -> GraspPlan {
    let gains =
        WrenchGains { position: [200.0, 400.0], orientation: [2.0, 4.0], damping: 0.05, compensated: false };
    GraspPlan {
        control: ObjectControl::Wrench(gains),
        load: LoadSource::Constant { mass: 0.05 },
        joint_targets: JointTargets::ClosedForm,
        ..paper_plan()
    }
}

/// An object 2 mm beside its place, under 10 N/mm: finger 3, which holds it with 1 N, would press with 7.5 N;
/// its limit is 1.5 N. Then the others, which hold it with 0.5 N, do not pull: the forces of the control are
/// scaled together. (0.058, −0.084) rad of the joints move a tip by 2 mm along x, as above, and the lever of
/// the second joint stays 54.2 mm.
#[test]
fn the_wrench_on_an_object_does_not_exceed_the_force_limit() {
    let gains = WrenchGains { position: [1e4, 0.0], orientation: [0.0; 2], damping: 0.0, compensated: true };
    let plan = GraspPlan { control: ObjectControl::Wrench(gains), force_limit: 1.5, ..wrench_plan() };
    let mut bench = holding_hand(plan);
    run_pressed(&mut bench, 20, false);
    for finger in bench.sensors.encoders.chunks_exact_mut(3) {
        finger[1] += (0.058 * COUNTS_PER_RADIAN) as i32;
        finger[2] -= (0.084 * COUNTS_PER_RADIAN) as i32;
    }
    let torques = run_pressed(&mut bench, 1, false);
    assert_eq!(seen(&mut bench).phase, Phase::Hold);
    // 81 mN·m, less up to 12 mN·m for the weight of the links and 10 mN·m for that of the object.
    assert!((0.059..0.082).contains(&-torques[7]), "{torques:?}");
    // The weights, and no force along x.
    assert!(torques[1].abs() < 0.03 && torques[4].abs() < 0.03, "{torques:?}");
}

/// The servos of a hand restart before open-loop internal forces rise, and after torque control.
/// [`Bench::tick`] compares the torques.
#[test]
fn servos_that_restart_in_a_grasp_keep_the_torque_rate() {
    for (plan, torques) in [(paper_plan(), false), (wrench_plan(), true)] {
        // 1 mN·m per tick.
        let mut bench = slow_holding_hand(plan, 0.1);
        assert_eq!(bench.node.state.targets.actuation != Actuation::Servo, torques);
        let held = run_pressed(&mut bench, 100, true);
        assert!(held.iter().any(|torque| torque.abs() > 0.01), "{held:?}");
        assert_eq!(bench.ask(task(GraspCommand::Open)), Reply::Done);
        run_pressed(&mut bench, 200, true);
        assert_eq!(bench.node.state.targets.actuation, Actuation::Servo);
    }
}

/// 0.05 rad away from where the PID was last in use, with a plan of the observer in between: for the PID that
/// is no speed. Its 0.01 N·m·s/rad, cut off at 30 rad/s, would make 15 mN·m of it, beside 20 mN·m for the
/// error.
#[test]
fn a_plan_with_the_other_servo_begins_it_where_the_joints_are() {
    let mut bench = tared_hand();
    assert_eq!(bench.ask(GRASP), Reply::Done);
    let observer = GraspPlan { control: ObjectControl::Differential(ServoMode::Observer), ..in_front() };
    for (command, ticks) in [(GraspCommand::Grasp(observer), 5), (GraspCommand::Open, 200)] {
        assert_eq!(bench.ask(task(command)), Reply::Done);
        for _ in 0..ticks {
            let joints = bench.node.telemetry().joints;
            for (count, joint) in bench.sensors.encoders.iter_mut().zip(joints) {
                *count = libm::roundf(joint.reference * COUNTS_PER_RADIAN) as i32;
            }
            // Constant counts would be a fault.
            bench.sensors.forces.iter_mut().for_each(|counts| counts[5] ^= 1);
            assert_eq!(bench.ask(KEEP), Reply::Done);
            assert!(bench.tick().enabled);
        }
    }
    assert_eq!(seen(&mut bench).phase, Phase::Ready);
    for _ in 0..10 {
        bench.sensors.encoders.iter_mut().for_each(|count| *count += (0.005 * COUNTS_PER_RADIAN) as i32);
        assert_eq!(bench.ask(KEEP), Reply::Done);
        assert!(bench.tick().enabled);
    }
    assert_eq!(bench.ask(grasp(in_front())), Reply::Done);
    for _ in 0..2 {
        assert!(bench.tick().enabled);
        for (joint, reference) in bench.node.state.references.iter().take(9).enumerate() {
            let error = reference.position - bench.node.state.measured.positions[joint];
            let effort = bench.node.state.joints[joint].effort;
            assert!(error < -0.049 && (effort - 0.4 * error).abs() < 2e-3, "{joint}: {effort} N·m, {error}");
        }
    }
}

/// Torques [N·m] from `tests/oracles/object_control.py` (NumPy: the pseudo-inverse of the grasp matrix,
/// Jacobians by difference quotients).
#[allow(clippy::excessive_precision, reason = "written by a script")]
const CONTROLLED: [f32; 9] = include!("../../../../tests/oracles/data/object_control.in");

/// Equations (16) to (20): the torques of all fingers push an object that lags behind its target towards it,
/// in addition to internal force and load, and contain nothing else.
#[test]
fn the_pose_of_the_object_is_controlled_by_torques_as_printed() {
    let mut bench = holding_hand(wrench_plan());
    let (translation, rotation) = ([0.002, 0.001, 0.003], [0.0, 0.02, 0.0]);
    for duration in [601.0, 0.0, f32::NAN] {
        let reply = bench.ask(task(GraspCommand::Move { translation, rotation, duration }));
        let refused = Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotFinite));
        assert_eq!(reply, Reply::Refused(refused), "{duration}");
    }
    assert_eq!(bench.ask(task(GraspCommand::Move { translation, rotation, duration: 1.0 })), Reply::Done);
    let torques = run_pressed(&mut bench, 110, false);
    for (joint, (torque, expected)) in torques.iter().zip(CONTROLLED).enumerate() {
        // One tick of the integral is 0.4 mN·m.
        assert!((torque - expected).abs() < 1e-3, "{joint}: {torque}, not {expected}");
    }
}

#[test]
fn what_is_refused_to_a_hand_says_why() {
    let texts = [
        (
            Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotAHand)),
            "the robot is not a hand of three fingers, each with a force sensor and three joints whose axes 2 and 3 \
                 are parallel",
        ),
        (
            Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotTared { chain: 1 })),
            "the force sensor of chain 1 was not tared since the model was pushed or the joints were \
             homed: tare it while nothing touches the tips",
        ),
        (
            Refusal::Task(TaskRefusal::Grasping(GraspRefusal::Busy(Phase::Move))),
            "not possible while the hand moves an object",
        ),
        (
            Refusal::Task(TaskRefusal::Grasping(GraspRefusal::Plan(InvalidPlan::NoTriangle))),
            "the contacts coincide or are collinear: place them on a triangle",
        ),
        (
            Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::TooMuchTorque {
                joint: 2,
                value: -0.75,
                limit: 0.5,
            }))),
            "joint 2: -0.75 N·m is beyond its limit of 0.5 N·m",
        ),
    ];
    for (refusal, text) in texts {
        assert_eq!(refusal.to_string(), text);
    }
    assert_eq!(
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::TooMuchTorque {
            joint: 2,
            value: 1.0,
            limit: 0.5
        })))
        .joint(),
        Some(2)
    );
    assert_eq!(Refusal::Task(TaskRefusal::Grasping(GraspRefusal::NotTared { chain: 1 })).chain(), Some(1));
    let fault = |cause, joint, value, limit| {
        Fault { cause, joint, value, limit, tick: 12 }.named(&hand()).to_string()
    };
    assert_eq!(
        fault(FaultCause::ObjectLost, Some(5), 0.01, 0.015),
        "fault 21 in tick 12: f: its finger no longer touches the object in the hand (value 0.01 N, limit \
         0.015 N)"
    );
    assert_eq!(
        fault(FaultCause::ObjectMoved, None, 0.016, 0.015),
        "fault 22 in tick 12: the object in the hand was moved, or slid between the fingers (value 0.016 m, \
         limit 0.015 m)"
    );
}
