//! Chains whose first joint follows a joint of another chain.

use crate::kinematics::Posture;
use crate::model::{MAX_CHAIN_JOINTS, MAX_JOINTS, MimicJoint};

use super::{ChainConfig, Robot};

/// What a mimic joint follows: angle = `multiplier` · angle of `joint` + `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mimic {
    /// The joint of the robot.
    pub joint: usize,
    /// Ratio of the velocities; not 0.
    pub multiplier: f32,
    /// Angle when the other is at 0 [rad].
    pub offset: f32,
}

impl Mimic {
    pub(super) fn new(model: &MimicJoint) -> Self {
        Self { joint: model.joint.into(), multiplier: model.multiplier, offset: model.offset }
    }

    /// Angle of the mimic joint when the joint that it follows is at `angle` [rad].
    pub fn angle(&self, angle: f32) -> f32 {
        self.multiplier * angle + self.offset
    }
}

impl ChainConfig {
    /// The posture at the angles of all joints of the robot [rad].
    pub fn posture(&self, angles: &[f32]) -> Posture {
        let own = angles.get(self.joints()).unwrap_or_default();
        let Some(mimic) = &self.mimic else { return self.chain.posture(own) };
        let mut all = [0.0; MAX_CHAIN_JOINTS];
        for (place, angle) in
            all.iter_mut().zip(core::iter::once(&self.mimic_angle(mimic, angles)).chain(own))
        {
            *place = *angle;
        }
        self.chain.posture(&all)
    }

    fn mimic_angle(&self, mimic: &Mimic, angles: &[f32]) -> f32 {
        mimic.angle(angles.get(mimic.joint).copied().unwrap_or(0.0))
    }
}

/// Position [rad], velocity [rad/s] and acceleration [rad/s²] of each joint of a robot.
pub(crate) type Motion = [[f32; 3]; MAX_JOINTS];

impl Robot {
    /// Inverse dynamics of all chains of a robot with mimic joints: the torques of its actuated joints [N·m].
    /// The torque of a mimic joint acts on the joint that it follows, times the ratio of their velocities
    /// (principle of virtual work).
    #[cold]
    #[inline(never)]
    pub(crate) fn coupled_dynamics(&self, motion: &Motion) -> [f32; MAX_JOINTS] {
        let mut sum = [0.0; MAX_JOINTS];
        for config in self.chains() {
            let [mut q, mut qd, mut qdd, mut torques] = [[0.0; MAX_CHAIN_JOINTS]; 4];
            let following = config.mimic.map(|mimic| {
                let [position, velocity, acceleration] = motion.get(mimic.joint).copied().unwrap_or_default();
                let ratio = mimic.multiplier;
                [mimic.angle(position), ratio * velocity, ratio * acceleration]
            });
            let own = motion.get(config.joints()).unwrap_or_default();
            let values = q.iter_mut().zip(&mut qd).zip(&mut qdd);
            for (((q, qd), qdd), motion) in values.zip(following.iter().chain(own)) {
                [*q, *qd, *qdd] = *motion;
            }
            config.chain.inverse_dynamics(self.gravity(), &q, &qd, &qdd, &mut torques);
            let mut torques = torques.iter();
            if let Some(mimic) = &config.mimic
                && let (Some(torque), Some(driving)) = (torques.next(), sum.get_mut(mimic.joint))
            {
                *driving += mimic.multiplier * torque;
            }
            for (sum, torque) in sum.iter_mut().skip(config.joints().start).zip(torques.take(own.len())) {
                *sum += torque;
            }
        }
        sum
    }
}
