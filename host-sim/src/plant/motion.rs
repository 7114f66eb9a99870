//! How points of bodies move.

use rapier3d::na::Vector3;

/// Motion of a point of a body in the frame of the base, half a sub-step ago: velocities of the point [m/s]
/// and of the body [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    pub linear: Vector3<f64>,
    pub angular: Vector3<f64>,
}

impl Motion {
    /// Half a sub-step later: what it will be if it goes on changing as since a sub-step `before`.
    pub fn half_a_step_on(&self, before: &Self) -> Self {
        let on = |now: Vector3<f64>, before: Vector3<f64>| now + (now - before) * 0.5;
        Self { linear: on(self.linear, before.linear), angular: on(self.angular, before.angular) }
    }
}
