//! Kinetic energy of the machine, and the torques of its weight.

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
    /// About the centre of mass, axes of the body's frame.
    inertia: Matrix3<f64>,
    /// Reflected inertia of the rotor [kg·m²].
    pub rotor: f64,
}

impl Inertial {
    /// Of a body with its deviations.
    pub fn new(body: &Body, factors: &JointFactors) -> Self {
        let (mass, inertia) = (body.mass * factors.mass, body.inertia * factors.inertia);
        Self { mass, center: body.center_of_mass, inertia, rotor: 0.0 }
    }

    fn center(&self, frame: &Isometry3<f64>) -> Vector3<f64> {
        (frame * Point3::from(self.center)).coords
    }
}

impl World {
    fn kinetic_energy(&self) -> f64 {
        let energy = |(index, ((inertial, _), speed)): (usize, ((&Inertial, _), f64))| {
            let Some(frame) = self.body(index) else { return 0.0 };
            let motion = self.motion_at(index, &inertial.center(&frame));
            let turn = frame.rotation.inverse() * motion.angular;
            0.5 * (inertial.mass * motion.linear.norm_squared()
                + turn.dot(&(inertial.inertia * turn))
                + inertial.rotor * speed * speed)
        };
        self.inertials().zip(self.velocities()).enumerate().map(energy).sum()
    }

    /// The torques that keep the machine's weight in balance, in the order of the world's joints [N·m].
    fn weight_torques(&self) -> Vec<f64> {
        let bodies: Vec<_> = self.inertials().collect();
        let mut torques = vec![0.0; bodies.len()];
        for (index, (inertial, _)) in bodies.iter().enumerate() {
            let Some(frame) = self.body(index) else { continue };
            let (center, weight) = (inertial.center(&frame), self.gravity() * inertial.mass);
            let mut next = Some(index);
            while let Some((joint, (axis, origin))) =
                next.and_then(|joint| Some((joint, self.joint_axis(joint)?)))
            {
                if let Some(torque) = torques.get_mut(joint) {
                    *torque -= axis.dot(&(center - origin).cross(&weight));
                }
                next = bodies.get(joint).and_then(|(_, before)| *before);
            }
        }
        torques
    }
}

impl Plant {
    /// Kinetic energy of links and rotors [J], without that of an object.
    pub fn kinetic_energy(&self) -> f64 {
        self.world.kinetic_energy()
    }

    /// The torques that keep the true weight of the links in balance [N·m].
    pub fn weight_torques(&self) -> Vec<f64> {
        in_drive_order(&self.drive_of, self.world.weight_torques().into_iter())
    }

    /// The true Coulomb friction of the joints [N·m].
    pub fn coulomb_frictions(&self) -> Vec<f64> {
        in_drive_order(&self.drive_of, self.world.coulomb_frictions())
    }

    /// Mass of all moving links [kg].
    pub fn mass(&self) -> f64 {
        self.world.inertials().map(|(inertial, _)| inertial.mass).sum()
    }
}
