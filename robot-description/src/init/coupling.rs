//! Servos of joints that carry much of each other's inertia: slow enough that they do not swing together.

use nalgebra::{DMatrix, DVector};
use tesaki::TICK;
use tesaki::control::{ErrorObserver, ObserverState};

use super::servo::JointPlan;
use crate::load::CoupledChains;

/// The largest mean factor of an error in a tick.
const DECAY: f32 = 0.99;
/// An error of 1 is followed until it has decayed or grown to these values, but not for longer than this.
const DECAYED: f32 = 3e-4;
const GROWN: f32 = 1e6;
const TICKS: u16 = 1000;
/// Time in which an error's velocity counts as an error [s].
const AHEAD: f32 = 0.05;

/// Lowers bandwidths until the error of each joint decays in every posture within `limits` [rad], with those
/// that it causes in other joints. `slower` plans a joint with the next lower bandwidth, if there is one: the
/// joint is slowed for which that helps most in the worst posture.
pub fn slow_down(
    group: &CoupledChains,
    limits: &[(f32, f32)],
    plans: &mut [JointPlan],
    slower: impl Fn(usize, &JointPlan) -> Option<JointPlan>,
) {
    let mobilities: Vec<DMatrix<f32>> = group.mobilities(limits).collect();
    let mut servos: Vec<ErrorObserver> = plans.iter().map(JointPlan::observer).collect();
    loop {
        let factors = mobilities.iter().map(|mobility| (factor(mobility, &servos), mobility));
        let Some((worst, mobility)) = factors.max_by(|one, other| one.0.total_cmp(&other.0)) else { return };
        if worst <= DECAY {
            return;
        }
        let slowed = plans.iter().enumerate().filter_map(|(index, plan)| {
            let plan = slower(index, plan)?;
            let mut servos = servos.clone();
            *servos.get_mut(index)? = plan.observer();
            Some((factor(mobility, &servos), index, plan))
        });
        let Some((_, index, plan)) = slowed.min_by(|one, other| one.0.total_cmp(&other.0)) else { return };
        servos[index] = plan.observer();
        plans[index] = plan;
    }
}

/// The mean factor by which errors change in a tick, the largest over those that begin in a single joint.
/// `mobility` is the inverse of the mass matrix [1/(kg·m²)].
fn factor(mobility: &DMatrix<f32>, servos: &[ErrorObserver]) -> f32 {
    (0..servos.len()).map(|joint| factor_of(joint, mobility, servos)).fold(0.0, f32::max)
}

fn factor_of(joint: usize, mobility: &DMatrix<f32>, servos: &[ErrorObserver]) -> f32 {
    let mut states = vec![ObserverState::new(); servos.len()];
    let lag = servos.first().map_or(0.0, ErrorObserver::delay_fraction) * TICK;
    let [mut errors, mut velocities, mut efforts, mut last, mut change] =
        [(); 5].map(|()| DVector::zeros(servos.len()));
    errors[joint] = 1.0;
    for tick in 1..=TICKS {
        last.copy_from(&efforts);
        let measured = servos.iter().zip(&mut states).zip(&errors);
        for (effort, ((servo, state), error)) in efforts.iter_mut().zip(measured) {
            *effort = servo.effort(state, *error, false);
            servo.predict(state, *effort);
        }
        // Those of the last tick act until the current loop has the new ones.
        for (time, efforts) in [(lag, &last), (TICK - lag, &efforts)] {
            change.gemv(1.0, mobility, efforts, 0.0);
            for ((error, velocity), change) in errors.iter_mut().zip(&mut velocities).zip(&change) {
                let change = change * -time;
                *error += (*velocity + change * 0.5) * time;
                *velocity += change;
            }
        }
        let left = errors.amax().max(AHEAD * velocities.amax());
        if !(DECAYED..GROWN).contains(&left) || tick == TICKS {
            return libm::powf(left, 1.0 / f32::from(tick));
        }
    }
    1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use tesaki::model::ObserverGains;

    /// Mass matrix `M₁₁, M₁₂, M₂₂`, inertia, bandwidth and observer bandwidth of both servos, and the largest
    /// eigenvalue of the loop; from `tests/oracles/coupled_servos.py`. A fast decay ends before the slowest
    /// part of it is all that is left.
    const LOOPS: &[[f32; 10]] = include!("../../../tests/oracles/data/coupled_servos.in");

    #[test]
    fn errors_decay_as_the_eigenvalues_of_the_loop_say() {
        for &[first, coupled, second, own, other, fast, slow, observer, other_observer, eigenvalue] in LOOPS {
            let mass = DMatrix::from_row_slice(2, 2, &[first, coupled, coupled, second]);
            let servo = |inertia, bandwidth, observer_bandwidth| {
                let gains = ObserverGains { inertia, bandwidth, observer_bandwidth };
                ErrorObserver::with_lag(&gains, 3e-4 + 1.0 / (core::f32::consts::TAU * 300.0))
            };
            let servos = [servo(own, fast, observer), servo(other, slow, other_observer)];
            let found = mass.try_inverse().map(|mobility| factor(&mobility, &servos));
            assert!(found.is_some_and(|found| (found - eigenvalue).abs() < 0.015), "{found:?} {eigenvalue}");
        }
    }
}
