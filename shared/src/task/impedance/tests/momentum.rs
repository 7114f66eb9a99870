//! The momentum observer.

use super::fixture::ArmFixture;
use crate::TICK;
use crate::model::MAX_CHAIN_JOINTS;
use crate::task::impedance::momentum::MomentumObserver;
use crate::task::impedance::redundancy::JointVector;

/// Per tick: joint angles, motor torques of the next period, and external joint torques half a period ago
/// behind a filter of 30 rad/s (`tests/oracles/momentum.py`).
type Sample = ([f32; MAX_CHAIN_JOINTS], [f32; MAX_CHAIN_JOINTS], [f32; MAX_CHAIN_JOINTS]);

#[allow(clippy::excessive_precision, reason = "the digits of the script")]
const SAMPLES: &[Sample] = include!("../../../../../tests/oracles/data/momentum.in");

#[test]
fn external_torques_are_estimated_from_motor_torques() {
    let mut fixture = ArmFixture::new();
    fixture.model.joints.iter_mut().for_each(|joint| {
        (joint.friction.coulomb, joint.friction.viscous) = (0.0, 0.3);
    });
    let mut observer = MomentumObserver::NONE;
    let (mut max_error, mut max_torque, mut last) = (0.0_f32, 0.0_f32, SAMPLES[0].0);
    for (tick, (angles, torques, expected)) in SAMPLES.iter().enumerate() {
        let velocities = core::array::from_fn(|joint| (angles[joint] - last[joint]) / TICK);
        // At rest by its argument, the observer tares at sample 42; the external torques begin after sample
        // 50.
        observer.update(&fixture.arm(), angles, &velocities, 30.0, true);
        // An earlier tare has no effect.
        if tick < 42 {
            observer.tare();
            assert!(tick == 41 || observer.torques() == JointVector::zeros(), "0 before the tare");
        }
        let error = observer.torques() - JointVector::from(*expected);
        max_error = max_error.max(error.amax());
        max_torque = max_torque.max(JointVector::from(*expected).amax());
        observer.push(torques);
        last = *angles;
    }
    assert!(max_torque > 1.5 && max_error < 0.02 * max_torque, "{max_error} of {max_torque} N·m");
}
