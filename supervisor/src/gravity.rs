//! The effect of gravity on a robot whose outputs are switched off.

use std::fmt;

use tesaki::math::abs;
use tesaki::model::{JointModel, RobotModel};
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
        let (joint, torque) = worst(model, angles, |joint| joint.friction.coulomb)?;
        Some(Self {
            robot: model.name.to_string(),
            joint: joint.name.to_string(),
            torque,
            friction: joint.friction.coulomb,
        })
    }
}

/// The joint at which gravity [N·m] exceeds what `holds` it [N·m] most; `None` if it exceeds it nowhere.
fn worst<'a>(
    model: &'a RobotModel,
    angles: &[f32],
    holds: impl Fn(&JointModel) -> f32,
) -> Option<(&'a JointModel, f32)> {
    let mut robot = Box::new(Robot::NONE);
    robot.configure(model).ok()?;
    let loads =
        model.joints.iter().zip(robot.gravity_torques(angles)).map(|(joint, torque)| (joint, abs(torque)));
    let excess = |(joint, torque): &(&JointModel, f32)| torque - holds(joint);
    loads.filter(|load| excess(load) > 0.0).max_by(|one, other| excess(one).total_cmp(&excess(other)))
}

/// The joint whose motor is farthest from bearing its links: enabled, it moves down all the same.
#[derive(Clone, Debug, PartialEq)]
pub struct TooHeavy {
    joint: String,
    /// The torque of gravity [N·m].
    torque: f32,
    /// The largest torque of the motor, and Coulomb friction [N·m].
    motor: f32,
    friction: f32,
}

impl TooHeavy {
    /// Of `model` at rest at `angles` [rad]; `None` if the motors and friction can hold every joint.
    pub fn at(model: &RobotModel, angles: &[f32]) -> Option<Self> {
        let (joint, torque) = worst(model, angles, |joint| joint.torque_limit() + joint.friction.coulomb)?;
        Some(Self {
            joint: joint.name.to_string(),
            torque,
            motor: joint.torque_limit(),
            friction: joint.friction.coulomb,
        })
    }

    /// The name of the joint.
    pub fn joint(&self) -> &str {
        &self.joint
    }
}

impl fmt::Display for TooHeavy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} cannot be held there: gravity {:.2} N·m, its motor at most {:.2} N·m, friction {:.2} N·m",
            self.joint, self.torque, self.motor, self.friction
        )
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

    #[test]
    fn a_motor_that_cannot_bear_its_links_is_named() {
        let mut arm = model("arm7");
        let stretched = [0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(TooHeavy::at(&arm, &stretched), None);
        // Friction holds, too.
        let gravity = Load::at(&arm, &stretched).unwrap();
        let index = arm.joints.iter().position(|joint| joint.name == gravity.joint.as_str()).unwrap();
        arm.joints[index].limits.torque = gravity.torque - 0.9 * gravity.friction;
        assert_eq!(TooHeavy::at(&arm, &stretched), None);
        arm.joints[index].limits.torque = gravity.torque - 1.1 * gravity.friction;
        let told = TooHeavy::at(&arm, &stretched).unwrap();
        assert!(told.to_string().starts_with(&format!("{} cannot be held", gravity.joint)), "{told}");
    }
}
