//! The physics: rapier multibodies, one for each joint of the base, with all links behind it.

use rapier3d::dynamics::{
    GenericJointBuilder, JointAxesMask, JointAxis, MassProperties, MultibodyJointHandle, RigidBodyBuilder,
    RigidBodyHandle,
};
use rapier3d::geometry::NarrowPhase;
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Point3, UnitQuaternion, Vector3};
use rapier3d::pipeline::PhysicsWorld;

use super::convert::{mass_properties, narrow, pose, vector, wide};
use super::end_effector::Tip;
use super::energy::Inertial;
use super::environment::Environment;
use super::factors::JointFactors;
use super::fixture::{self, Element, Fixture, Fixtures};
use super::grasp::Grasp;
use super::linkage::Linkage;
use super::links::Links;
use super::narrow_phase::CheckedContacts;
use super::push::{Disturbances, Push};
use super::tree::Body;
use tesaki_description::object::ObjectValues;

/// Solver sweeps over the constraints in a sub-step. Dry friction in the joints of a chain is coupled: with
/// too few sweeps, joints that should be at rest creep.
const SWEEPS: usize = 8;

/// Parameters of a joint in the physics engine.
pub struct JointValues {
    /// Reflected inertia of the rotor [kg·m²].
    pub rotor_inertia: f64,
    /// Coulomb friction [N·m].
    pub coulomb: f64,
    /// Viscous friction [N·m·s/rad].
    pub viscous: f64,
}

/// Moving bodies and their joints.
pub struct World {
    pub(super) physics: PhysicsWorld,
    pub(super) joints: Vec<Joint>,
    /// The links; rapier moves them if fixed bodies can touch them.
    pub(super) links: Option<Links>,
    linkages: Vec<Linkage>,
    pub(super) tips: Vec<Tip>,
    grasp: Option<Grasp>,
    fixtures: Option<Fixtures>,
    environment: Environment,
    /// Pushes on the origins of bodies: body, start time and push.
    link_pushes: Vec<(usize, f64, Push)>,
    gravity: Vector,
    step: f64,
    /// Sub-steps since the start.
    steps: u64,
}

/// A joint and the body behind it.
pub(super) struct Joint {
    pub(super) handle: MultibodyJointHandle,
    pub(super) body: RigidBodyHandle,
    parent: RigidBodyHandle,
    /// Index of the joint before it.
    pub(super) before: Option<usize>,
    /// Axis in the frame of the body.
    pub(super) axis: Vector,
    /// End stops [rad].
    stops: Option<[f32; 2]>,
    inertial: Inertial,
}

impl World {
    pub fn new(
        gravity: [f64; 3],
        step: f64,
        bodies: &[Body],
        values: &[JointValues],
        factors: &[JointFactors],
        posture: &[f64],
    ) -> Self {
        let mut physics = PhysicsWorld::default();
        let parameters = &mut physics.integration_parameters;
        parameters.dt = narrow(step);
        parameters.num_solver_iterations = 1;
        parameters.num_internal_pgs_iterations = SWEEPS;
        parameters.num_internal_stabilization_iterations = 0;
        parameters.normalized_max_linear_velocity = f32::MAX;

        let mut joints: Vec<Joint> = Vec::new();
        for (body, factors) in bodies.iter().zip(factors) {
            let parent = match body.parent.and_then(|parent| joints.get(parent)) {
                Some(parent) => parent.body,
                None => physics.insert_body(RigidBodyBuilder::fixed()),
            };
            let handle = physics.insert_body(
                RigidBodyBuilder::dynamic().additional_mass_properties(mass(body, factors)).can_sleep(false),
            );
            // Rapier's joints turn about the x axis of their own frame.
            let turn = UnitQuaternion::rotation_between(&Vector3::x(), &body.axis).unwrap_or_else(|| {
                UnitQuaternion::from_axis_angle(&Vector3::y_axis(), core::f64::consts::PI)
            });
            let turn = Isometry3::from_parts(Vector3::zeros().into(), turn);
            let mut joint = GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
                .local_frame1(pose(&(body.origin * turn)))
                .local_frame2(pose(&turn))
                .contacts_enabled(false);
            let stops = body.stops.map(|stops| stops.map(narrow));
            if let Some(stops) = stops {
                joint = joint.limits(JointAxis::AngX, stops);
            }
            if let Some(joint) = physics.multibody_joints.insert(parent, handle, joint, true) {
                let (axis, before) = (vector(&body.axis), body.parent);
                let inertial = Inertial::new(body, factors);
                joints.push(Joint { handle: joint, body: handle, parent, before, axis, stops, inertial });
            }
        }
        let gravity = vector(&Vector3::from(gravity));
        let (tips, grasp, environment) = (Vec::new(), None, Environment::default());
        let link_pushes = Vec::new();
        let mut world = Self {
            physics,
            joints,
            links: None,
            linkages: Vec::new(),
            tips,
            grasp,
            fixtures: None,
            environment,
            link_pushes,
            gravity,
            step,
            steps: 0,
        };
        world.set_posture(posture);
        world.set_values(values, step);
        // Otherwise, in the first step, rapier would use the mass properties with which a body was built.
        for joint in &world.joints {
            if let Some(body) = world.physics.bodies.get_mut(joint.body) {
                body.recompute_mass_properties_from_colliders(&world.physics.colliders);
            }
        }
        let links = world.joints.iter().map(|joint| joint.body);
        world.links = Links::new(&world.physics.multibody_joints, &world.physics.bodies, links);
        world
    }

