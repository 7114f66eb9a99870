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

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use crate::math;
    use crate::model::{ChainModel, Field, Inertial, Pose, Problem, RobotModel};
    use crate::test_support;

    /// One joint turns a link of 20 g with its centre 20 mm away; a second chain follows it with ratio −0.4
    /// and has a joint of its own 50 mm on. All axes are y: the links rise and fall.
    fn robot() -> RobotModel {
        let mut model = test_support::finger();
        let place = |x: f32| Pose { translation: [x, 0.0, 0.0], ..Pose::IDENTITY };
        let link = Inertial { mass: 0.02, center_of_mass: [0.02, 0.0, 0.0], inertia: [0.0; 6] };
        model.joints.truncate(2);
        for joint in &mut model.joints {
            (joint.axis, joint.link) = ([0.0, 1.0, 0.0], link);
        }
        model.joints[1].origin = place(0.05);
        let first = ChainModel { joints: 1, ..model.chains[0].clone() };
        let axis = [0.0, 1.0, 0.0];
        let mimic = MimicJoint { joint: 0, multiplier: -0.4, offset: 0.1, origin: place(0.0), axis, link };
        let second = ChainModel { name: "other".try_into().unwrap(), mimic: Some(mimic), ..first.clone() };
        model.chains = [first, second].into_iter().collect();
        model
    }

    fn configured(model: &RobotModel) -> Box<Robot> {
        let mut robot = Box::new(Robot::NONE);
        robot.configure(model).unwrap();
        robot
    }

    #[test]
    fn the_driving_joint_carries_what_follows_it() {
        let robot = configured(&robot());
        assert!(robot.has_mimics() && robot.chains()[1].joints() == (1..2));
        let (driving, own) = (0.3, 0.2);
        let motion: Motion =
            core::array::from_fn(|joint| [[driving, own].get(joint).copied().unwrap_or(0.0), 0.0, 0.0]);
        let torques = robot.coupled_dynamics(&motion);
        // By hand: about +y a weight at x turns by −g m x; the motor holds against it. A link at angle q from
        // x has its centre at x = 0.02 cos q.
        let weight = 0.02 * 9.81;
        let cos = |angle: f32| math::sin_cos(angle).1;
        let follower = -0.4 * driving + 0.1;
        let of_own = weight * 0.02 * cos(follower + own);
        let of_follower = weight * (0.02 + 0.05) * cos(follower) + of_own;
        let expected = [-weight * 0.02 * cos(driving) + 0.4 * of_follower, -of_own];
        for (got, expected) in torques.iter().zip(expected) {
            assert!(math::abs(got - expected) < 1e-6, "{got} {expected}");
        }
        // Acceleration: each point mass counts with the square of the ratio (all angles so that the links are
        // in line: offset 0.1 − 0.4 · 0.25 = 0).
        let at = |acceleration| {
            let motion: Motion =
                core::array::from_fn(|joint| if joint == 0 { [0.25, 0.0, acceleration] } else { [0.0; 3] });
            robot.coupled_dynamics(&motion)[0]
        };
        let inertia = at(1.0) - at(0.0);
        let by_hand = 0.02 * (0.02 * 0.02) + 0.16 * 0.02 * (0.02 * 0.02 + 0.07 * 0.07);
        assert!(math::abs(inertia - by_hand) < 1e-8, "{inertia} {by_hand}");
    }

    #[test]
    fn the_tip_moves_with_the_joint_that_its_chain_follows() {
        let robot = configured(&robot());
        let config = &robot.chains()[1];
        let tip = config.posture(&[0.3, 0.2]).tip().translation.vector;
        // The tip's frame is that of the last joint: 50 mm along the link that follows.
        let (sine, cosine) = math::sin_cos(-0.4 * 0.3 + 0.1);
        assert!((tip - nalgebra::Vector3::new(0.05 * cosine, 0.0, -0.05 * sine)).norm() < 1e-7, "{tip}");
        assert!(config.finger.is_none());
    }

    #[test]
    fn what_a_mimic_joint_cannot_be_is_refused() {
        let refused = |change: fn(&mut ChainModel)| {
            let mut model = robot();
            change(&mut model.chains[1]);
            let error = model.validate().unwrap_err();
            (error.field, error.problem)
        };
        let own = |chain: &mut ChainModel| chain.mimic.as_mut().unwrap().joint = 1;
        let none = |chain: &mut ChainModel| chain.mimic.as_mut().unwrap().joint = 2;
        assert_eq!(refused(own), (Field::MimicJoint, Problem::NotAnotherChains));
        assert_eq!(refused(none), (Field::MimicJoint, Problem::NotAnotherChains));
        let still = |chain: &mut ChainModel| chain.mimic.as_mut().unwrap().multiplier = 0.0;
        assert_eq!(refused(still), (Field::MimicMultiplier, Problem::NotSupported));
        let nan = |chain: &mut ChainModel| chain.mimic.as_mut().unwrap().offset = f32::NAN;
        assert_eq!(refused(nan), (Field::MimicOffset, Problem::NotFinite));
        let axis = |chain: &mut ChainModel| chain.mimic.as_mut().unwrap().axis = [0.0; 3];
        assert_eq!(refused(axis), (Field::Axis, Problem::NotUnit));
    }
}
