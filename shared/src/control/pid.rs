use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::JointPoint;
use crate::TICK;
use crate::model::PidGains;
use crate::signal::PseudoDifferentiator;

/// PID on a joint angle with a pseudo-differentiator (Hand3 section 4).
///
/// `u = K_p·e + ∫ K_i·e + K_d·H(e)`, `e = reference − measured`. `H` acts on the reference's velocity and the
/// change of the measurement, not on the position error, so a set-point step causes no derivative kick.
///
/// The caller limits the torque after [`Pid::output`] and passes the result to [`Pid::integrate`], which
/// prevents integrator wind-up by back-calculation.
///
/// ```
/// use tesaki::{control::{JointPoint, Pid, PidState}, model::PidGains};
/// let pid = Pid::new(&PidGains { proportional: 2.0, integral: 0.0, derivative: 0.0, cutoff: 30.0 });
/// let mut state = PidState::at(0.5);
/// let reference = JointPoint { position: 0.75, ..Default::default() };
/// assert_eq!(pid.output(&mut state, &reference, 0.5), 0.5);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Pid {
    proportional: f32,
    derivative: f32,
    differentiator: PseudoDifferentiator,
    /// `K_i·T`.
    integral_step: f32,
    /// Back-calculation gain: fraction of the torque cut off by the limits that leaves the integrator per
    /// tick.
    back_calculation: f32,
}

/// State of a [`Pid`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct PidState {
    integral: f32,
    derivative: f32,
    measured: f32,
    error: f32,
}

impl PidState {
    /// The state at rest at the measured angle.
    pub const fn at(measured: f32) -> Self {
        Self { integral: 0.0, derivative: 0.0, measured, error: 0.0 }
    }

    /// Subtracts `torque` [N·m] from the integrator: the feed-forward supplies it from now on.
    pub const fn hand_over(&mut self, torque: f32) {
        self.integral -= torque;
    }

    /// The integrator's torque [N·m].
    pub const fn integral(&self) -> f32 {
        self.integral
    }
}

impl Pid {
    /// The PID with the gains of a validated model.
    pub fn new(gains: &PidGains) -> Self {
        let integral_step = gains.integral * TICK;
        // Tracking time constant of the back-calculation: K_p/K_i, the usual choice.
        let back_calculation =
            if gains.proportional > 0.0 { (integral_step / gains.proportional).min(1.0) } else { 1.0 };
        Self {
            proportional: gains.proportional,
            derivative: gains.derivative,
            differentiator: PseudoDifferentiator::new(gains.cutoff),
            integral_step,
            back_calculation,
        }
    }

    /// The torque [N·m] at the `measured` angle [rad], before limits.
    #[inline]
    pub const fn output(&self, state: &mut PidState, reference: &JointPoint, measured: f32) -> f32 {
        let error = reference.position - measured;
        let change = reference.velocity * TICK - (measured - state.measured);
        let rate = self.differentiator.update(&mut state.derivative, change);
        state.measured = measured;
        state.error = error;
        self.proportional * error + state.integral + self.derivative * rate
    }

    /// Closes the tick: integrates, with back-calculation of the torque that the limits cut off. `requested`
    /// and `applied` are the torque before and after *every* limit [N·m]; while `at_rest` the error is not
    /// integrated.
    #[inline]
    pub const fn integrate(&self, state: &mut PidState, requested: f32, applied: f32, at_rest: bool) {
        let error = if at_rest { 0.0 } else { state.error };
        state.integral += self.integral_step * error + self.back_calculation * (applied - requested);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAINS: PidGains = PidGains { proportional: 2.0, integral: 5.0, derivative: 0.1, cutoff: 30.0 };

    #[test]
    fn three_ticks_worked_by_hand() {
        // a = e^(−0.3) = 0.740 818; (1−a)/T = 25.918 18. The reference is 1; the joint reads 0, 0.01, 0.03.
        let pid = Pid::new(&GAINS);
        let mut state = PidState::at(0.0);
        let reference = JointPoint { position: 1.0, velocity: 0.0, acceleration: 0.0 };
        // 1: P = 2, I = 0, D = 0 although the error has just jumped to 1. Then I = 5·0.01·1 = 0.05.
        let first = pid.output(&mut state, &reference, 0.0);
        assert!((first - 2.0).abs() < 1e-6);
        pid.integrate(&mut state, first, first, false);
        // 2: P = 1.98, I = 0.05, D = −0.1·25.918 18·0.01 = −0.025 918. Then I = 0.0995.
        let second = pid.output(&mut state, &reference, 0.01);
        assert!((second - 2.004_082).abs() < 1e-5, "{second}");
        pid.integrate(&mut state, second, second, false);
        // 3: P = 1.94, I = 0.0995, D: −(0.740 818·0.259 182 + 25.918 18·0.02)·0.1 = −0.071 037.
        let third = pid.output(&mut state, &reference, 0.03);
        assert!((third - 1.968_463).abs() < 1e-5, "{third}");
    }

    #[test]
    fn a_saturated_torque_does_not_wind_the_integrator_up() {
        let pid = Pid::new(&GAINS);
        let mut state = PidState::at(0.0);
        let reference = JointPoint { position: 1.0, velocity: 0.0, acceleration: 0.0 };
        for _ in 0..1000 {
            let requested = pid.output(&mut state, &reference, 0.0);
            pid.integrate(&mut state, requested, requested.min(0.5), false);
        }
        // In balance K_i·T·e = (K_i·T/K_p)·(requested − applied): requested = 0.5 + K_p·e = 2.5, of which P
        // is 2.
        assert!((state.integral() - 0.5).abs() < 1e-4, "{}", state.integral());
    }

    #[test]
    fn a_reference_that_moves_as_the_joint_does_needs_no_damping_torque() {
        let pid = Pid::new(&GAINS);
        let mut state = PidState::at(0.0);
        for tick in 1..200_u16 {
            let angle = 0.003 * f32::from(tick);
            let reference = JointPoint { position: angle, velocity: 0.3, acceleration: 0.0 };
            assert!(pid.output(&mut state, &reference, angle).abs() < 1e-6);
        }
    }
}
