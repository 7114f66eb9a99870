//! Kinetic energy of the machine, and joint torques of its weight and of external loads.

use rapier3d::na::{Isometry3, Matrix3, Point3, Vector3};

use super::factors::JointFactors;
use super::machine::{Plant, in_drive_order};
use super::tree::Body;
use super::world::World;

/// Mass distribution of a body and of the rotor that turns it.
#[derive(Clone, Copy, Debug)]
pub struct Inertial {
    mass: f64,
    center: Vector3<f64>,
    /// About the centre of mass, in the axes of the body's frame.
    inertia: Matrix3<f64>,
    /// Reflected inertia of the rotor [kg·m²].
    rotor: f64,
}

impl Inertial {
    /// Computes the mass distribution of a body with its deviations from the nominal values.
    pub fn new(body: &Body, factors: &JointFactors, rotor: f64) -> Self {
        let (mass, inertia) = (body.mass * factors.mass, body.inertia * factors.inertia);
        Self { mass, center: body.center_of_mass, inertia, rotor }
    }

    fn center(&self, frame: &Isometry3<f64>) -> Vector3<f64> {
        (frame * Point3::from(self.center)).coords
    }
}

impl World {
    fn kinetic_energy(&self) -> f64 {
        let energy = |(index, (inertial, speed)): (usize, (&Inertial, f64))| {
            let frame = self.body(index);
            let motion = self.motion_at(index, &inertial.center(&frame));
            let turn = frame.rotation.inverse() * motion.angular;
            0.5 * (inertial.mass * motion.linear.norm_squared()
                + turn.dot(&(inertial.inertia * turn))
                + inertial.rotor * speed * speed)
        };
        self.inertials().zip(self.velocities()).enumerate().map(energy).sum()
    }

    /// Computes the torques that balance the machine's weight, in the order of the world's joints [N·m].
    fn weight_torques(&self) -> Vec<f64> {
        let weights = self.inertials().enumerate().map(|(index, inertial)| {
            let center = inertial.center(&self.body(index));
            (index, center, self.gravity() * -inertial.mass, Vector3::zeros())
        });
        self.joint_torques(weights)
    }

    /// Computes the torques of tip forces, contacts and pushes, in the order of the world's joints [N·m].
    fn load_torques(&self) -> Vec<f64> {
        let on_tips = self.tips().iter().enumerate().filter_map(|(index, tip)| {
            let (frame, around) = (self.tip_frame(index)?, self.environment().of_tip(index)?);
            let (wrench, _) = around.means();
            Some((tip.body, frame.translation.vector, wrench.force, wrench.torque))
        });
        let contacts = self.grasp().map_or(&[][..], |grasp| grasp.tip_contacts());
        let of_object = self.tips().iter().zip(contacts).map(|(tip, contact)| {
            // `mean_force` is the force on the object.
            (tip.body, contact.point, -contact.mean_force(), Vector3::zeros())
        });
        let on_links = self.link_forces().map(|(body, point, force)| (body, point, force, Vector3::zeros()));
        self.joint_torques(on_tips.chain(of_object).chain(on_links))
    }

    /// Computes the joint torques of loads: each a body, a point and a force [N] in the base frame, and a
    /// moment [N·m].
    fn joint_torques(
        &self,
        loads: impl Iterator<Item = (usize, Vector3<f64>, Vector3<f64>, Vector3<f64>)>,
    ) -> Vec<f64> {
        let mut torques = vec![0.0; self.joints.len()];
        for (body, point, force, moment) in loads {
            let mut next = Some(body);
            while let Some(joint) = next {
                let (axis, origin) = self.joint_axis(joint);
                torques[joint] += axis.dot(&(moment + (point - origin).cross(&force)));
                next = self.joints[joint].before;
            }
        }
        torques
    }
}

impl Plant {
    /// Computes the kinetic energy of links and rotors [J], without that of an object.
    pub fn kinetic_energy(&self) -> f64 {
        self.world.kinetic_energy()
    }

    /// Computes the torques that balance the true weight of the links [N·m].
    pub fn weight_torques(&self) -> Vec<f64> {
        in_drive_order(&self.drive_of, self.world.weight_torques().into_iter())
    }

    /// Computes the joint torques of contacts, pushes and pulls on the robot [N·m]: tip forces and contacts
    /// as means over the last control period, pushes on links at their present value. Contacts with fixed
    /// bodies are not included.
    pub fn load_torques(&self) -> Vec<f64> {
        in_drive_order(&self.drive_of, self.world.load_torques().into_iter())
    }

    /// The true Coulomb friction of the joints [N·m].
    pub fn coulomb_frictions(&self) -> Vec<f64> {
        in_drive_order(&self.drive_of, self.world.coulomb_frictions())
    }

    /// Mass of all moving links [kg].
    pub fn mass(&self) -> f64 {
        self.world.inertials().map(|inertial| inertial.mass).sum()
    }
}