    /// Lets rapier move the links of a robot without an object, as if they could touch fixed bodies.
    pub fn leave_to_rapier(&mut self) {
        self.links = None;
    }

    /// Sets the joints that follow others.
    pub fn insert_linkages(&mut self, linkages: Vec<Linkage>) {
        self.linkages = linkages;
    }

    /// Computes the torques of the linkages: joint and torque [N·m].
    fn linkage_torques(&self) -> Vec<(usize, f64)> {
        if self.linkages.is_empty() {
            return Vec::new();
        }
        let motion: Vec<(f64, f64)> = self.positions().zip(self.velocities()).collect();
        let mut torques = Vec::new();
        for linkage in &self.linkages {
            let Linkage { follower, driver, multiplier, .. } = *linkage;
            let torque = linkage.torque(motion[driver], motion[follower]);
            torques.extend([(follower, torque), (driver, -multiplier * torque)]);
        }
        torques
    }

    /// Sets the tips of the bodies, and puts an object among them, if there is one.
    pub fn insert_object(&mut self, tips: Vec<Tip>, object: Option<(&ObjectValues, f64)>) {
        self.environment = Environment::new(tips.len());
        self.tips = tips;
        let Some((values, friction)) = object else { return };
        self.tips.retain(|tip| tip.body < self.joints.len());
        self.grasp = Some(Grasp::new(values, friction, &self.tips));
    }

    /// Puts fixed bodies around the robot, for contact with the collision elements of its links.
    pub fn insert_fixtures(&mut self, fixtures: &[Fixture], elements: Vec<Element>) {
        self.leave_to_rapier();
        fixture::set_parameters(&mut self.physics.integration_parameters);
        self.physics.narrow_phase = NarrowPhase::with_query_dispatcher(CheckedContacts);
        let with_body = |element: Element| Some((self.joints.get(element.body)?.body, element));
        let elements = elements.into_iter().filter_map(with_body).collect();
        self.fixtures = Some(Fixtures::new(&mut self.physics, fixtures, elements));
    }

    /// Moves the joints, which are at 0, to `posture`.
    fn set_posture(&mut self, posture: &[f64]) {
        for (joint, angle) in self.joints.iter().zip(posture) {
            if let Some((chain, link)) = self.physics.multibody_joints.get_mut(joint.handle) {
                // Once the root is marked as fixed, degrees of freedom count from the first joint.
                chain.forward_kinematics(&self.physics.bodies, true);
                let mut displacements = vec![0.0; chain.ndofs()];
                if let Some(displacement) = first_dof(chain, link).and_then(|dof| displacements.get_mut(dof))
                {
                    *displacement = narrow(*angle);
                }
                chain.apply_displacements(&displacements);
                chain.forward_kinematics(&self.physics.bodies, false);
                chain.update_rigid_bodies(&mut self.physics.bodies, true);
            }
        }
    }

    fn set_values(&mut self, values: &[JointValues], step: f64) {
        for (joint, values) in self.joints.iter_mut().zip(values) {
            let Some((chain, link)) = self.physics.multibody_joints.get_mut(joint.handle) else { continue };
            let Some(dof) = first_dof(chain, link) else { continue };
            joint.inertial.rotor = values.rotor_inertia;
            chain.damping_mut()[dof] = narrow(values.viscous);
            // Rapier computes damping from the velocity at the end of the kick; this makes it the mean of
            // both ends.
            chain.armature_mut()[dof] = narrow(values.rotor_inertia - 0.5 * values.viscous * step);
            chain.frictions_mut()[dof] = narrow(values.coulomb);
        }
    }

