use heapless::Vec;
use nalgebra::{IsometryMatrix3, Matrix3, SMatrix, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::math::{self, abs};
use crate::model::MAX_CHAIN_JOINTS;

/// Threshold of singularity: determinant of the Jacobian over that of orthogonal columns of equal length.
const SINGULAR: f32 = 1e-3;

/// Jacobian of a chain's tip: `[v; ω] = J q̇`. One column per joint; columns beyond the chain's joints are 0.
pub type Jacobian = SMatrix<f32, 6, MAX_CHAIN_JOINTS>;

/// One point of a tip's trajectory, in the base frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct TipPoint {
    /// Position [m].
    pub position: [f32; 3],
    /// Its first derivative [m/s].
    pub velocity: [f32; 3],
    /// Its second derivative [m/s²].
    pub acceleration: [f32; 3],
}

/// A chain at certain joint angles. The default is one without joints.
#[derive(Clone, Debug, Default)]
pub struct Posture {
    /// Axis (unit vector) of each joint and its origin relative to that of the first [m]: a distant base
    /// costs no significant digits.
    pub(super) joints: Vec<(Vector3<f32>, Vector3<f32>), MAX_CHAIN_JOINTS>,
    /// Position of the tip relative to the first joint [m].
    pub(super) reach: Vector3<f32>,
    pub(super) tip: IsometryMatrix3<f32>,
}

impl Posture {
    /// The tip's frame.
    pub const fn tip(&self) -> &IsometryMatrix3<f32> {
        &self.tip
    }

    /// Axis (a unit vector) of a joint and its origin from that of the first joint [m].
    pub fn joint(&self, joint: usize) -> Option<&(Vector3<f32>, Vector3<f32>)> {
        self.joints.get(joint)
    }

    /// Axis (a unit vector) and origin of the first joint [m].
    pub(crate) fn first_axis(&self) -> Option<(Vector3<f32>, Vector3<f32>)> {
        self.joint(0).map(|(axis, _)| (*axis, self.tip.translation.vector - self.reach))
    }

    /// The geometric Jacobian of the tip [m/rad; 1].
    #[inline]
    pub fn jacobian(&self) -> Jacobian {
        let mut jacobian = Jacobian::zeros();
        self.write_jacobian(&mut jacobian);
        jacobian
    }

    /// In place: by value it would be copied once more.
    fn write_jacobian(&self, jacobian: &mut Jacobian) {
        for (mut column, (axis, origin)) in jacobian.column_iter_mut().zip(&self.joints) {
            let linear = axis.cross(&(self.reach - origin));
            column.fixed_rows_mut::<3>(0).copy_from(&linear);
            column.fixed_rows_mut::<3>(3).copy_from(axis);
        }
    }

    /// Joint velocities [rad/s] and accelerations [rad/s²] of a three-joint chain for the motion `point` of
    /// its tip. `None` near a singular posture or for another number of joints.
    pub fn joint_motion(&self, point: &TipPoint) -> Option<([f32; 3], [f32; 3])> {
        let (velocity, acceleration) = (Vector3::from(point.velocity), Vector3::from(point.acceleration));
        if velocity == Vector3::zeros() && acceleration == Vector3::zeros() {
            return Some(([0.0; 3], [0.0; 3]));
        }
        if self.joints.len() != 3 {
            return None;
        }
        // `into_owned` would contain a panic.
        let mut jacobian = Matrix3::zeros();
        jacobian.copy_from(&self.jacobian().fixed_view::<3, 3>(0, 0));
        let size = jacobian.column_iter().fold(0.0_f32, |size, column| {
            let squared = column.norm_squared();
            if squared > size { squared } else { size }
        });
        // 1 when the joints move the tip equally far and at right angles.
        if abs(jacobian.determinant()) < SINGULAR * size * math::sqrt(size) {
            return None;
        }
        let inverse = jacobian.try_inverse()?;
        let qd = inverse * velocity;
        // ẍ = J q̈ + J̇ q̇
        let qdd = inverse * (acceleration - self.bias_acceleration(qd.as_slice()).fixed_rows::<3>(0));
        Some((qd.into(), qdd.into()))
    }

    /// `J̇ q̇`: the acceleration of the tip [m/s², rad/s²] that joint velocities `qd` [rad/s] cause without
    /// any joint acceleration. The linear part is that of the tip's point (the classical acceleration).
    pub fn bias_acceleration(&self, qd: &[f32]) -> Vector6<f32> {
        let zero = Vector3::zeros();
        let (mut omega, mut alpha, mut acceleration, mut previous) = (zero, zero, zero, zero);
        for ((axis, origin), &qd) in self.joints.iter().zip(qd) {
            let step = origin - previous;
            acceleration += alpha.cross(&step) + omega.cross(&omega.cross(&step));
            previous = *origin;
            let own = axis * qd;
            alpha += omega.cross(&own);
            omega += own;
        }
        let step = self.reach - previous;
        acceleration += alpha.cross(&step) + omega.cross(&omega.cross(&step));
        math::stack([acceleration, alpha])
    }
}
