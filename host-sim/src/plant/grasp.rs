//! An object in the physics: its colliders, what touches it, and how hard.

use rapier3d::dynamics::{CoefficientCombineRule, IntegrationParameters, RigidBodyBuilder, RigidBodyHandle};
use rapier3d::dynamics::{FrictionModel, SpringCoefficients};
use rapier3d::geometry::{
    Collider, ColliderBuilder, ColliderHandle, ContactPair, Group, InteractionGroups, InteractionTestMode,
};
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d::pipeline::{ActiveHooks, PhysicsWorld};

use super::object::{ObjectValues, Shape};
use super::push::Disturbances;
use super::stick::Creep;
use super::tips::Tip;
use super::world::{narrow, pose, wide};

/// Sweeps over the constraints in a sub-step: more than a free hand needs, since what squeezes an object is coupled
/// through it.
const SWEEPS: usize = 16;
/// A contact slides when its friction is at least this share of what it can be.
const SLIDING: f64 = 0.999;
/// Spring of a contact, on the masses that it parts: natural frequency [Hz] and damping ratio.
const SOFTNESS: (f32, f32) = (1000.0, 1.0);

/// Motion of a point of a body in the frame of the base, half a sub-step ago: velocities of the point [m/s] and of the
/// body [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    pub linear: Vector3<f64>,
    pub angular: Vector3<f64>,
}

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

/// A fingertip and its contact with the object, as of the last sub-step.
#[derive(Clone, Debug)]
pub struct Touch {
    collider: ColliderHandle,
    /// On the object, in the frame of the base [N].
    pub force: Vector3<f64>,
    /// Where it acts, in the frame of the base [m]; the middle of the tip without contact.
    pub point: Vector3<f64>,
    /// Out of the object, in the frame of the base; 0 without contact.
    pub normal: Vector3<f64>,
    /// How deep the tip is in the object [m].
    pub depth: f64,
    /// Of the tip along the object's surface, in the frame of the object [m/s].
    pub slip_velocity: Vector3<f64>,
    /// Its integral while the tip touched [m].
    pub slip: Vector3<f64>,
    /// Integral of its size while the contact slid [m].
    pub slip_path: f64,
    /// `slip` when the contact last slid: all since then is creep.
    stuck_at: Vector3<f64>,
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
    // Of faces; a tip's point always has Coulomb's. With the other model each corner of a face that slides pulls at an
    // angle, and all together too little.
    parameters.friction_model = FrictionModel::Simplified;
    parameters.friction_in_bias_pass = true;
    parameters.num_internal_pgs_iterations = SWEEPS;
}

impl Grasp {
    /// Puts the object, its support and a sphere for each tip into the physics. `links` are the bodies of the tips.
    pub fn new(
        physics: &mut PhysicsWorld,
        values: &ObjectValues,
        friction: f64,
        tips: &[Tip],
        links: &[RigidBodyHandle],
    ) -> Self {
        let place = isometry(values.position, values.orientation);
        let object = physics.insert_body(RigidBodyBuilder::dynamic().pose(pose(&place)).can_sleep(false));
        let body = solid(values).mass(narrow(values.mass)).collision_groups(groups(true));
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
        Self {
            object,
            collider,
            support,
            stuck_at: place,
            touches,
            friction,
            disturbances: Disturbances::default(),
        }
    }

    /// Lets pushes and weights act in the sub-step around `time`, with a share of each force.
    pub fn disturb(&mut self, physics: &mut PhysicsWorld, time: f64, share: f64) {
        if let Some(body) = physics.bodies.get_mut(self.object) {
            self.disturbances.act(body, &physics.colliders, time, share);
        }
    }

    pub fn remove_support(&mut self, physics: &mut PhysicsWorld) {
        if let Some(support) = self.support.take() {
            physics.remove_collider(support);
        }
    }

    /// Reads the contacts of the last sub-step. `tips` are the middles of the tips and their motions, `step` in seconds.
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
            let slip = tip.linear + tip.angular.cross(&(point - center)) - object.linear;
            let slip = turn.inverse() * (slip - contact.normal * contact.normal.dot(&slip));
            if let Some(touch) = self.touches.get_mut(index) {
                touch.update(&contact, point, slip, step, contact.slides(self.friction));
            }
        }
        if self.support_contact(physics, step).is_none_or(|contact| contact.slides(self.friction)) {
            self.stuck_at = self.pose(physics);
        }
    }

    /// What the contacts have crept since they last slid.
    pub fn creep(&self, physics: &PhysicsWorld, step: f64) -> Creep {
        let pose = self.pose(physics);
        let tip = |touch: &Touch| (touch.collider, pose.rotation * (touch.slip - touch.stuck_at));
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

impl Touch {
    fn new(collider: ColliderHandle) -> Self {
        let zero = Vector3::zeros();
        Self {
            collider,
            force: zero,
            point: zero,
            normal: zero,
            depth: 0.0,
            slip_velocity: zero,
            slip: zero,
            slip_path: 0.0,
            stuck_at: zero,
        }
    }

    fn update(
        &mut self,
        contact: &Contact,
        point: Vector3<f64>,
        slip: Vector3<f64>,
        step: f64,
        slides: bool,
    ) {
        let touches = contact.force != Vector3::zeros();
        self.force = contact.force;
        self.point = point;
        self.normal = contact.normal;
        self.depth = contact.depth;
        self.slip_velocity = if touches { slip } else { Vector3::zeros() };
        self.slip += self.slip_velocity * step;
        if slides {
            self.slip_path += self.slip_velocity.norm() * step;
            self.stuck_at = self.slip;
        }
    }
}

/// What one collider does to another.
#[derive(Default)]
struct Contact {
    force: Vector3<f64>,
    normal: Vector3<f64>,
    depth: f64,
}

impl Contact {
    /// Whether it slides, or parts.
    fn slides(&self, friction: f64) -> bool {
        let normal = self.force.dot(&self.normal);
        (self.force - self.normal * normal).norm() >= SLIDING * friction * normal.abs()
    }
}

/// The forces of a pair on `object` in the last sub-step, which had one solver iteration.
fn contact(pair: &ContactPair, object: ColliderHandle, step: f64) -> Contact {
    let side = if pair.collider1 == object { 1.0 } else { -1.0 };
    let mut contact = Contact::default();
    for manifold in pair.manifolds() {
        let normal = wide(manifold.data.normal);
        let touching = || manifold.points.iter().filter(|point| point.data.impulse > 0.0);
        let Some(first) = touching().next() else { continue };
        // A face rubs as a whole, and each of its points is told the whole friction.
        let friction = wide(first.data.warmstart_tangent_world);
        let push = touching().map(|point| f64::from(point.data.impulse)).sum::<f64>();
        contact.force += (friction - normal * push) * (side / step);
        contact.normal = normal * side;
        contact.depth = touching().fold(contact.depth, |depth, point| depth.max(-f64::from(point.dist)));
    }
    contact
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
