//! The effect of gravity on a robot whose outputs are switched off.

use std::fmt;

use tesaki::math::abs;
use tesaki::model::RobotModel;
use tesaki::protocol::Telemetry;
use tesaki::robot::Robot;

use crate::angles;

/// The joint at which gravity exceeds friction most: without power it moves down.
pub struct Load {
    robot: String,
    joint: String,
    /// The torque of gravity [N·m].
    torque: f32,
    /// Coulomb friction [N·m].
    friction: f32,
}

impl Load {
    /// As [`Load::at`], at the measured angles.
    pub fn measured(model: &RobotModel, telemetry: &Telemetry) -> Option<Self> {
        Self::at(model, &angles::measured(telemetry))
    }

    /// Computes the load of `model` at rest at `angles` [rad]; `None` if friction holds every joint.
    pub fn at(model: &RobotModel, angles: &[f32]) -> Option<Self> {
        let mut robot = Box::new(Robot::NONE);
        robot.configure(model).ok()?;
        let mut worst: Option<Self> = None;
        for (joint, torque) in model.joints.iter().zip(robot.weight(angles)) {
            let friction = joint.friction.coulomb;
            let excess = abs(torque) - friction;
            if excess > worst.as_ref().map_or(0.0, |worst| worst.torque - worst.friction) {
                worst = Some(Self {
                    robot: model.name.to_string(),
                    joint: joint.name.to_string(),
                    torque: abs(torque),
                    friction,
                });
            }
        }
        worst
    }
}

impl fmt::Display for Load {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "without power {} falls unless it is supported ({}: gravity {:.2} N·m, friction {:.2} N·m)",
            self.robot, self.joint, self.torque, self.friction
        )
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::path::Path;

    use tesaki_description::robot::RobotFolder;

    use super::*;

    fn model(name: &str) -> RobotModel {
        RobotFolder::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(name)).unwrap().model
    }

    #[test]
    fn an_arm_falls_and_the_fingers_of_a_hand_stay() {
        let arm = model("arm7");
        let load = Load::at(&arm, &[0.0, 0.6, 0.0, 1.2, 0.0, 0.6, 0.0]).unwrap();
        assert!(load.torque > 5.0 && load.friction < 1.0, "{load}");
        assert!(load.to_string().contains("arm7 falls"), "{load}");
        let hand = model("hand3");
        for angle in [-0.5, 0.0, 0.5, 1.0] {
            assert!(Load::at(&hand, &[angle; 9]).is_none(), "{angle}");
        }
        // Without friction, a finger falls.
        let mut slippery = hand;
        slippery.joints.iter_mut().for_each(|joint| joint.friction.coulomb = 0.0);
        assert!(Load::at(&slippery, &[0.3; 9]).is_some());
    }
}
