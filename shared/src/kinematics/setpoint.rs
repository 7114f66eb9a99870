use nalgebra::Quaternion;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{TICK, math};

/// Where the tool should be, how fast, and how that changes. In the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PosePoint {
    /// Position [m].
    pub position: [f32; 3],
    /// Orientation as a unit quaternion, `[x, y, z, w]`.
    pub rotation: [f32; 4],
    /// `[v; ω]` [m/s, rad/s].
    pub velocity: [f32; 6],
    /// Its derivative [m/s², rad/s²].
    pub acceleration: [f32; 6],
}

/// Where the elbow should be: angle of the driven joint, or the arm angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ElbowSetpoint {
    /// [rad]
    pub angle: f32,
    /// [rad/s]
    pub velocity: f32,
    /// [rad/s²]
    pub acceleration: f32,
}

/// Share of its velocity that a set-point keeps in a period without a new one: it comes to rest within some 0.2 s.
const COAST: f32 = 0.8;

impl PosePoint {
    /// A control period later without a new one.
    #[must_use]
    pub(crate) fn coasted(&self) -> Self {
        let mut next = Self { acceleration: [0.0; 6], ..*self };
        let [vx, vy, vz, wx, wy, wz] = self.velocity;
        next.position.iter_mut().zip([vx, vy, vz]).for_each(|(place, speed)| *place += speed * TICK);
        if [wx, wy, wz].iter().any(|rate| *rate != 0.0) {
            // Half the way as a quaternion; a period's turn is small, and what the norm loses is given back.
            let [x, y, z, w] = self.rotation;
            let turn = Quaternion::new(0.0, wx, wy, wz) * Quaternion::new(w, x, y, z) * (0.5 * TICK);
            let turned = Quaternion::new(w, x, y, z) + turn;
            let scale = 1.0 / math::sqrt(turned.norm_squared());
            next.rotation = (turned * scale).coords.into();
        }
        next.velocity.iter_mut().for_each(|speed| *speed *= COAST);
        next
    }

    /// Where it is a control period later, its acceleration included.
    #[must_use]
    pub(crate) fn ahead(&self) -> Self {
        let mut faster = *self;
        let speeds = faster.velocity.iter_mut().zip(&self.acceleration);
        speeds.for_each(|(speed, acceleration)| *speed += acceleration * TICK);
        faster.coasted()
    }
}

impl ElbowSetpoint {
    /// A control period later without a new one.
    #[must_use]
    pub(crate) const fn coasted(&self) -> Self {
        Self { angle: self.angle + self.velocity * TICK, velocity: COAST * self.velocity, acceleration: 0.0 }
    }
}
