//! Set-points of fingertips.

use heapless::Vec;

use super::rig::{COUNTS_PER_RADIAN, Rig, model, refusal};
use crate::control::JointPoint;
use crate::kinematics::TipPoint;
use crate::model::{ChainModel, RobotModel};
use crate::protocol::{Refusal, Reply, Request};
use crate::robot::LimitRefusal;
use crate::task::joint_servo::{JointCommand, JointServoRefusal};
use crate::task::{TaskCommand, TaskRefusal};

/// Two fingers of the Hand3 paper, side by side.
pub fn fingers() -> RobotModel {
    let mut model = model();
    model.joints.extend_from_slice(&model.joints.clone()).unwrap();
    let shapes = [(0.0, [0.0, 0.0, 1.0]), (0.039, [0.0, 1.0, 0.0]), (0.046, [0.0, 1.0, 0.0])];
    for (index, joint) in model.joints.iter_mut().enumerate() {
        let (height, axis) = shapes[index % 3];
        joint.name = ["a", "b", "c", "d", "e", "f"][index].try_into().unwrap();
        joint.origin.translation = [0.0, if index == 3 { 0.1 } else { 0.0 }, height];
        joint.axis = axis;
    }
    model.chains[0].tip.translation = [0.0, 0.0, 0.051_78];
    model.chains.push(ChainModel { name: "other".try_into().unwrap(), ..model.chains[0].clone() }).unwrap();
    model
}

/// An enabled rig with the fingers at these angles.
fn fingers_at(angles: [f32; 6]) -> Rig {
    let mut rig = Rig::new();
    rig.sensors.encoders = angles.iter().map(|angle| (angle * COUNTS_PER_RADIAN) as i32).collect();
    rig.sensors.currents = [0; 6].into_iter().collect();
    rig.command();
    assert_eq!(rig.push(&fingers()), Reply::Done);
    rig.tick();
    assert_eq!(rig.enable(), Reply::Done);
    rig.tick();
    rig
}

fn stream_tips(tips: &[TipPoint]) -> Request {
    Request::Task(TaskCommand::JointServo(JointCommand::StreamTips { tips: Vec::from_slice(tips).unwrap() }))
}

pub fn references(rig: &Rig) -> std::vec::Vec<JointPoint> {
    rig.node.state.references[..6].to_vec()
}

/// Fingertips at [`ANGLES`]: at (0.1, 0.5, 0.8) r = 46 sin 0.5 + 51.78 sin 1.3 = 71.9466 mm and z = 39 + 46
/// cos 0.5 + 51.78 cos 1.3 = 93.2199 mm. The second finger, 0.1 m beside the first, has the same r and z on
/// the other flexion branch.
pub const TIPS: [[f32; 3]; 2] =
    [[0.071_587_2, 0.007_182_7, 0.093_219_9], [0.070_512_5, 0.085_706_5, 0.093_219_9]];

pub const ANGLES: [f32; 6] = [0.1, 0.5, 0.8, -0.2, 1.349_97, -0.8];

#[test]
fn points_of_fingertips_become_positions_velocities_and_accelerations_of_joints() {
    let mut rig = fingers_at(ANGLES);
    // The first tip rotates about the root axis at 0.5 rad/s, with the centripetal acceleration ω² r: only
    // joint 1 moves. The second tip is at rest.
    let [x, y, _] = TIPS[0];
    let rotating = TipPoint {
        position: TIPS[0],
        velocity: [-0.5 * y, 0.5 * x, 0.0],
        acceleration: [-0.25 * x, -0.25 * y, 0.0],
    };
    let resting = TipPoint { position: TIPS[1], ..TipPoint::default() };
    assert_eq!(rig.ask(stream_tips(&[rotating, resting])), Reply::Done);
    rig.tick();
    for ((joint, angle), speed) in references(&rig).iter().zip(ANGLES).zip([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]) {
        assert!((joint.position - angle).abs() < 2e-4, "{joint:?} {angle}");
        assert!((joint.velocity - speed).abs() < 1e-3 && joint.acceleration.abs() < 1e-2, "{joint:?}");
    }
}

