//! Poses and motions of joints, links and tips.

use rapier3d::math::Pose;
use rapier3d::na::{Isometry3, Vector3};

use super::convert::{isometry_of, wide};
use super::motion::Motion;
use super::world::World;

impl World {
    /// Joint angles [rad].
    pub fn positions(&self) -> impl Iterator<Item = f64> {
        (0..self.joints.len()).map(|joint| f64::from(self.links.motion(joint).0))
    }

    /// Joint velocities in the last sub-step [rad/s].
    pub fn velocities(&self) -> impl Iterator<Item = f64> {
        (0..self.joints.len()).map(|joint| self.velocity(joint))
    }

    fn velocity(&self, joint: usize) -> f64 {
        f64::from(self.links.motion(joint).1)
    }

    /// Pose of the body behind a joint, in the frame of the base.
    pub(super) fn body(&self, joint: usize) -> Isometry3<f64> {
        isometry_of(self.links.pose(joint))
    }

    /// Pose of the body behind a joint, in the frame of the base: position [m] and orientation `[x, y, z,
    /// w]`.
    pub fn body_pose(&self, joint: usize) -> ([f64; 3], [f64; 4]) {
        let Pose { translation, rotation, .. } = self.links.pose(joint);
        (translation.to_array().map(f64::from), rotation.to_array().map(f64::from))
    }

    /// Axis of a joint, and a point on it, in the frame of the base.
    pub(super) fn joint_axis(&self, joint: usize) -> (Vector3<f64>, Vector3<f64>) {
        let pose = self.links.pose(joint);
        (wide(pose.rotation * self.joints[joint].axis), wide(pose.translation))
    }

    /// Frame of a tip's link in that of the base.
    pub fn tip_frame(&self, tip: usize) -> Option<Isometry3<f64>> {
        let tip = self.tips.get(tip)?;
        Some(self.body(tip.body) * tip.frame)
    }

    /// Returns the motion of a point of a joint's body, both in the frame of the base.
    pub fn motion_at(&self, joint: usize, point: &Vector3<f64>) -> Motion {
        let mut motion = Motion { linear: Vector3::zeros(), angular: Vector3::zeros() };
        let mut next = Some(joint);
        while let Some(index) = next {
            let (axis, origin) = self.joint_axis(index);
            let turn = axis * self.velocity(index);
            motion.angular += turn;
            motion.linear += turn.cross(&(point - origin));
            next = self.joints[index].before;
        }
        motion
    }
}
