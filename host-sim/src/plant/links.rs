//! The links of a robot.

use rapier3d::math::{Pose, Vector};
use rapier3d::na::Vector3;

use super::assembly::{Assembly, Handles};
use super::constraints::Row;
use super::multibody::Multibody;

/// All links of a robot, in the order of its joints.
pub struct Links {
    multibodies: Vec<Multibody>,
    /// Index of the multibody of each joint's link, and index of the link in it.
    places: Vec<(usize, usize)>,
}

impl Links {
    /// Takes over the links of an assembly.
    pub fn new(Assembly { physics, joints }: &Assembly) -> Self {
        let chains = physics.multibody_joints.multibodies();
        let multibodies: Vec<_> = chains.map(|chain| Multibody::new(chain, &physics.bodies)).collect();
        let place = |joint: &Handles| {
            let link = |multibody: &Multibody| multibody.bodies().position(|body| body == joint.body);
            multibodies.iter().enumerate().find_map(|(index, multibody)| Some((index, link(multibody)?)))
        };
        Self { places: joints.iter().filter_map(place).collect(), multibodies }
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

    /// Coulomb friction of a joint [N·m].
    pub fn friction(&self, joint: usize) -> f32 {
        let (multibody, link) = self.places[joint];
        self.multibodies[multibody].friction(link)
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
    pub fn step(&mut self, gravity: Vector, dt: f32) {
        self.multibodies.iter_mut().for_each(|multibody| multibody.step(gravity, dt));
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::path::Path;

    use rapier3d::dynamics::JointAxesMask;
    use tesaki_description::robot::RobotFolder;
    use tesaki_rng::Rng;

    use super::super::assembly::Parts;
    use super::super::convert::{narrow, vector};
    use super::super::factors;
    use super::super::machine::joint_values;
    use super::super::multibody::SWEEPS;
    use super::super::tree::{self, Body};
    use super::super::{CONTROL_PERIOD, Drive, PlantOptions};
    use super::*;

    const STEP: f64 = CONTROL_PERIOD / 10.0;

    /// Puts a robot together, with factors of a seed.
    fn assemble(robot: &RobotFolder, bodies: &[Body], seed: u64) -> Assembly {
        let drives: Vec<_> = robot.model.joints.iter().map(Drive::from).collect();
        let factors = factors::draw(seed, 0.1, bodies.len());
        let drive = |body: &Body| drives.iter().find(|drive| drive.joint == body.joint);
        let values = |(body, factors)| joint_values(body, drive(body), factors, &PlantOptions::exact());
        let values: Vec<_> = bodies.iter().zip(&factors).map(values).collect();
        let middle = |body: &Body| body.stops.map_or(0.1, |[lower, upper]| 0.4 * lower + 0.6 * upper);
        let posture: Vec<_> = bodies.iter().map(middle).collect();
        let mut assembly =
            Assembly::new(STEP, &Parts { bodies, values: &values, factors: &factors, posture: &posture });
        let parameters = &mut assembly.physics.integration_parameters;
        parameters.dt = narrow(STEP);
        parameters.num_solver_iterations = 1;
        parameters.num_internal_pgs_iterations = SWEEPS;
        parameters.num_internal_stabilization_iterations = 0;
        parameters.normalized_max_linear_velocity = f32::MAX;
        assembly
    }

    /// Angle and velocity of a joint, and pose of its link.
    fn motion(assembly: &Assembly, joint: &Handles) -> (f32, f32, Pose) {
        let (chain, link) = assembly.physics.multibody_joints.get(joint.handle).unwrap();
        let angle = chain.link(link).unwrap().joint().coords()[3];
        (angle, chain.generalized_velocity()[link - 1], *assembly.physics.bodies[joint.body].position())
    }

    /// Advances rapier by a sub-step in which it considers only the stops that joints have passed. Returns
    /// the number of these.
    fn step(assembly: &mut Assembly, bodies: &[Body]) -> usize {
        let mut passed = 0;
        for (joint, body) in assembly.joints.iter().zip(bodies) {
            let Some([lower, upper]) = body.stops.map(|stops| stops.map(narrow)) else { continue };
            let (chain, link) = assembly.physics.multibody_joints.get_mut(joint.handle).unwrap();
            let joint = &mut chain.link_mut(link).unwrap().joint;
            let is_beyond = joint.coords()[3] < lower || upper < joint.coords()[3];
            joint.data.limit_axes.set(JointAxesMask::ANG_X, is_beyond);
            passed += usize::from(is_beyond);
        }
        assembly.physics.step();
        passed
    }

    /// Compares the motion under torques that drive the joints into their stops, and a push on a link.
    #[test]
    fn every_bit_is_that_of_rapier() {
        // Each robot with its largest torques [N·m].
        let robots = [
            ("hand3", 0.1),
            ("arm7", 30.0),
            ("knob-arm", 10.0),
            ("hand5", 0.2),
            ("leap", 0.3),
            ("allegro", 0.3),
            ("inspire", 0.3),
        ];
        for ((name, largest), seed) in robots.into_iter().zip(1..) {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(name);
            let robot = RobotFolder::load(&folder).unwrap();
            let bodies = tree::bodies(&robot.urdf).unwrap();
            let mut rapier = assemble(&robot, &bodies, seed);
            let mut own = Links::new(&rapier);
            let gravity = Vector::new(0.5, -1.0, -9.8);
            rapier.physics.gravity = gravity;
            let (mut rng, mut stops) = (Rng::new(seed, 0), 0);
            let mut torques = vec![0.0; bodies.len()];
            for sub_step in 0..2000 {
                if sub_step % 200 == 0 {
                    torques.iter_mut().for_each(|torque| *torque = narrow(largest * rng.symmetric()));
                }
                own.release();
                for joint in &rapier.joints {
                    let body = &mut rapier.physics.bodies[joint.body];
                    body.reset_forces(false);
                    body.reset_torques(false);
                }
                for (index, torque) in torques.iter().enumerate() {
                    let torque = own.pose(index).rotation * vector(&bodies[index].axis) * *torque;
                    own.add_joint_torque(index, torque);
                    rapier.physics.bodies[rapier.joints[index].body].add_torque(torque, true);
                    if let Some(before) = bodies[index].parent {
                        rapier.physics.bodies[rapier.joints[before].body].add_torque(-torque, true);
                    }
                }
                if (500..1500).contains(&sub_step) {
                    let (force, torque) = (Vector::new(1.0, -2.0, 0.5), Vector::new(0.01, 0.0, 0.02));
                    let point = *own.pose(1) * Vector::new(0.01, 0.0, 0.02);
                    own.add_wrench(1, (force, point), torque);
                    let body = &mut rapier.physics.bodies[rapier.joints[1].body];
                    body.add_force_at_point(force, point, true);
                    body.add_torque(torque, true);
                }
                own.step(gravity, narrow(STEP));
                stops += step(&mut rapier, &bodies);
                for (index, joint) in rapier.joints.iter().enumerate() {
                    let (angle, velocity) = own.motion(index);
                    let (own, rapier) = ((angle, velocity, *own.pose(index)), motion(&rapier, joint));
                    assert!(own == rapier, "{name}, sub-step {sub_step}, joint {index}: {own:?} {rapier:?}");
                }
            }
            assert!(stops > 0, "{name} never reached a stop");
        }
    }
}
