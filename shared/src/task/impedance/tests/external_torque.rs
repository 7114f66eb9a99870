//! The estimate of external torques.

use super::fixture::ArmFixture;
use crate::TICK;
use crate::model::MAX_CHAIN_JOINTS;
use crate::task::impedance::external_torque::ExternalTorqueEstimate;
use crate::task::impedance::redundancy::JointVector;

/// Per tick: joint angles, motor torques of the next period, and external joint torques half a period ago
/// behind a filter of 30 rad/s (`tests/oracles/external_torque.py`).
type Sample = ([f32; MAX_CHAIN_JOINTS], [f32; MAX_CHAIN_JOINTS], [f32; MAX_CHAIN_JOINTS]);

#[allow(clippy::excessive_precision, reason = "the digits of the script")]
const SAMPLES: &[Sample] = include!("../../../../../tests/oracles/data/external_torque.in");

/// The maximum error of the estimate and the maximum torque [N·m], if some samples are missed.
fn estimate(missed: core::ops::Range<usize>) -> [f32; 2] {
    let mut fixture = ArmFixture::new();
    fixture.model.joints.iter_mut().for_each(|joint| {
        (joint.friction.coulomb, joint.friction.viscous) = (0.0, 0.3);
    });
    let mut observer = ExternalTorqueEstimate::NONE;
    let (mut max_error, mut max_torque) = (0.0_f32, 0.0_f32);
    for (tick, (angles, torques, expected)) in SAMPLES.iter().enumerate() {
        if missed.contains(&tick) {
            observer.push(torques);
            continue;
        }
        if tick == missed.end && !missed.is_empty() {
            observer.miss();
        }
        let (last, ..) = &SAMPLES[tick.saturating_sub(1)];
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
    }
    [max_error, max_torque]
}

#[test]
fn external_torques_are_estimated_from_motor_torques() {
    let [error, torque] = estimate(0..0);
    assert!(torque > 1.5 && error < 0.02 * torque, "{error} of {torque} N·m");
}

/// The estimate only stands still meanwhile.
#[test]
fn missed_ticks_are_no_external_torques() {
    for missed in [60..61, 70..72, 80..81] {
        let [error, torque] = estimate(missed.clone());
        assert!(error < 0.2 * torque, "{missed:?}: {error} of {torque} N·m");
    }
}
