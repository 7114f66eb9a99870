//! The links of a robot that touches no fixed bodies.

use rapier3d::dynamics::{IntegrationParameters, MultibodyJointSet, RigidBodyHandle, RigidBodySet};
use rapier3d::math::{Pose, Vector};
use rapier3d::na::Vector3;

use super::constraints::Row;
use super::multibody::Multibody;

/// All links of a robot, in the order of its joints.
pub struct Links {
    multibodies: Vec<Multibody>,
    /// Index of the multibody of each joint's link, and index of the link in it.
    places: Vec<(usize, usize)>,
}

impl Links {
    /// Takes over the links with these bodies from rapier.
    pub fn new(
        chains: &MultibodyJointSet,
        bodies: &RigidBodySet,
        links: impl Iterator<Item = RigidBodyHandle>,
    ) -> Option<Self> {
        let multibodies: Option<Vec<_>> =
            chains.multibodies().map(|chain| Multibody::new(chain, bodies)).collect();
        let multibodies = multibodies?;
        let place = |body| {
            let link = |multibody: &Multibody| multibody.bodies().position(|other| other == body);
            multibodies.iter().enumerate().find_map(|(index, multibody)| Some((index, link(multibody)?)))
        };
        let places: Option<Vec<_>> = links.map(place).collect();
        Some(Self { places: places?, multibodies })
    }

    /// Pose of the link behind a joint.
    pub fn pose(&self, joint: usize) -> &Pose {
        let (multibody, link) = self.places[joint];
        self.multibodies[multibody].pose(link)
    }

    /// Angle [rad] and velocity [rad/s] of a joint, the latter in the last sub-step.
    pub fn motion(&self, joint: usize) -> (f32, f32) {
        let (multibody, link) = self.places[joint];
        self.multibodies[multibody].motion(link)
    }

    /// Clears all forces and torques.
    pub fn release(&mut self) {
        self.multibodies.iter_mut().for_each(Multibody::release);
    }

    /// Adds a motor torque at a joint [N·m], in the frame of the base.
    pub fn add_joint_torque(&mut self, joint: usize, torque: Vector) {
        let (multibody, link) = self.places[joint];
        self.multibodies[multibody].add_joint_torque(link, torque);
    }

    /// Adds a force [N] at a point of the link behind a joint, and a torque [N·m], in the frame of the base.
    pub fn add_wrench(&mut self, joint: usize, (force, point): (Vector, Vector), torque: Vector) {
        let (multibody, link) = self.places[joint];
        self.multibodies[multibody].add_force(link, force, point);
        self.multibodies[multibody].add_torque(link, torque);
    }

    /// Changes the velocities by those of a sub-step, without constraints.
    pub fn accelerate(&mut self, gravity: Vector, dt: f32) {
        self.multibodies.iter_mut().for_each(|multibody| multibody.accelerate(gravity, dt));
    }

    /// The constraints of the joints.
    pub fn constraints(&mut self, dt: f32) -> Vec<Row> {
        let mut rows = Vec::new();
        for (chain, multibody) in self.multibodies.iter_mut().enumerate() {
            rows.extend(multibody.constraints(dt).map(|row| Row { chain, ..row }));
        }
        rows
    }

    /// The velocity of a point of the link behind a joint, along a direction, as a constraint.
    pub fn row(&self, joint: usize, point: &Vector3<f64>, direction: &Vector3<f64>) -> Row {
        let (chain, link) = self.places[joint];
        Row { chain, ..self.multibodies[chain].row(link, point, direction) }
    }

    /// Joint velocities of a multibody [rad/s].
    pub fn velocities(&self, chain: usize) -> &[f32] {
        self.multibodies[chain].velocities()
    }

    /// Changes the velocities by the impulses of `rows`, of which the first are the constraints of the
    /// joints.
    pub fn take_impulses(&mut self, rows: &[Row]) {
        for (chain, multibody) in self.multibodies.iter_mut().enumerate() {
            multibody.take_impulses(rows.iter().filter(|row| row.chain == chain));
        }
    }

    /// Moves the links with their velocities.
    pub fn advance(&mut self, dt: f32) {
        self.multibodies.iter_mut().for_each(|multibody| multibody.advance(dt));
    }

    /// Advances links without contacts by one sub-step.
    pub fn step(&mut self, gravity: Vector, parameters: &IntegrationParameters) {
        self.multibodies.iter_mut().for_each(|multibody| multibody.step(gravity, parameters));
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests")]
mod tests {
    use std::path::Path;

    use tesaki::protocol::ActuatorFrame;
    use tesaki_description::robot::RobotFolder;
    use tesaki_rng::Rng;

    use super::super::{Plant, PlantOptions, Push};

    fn plant(robot: &str, seed: u64) -> Plant {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(robot);
        let robot = RobotFolder::load(&folder).unwrap();
        Plant::of(&robot, &PlantOptions::mismatched(seed)).unwrap()
    }

    /// Returns the observable motion of a plant: angles, velocities, poses of the links, wrenches of the
    /// tips.
    fn state(plant: &Plant) -> impl PartialEq + std::fmt::Debug + use<> {
        let truth = plant.truth();
        let poses: Vec<_> = (0..truth.positions.len()).map(|joint| plant.link_pose(joint)).collect();
        (truth.positions, truth.velocities, poses, plant.tip_wrenches())
    }

    /// Compares the motion under torques that drive the joints into their stops, a push on a link, and a
    /// wall.
    #[test]
    fn every_bit_is_that_of_rapier() {
        // Each robot with its largest torques [N·m].
        let robots = [
            ("hand3", 0.1),
            ("arm7", 30.0),
            ("hand5", 0.2),
            ("leap", 0.3),
            ("allegro", 0.3),
            ("inspire", 0.3),
        ];
        for ((robot, largest), seed) in robots.into_iter().zip(1..) {
            let (mut own, mut rapier) = (plant(robot, seed), plant(robot, seed));
            assert!(own.world.links.is_some(), "{robot}");
            rapier.world.leave_to_rapier();
            let (mut rng, mut stops) = (Rng::new(seed, 0), 0);
            let mut torques = vec![0.0; own.drives.len()];
            for period in 0..200 {
                if period % 20 == 0 {
                    torques.iter_mut().for_each(|torque| *torque = (largest * rng.symmetric()) as f32);
                }
                for plant in [&mut own, &mut rapier] {
                    match period {
                        50 => {
                            let push = Push {
                                force: [1.0, -2.0, 0.5],
                                point: [0.01, 0.0, 0.02],
                                ramp: 0.01,
                                hold: 0.2,
                            };
                            plant.push_link(1, push).unwrap();
                        }
                        100 => {
                            plant.insert_wall_ahead([1.0, 0.2, -0.3], 0.002, 1000.0).unwrap();
                        }
                        _ => {}
                    }
                    let torques = torques.iter().copied().collect();
                    plant.apply(&ActuatorFrame { sequence: period, enabled: true, torques }).unwrap();
                }
                assert!(
                    state(&own) == state(&rapier),
                    "{robot}, period {period}:\n{:?}\n{:?}",
                    state(&own),
                    state(&rapier)
                );
                let is_beyond = |(angle, stops): (&f64, Option<[f64; 2]>)| {
                    stops.is_some_and(|[lower, upper]| *angle < lower || *angle > upper)
                };
                stops +=
                    own.truth().positions.iter().zip(own.stops()).filter(|pair| is_beyond(*pair)).count();
            }
            assert!(stops > 0, "{robot} never reached a stop");
        }
    }
}
