//! The true state, independent of the sensors.

use rapier3d::na::Vector3;

use super::contact::TipContact;
use super::end_effector::Tip;
use super::fixture::{FixtureContact, Fixtures};
use super::machine::{Plant, in_drive_order};

/// True state of the machine. Joints are in the order of the drives.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Joint angles [rad].
    pub positions: Vec<f64>,
    /// Joint velocities, half a sub-step ago [rad/s].
    pub velocities: Vec<f64>,
    /// Torques of the motors at the joints [N·m].
    pub torques: Vec<f64>,
    /// Angle found by homing, minus the true angle [rad].
    pub homing_errors: Vec<f64>,
}

/// True state of a tip, in the frame of the base. Velocities are half a sub-step old.
#[derive(Clone, Debug, PartialEq)]
pub struct TipTruth {
    /// Its link.
    pub link: String,
    /// Position of the frame of its link [m].
    pub position: [f64; 3],
    /// Unit quaternion `[x, y, z, w]`.
    pub orientation: [f64; 4],
    /// Velocity of the origin of its frame [m/s].
    pub velocity: [f64; 3],
    /// Angular velocity [rad/s].
    pub angular_velocity: [f64; 3],
    /// Force of walls, holds and pushes, mean over the last control period [N].
    pub force: [f64; 3],
    /// Torque of the same about the origin of its frame [N·m].
    pub torque: [f64; 3],
    /// Part of `force` that is due to walls [N].
    pub wall_force: [f64; 3],
    /// Penetration into a wall [m].
    pub wall_depth: f64,
}

/// True state of the object, in the frame of the base.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectTruth {
    /// Position of its frame [m].
    pub position: [f64; 3],
    /// Unit quaternion `[x, y, z, w]`.
    pub orientation: [f64; 4],
    /// Velocity of the origin of its frame, half a sub-step ago [m/s].
    pub velocity: [f64; 3],
    /// Angular velocity, half a sub-step ago [rad/s].
    pub angular_velocity: [f64; 3],
    /// Mass of the weights on it [kg].
    pub load: f64,
    /// Coefficient of friction of all its contacts.
    pub friction: f64,
    /// Force of the support on it in the last sub-step [N].
    pub support_force: [f64; 3],
}

/// A fingertip's contact with the object at the end of the last sub-step, depth and normal at its start, in
/// the frame of the base unless stated otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactTruth {
    /// Link of the fingertip.
    pub link: String,
    /// Force on the object, mean over the last control period [N].
    pub force: [f64; 3],
    /// Point of application, on the fingertip [m].
    pub point: [f64; 3],
    /// Unit vector out of the object, through the centre of the tip; 0 without contact.
    pub normal: [f64; 3],
    /// Penetration of the tip into the object [m].
    pub depth: f64,
    /// Velocity of the tip's surface along that of the object, in the frame of the object, half a sub-step
    /// ago [m/s].
    pub slip_velocity: [f64; 3],
    /// Integral of `slip_velocity` since the start during contact [m].
    pub slip: [f64; 3],
    /// Integral of the magnitude of `slip_velocity` while friction was at its limit [m]; motions to and fro
    /// add up.
    pub slip_path: f64,
}

impl ContactTruth {
    /// Component of the force along the normal, into the object [N].
    pub fn normal_force(&self) -> f64 {
        -Vector3::from(self.force).dot(&Vector3::from(self.normal))
    }

    /// Magnitude of the force along the surface [N].
    pub fn tangential_force(&self) -> f64 {
        let (force, normal) = (Vector3::from(self.force), Vector3::from(self.normal));
        (force - normal * force.dot(&normal)).norm()
    }
}

impl Plant {
    /// The state of the machine.
    pub fn truth(&self) -> Truth {
        let half = self.values.integration.step / 2.0;
        Truth {
            positions: in_drive_order(&self.drive_of, self.world.positions()),
            velocities: in_drive_order(&self.drive_of, self.world.velocities()),
            torques: self.drives.iter().map(|drive| drive.torque(half)).collect(),
            homing_errors: self.drives.iter().map(|drive| drive.homing_error).collect(),
        }
    }

    /// The state of the object; `None` without one.
    pub fn object(&self) -> Option<ObjectTruth> {
        let grasp = self.world.grasp()?;
        let pose = grasp.pose();
        let motion = grasp.motion_at(&pose.translation.vector);
        Some(ObjectTruth {
            position: pose.translation.vector.into(),
            orientation: pose.rotation.coords.into(),
            velocity: motion.linear.into(),
            angular_velocity: motion.angular.into(),
            load: grasp.disturbances.mass(self.world.time()),
            friction: grasp.friction,
            support_force: grasp.support_force.into(),
        })
    }

    /// Returns a contact for each fingertip, touching or not, in the order of the URDF; none without an
    /// object.
    pub fn contacts(&self) -> Vec<ContactTruth> {
        let tip_contacts = self.world.grasp().map_or(&[][..], |grasp| grasp.tip_contacts());
        let truth = |(tip, touch): (&Tip, &TipContact)| ContactTruth {
            link: tip.link.clone(),
            force: touch.mean_force().into(),
            point: touch.point.into(),
            normal: touch.normal.into(),
            depth: touch.depth,
            slip_velocity: touch.slip_velocity.into(),
            slip: touch.slip.into(),
            slip_path: touch.slip_path,
        };
        self.world.tips().iter().zip(tip_contacts).map(truth).collect()
    }

    /// Returns the contacts of links with fixed bodies in the last control period.
    pub fn fixture_contacts(&self) -> Vec<FixtureContact> {
        self.world.fixtures().map(Fixtures::contacts).unwrap_or_default()
    }

    /// The tips, in the order of the URDF.
    pub fn tips(&self) -> Vec<TipTruth> {
        let truth = |(index, tip): (usize, &Tip)| {
            let (frame, around) = (self.world.tip_frame(index)?, self.world.environment().of_tip(index)?);
            let motion = self.world.motion_at(tip.body, &frame.translation.vector);
            let (wrench, walls) = around.means();
            Some(TipTruth {
                link: tip.link.clone(),
                position: frame.translation.vector.into(),
                orientation: frame.rotation.coords.into(),
                velocity: motion.linear.into(),
                angular_velocity: motion.angular.into(),
                force: wrench.force.into(),
                torque: wrench.torque.into(),
                wall_force: walls.into(),
                wall_depth: around.depth,
            })
        };
        self.world.tips().iter().enumerate().filter_map(truth).collect()
    }

    /// Returns the error-free readings of the force sensors, one per fingertip: forces [N] and torques [N·m].
    pub fn tip_wrenches(&self) -> Vec<[f64; 6]> {
        self.forces.wrenches()
    }
}