/// The refusal of `point` for the second fingertip. The references must not change.
fn refused(point: TipPoint) -> JointServoRefusal {
    let mut rig = fingers_at(ANGLES);
    let before = references(&rig);
    let still = TipPoint { position: TIPS[0], ..TipPoint::default() };
    let Refusal::Task(TaskRefusal::JointServo(refusal)) = refusal(rig.ask(stream_tips(&[still, point])))
    else {
        panic!()
    };
    rig.tick();
    assert_eq!(references(&rig), before);
    refusal
}

fn at_rest(position: [f32; 3]) -> TipPoint {
    TipPoint { position, ..TipPoint::default() }
}

/// A point with this motion at the second fingertip.
fn moving(velocity: [f32; 3], acceleration: [f32; 3]) -> TipPoint {
    TipPoint { position: TIPS[1], velocity, acceleration }
}

#[test]
fn points_out_of_reach_and_singular_points_are_refused() {
    // The straight finger has a reach of 97.78 mm from its second joint.
    let JointServoRefusal::OutOfReach { chain: 1, nearest: [x, y, z] } = refused(at_rest([0.3, 0.1, 0.039]))
    else {
        panic!()
    };
    assert!((x - 0.097_78).abs() < 1e-6 && (y - 0.1).abs() < 1e-6 && (z - 0.039).abs() < 1e-6, "{x} {y} {z}");
    assert_eq!(refused(at_rest([f32::NAN, 0.1, 0.1])), JointServoRefusal::TipNotFinite { chain: 1 });
    // Nearly straight: singular in the radial direction.
    let straight = [0.097_779_9 * 0.841_471, 0.1, 0.039 + 0.097_779_9 * 0.540_302];
    let straight = TipPoint { velocity: [0.001, 0.0, 0.0], ..at_rest(straight) };
    assert_eq!(refused(straight), JointServoRefusal::Singular { chain: 1 });
}

#[test]
fn points_beyond_joint_limits_are_refused() {
    assert_eq!(
        refused(moving([f32::NAN, 0.0, 0.0], [0.0; 3])),
        JointServoRefusal::Limit(LimitRefusal::NotFinite { joint: 3 })
    );
    assert!(matches!(
        refused(moving([0.0, 2.0, 0.0], [0.0; 3])),
        JointServoRefusal::Limit(LimitRefusal::TooFast { joint: 3, .. })
    ));
    // 0.6 N·m on 2.1e-4 kg·m².
    let JointServoRefusal::Limit(LimitRefusal::TooMuchAcceleration { joint: 3, limit, .. }) =
        refused(moving([0.0; 3], [0.0, 900.0, 0.0]))
    else {
        panic!()
    };
    assert!((limit - 2857.14).abs() < 0.1, "{limit}");
    let [x, y, z] = TIPS[1];
    // Joint 1 at 1.54 rad or, over the axis, at −1.60 rad: both beyond ±1.5.
    let JointServoRefusal::Limit(LimitRefusal::OutsideLimits { joint: 3, value, lower: -1.5, upper: 1.5 }) =
        refused(at_rest([0.002_215, 0.171_912, z]))
    else {
        panic!()
    };
    assert!((value + 1.6).abs() < 0.01 || (value - 1.54).abs() < 0.01, "{value}");
    // Over the axis: within the limits, but far from the reference.
    assert!(matches!(
        refused(at_rest([-x, 0.2 - y, z])),
        JointServoRefusal::Limit(LimitRefusal::Jump { joint: 4, .. })
    ));
}

#[test]
fn wrong_numbers_of_tips_and_other_chains_are_refused() {
    let still = at_rest(TIPS[0]);
    let mut rig = fingers_at(ANGLES);
    assert_eq!(
        refusal(rig.ask(stream_tips(&[still]))),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::TipCount { got: 1, expected: 2 }))
    );
    let mut other = Rig::enabled(&model());
    assert_eq!(
        refusal(other.ask(stream_tips(&[still]))),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::NotAFinger { chain: 0 }))
    );
}
