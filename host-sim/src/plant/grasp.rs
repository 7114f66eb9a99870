//! The grasped object, and the sub-steps of a hand that may touch it.

use rapier3d::geometry::ColliderBuilder;
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Point3, Translation3, Vector3};

use super::constraints::Constraints;
use super::contact::{self, Pair, TipContact, Touch};
use super::convert::{isometry, isometry_of, narrow, vector};
use super::end_effector::Tip;
use super::links::Links;
use super::motion::Motion;
use super::push::Disturbances;
use super::rigid_body::FreeBody;
use super::shapes::{Solid, cuboid, cylinder, placed};
use tesaki_description::object::{ObjectValues, Shape};

/// Distance to which a removed object is moved [m].
const AWAY: f64 = 100.0;

/// An object among the fingertips.
pub struct Grasp {
    body: FreeBody,
    solid: Solid,
    /// The support, and the balls of the tips, each with its contacts.
    support: Option<(Solid, Pair)>,
    balls: Vec<(Solid, Pair)>,
    tip_contacts: Vec<TipContact>,
    /// Coefficient of friction of every contact of the object.
    pub friction: f64,
    pub disturbances: Disturbances,
    /// Force of the support on the object in the last sub-step, in the frame of the base [N].
    pub support_force: Vector3<f64>,
    constraints: Constraints,
    is_removed: bool,
}

impl Grasp {
    /// Puts the object on its support, among the tips.
    pub fn new(values: &ObjectValues, friction: f64, tips: &[Tip]) -> Self {
        let disturbances = Disturbances::new(values);
        let place = isometry(values.position, values.orientation);
        let support = values.support.map(|support| {
            let place = isometry(support.position, support.orientation);
            (placed(cuboid(support.size), &place).into(), Pair::default())
        });
        let ball = |tip: &Tip| (ColliderBuilder::ball(narrow(tip.radius)).into(), Pair::default());
        Self {
            body: FreeBody::new(place, disturbances.mass_distribution(0.0)),
            solid: solid(values).into(),
            support,
            balls: tips.iter().map(ball).collect(),
            tip_contacts: tips.iter().map(|_| TipContact::default()).collect(),
            friction,
            disturbances,
            support_force: Vector3::zeros(),
            constraints: Constraints::default(),
            is_removed: false,
        }
    }

    /// Advances links and object by the sub-step of `step` seconds around `time`. Disturbances are scaled by
    /// `fraction`, as `gravity` is already.
    pub fn step(
        &mut self,
        (links, tips): (&mut Links, &[Tip]),
        gravity: &Vector3<f64>,
        (time, fraction): (f64, f64),
        step: f64,
    ) {
        let mut touches = Vec::new();
        if !self.is_removed {
            self.disturbances.act(&mut self.body, time, fraction);
            self.body.accelerate(gravity, step);
            touches = self.find_touches(links, tips);
        }
        links.accelerate(vector(gravity), narrow(step));
        contact::constrain(&mut self.constraints, links, Some(&mut self.body), &mut touches, step);
        links.advance(narrow(step));
        self.body.advance(step);
        self.read((links, tips), &touches, step);
    }

    /// Finds the points where the object touches the tips, in their order, then those on the support.
    fn find_touches(&mut self, links: &Links, tips: &[Tip]) -> Vec<Touch> {
        let object = (&self.solid, self.body.pose * self.solid.place);
        let mut touches = Vec::new();
        for (index, ((ball, pair), tip)) in self.balls.iter_mut().zip(tips).enumerate() {
            let center = Translation3::from(center(links, tip));
            touches.extend(pair.find(object, (ball, center.into()), (index, Some(tip.body), self.friction)));
        }
        if let Some((support, pair)) = &mut self.support {
            let index = self.balls.len();
            touches.extend(pair.find(object, (support, support.place), (index, None, self.friction)));
        }
        touches
    }

    /// Reads the contacts after the sub-step.
    fn read(&mut self, (links, tips): (&Links, &[Tip]), touches: &[Touch], step: f64) {
        let of = |pair: usize| touches.iter().filter(move |touch| touch.pair == pair);
        for (index, contact) in self.tip_contacts.iter_mut().enumerate() {
            let (_, pair) = &mut self.balls[index];
            pair.keep(of(index));
            let ball = (center(links, &tips[index]), tips[index].radius);
            contact.update(of(index).next(), ball, &self.body.pose.rotation, (self.friction, step));
        }
        let support = self.balls.len();
        self.support_force = of(support).map(|touch| touch.impulse).sum::<Vector3<f64>>() / step;
        if let Some((_, pair)) = &mut self.support {
            pair.keep(of(support));
        }
    }

    /// Moves the object far away, where it rests.
    pub fn remove(&mut self) {
        self.is_removed = true;
        self.body.pose.translation = Translation3::new(0.0, 0.0, -AWAY);
        (self.body.linear, self.body.angular) = (Vector3::zeros(), Vector3::zeros());
    }

    pub fn remove_support(&mut self) {
        self.support = None;
    }

    /// Pose of the object, in the base frame.
    pub const fn pose(&self) -> &Isometry3<f64> {
        &self.body.pose
    }

    /// Motion of the object at a point, both in the base frame.
    pub fn motion_at(&self, point: &Vector3<f64>) -> Motion {
        self.body.motion_at(point)
    }

    /// Begins a new averaging interval of the forces.
    pub fn begin_means(&mut self) {
        self.tip_contacts.iter_mut().for_each(TipContact::begin_mean);
    }

    /// The contact of each tip.
    pub fn tip_contacts(&self) -> &[TipContact] {
        &self.tip_contacts
    }
}

/// Centre of a tip's ball, in the frame of the base.
fn center(links: &Links, tip: &Tip) -> Vector3<f64> {
    (isometry_of(links.pose(tip.body)) * tip.frame * Point3::from(tip.center)).coords
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
