//! Set-points of fingertips.

use heapless::Vec;

use super::bench::{Bench, COUNTS_PER_RADIAN, model, refusal};
use crate::control::JointPoint;
use crate::kinematics::TipPoint;
use crate::model::{ChainModel, RobotModel};
use crate::protocol::{Refusal, Reply, Request};
use crate::robot::LimitRefusal;
use crate::task::joint_servo::{JointCommand, JointServoRefusal};
use crate::task::{TaskCommand, TaskRefusal};

/// Two fingers of Hand3, side by side.
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

/// Armed, the fingers at these angles.
fn fingers_at(angles: [f32; 6]) -> Bench {
    let mut bench = Bench::new();
    bench.sensors.encoders = angles.iter().map(|angle| (angle * COUNTS_PER_RADIAN) as i32).collect();
    bench.sensors.currents = [0; 6].into_iter().collect();
    bench.command();
    assert_eq!(bench.push(&fingers()), Reply::Done);
    bench.tick();
    assert_eq!(bench.arm(), Reply::Done);
    bench.tick();
    bench
}

fn reach(tips: &[TipPoint]) -> Request {
    Request::Task(TaskCommand::JointServo(JointCommand::Reach { tips: Vec::from_slice(tips).unwrap() }))
}

pub fn references(bench: &Bench) -> std::vec::Vec<JointPoint> {
    bench.node.state.references[..6].to_vec()
}

/// Tip of the first finger at (0.1, 0.5, 0.8): r = 46 sin 0.5 + 51.78 sin 1.3 = 71.9466 mm,
/// z = 39 + 46 cos 0.5 + 51.78 cos 1.3 = 93.2199 mm; and of the second one, 0.1 m beside it, at (−0.2, 1.349
/// 97, −0.8), which bends the other way to the same r and z.
pub const TIPS: [[f32; 3]; 2] =
    [[0.071_587_2, 0.007_182_7, 0.093_219_9], [0.070_512_5, 0.085_706_5, 0.093_219_9]];

pub const ANGLES: [f32; 6] = [0.1, 0.5, 0.8, -0.2, 1.349_97, -0.8];

#[test]
fn fingertips_are_led_through_space_with_their_velocities_and_accelerations() {
    let mut bench = fingers_at(ANGLES);
    // The first round its root's axis: only its first joint turns, at 0.5 rad/s, and the tip falls towards
    // the axis with ω² r. The second stays where it is, bent as it is.
    let [x, y, _] = TIPS[0];
    let turning = TipPoint {
        position: TIPS[0],
        velocity: [-0.5 * y, 0.5 * x, 0.0],
        acceleration: [-0.25 * x, -0.25 * y, 0.0],
    };
    let resting = TipPoint { position: TIPS[1], ..TipPoint::default() };
    assert_eq!(bench.ask(reach(&[turning, resting])), Reply::Done);
    bench.tick();
    for ((joint, angle), speed) in references(&bench).iter().zip(ANGLES).zip([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]) {
        assert!((joint.position - angle).abs() < 2e-4, "{joint:?} {angle}");
        assert!((joint.velocity - speed).abs() < 1e-3 && joint.acceleration.abs() < 1e-2, "{joint:?}");
    }
}

#[test]
fn fingertips_are_refused_by_name_what_they_cannot_do() {
    let mut bench = fingers_at(ANGLES);
    let before = references(&bench);
    let rest = |position| TipPoint { position, ..TipPoint::default() };
    let still = rest(TIPS[0]);
    let mut refused = |second: TipPoint| refusal(bench.ask(reach(&[still, second])));
    // Straight out from the second finger's second joint it reaches 97.78 mm.
    let Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::OutOfReach {
        chain: 1,
        nearest: [x, y, z],
    })) = refused(rest([0.3, 0.1, 0.039]))
    else {
        panic!()
    };
    assert!((x - 0.097_78).abs() < 1e-6 && (y - 0.1).abs() < 1e-6 && (z - 0.039).abs() < 1e-6, "{x} {y} {z}");
    assert_eq!(
        refused(rest([f32::NAN, 0.1, 0.1])),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::TipNotFinite { chain: 1 }))
    );
    let [x, y, z] = TIPS[1];
    let moving = |velocity, acceleration| TipPoint { position: [x, y, z], velocity, acceleration };
    assert_eq!(
        refused(moving([f32::NAN, 0.0, 0.0], [0.0; 3])),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::NotFinite {
            joint: 3
        })))
    );
    assert!(matches!(
        refused(moving([0.0, 2.0, 0.0], [0.0; 3])),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::TooFast {
            joint: 3,
            ..
        })))
    ));
    // 0.6 N·m on 2.1e-4 kg·m².
    let Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::TooMuchAcceleration {
        joint: 3,
        limit,
        ..
    }))) = refused(moving([0.0; 3], [0.0, 900.0, 0.0]))
    else {
        panic!()
    };
    assert!((limit - 2857.14).abs() < 0.1, "{limit}");
    // Its first joint at 1.54 rad, or bent over its axis at −1.60 rad: both beyond ±1.5.
    let Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::OutsideLimits {
        joint: 3,
        value,
        lower: -1.5,
        upper: 1.5,
    }))) = refused(rest([0.002_215, 0.171_912, z]))
    else {
        panic!()
    };
    assert!((value + 1.6).abs() < 0.01 || (value - 1.54).abs() < 0.01, "{value}");
    // Over its axis: within the limits, but far from how it is bent.
    assert!(matches!(
        refused(rest([-x, 0.2 - y, z])),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Limit(LimitRefusal::Jump { joint: 4, .. })))
    ));
    // Nearly straight: the tip hardly moves outwards.
    let straight = rest([0.097_779_9 * 0.841_471, 0.1, 0.039 + 0.097_779_9 * 0.540_302]);
    let straight = TipPoint { velocity: [0.001, 0.0, 0.0], ..straight };
    assert_eq!(
        refused(straight),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::Singular { chain: 1 }))
    );
    assert_eq!(
        refusal(bench.ask(reach(&[still]))),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::TipCount { got: 1, expected: 2 }))
    );
    bench.tick();
    assert_eq!(references(&bench), before);
    // Another robot has no closed form.
    let mut other = Bench::armed(&model());
    assert_eq!(
        refusal(other.ask(reach(&[still]))),
        Refusal::Task(TaskRefusal::JointServo(JointServoRefusal::NotAFinger { chain: 0 }))
    );
}
