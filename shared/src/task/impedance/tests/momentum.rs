//! The torques of the world, found by the motors.

use super::machine::Machine;
use crate::TICK;
use crate::model::MAX_CHAIN_JOINTS;
use crate::task::impedance::momentum::MomentumObserver;
use crate::task::impedance::redundancy::Joints;

/// Of each tick: angles, torques held from then on, and the joint torques of a push behind a filter of 30
/// rad/s, half a period ago (`tests/oracles/momentum.py`).
type Moved = ([f32; MAX_CHAIN_JOINTS], [f32; MAX_CHAIN_JOINTS], [f32; MAX_CHAIN_JOINTS]);

#[allow(clippy::excessive_precision, reason = "as the script has them")]
const MOVED: &[Moved] = include!("../../../../../tests/oracles/data/momentum.in");

#[test]
fn torques_of_the_world_are_found_in_those_of_the_motors() {
    let mut machine = Machine::new();
    machine.model.joints.iter_mut().for_each(|joint| {
        (joint.friction.coulomb, joint.friction.viscous) = (0.0, 0.3);
    });
    let mut observer = MomentumObserver::NONE;
    let (mut worst, mut largest, mut last) = (0.0_f32, 0.0_f32, MOVED[0].0);
    for (tick, (angles, torques, expected)) in MOVED.iter().enumerate() {
        let velocities = core::array::from_fn(|joint| (angles[joint] - last[joint]) / TICK);
        // It counts as resting and tares at the 42nd reading; nothing pushes before the fiftieth.
        observer.update(&machine.arm(), angles, &velocities, 30.0, true);
        // A tare before that changes nothing.
        if tick < 42 {
            observer.tare();
            assert!(tick == 41 || observer.torques() == Joints::zeros(), "none before the tare");
        }
        let error = observer.torques() - Joints::from(*expected);
        worst = worst.max(error.amax());
        largest = largest.max(Joints::from(*expected).amax());
        observer.push(torques);
        last = *angles;
    }
    assert!(largest > 1.5 && worst < 0.02 * largest, "{worst} of {largest} N·m");
}
