//! Chains with joints that have no motor and follow another joint.

use crate::kinematics::Posture;
use crate::model::{MAX_CHAIN_JOINTS, MAX_JOINTS};

use super::Robot;

/// Position [rad], velocity [rad/s] and acceleration [rad/s²] of each joint of a robot.
pub(crate) type Motion = [[f32; 3]; MAX_JOINTS];

impl Robot {
    /// The posture of a chain at the angles of all joints with a motor [rad]; `None` without such a chain.
    pub fn posture(&self, chain: usize, angles: &[f32]) -> Option<Posture> {
        let config = self.chains().get(chain)?;
        if config.has_mimics {
            return Some(config.chain.posture(&self.model().chain_angles(chain, angles)));
        }
        Some(config.chain.posture(angles.get(config.joints()).unwrap_or_default()))
    }

    /// Inverse dynamics of all chains of a robot with mimic joints: the torques of its actuated joints [N·m].
    /// The torque of a mimic joint acts on the joint that it follows, times the ratio of their velocities
    /// (principle of virtual work).
    #[cold]
    #[inline(never)]
    pub(crate) fn coupled_dynamics(&self, motion: &Motion) -> [f32; MAX_JOINTS] {
        let mut sum = [0.0; MAX_JOINTS];
        for (index, config) in self.chains().iter().enumerate() {
            let [mut q, mut qd, mut qdd, mut torques] = [[0.0; MAX_CHAIN_JOINTS]; 4];
            let values = q.iter_mut().zip(&mut qd).zip(&mut qdd);
            for (((q, qd), qdd), joint) in values.zip(self.model().joints_of(index)) {
                let coupling = joint.coupling();
                let actuated = motion.get(usize::from(coupling.actuated)).copied().unwrap_or_default();
                let ([position, velocity, acceleration], ratio) = (actuated, coupling.multiplier);
                [*q, *qd, *qdd] = [coupling.angle(position), ratio * velocity, ratio * acceleration];
            }
            config.chain.inverse_dynamics(self.gravity(), &q, &qd, &qdd, &mut torques);
            for (torque, joint) in torques.into_iter().zip(self.model().joints_of(index)) {
                let coupling = joint.coupling();
                if let Some(sum) = sum.get_mut(usize::from(coupling.actuated)) {
                    *sum += coupling.multiplier * torque;
                }
            }
        }
        sum
    }

    /// Gravity torques of the actuated joints [N·m] at their angles [rad].
    pub fn gravity_torques(&self, angles: &[f32]) -> [f32; MAX_JOINTS] {
        let mut motion = Motion::default();
        motion.iter_mut().zip(angles).for_each(|([position, ..], angle)| *position = *angle);
        self.coupled_dynamics(&motion)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use crate::math;
    use crate::model::{ChainModel, Field, Inertial, MimicJoint, Pose, Problem, RobotModel};
    use crate::test_support;

    /// One joint moves a link of 20 g whose centre of mass is 20 mm away. A second chain has a mimic joint
    /// that follows it with ratio −0.4, and 50 mm further a joint with a motor. All axes are y: the links
    /// rise and fall.
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
        let second = ChainModel { name: "other".try_into().unwrap(), ..first.clone() };
        model.chains = [first, second].into_iter().collect();
        let (chain, place, joint, origin) = (1, 0, 0, place(0.0));
        let mimic = MimicJoint { chain, place, joint, multiplier: -0.4, offset: 0.1, origin, axis, link };
        model.mimics = [mimic].into_iter().collect();
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
        // By hand: a weight at x has the moment −g m x about +y, as the motor must balance it. A link at
        // angle q from x has its centre at x = 0.02 cos q.
        let weight = 0.02 * 9.81;
        let cos = |angle: f32| math::sin_cos(angle).1;
        let follower = -0.4 * driving + 0.1;
        let of_own = weight * 0.02 * cos(follower + own);
        let of_follower = weight * (0.02 + 0.05) * cos(follower) + of_own;
        let expected = [-weight * 0.02 * cos(driving) + 0.4 * of_follower, -of_own];
        for (got, expected) in torques.iter().zip(expected) {
            assert!(math::abs(got - expected) < 1e-6, "{got} {expected}");
        }
        // Acceleration: each point mass counts with the square of the ratio. The angles align the links:
        // offset 0.1 − 0.4 · 0.25 = 0.
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
        let tip = robot.posture(1, &[0.3, 0.2]).unwrap().tip().translation.vector;
        // The tip's frame is that of the last joint: 50 mm along the link of the mimic joint.
        let (sine, cosine) = math::sin_cos(-0.4 * 0.3 + 0.1);
        assert!((tip - nalgebra::Vector3::new(0.05 * cosine, 0.0, -0.05 * sine)).norm() < 1e-7, "{tip}");
        assert!(config.finger.is_none());
    }

