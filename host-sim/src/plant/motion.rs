//! Motion of points of bodies.

use rapier3d::na::Vector3;

/// Motion of a point of a body in the frame of the base, half a sub-step ago: velocity of the point [m/s] and
/// angular velocity of the body [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    pub linear: Vector3<f64>,
    pub angular: Vector3<f64>,
}

impl Motion {
    /// Extrapolates linearly by half a sub-step, from the motion one sub-step `before`.
    pub fn extrapolated(&self, before: &Self) -> Self {
        let on = |now: Vector3<f64>, before: Vector3<f64>| now + (now - before) * 0.5;
        Self { linear: on(self.linear, before.linear), angular: on(self.angular, before.angular) }
    }
}
