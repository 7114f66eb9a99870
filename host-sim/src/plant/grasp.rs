//! The grasped object in the physics engine: its colliders and contacts.

use rapier3d::dynamics::{FrictionModel, SpringCoefficients};
use rapier3d::dynamics::{IntegrationParameters, RigidBodyBuilder, RigidBodyHandle};
use rapier3d::geometry::{ColliderBuilder, ColliderHandle, Group, InteractionGroups, InteractionTestMode};
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Translation3, Vector3};
use rapier3d::pipeline::PhysicsWorld;

use super::contact::{Contact, TipContact, contact};
use super::convert::{isometry, narrow, pose, pose_of, wide};
use super::end_effector::Tip;
use super::motion::Motion;
use super::push::Disturbances;
use super::shapes::{cuboid, cylinder, with_friction};
use super::stiction::{Creep, Crept};
use tesaki_description::object::{ObjectValues, Shape};

/// Solver iterations over the constraints in a sub-step. A grasp needs many more than a free hand, because
/// the object couples the fingers. With 16, joints that should stick creep, and joint friction of 0.08 N·m
/// has no effect on a finger's 2 N at rest. The effect has converged at 256: the normal force is 2.02, 1.91,
/// 0.77 and 0.77 N with 16, 64, 256 and 1000 iterations.
const ITERATIONS: usize = 256;
/// How far from the robot a removed object is [m].
const AWAY: f32 = 100.0;
/// Natural frequency [Hz] and damping ratio of the contact spring with the effective mass.
const SOFTNESS: (f32, f32) = (1000.0, 1.0);

/// An object among the fingertips.
pub struct Grasp {
    object: RigidBodyHandle,
    collider: ColliderHandle,
    support: Option<ColliderHandle>,
    /// Pose of the object when it last slid on its support.
    stuck_at: Isometry3<f64>,
    tip_contacts: Vec<TipContact>,
    /// Coefficient of friction of every contact of the object.
    pub friction: f64,
    pub disturbances: Disturbances,
}

/// Sets rapier's parameters for contacts at the scale of grams and centimetres.
pub fn set_parameters(parameters: &mut IntegrationParameters) {
    let (natural_frequency, damping_ratio) = SOFTNESS;
    let softness = SpringCoefficients { natural_frequency, damping_ratio };
    parameters.length_unit = 0.01;
    parameters.normalized_max_corrective_velocity = 300.0;
    parameters.contact_recycling = false;
    parameters.contact_softness = softness;
    parameters.static_contact_softness = softness;
    // Concerns faces only; a point contact always has Coulomb friction. With the other model, the friction at
    // the corners of a sliding face has different directions, and the sum is too small.
    parameters.friction_model = FrictionModel::Simplified;
    parameters.friction_in_bias_pass = true;
    parameters.num_internal_pgs_iterations = ITERATIONS;
}

impl Grasp {
    /// Inserts the object, its support and a sphere for each tip into the physics engine. `links` are the
    /// bodies of the tips.
    pub fn new(
        physics: &mut PhysicsWorld,
        values: &ObjectValues,
        friction: f64,
        tips: &[Tip],
        links: &[RigidBodyHandle],
    ) -> Self {
        let place = isometry(values.position, values.orientation);
        let disturbances = Disturbances::new(values);
        // Rapier's own principal axes of a convex hull can be wrong.
        let mass = disturbances.mass_properties(0.0);
        let body = RigidBodyBuilder::dynamic().pose(pose(&place)).additional_mass_properties(mass);
        let object = physics.insert_body(body.can_sleep(false));
        let body = solid(values).density(0.0).collision_groups(groups(true));
        let collider = physics.insert_collider(with_friction(body, friction), Some(object));
        let support = values.support.map(|support| {
            let place = isometry(support.position, support.orientation);
            let block = cuboid(support.size).position(pose(&place));
            physics.insert_collider(with_friction(block.collision_groups(groups(false)), friction), None)
        });
        let mut tip_contacts = Vec::new();
        for (tip, &link) in tips.iter().zip(links) {
            let center = tip.frame * Translation3::from(tip.center);
            let ball = ColliderBuilder::ball(narrow(tip.radius)).position(pose(&center)).density(0.0);
            let ball = with_friction(ball.collision_groups(groups(false)), friction);
            tip_contacts.push(TipContact::new(physics.insert_collider(ball, Some(link))));
        }
        Self { object, collider, support, stuck_at: place, tip_contacts, friction, disturbances }
    }

    /// Applies a fraction of the forces of pushes and weights in the sub-step around `time`.
    pub fn disturb(&mut self, physics: &mut PhysicsWorld, time: f64, fraction: f64) {
        if let Some(body) = physics.bodies.get_mut(self.object) {
            self.disturbances.act(body, &physics.colliders, time, fraction);
        }
    }

