//! Poses and motions of joints, links and tips.

use rapier3d::math::Pose;
use rapier3d::na::{Isometry3, Vector3};

use super::convert::{isometry_of, wide};
use super::motion::Motion;
use super::world::{World, first_dof};

impl World {
    /// Joint angles [rad].
    pub fn positions(&self) -> impl Iterator<Item = f64> {
        self.joints.iter().enumerate().map(|(index, joint)| match &self.links {
            Some(links) => f64::from(links.motion(index).0),
            None => {
                let chain = self.physics.multibody_joints.get(joint.handle);
                let link = chain.and_then(|(chain, link)| chain.link(link));
                link.map_or(f64::NAN, |link| f64::from(link.joint().coords()[3]))
            }
        })
    }

    /// Joint velocities in the last sub-step [rad/s].
    pub fn velocities(&self) -> impl Iterator<Item = f64> {
        (0..self.joints.len()).map(|joint| self.velocity(joint))
    }

    fn velocity(&self, joint: usize) -> f64 {
        if let Some(links) = &self.links {
            return f64::from(links.motion(joint).1);
        }
        let chain = self.joints.get(joint).and_then(|joint| self.physics.multibody_joints.get(joint.handle));
        chain
            .and_then(|(chain, link)| Some(f64::from(chain.generalized_velocity()[first_dof(chain, link)?])))
            .unwrap_or(f64::NAN)
    }

    /// Pose of the body behind a joint, in the frame of the base.
    pub(super) fn pose(&self, joint: usize) -> Option<Pose> {
        let body = self.joints.get(joint)?.body;
        match &self.links {
            Some(links) => Some(*links.pose(joint)),
            None => self.physics.bodies.get(body).map(|body| *body.position()),
        }
    }

    /// Pose of the body behind a joint, in the frame of the base.
    pub(super) fn body(&self, joint: usize) -> Option<Isometry3<f64>> {
        Some(isometry_of(&self.pose(joint)?))
    }

    /// Pose of the body behind a joint, in the frame of the base: position [m] and orientation `[x, y, z,
    /// w]`.
    pub fn body_pose(&self, joint: usize) -> Option<([f64; 3], [f64; 4])> {
        let Pose { translation, rotation, .. } = self.pose(joint)?;
        Some((translation.to_array().map(f64::from), rotation.to_array().map(f64::from)))
    }

    /// Axis of a joint, and a point on it, in the frame of the base.
    pub(super) fn joint_axis(&self, joint: usize) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let pose = self.pose(joint)?;
        Some((wide(pose.rotation * self.joints.get(joint)?.axis), wide(pose.translation)))
    }

    /// Frame of a tip's link in that of the base.
    pub fn tip_frame(&self, tip: usize) -> Option<Isometry3<f64>> {
        let tip = self.tips.get(tip)?;
        Some(self.body(tip.body)? * tip.frame)
    }

    /// Returns the motion of a point of a joint's body, both in the frame of the base.
    pub fn motion_at(&self, joint: usize, point: &Vector3<f64>) -> Motion {
        let mut motion = Motion { linear: Vector3::zeros(), angular: Vector3::zeros() };
        let mut next = Some(joint);
        while let Some((index, joint)) = next.and_then(|index| Some((index, self.joints.get(index)?))) {
            if let Some(pose) = self.pose(index) {
                let turn = wide(pose.rotation * joint.axis) * self.velocity(index);
                motion.angular += turn;
                motion.linear += turn.cross(&(point - wide(pose.translation)));
            }
            next = joint.before.filter(|&before| before < index);
        }
        motion
    }
}