    #[test]
    fn what_a_mimic_joint_cannot_be_is_refused() {
        let refused = |change: fn(&mut MimicJoint)| {
            let mut model = robot();
            change(&mut model.mimics[0]);
            let error = model.validate().unwrap_err();
            (error.field, error.problem)
        };
        assert_eq!(refused(|mimic| mimic.joint = 2), (Field::MimicJoint, Problem::NoSuchJoint));
        assert_eq!(refused(|mimic| mimic.chain = 2), (Field::MimicChain, Problem::NotSupported));
        assert_eq!(refused(|mimic| mimic.place = 2), (Field::MimicPlace, Problem::NotSupported));
        assert_eq!(refused(|mimic| mimic.multiplier = 0.0), (Field::MimicMultiplier, Problem::NotSupported));
        assert_eq!(refused(|mimic| mimic.offset = f32::NAN), (Field::MimicOffset, Problem::NotFinite));
        assert_eq!(refused(|mimic| mimic.axis = [0.0; 3]), (Field::Axis, Problem::NotUnit));
        // Two at the same place in the chain.
        let mut model = robot();
        let mimic = model.mimics[0];
        model.mimics.push(mimic).unwrap();
        assert_eq!(model.validate().unwrap_err().field, Field::MimicPlace);
    }

    /// The same links in one chain: a joint at the base, and 50 mm further a mimic joint with ratio 0.5.
    fn curling() -> RobotModel {
        let mut model = robot();
        model.chains.truncate(1);
        model.joints.truncate(1);
        model.mimics[0] = MimicJoint {
            chain: 0,
            place: 1,
            multiplier: 0.5,
            origin: Pose { translation: [0.05, 0.0, 0.0], ..Pose::IDENTITY },
            ..model.mimics[0]
        };
        model
    }

    #[test]
    fn a_joint_carries_the_one_behind_it_that_follows_it() {
        let robot = configured(&curling());
        assert!(robot.chains()[0].joints() == (0..1) && robot.chains()[0].chain.len() == 2);
        let at = |motion: [f32; 3]| {
            let mut all = Motion::default();
            all[0] = motion;
            robot.coupled_dynamics(&all)
        };
        // By hand: potential energy over the driving angle, (m g) d/dq of the heights of both centres; about
        // +y a link at x falls as its angle grows.
        let (q, weight) = (0.3_f32, 0.02 * 9.81);
        let cos = |angle: f32| math::sin_cos(angle).1;
        let outer = q + 0.5 * q + 0.1;
        let expected = -weight * (0.02 * cos(q) + 0.05 * cos(q) + 1.5 * 0.02 * cos(outer));
        let torques = at([q, 0.0, 0.0]);
        assert!(math::abs(torques[0] - expected) < 1e-6, "{torques:?} {expected}");
        assert!(torques[1..].iter().all(|torque| *torque == 0.0));
        // Kinetic energy with the links in line, where 0.5 q + 0.1 = 0: the outer centre moves at 0.05 + 1.5
        // · 0.02.
        let inertia = at([-0.2, 0.0, 1.0])[0] - at([-0.2, 0.0, 0.0])[0];
        let by_hand = 0.02 * (0.02 * 0.02 + 0.08 * 0.08);
        assert!(math::abs(inertia - by_hand) < 1e-8, "{inertia} {by_hand}");
        // The tip's frame is that of the outer joint.
        let tip = *robot.posture(0, &[q]).unwrap().tip();
        let (sine, cosine) = math::sin_cos(q);
        assert!(
            (tip.translation.vector - nalgebra::Vector3::new(0.05 * cosine, 0.0, -0.05 * sine)).norm() < 1e-7
        );
        let (sine, _) = math::sin_cos(outer);
        assert!(math::abs(tip.rotation[(0, 2)] - sine) < 1e-6);
    }
}