    /// Coulomb friction of the joints [N·m].
    pub fn coulomb_frictions(&self) -> impl Iterator<Item = f64> {
        self.joints
            .iter()
            .map(|joint| {
                let (chain, link) = self.physics.multibody_joints.get(joint.handle)?;
                chain.frictions().get(first_dof(chain, link)?).copied()
            })
            .map(|friction| friction.map_or(0.0, f64::from))
    }

    /// Advances by one sub-step under the given motor torques [N·m].
    pub fn step(&mut self, torques: impl Iterator<Item = f64>) {
        let of_linkages = self.linkage_torques();
        self.release();
        for (joint, torque) in torques.enumerate().chain(of_linkages) {
            self.add_joint_torque(joint, torque);
        }
        // From rest, half a sub-step leads to the middle of the first one. (The mean torques already account
        // for that.)
        let fraction = if self.steps > 0 { 1.0 } else { 0.5 };
        self.physics.gravity = self.gravity * narrow(fraction);
        let time = self.time();
        self.act_on_tips(time, fraction);
        self.act_on_links(time, fraction);
        self.steps += 1;
        match (&mut self.links, &mut self.grasp) {
            (Some(links), Some(grasp)) => {
                let gravity = wide(self.gravity) * fraction;
                grasp.step((links, &self.tips), &gravity, (time, fraction), self.step);
            }
            (Some(links), None) => links.step(self.physics.gravity, &self.physics.integration_parameters),
            (None, _) => {
                self.watch_stops();
                match &self.fixtures {
                    Some(fixtures) => {
                        self.physics.step_with_events(&fixtures.creep(&self.physics, self.step), &());
                    }
                    None => self.physics.step(),
                }
                if let Some(fixtures) = &mut self.fixtures {
                    fixtures.read(&self.physics, self.step);
                }
            }
        }
    }

    /// Clears the forces and torques of the last sub-step.
    fn release(&mut self) {
        if let Some(links) = &mut self.links {
            return links.release();
        }
        for joint in &self.joints {
            if let Some(body) = self.physics.bodies.get_mut(joint.body) {
                body.reset_torques(false);
                body.reset_forces(false);
            }
        }
    }

    /// Adds a torque between the bodies before and behind a joint [N·m].
    fn add_joint_torque(&mut self, index: usize, torque: f64) {
        let (Some(joint), Some(pose)) = (self.joints.get(index), self.pose(index)) else { return };
        let torque = pose.rotation * joint.axis * narrow(torque);
        if let Some(links) = &mut self.links {
            return links.add_joint_torque(index, torque);
        }
        let (behind, before) = (joint.body, joint.parent);
        for (body, torque) in [(behind, torque), (before, -torque)] {
            if let Some(body) = self.physics.bodies.get_mut(body) {
                body.add_torque(torque, true);
            }
        }
    }

    /// Adds a force on a point of the body behind a joint [N], and a torque [N·m], in the frame of the base.
    fn add_wrench(&mut self, index: usize, force: (Vector, Vector), torque: Vector) {
        if let Some(links) = &mut self.links {
            return links.add_wrench(index, force, torque);
        }
        let body = self.joints.get(index).and_then(|joint| self.physics.bodies.get_mut(joint.body));
        if let Some(body) = body {
            body.add_force_at_point(force.0, force.1, true);
            body.add_torque(torque, true);
        }
    }

    /// Makes the physics check only the stops of joints that have passed them.
    fn watch_stops(&mut self) {
        for joint in &self.joints {
            let Some([lower, upper]) = joint.stops else { continue };
            let Some((chain, link)) = self.physics.multibody_joints.get_mut(joint.handle) else { continue };
            let Some(link) = chain.link_mut(link) else { continue };
            let angle = link.joint.coords()[3];
            link.joint.data.limit_axes.set(JointAxesMask::ANG_X, angle < lower || upper < angle);
        }
    }

