//! The physics: the links, and all that acts on them.

use rapier3d::math::Vector;
use rapier3d::na::{Point3, Vector3};

use super::assembly::{Assembly, JointValues, Parts};
use super::convert::{narrow, vector, wide};
use super::end_effector::Tip;
use super::energy::Inertial;
use super::environment::Environment;
use super::factors::JointFactors;
use super::fixture::{Element, Fixture, Fixtures};
use super::grasp::Grasp;
use super::linkage::Linkage;
use super::links::Links;
use super::push::{Disturbances, Push};
use super::tree::Body;
use tesaki_description::object::ObjectValues;

/// Moving bodies and their joints.
pub struct World {
    pub(super) joints: Vec<Joint>,
    pub(super) links: Links,
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
    /// Index of the joint before it.
    pub(super) before: Option<usize>,
    /// Axis in the frame of the body.
    pub(super) axis: Vector,
    inertial: Inertial,
}

impl World {
    pub fn new(gravity: [f64; 3], step: f64, parts: &Parts<'_>) -> Self {
        let joint = |((body, factors), values): ((&Body, &JointFactors), &JointValues)| Joint {
            before: body.parent,
            axis: vector(&body.axis),
            inertial: Inertial::new(body, factors, values.rotor_inertia),
        };
        Self {
            joints: parts.bodies.iter().zip(parts.factors).zip(parts.values).map(joint).collect(),
            links: Links::new(&Assembly::new(step, parts)),
            linkages: Vec::new(),
            tips: Vec::new(),
            grasp: None,
            fixtures: None,
            environment: Environment::default(),
            link_pushes: Vec::new(),
            gravity: vector(&Vector3::from(gravity)),
            step,
            steps: 0,
        }
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
        self.grasp = Some(Grasp::new(values, friction, &self.tips));
    }

    /// Puts fixed bodies around the robot, for contact with the collision elements of its links.
    pub fn insert_fixtures(&mut self, fixtures: &[Fixture], elements: Vec<Element>) {
        self.fixtures = Some(Fixtures::new(fixtures, elements));
    }

    /// Coulomb friction of the joints [N·m].
    pub fn coulomb_frictions(&self) -> impl Iterator<Item = f64> {
        (0..self.joints.len()).map(|joint| f64::from(self.links.friction(joint)))
    }

    /// Advances by one sub-step under the given motor torques [N·m].
    pub fn step(&mut self, torques: impl Iterator<Item = f64>) {
        let of_linkages = self.linkage_torques();
        self.links.release();
        for (joint, torque) in torques.enumerate().chain(of_linkages) {
            self.add_joint_torque(joint, torque);
        }
        // From rest, half a sub-step leads to the middle of the first one. (The mean torques already account
        // for that.)
        let fraction = if self.steps > 0 { 1.0 } else { 0.5 };
        let gravity = self.gravity * narrow(fraction);
        let time = self.time();
        self.act_on_tips(time, fraction);
        self.act_on_links(time, fraction);
        self.steps += 1;
        let links = &mut self.links;
        if let Some(grasp) = &mut self.grasp {
            let gravity = wide(self.gravity) * fraction;
            grasp.step((links, &self.tips), &gravity, (time, fraction), self.step);
        } else if let Some(fixtures) = &mut self.fixtures {
            fixtures.step(links, gravity, self.step);
        } else {
            links.step(gravity, narrow(self.step));
        }
    }

    /// Adds a torque between the bodies before and behind a joint [N·m].
    fn add_joint_torque(&mut self, index: usize, torque: f64) {
        let axis = self.links.pose(index).rotation * self.joints[index].axis;
        self.links.add_joint_torque(index, axis * narrow(torque));
    }

    fn act_on_tips(&mut self, time: f64, fraction: f64) {
        if !std::mem::take(&mut self.environment.active) {
            return;
        }
        for index in 0..self.tips.len() {
            let tip = &self.tips[index];
            let frame = self.body(tip.body) * tip.frame;
            let origin = frame.translation.vector;
            let motion = self.motion_at(tip.body, &origin);
            let (body, wrench) =
                (tip.body, self.environment.act(index, tip, (&frame, motion), time, fraction));
            self.environment.active |= wrench.is_some();
            if let Some(wrench) = wrench {
                let force = (vector(&wrench.force), vector(&origin));
                self.links.add_wrench(body, force, vector(&wrench.torque));
            }
        }
    }

    fn act_on_links(&mut self, time: f64, fraction: f64) {
        self.link_pushes.retain(|(_, begin, push)| !push.is_over(time - begin));
        for index in 0..self.link_pushes.len() {
            let (joint, begin, push) = self.link_pushes[index];
            let pose = self.links.pose(joint);
            let force = Vector3::from(push.force) * (push.fraction(time - begin) * fraction);
            let point = *pose * vector(&Vector3::from(push.point));
            self.links.add_wrench(joint, (vector(&force), point), Vector::ZERO);
        }
    }

    /// The present pushes on links: body, point and force in the frame of the base [m, N].
    pub(super) fn link_forces(&self) -> impl Iterator<Item = (usize, Vector3<f64>, Vector3<f64>)> {
        let time = self.time();
        self.link_pushes.iter().map(move |(joint, begin, push)| {
            let point = self.body(*joint) * Point3::from(Vector3::from(push.point));
            (*joint, point.coords, Vector3::from(push.force) * push.fraction(time - begin))
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

    /// Mass distribution of each body.
    pub(super) fn inertials(&self) -> impl Iterator<Item = &Inertial> {
        self.joints.iter().map(|joint| &joint.inertial)
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
