use crate::math;
use crate::model::Friction;

/// Below this reference speed the Coulomb term fades linearly to nothing [rad/s].
const STALL_SPEED: f32 = 0.02;

/// Torque against friction, from the reference's velocity.
///
/// The rule for a stalled joint: the sign of the Coulomb term is the *reference's* direction, never the measured one,
/// so a joint that sticks is pushed where it should go; and as the reference comes to rest the term fades out linearly
/// below 0.02 rad/s, so that a joint at rest is held by its own friction and not shaken.
#[derive(Clone, Copy, Debug)]
pub struct FrictionFeedforward {
    coulomb: f32,
    viscous: f32,
}

impl FrictionFeedforward {
    /// For `friction`, of whose Coulomb part the share `coulomb_share` (0 to 1) is fed forward.
    pub const fn new(friction: &Friction, coulomb_share: f32) -> Self {
        Self { coulomb: friction.coulomb * coulomb_share, viscous: friction.viscous }
    }

    /// The torque [N·m] for a reference velocity [rad/s].
    ///
    /// ```
    /// use tesaki::{control::FrictionFeedforward, model::Friction};
    /// let friction = FrictionFeedforward::new(&Friction { coulomb: 0.02, viscous: 0.002 }, 1.0);
    /// assert!((friction.torque(-1.0) + 0.022).abs() < 1e-7);
    /// assert!((friction.torque(0.01) - 0.01002).abs() < 1e-7); // half of the Coulomb term at half the stall speed
    /// ```
    #[inline]
    pub const fn torque(&self, velocity: f32) -> f32 {
        self.coulomb * math::clamp(velocity * (1.0 / STALL_SPEED), -1.0, 1.0) + self.viscous * velocity
    }
}
