//! An object in the physics: its colliders, what touches it, and how hard.

use rapier3d::dynamics::{CoefficientCombineRule, IntegrationParameters, RigidBodyBuilder, RigidBodyHandle};
use rapier3d::dynamics::{FrictionModel, SpringCoefficients};
use rapier3d::geometry::{
    Collider, ColliderBuilder, ColliderHandle, Group, InteractionGroups, InteractionTestMode,
};
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d::pipeline::{ActiveHooks, PhysicsWorld};

use super::contact::{Contact, Touch, contact};
use super::convert::{narrow, pose, wide};
use super::end_effector::Tip;
use super::motion::Motion;
use super::object::{ObjectValues, Shape};
use super::push::Disturbances;
use super::stiction::Creep;

/// Sweeps over the constraints in a sub-step: many more than a free hand needs, since what squeezes an object
/// is coupled through it. With 16, joints that should stick creep, and friction of 0.08 N·m takes nothing of
/// a finger's 2 N at rest; from 256 on it takes as much as with 1000 (2.02, 1.91, 0.77 and 0.77 N of normal
/// force with 16, 64, 256 and 1000).
const SWEEPS: usize = 256;
/// Spring of a contact, on the masses that it parts: natural frequency [Hz] and damping ratio.
const SOFTNESS: (f32, f32) = (1000.0, 1.0);

/// An object among the fingertips.
pub struct Grasp {
    object: RigidBodyHandle,
    collider: ColliderHandle,
    support: Option<ColliderHandle>,
    /// Where the object last slid on its support.
    stuck_at: Isometry3<f64>,
    touches: Vec<Touch>,
    /// Coefficient of friction of every contact of the object.
    pub friction: f64,
    pub disturbances: Disturbances,
}

/// What contacts at the scale of grams and centimetres need of rapier.
pub fn set_parameters(parameters: &mut IntegrationParameters) {
    let (natural_frequency, damping_ratio) = SOFTNESS;
    let softness = SpringCoefficients { natural_frequency, damping_ratio };
    parameters.length_unit = 0.01;
    parameters.normalized_max_corrective_velocity = 300.0;
    parameters.contact_recycling = false;
    parameters.contact_softness = softness;
    parameters.static_contact_softness = softness;
    // Of faces; a tip's point always has Coulomb's. With the other model each corner of a face that slides
    // pulls at an angle, and all together too little.
    parameters.friction_model = FrictionModel::Simplified;
    parameters.friction_in_bias_pass = true;
    parameters.num_internal_pgs_iterations = SWEEPS;
}

impl Grasp {
    /// Puts the object, its support and a sphere for each tip into the physics. `links` are the bodies of the
    /// tips.
    pub fn new(
        physics: &mut PhysicsWorld,
        values: &ObjectValues,
        friction: f64,
        tips: &[Tip],
        links: &[RigidBodyHandle],
    ) -> Self {
        let place = isometry(values.position, values.orientation);
        let disturbances = Disturbances::new(values);
        // Not of rapier's own making: its principal axes of a convex hull can be wrong.
        let mass = disturbances.mass_properties(0.0);
        let body = RigidBodyBuilder::dynamic().pose(pose(&place)).additional_mass_properties(mass);
        let object = physics.insert_body(body.can_sleep(false));
        let body = solid(values).density(0.0).collision_groups(groups(true));
        let collider = physics.insert_collider(rubbing(body, friction), Some(object));
        let support = values.support.map(|support| {
            let place = isometry(support.position, support.orientation);
            let [x, y, z] = support.size.map(|extent| narrow(extent / 2.0));
            let block = ColliderBuilder::cuboid(x, y, z).position(pose(&place));
            physics.insert_collider(rubbing(block.collision_groups(groups(false)), friction), None)
        });
        let mut touches = Vec::new();
        for (tip, &link) in tips.iter().zip(links) {
            let center = tip.frame * Translation3::from(tip.center);
            let ball = ColliderBuilder::ball(narrow(tip.radius)).position(pose(&center)).density(0.0);
            let ball = rubbing(ball.collision_groups(groups(false)), friction);
            touches.push(Touch::new(physics.insert_collider(ball, Some(link))));
        }
        Self { object, collider, support, stuck_at: place, touches, friction, disturbances }
    }

    /// Lets pushes and weights act in the sub-step around `time`, with a share of each force.
    pub fn disturb(&mut self, physics: &mut PhysicsWorld, time: f64, fraction: f64) {
        if let Some(body) = physics.bodies.get_mut(self.object) {
            self.disturbances.act(body, &physics.colliders, time, fraction);
        }
    }

