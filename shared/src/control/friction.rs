use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::model::Friction;
use crate::{TICK, math};

/// Below this reference speed the Coulomb term falls linearly to 0 [rad/s]. A larger one is smoother, but
/// compensates less at the start of a motion.
pub(crate) const STALL_SPEED: f32 = 0.002;
/// Minimum reference speed of the adaptation [rad/s]; slower motion is dominated by stiction.
const LEARNING_SPEED: f32 = 0.05;
/// Adaptation rate: fraction of the disturbance taken over per second of motion [1/s].
const LEARNING_RATE: f32 = 2.0;
/// Limit of the adaptation as a fraction of the model's Coulomb friction; a larger error means a wrong model.
const LEARNING_RANGE: f32 = 0.5;

/// Friction feed-forward with adaptation of the Coulomb torque.
///
/// The sign of the Coulomb term follows the *reference* velocity, not the measured one, so that it helps a
/// joint in stiction to break away. Below 0.002 rad/s the term falls linearly to 0: without that band it
/// would chatter at rest.
///
/// An error of the model's Coulomb friction changes its sign at every reversal, just after an integrator or
/// observer has adapted to the opposite sign. Therefore the feed-forward takes over, while the joint moves,
/// the part of their estimate that follows the direction of motion.
#[derive(Clone, Copy, Debug)]
pub struct FrictionFeedforward {
    coulomb: f32,
    viscous: f32,
}

/// State of a [`FrictionFeedforward`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct FrictionState {
    /// Coulomb friction beyond the model's [N·m].
    learnt: f32,
}

impl FrictionState {
    /// The state without adaptation.
    pub const fn new() -> Self {
        Self { learnt: 0.0 }
    }
}

impl FrictionFeedforward {
    /// The feed-forward of the model's friction.
    pub const fn new(friction: &Friction) -> Self {
        Self { coulomb: friction.coulomb, viscous: friction.viscous }
    }

    /// The torque [N·m] for a reference velocity [rad/s].
    ///
    /// ```
    /// use tesaki::{control::{FrictionFeedforward, FrictionState}, model::Friction};
    /// let friction = FrictionFeedforward::new(&Friction { coulomb: 0.02, viscous: 0.002 });
    /// let state = FrictionState::new();
    /// assert!((friction.torque(&state, -1.0) + 0.022).abs() < 1e-7);
    /// // Half of the Coulomb term at half the stall speed.
    /// assert!((friction.torque(&state, 0.001) - 0.010_002).abs() < 1e-7);
    /// ```
    #[inline]
    pub const fn torque(&self, state: &FrictionState, velocity: f32) -> f32 {
        let direction = math::clamp(velocity * (1.0 / STALL_SPEED), -1.0, 1.0);
        (self.coulomb + state.learnt) * direction + self.viscous * velocity
    }

    /// Takes over a part of the `disturbance` [N·m] that the feedback compensates at a reference `velocity`
    /// [rad/s]. Returns that part, which the feedback then need not supply.
    #[inline]
    pub const fn learn(&self, state: &mut FrictionState, velocity: f32, disturbance: f32) -> f32 {
        if math::abs(velocity) < LEARNING_SPEED {
            return 0.0;
        }
        let direction = if velocity > 0.0 { 1.0 } else { -1.0 };
        let range = LEARNING_RANGE * self.coulomb;
        let before = state.learnt;
        state.learnt = math::clamp(before + LEARNING_RATE * TICK * direction * disturbance, -range, range);
        (state.learnt - before) * direction
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn learns_what_changes_its_sign_with_the_direction_and_not_what_stays() {
        // A joint with 24 mN·m of friction instead of the model's 20, and 2 mN·m of unmodelled gravity: 20
        // motions of 0.4 s back and forth, with a feedback that estimates the whole disturbance exactly.
        let feedforward = FrictionFeedforward::new(&Friction { coulomb: 0.02, viscous: 0.0 });
        let mut state = FrictionState::new();
        for motion in 0..20 {
            let velocity = if motion % 2 == 0 { 0.3 } else { -0.3 };
            for _ in 0..40 {
                let needed = if velocity > 0.0 { 0.024 + 0.002 } else { -0.024 + 0.002 };
                let disturbance = needed - feedforward.torque(&state, velocity);
                feedforward.learn(&mut state, velocity, disturbance);
            }
        }
        // Learnt: 4 mN·m, and a share tanh(0.8/2) of the 2 mN·m that alternates with the direction of the
        // last motion.
        assert!((state.learnt - 0.004).abs() < 0.000_77, "{}", state.learnt);
    }

    #[test]
    fn never_learns_more_than_half_of_the_model() {
        let feedforward = FrictionFeedforward::new(&Friction { coulomb: 0.02, viscous: 0.0 });
        let mut state = FrictionState::new();
        for _ in 0..1000 {
            feedforward.learn(&mut state, 1.0, 0.5);
        }
        assert!((state.learnt - 0.01).abs() < 1e-7);
        assert!((feedforward.learn(&mut state, 0.01, 0.5)).abs() < 1e-9, "nothing is learnt at rest");
    }
}