    /// Moves the object far away, at rest.
    pub fn remove(&self, physics: &mut PhysicsWorld) {
        if let Some(body) = physics.bodies.get_mut(self.object) {
            body.set_translation(Vector::new(0.0, 0.0, -AWAY), true);
            body.set_linvel(Vector::ZERO, true);
            body.set_angvel(Vector::ZERO, true);
        }
    }

    pub fn remove_support(&mut self, physics: &mut PhysicsWorld) {
        if let Some(support) = self.support.take() {
            physics.remove_collider(support);
        }
    }

    /// Reads the contacts of the last sub-step of `step` seconds. `tips` are radius, centre and motion of
    /// each tip.
    pub fn read(&mut self, physics: &PhysicsWorld, tips: &[(f64, Vector3<f64>, Motion)], step: f64) {
        let turn = self.pose(physics).rotation;
        for index in 0..self.tip_contacts.len() {
            let (Some(touch), Some((radius, center, tip))) = (self.tip_contacts.get(index), tips.get(index))
            else {
                continue;
            };
            let pair = physics.contact_pair(touch.collider, self.collider);
            let contact = pair.map(|pair| contact(pair, self.collider, step)).unwrap_or_default();
            let point = center - contact.normal * *radius;
            let object = self.motion_at(physics, &point);
            let motion = tip.linear + tip.angular.cross(&(point - center)) - object.linear;
            if let Some(touch) = self.tip_contacts.get_mut(index) {
                touch.update(&contact, point, &motion, &turn, (self.friction, step));
            }
        }
        if self.support_contact(physics, step).is_none_or(|contact| contact.slides(self.friction)) {
            self.stuck_at = self.pose(physics);
        }
    }

    /// Creep of the contacts since they last slid, which rapier corrects.
    pub fn creep(&self, physics: &PhysicsWorld, step: f64) -> Creep {
        let pose = self.pose(physics);
        let tip = |touch: &TipContact| (touch.collider, pose.rotation * touch.correction(step));
        let crept = |fixed| Crept { fixed, moving: self.collider, motion: pose * self.stuck_at.inverse() };
        Creep {
            tips: self.tip_contacts.iter().map(tip).collect(),
            fixed: self.support.into_iter().map(crept).collect(),
            step,
        }
    }

    /// Pose of the object, in the base frame.
    pub fn pose(&self, physics: &PhysicsWorld) -> Isometry3<f64> {
        physics.bodies.get(self.object).map_or_else(Isometry3::identity, pose_of)
    }

    /// Motion of the object at a point, both in the base frame.
    pub fn motion_at(&self, physics: &PhysicsWorld, point: &Vector3<f64>) -> Motion {
        let Some(body) = physics.bodies.get(self.object) else {
            return Motion { linear: Vector3::zeros(), angular: Vector3::zeros() };
        };
        let (linear, angular) = (wide(body.linvel()), wide(body.angvel()));
        let lever = point - wide(body.center_of_mass());
        Motion { linear: linear + angular.cross(&lever), angular }
    }

    /// Begins a new averaging interval of the forces.
    pub fn begin_means(&mut self) {
        self.tip_contacts.iter_mut().for_each(TipContact::begin_mean);
    }

    /// The contact of each tip.
    pub fn tip_contacts(&self) -> &[TipContact] {
        &self.tip_contacts
    }

    /// Force of the support on the object in the last sub-step, in the frame of the base [N].
    pub fn support_force(&self, physics: &PhysicsWorld, step: f64) -> Vector3<f64> {
        self.support_contact(physics, step).map_or_else(Vector3::zeros, |contact| contact.force)
    }

    fn support_contact(&self, physics: &PhysicsWorld, step: f64) -> Option<Contact> {
        let pair = physics.contact_pair(self.support?, self.collider)?;
        Some(contact(pair, self.collider, step))
    }
}

fn solid(values: &ObjectValues) -> ColliderBuilder {
    let [x, y, z] = values.size.map(|extent| narrow(extent / 2.0));
    match values.shape {
        Shape::Box => cuboid(values.size),
        Shape::Cylinder => cylinder(values.size[0] / 2.0, values.size[2]),
        Shape::Wedge { top } => {
            let narrower = x * narrow(top);
            let corners = [(x, -z), (-x, -z), (narrower, z), (-narrower, z)];
            let corners = corners.map(|(x, z)| [Vector::new(x, y, z), Vector::new(x, -y, z)]);
            ColliderBuilder::convex_hull(corners.as_flattened()).unwrap_or(cuboid(values.size))
        }
    }
}

/// The object touches all other colliders; these touch only the object.
const fn groups(object: bool) -> InteractionGroups {
    let (own, other) =
        if object { (Group::GROUP_1, Group::GROUP_2) } else { (Group::GROUP_2, Group::GROUP_1) };
    InteractionGroups::new(own, other, InteractionTestMode::And)
}