    pub fn remove_support(&mut self, physics: &mut PhysicsWorld) {
        if let Some(support) = self.support.take() {
            physics.remove_collider(support);
        }
    }

    /// Reads the contacts of the last sub-step. `tips` are the middles of the tips and their motions, `step`
    /// in seconds.
    pub fn read(&mut self, physics: &PhysicsWorld, tips: &[(f64, Vector3<f64>, Motion)], step: f64) {
        let turn = self.pose(physics).rotation;
        for index in 0..self.touches.len() {
            let (Some(touch), Some((radius, center, tip))) = (self.touches.get(index), tips.get(index))
            else {
                continue;
            };
            let pair = physics.contact_pair(touch.collider, self.collider);
            let contact = pair.map(|pair| contact(pair, self.collider, step)).unwrap_or_default();
            let point = center - contact.normal * *radius;
            let object = self.motion_at(physics, &point);
            let motion = tip.linear + tip.angular.cross(&(point - center)) - object.linear;
            if let Some(touch) = self.touches.get_mut(index) {
                touch.update(&contact, point, &motion, &turn, (self.friction, step));
            }
        }
        if self.support_contact(physics, step).is_none_or(|contact| contact.slides(self.friction)) {
            self.stuck_at = self.pose(physics);
        }
    }

    /// What the contacts have crept since they last slid, for rapier to take back.
    pub fn creep(&self, physics: &PhysicsWorld, step: f64) -> Creep {
        let pose = self.pose(physics);
        let tip = |touch: &Touch| (touch.collider, pose.rotation * touch.correction(step));
        Creep {
            tips: self.touches.iter().map(tip).collect(),
            support: self.support.map(|support| (support, pose * self.stuck_at.inverse())),
            step,
        }
    }

    /// Where the object is, in the frame of the base.
    pub fn pose(&self, physics: &PhysicsWorld) -> Isometry3<f64> {
        let Some(body) = physics.bodies.get(self.object) else { return Isometry3::identity() };
        isometry(body.translation().to_array().map(f64::from), body.rotation().to_array().map(f64::from))
    }

    /// Motion of the object at a point, both in the frame of the base.
    pub fn motion_at(&self, physics: &PhysicsWorld, point: &Vector3<f64>) -> Motion {
        let Some(body) = physics.bodies.get(self.object) else {
            return Motion { linear: Vector3::zeros(), angular: Vector3::zeros() };
        };
        let (linear, angular) = (wide(body.linvel()), wide(body.angvel()));
        let arm = point - wide(body.center_of_mass());
        Motion { linear: linear + angular.cross(&arm), angular }
    }

    /// Begins new means of the forces.
    pub fn begin_means(&mut self) {
        self.touches.iter_mut().for_each(Touch::begin_mean);
    }

    /// A tip each.
    pub fn touches(&self) -> &[Touch] {
        &self.touches
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
        Shape::Box => ColliderBuilder::cuboid(x, y, z),
        Shape::Cylinder => ColliderBuilder::cylinder(z, x).rotation(Vector::X * core::f32::consts::FRAC_PI_2),
        Shape::Wedge { top } => {
            let narrower = x * narrow(top);
            let corners = [(x, -z), (-x, -z), (narrower, z), (-narrower, z)];
            let corners = corners.map(|(x, z)| [Vector::new(x, y, z), Vector::new(x, -y, z)]);
            ColliderBuilder::convex_hull(corners.as_flattened()).unwrap_or(ColliderBuilder::cuboid(x, y, z))
        }
    }
}

/// Every pair rubs with the coefficient that all have.
fn rubbing(collider: ColliderBuilder, friction: f64) -> Collider {
    let collider = collider.friction(narrow(friction)).friction_combine_rule(CoefficientCombineRule::Max);
    collider.active_hooks(ActiveHooks::MODIFY_SOLVER_CONTACTS).build()
}

/// The object touches all others and these nothing else.
const fn groups(object: bool) -> InteractionGroups {
    let (own, other) =
        if object { (Group::GROUP_1, Group::GROUP_2) } else { (Group::GROUP_2, Group::GROUP_1) };
    InteractionGroups::new(own, other, InteractionTestMode::And)
}

/// From a position [m] and a quaternion `[x, y, z, w]`.
fn isometry([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Isometry3::from_parts(Translation3::new(x, y, z), turn)
}
