//! The arm angle and its Jacobian.

use super::fixture::{ArmFixture, DOWN, POSTURES, arm7};
use crate::kinematics::Chain;
use crate::model::MAX_CHAIN_JOINTS;
use crate::task::impedance::ArmAngle;

#[test]
fn the_jacobian_of_the_arm_angle_matches_difference_quotients() {
    let fixture = ArmFixture::new();
    let arm_angle = |angles: &[f32]| ArmAngle::of(&fixture.chain.posture(angles), &DOWN).unwrap();
    // By definition: the elbow is down in the first posture.
    assert!(arm_angle(&POSTURES[0]).angle.abs() < 1e-6);
    for posture in POSTURES {
        let ArmAngle { jacobian, .. } = arm_angle(&posture);
        for joint in 0..MAX_CHAIN_JOINTS {
            let at = |step: f32| {
                let mut angles = posture;
                angles[joint] += step;
                arm_angle(&angles).angle
            };
            let step = 2e-3;
            let change = (at(step) - at(-step)) / (2.0 * step);
            assert!((change - jacobian[joint]).abs() < 2e-3, "{posture:?} {joint}: {change} {jacobian}");
        }
    }
}

#[test]
fn the_arm_angle_is_undefined_for_a_vertical_arm_and_for_six_joints() {
    let fixture = ArmFixture::new();
    let hanging = fixture.chain.posture(&[0.0; MAX_CHAIN_JOINTS]);
    assert!(ArmAngle::of(&hanging, &DOWN).is_none());
    let model = arm7();
    let six = Chain::new(&model.joints[..6], &model.chains[0].tip);
    assert!(ArmAngle::of(&six.posture(&POSTURES[1]), &DOWN).is_none());
}
