//! The arm angle and its Jacobian.

use super::machine::{DOWN, Machine, POSTURES, arm7};
use crate::arm::ArmAngle;
use crate::kinematics::Chain;
use crate::model::MAX_CHAIN_JOINTS;

#[test]
fn the_jacobian_of_the_arm_angle_is_how_it_changes() {
    let machine = Machine::new();
    let of = |angles: &[f32]| ArmAngle::of(&machine.chain.posture(angles), &DOWN).unwrap();
    // By the definition: elbow down in the first posture; out to the right is a quarter of a turn.
    assert!(of(&POSTURES[0]).angle.abs() < 1e-6);
    for posture in POSTURES {
        let ArmAngle { jacobian, .. } = of(&posture);
        for joint in 0..MAX_CHAIN_JOINTS {
            let at = |step: f32| {
                let mut angles = posture;
                angles[joint] += step;
                of(&angles).angle
            };
            let step = 2e-3;
            let change = (at(step) - at(-step)) / (2.0 * step);
            assert!((change - jacobian[joint]).abs() < 2e-3, "{posture:?} {joint}: {change} {jacobian}");
        }
    }
}

#[test]
fn there_is_no_arm_angle_below_the_shoulder_and_of_six_joints() {
    let machine = Machine::new();
    let hanging = machine.chain.posture(&[0.0; MAX_CHAIN_JOINTS]);
    assert!(ArmAngle::of(&hanging, &DOWN).is_none());
    let model = arm7();
    let six = Chain::new(&model.joints[..6], &model.chains[0].tip);
    assert!(ArmAngle::of(&six.posture(&POSTURES[1]), &DOWN).is_none());
}