    fn act_on_tips(&mut self, time: f64, fraction: f64) {
        if !std::mem::take(&mut self.environment.active) {
            return;
        }
        for index in 0..self.tips.len() {
            let (Some(frame), Some(tip)) = (self.tip_frame(index), self.tips.get(index)) else { continue };
            let origin = frame.translation.vector;
            let motion = self.motion_at(tip.body, &origin);
            let (body, wrench) =
                (tip.body, self.environment.act(index, tip, (&frame, motion), time, fraction));
            self.environment.active |= wrench.is_some();
            if let Some(wrench) = wrench {
                let force = (vector(&wrench.force), vector(&origin));
                self.add_wrench(body, force, vector(&wrench.torque));
            }
        }
    }

    fn act_on_links(&mut self, time: f64, fraction: f64) {
        self.link_pushes.retain(|(_, begin, push)| !push.is_over(time - begin));
        for index in 0..self.link_pushes.len() {
            let (joint, begin, push) = self.link_pushes[index];
            let Some(pose) = self.pose(joint) else { continue };
            let force = Vector3::from(push.force) * (push.fraction(time - begin) * fraction);
            let point = pose * vector(&Vector3::from(push.point));
            self.add_wrench(joint, (vector(&force), point), Vector::ZERO);
        }
    }

    /// The present pushes on links: body, point and force in the frame of the base [m, N].
    pub(super) fn link_forces(&self) -> impl Iterator<Item = (usize, Vector3<f64>, Vector3<f64>)> {
        let time = self.time();
        self.link_pushes.iter().filter_map(move |(joint, begin, push)| {
            let point = self.body(*joint)? * Point3::from(Vector3::from(push.point));
            Some((*joint, point.coords, Vector3::from(push.force) * push.fraction(time - begin)))
        })
    }

    /// Begins a push on the body behind a joint.
    pub fn push_link(&mut self, joint: usize, push: Push) {
        let time = self.time();
        self.link_pushes.push((joint, time, push));
    }

    /// Removes the object.
    pub fn remove_object(&mut self) {
        if let Some(grasp) = &mut self.grasp {
            grasp.remove();
        }
    }

    /// Mass distribution of each body, with the joint before its own.
    pub(super) fn inertials(&self) -> impl Iterator<Item = (&Inertial, Option<usize>)> {
        self.joints.iter().map(|joint| (&joint.inertial, joint.before))
    }

    /// Acceleration of gravity in the frame of the base [m/s²].
    pub fn gravity(&self) -> Vector3<f64> {
        wide(self.gravity)
    }

    /// The object and its contacts.
    pub const fn grasp(&self) -> Option<&Grasp> {
        self.grasp.as_ref()
    }

    /// The fixed bodies and their contacts.
    pub const fn fixtures(&self) -> Option<&Fixtures> {
        self.fixtures.as_ref()
    }

    /// The tips, in the order of their bodies.
    pub fn tips(&self) -> &[Tip] {
        &self.tips
    }

    /// External forces on the tips, except those of the object.
    pub const fn environment(&self) -> &Environment {
        &self.environment
    }

    /// External forces on the tips, except those of the object.
    pub const fn environment_mut(&mut self) -> &mut Environment {
        &mut self.environment
    }

    /// Begins a control period: restarts the means of the contact forces.
    pub fn begin_period(&mut self) {
        self.environment.begin_means();
        if let Some(grasp) = &mut self.grasp {
            grasp.begin_means();
        }
        if let Some(fixtures) = &mut self.fixtures {
            fixtures.begin_means();
        }
    }

    /// Disturbances of the object.
    pub fn disturbances(&mut self) -> Option<&mut Disturbances> {
        self.grasp.as_mut().map(|grasp| &mut grasp.disturbances)
    }

    /// Removes the support of the object.
    pub fn remove_support(&mut self) {
        if let Some(grasp) = &mut self.grasp {
            grasp.remove_support();
        }
    }

    /// Simulated time [s].
    #[expect(clippy::cast_precision_loss, reason = "exact for thousands of years")]
    pub fn time(&self) -> f64 {
        self.steps as f64 * self.step
    }
}

/// Index of a link's degree of freedom in its multibody: links are in order, and the root has none.
pub(super) fn first_dof(chain: &rapier3d::dynamics::Multibody, link: usize) -> Option<usize> {
    let dof = link.checked_sub(1)?;
    (dof < chain.ndofs()).then_some(dof)
}

fn mass(body: &Body, factors: &JointFactors) -> MassProperties {
    mass_properties(body.mass * factors.mass, &body.center_of_mass, body.inertia * factors.inertia)
}
