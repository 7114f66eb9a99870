//! What acts on the tips besides a grasped object: walls, somebody who holds a tip, pushes.
//!
//! Forces are computed from the state at the start of a sub-step, where the leapfrog has its angles: springs
//! are exact to second order. Velocities are half a sub-step old there, so dampers use their extrapolation.
//! Springs are stable up to `4 m / h²` and dampers up to `m / h`, with the sub-step `h` and the mass `m` that
//! the tip presents; at 1 ms and 0.5 kg that is 2 MN/m and 500 N·s/m.

use rapier3d::na::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use tesaki_supervisor::trajectory::minimum_jerk;

use super::end_effector::Tip;
use super::error::{PlantError, check};
use super::motion::Motion;
use super::push::Push;

/// A plane that tips cannot pass freely: a spring and a damper along its normal, and friction along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// A point of its surface, in the frame of the base [m].
    pub point: [f64; 3],
    /// Out of the wall, in the frame of the base; of any length.
    pub normal: [f64; 3],
    /// Of the spring, of normal and sticking friction alike [N/m].
    pub stiffness: f64,
    /// Of the damper, along normal and surface alike [N·s/m]. The wall never pulls.
    pub damping: f64,
    /// Coefficient of Coulomb friction; 0 for none.
    pub friction: f64,
}

impl Wall {
    pub(super) fn validate(&self) -> Result<(), PlantError> {
        check("wall.point", &self.point, f64::is_finite, "finite [m]")?;
        let length = Vector3::from(self.normal).norm();
        check(
            "the length of wall.normal",
            &[length],
            |length| length > 1e-6 && length.is_finite(),
            "above 0",
        )?;
        check("wall.stiffness", &[self.stiffness], |k| k > 0.0 && k <= 1e6, "above 0, at most 1e6 N/m")?;
        let rest = [("wall.damping", self.damping), ("wall.friction", self.friction)];
        rest.iter().try_for_each(|(field, value)| check(field, &[*value], not_negative, "at least 0"))
    }

    /// Force on a point with a velocity, and how deep the point is; `anchor` is where it sticks.
    fn force(
        &self,
        point: &Vector3<f64>,
        velocity: &Vector3<f64>,
        anchor: &mut Option<Vector3<f64>>,
    ) -> (Vector3<f64>, f64) {
        let normal = Vector3::from(self.normal).normalize();
        let depth = (Vector3::from(self.point) - point).dot(&normal);
        if depth <= 0.0 {
            *anchor = None;
            return (Vector3::zeros(), 0.0);
        }
        let speed = velocity.dot(&normal);
        let push = (self.stiffness * depth - self.damping * speed).max(0.0);
        let along = |vector: Vector3<f64>| vector - normal * normal.dot(&vector);
        let stuck = anchor.get_or_insert(*point);
        let wanted = -along(point - *stuck) * self.stiffness - along(*velocity) * self.damping;
        let rub = wanted.cap_magnitude(self.friction * push);
        if rub != wanted {
            // It slides: from here on the spring is as long as friction lets it be.
            *stuck = point + (rub + along(*velocity) * self.damping) / self.stiffness;
        }
        (normal * push + rub, depth)
    }
}

/// Somebody takes a tip, leads it to a place within a time, and holds it there: springs and dampers between
/// the tip's frame and a frame that moves with minimum jerk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// Where the tip's frame is led, in the frame of the base [m].
    pub position: [f64; 3],
    /// How it is turned there: a unit quaternion `[x, y, z, w]`.
    pub orientation: [f64; 4],
    /// Time of the way [s].
    pub ramp: f64,
    /// Against shifts [N/m].
    pub stiffness: f64,
    /// Against velocities [N·s/m].
    pub damping: f64,
    /// Against turns [N·m/rad]; 0 leaves the tip free to turn.
    pub turn_stiffness: f64,
    /// Against angular velocities [N·m·s/rad].
    pub turn_damping: f64,
}

impl Hold {
    /// A firm grip on a hand of half a kilogram: 20 kN/m and 100 N·m/rad.
    pub const fn firm(position: [f64; 3], orientation: [f64; 4], ramp: f64) -> Self {
        let (stiffness, damping) = (20_000.0, 150.0);
        let (turn_stiffness, turn_damping) = (100.0, 1.0);
        Self { position, orientation, ramp, stiffness, damping, turn_stiffness, turn_damping }
    }

    /// The same without a hold on how the hand is turned.
    #[must_use]
    pub const fn turning_freely(mut self) -> Self {
        (self.turn_stiffness, self.turn_damping) = (0.0, 0.0);
        self
    }

    pub(super) fn validate(&self) -> Result<(), PlantError> {
        check("hold.position", &self.position, f64::is_finite, "finite [m]")?;
        let norm = self.orientation.iter().map(|part| part * part).sum::<f64>();
        let unit = |norm: f64| (norm - 1.0).abs() < 1e-3;
        check("the square of hold.orientation", &[norm], unit, "1, as of a unit quaternion")?;
        let rest = [
            ("hold.ramp", self.ramp),
            ("hold.stiffness", self.stiffness),
            ("hold.damping", self.damping),
            ("hold.turn_stiffness", self.turn_stiffness),
            ("hold.turn_damping", self.turn_damping),
        ];
        rest.iter().try_for_each(|(field, value)| check(field, &[*value], not_negative, "at least 0"))
    }

    fn end(&self) -> Isometry3<f64> {
        let [x, y, z, w] = self.orientation;
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Isometry3::from_parts(Translation3::from(self.position), turn)
    }
}

fn not_negative(value: f64) -> bool {
    value.is_finite() && value >= 0.0
}

/// A hold that has begun.
struct Held {
    hold: Hold,
    /// Where the tip was then, and when.
    from: Isometry3<f64>,
    begin: f64,
    /// When it ends.
    end: f64,
}

impl Held {
    fn wrench(&self, frame: &Isometry3<f64>, motion: &Motion, time: f64) -> Wrench {
        let (from, to, hold) = (&self.from, self.hold.end(), &self.hold);
        let (fraction, rate) = if hold.ramp > 0.0 {
            let [fraction, rate, _] = minimum_jerk((time - self.begin) / hold.ramp);
            (fraction, rate / hold.ramp)
        } else {
            (1.0, 0.0)
        };
        let way = to.translation.vector - from.translation.vector;
        let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
        let place = from.translation.vector + way * fraction;
        let turned = UnitQuaternion::new(turn * fraction) * from.rotation;
        let off = (turned * frame.rotation.inverse()).scaled_axis();
        Wrench {
            force: (place - frame.translation.vector) * hold.stiffness
                + (way * rate - motion.linear) * hold.damping,
            torque: off * hold.turn_stiffness + (turn * rate - motion.angular) * hold.turn_damping,
        }
    }
}

/// Force [N] and torque about the origin of a tip's frame [N·m], in the frame of the base.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wrench {
    pub force: Vector3<f64>,
    pub torque: Vector3<f64>,
}

impl Wrench {
    fn add(&mut self, force: &Vector3<f64>, arm: &Vector3<f64>) {
        self.force += force;
        self.torque += arm.cross(force);
    }
}

/// What acts on a tip.
#[derive(Default)]
pub struct Surroundings {
    hold: Option<Held>,
    pushes: Vec<(f64, Push)>,
    /// Where it sticks to each wall.
    anchors: Vec<Option<Vector3<f64>>>,
    /// A sub-step ago.
    before: Option<Motion>,
    /// Of the last sub-step, in the frame of the tip: what its force sensor adds up.
    pub felt: Wrench,
    /// Share of the walls in the force, and the depth in the deepest, in the last sub-step.
    pub wall_force: Vector3<f64>,
    pub depth: f64,
    sum: (Wrench, Vector3<f64>, f64),
}

impl Surroundings {
    /// Means since the last [`Environment::begin_means`]: of all, and of the walls' forces.
    pub fn means(&self) -> (Wrench, Vector3<f64>) {
        let (wrench, walls, steps) = &self.sum;
        let steps = steps.max(1.0);
        (Wrench { force: wrench.force / steps, torque: wrench.torque / steps }, walls / steps)
    }
}

/// Everything around the tips.
#[derive(Default)]
pub struct Environment {
    walls: Vec<Wall>,
    tips: Vec<Surroundings>,
    /// Whether anything acted in the last sub-step, or has come since.
    pub active: bool,
}

impl Environment {
    pub fn new(tips: usize) -> Self {
        Self { tips: (0..tips).map(|_| Surroundings::default()).collect(), ..Self::default() }
    }

    pub fn insert_wall(&mut self, wall: Wall) {
        self.active = true;
        self.walls.push(wall);
        self.tips.iter_mut().for_each(|tip| tip.anchors.push(None));
    }

    pub fn remove_walls(&mut self) {
        self.walls.clear();
        self.tips.iter_mut().for_each(|tip| tip.anchors.clear());
    }

    /// Begins to hold a tip that stands at `from`.
    pub fn hold(&mut self, tip: usize, hold: Hold, from: Isometry3<f64>, begin: f64) {
        self.active = true;
        if let Some(tip) = self.tips.get_mut(tip) {
            tip.hold = Some(Held { hold, from, begin, end: f64::INFINITY });
        }
    }

    /// The tip is let go at `time`.
    pub fn release(&mut self, tip: usize, time: f64) {
        if let Some(held) = self.tips.get_mut(tip).and_then(|tip| tip.hold.as_mut()) {
            held.end = time;
        }
    }

    pub fn push(&mut self, tip: usize, push: Push, begin: f64) {
        self.active = true;
        if let Some(tip) = self.tips.get_mut(tip) {
            tip.pushes.push((begin, push));
        }
    }

    /// Begins new means.
    pub fn begin_means(&mut self) {
        self.tips.iter_mut().for_each(|tip| tip.sum = Default::default());
    }

    pub fn of_tip(&self, tip: usize) -> Option<&Surroundings> {
        self.tips.get(tip)
    }

    /// What acts on a tip in the sub-step around `time`, with a share of each force; `None` for nothing.
    pub fn act(
        &mut self,
        number: usize,
        tip: &Tip,
        (frame, motion): (&Isometry3<f64>, Motion),
        time: f64,
        fraction: f64,
    ) -> Option<Wrench> {
        let around = self.tips.get_mut(number)?;
        let before = around.before.take();
        if around.hold.as_ref().is_some_and(|held| time >= held.end) {
            around.hold = None;
        }
        around.pushes.retain(|(begin, push)| !push.is_over(time - begin));
        (around.felt, around.wall_force, around.depth) = (Wrench::default(), Vector3::zeros(), 0.0);
        around.sum.2 += 1.0;
        if self.walls.is_empty() && around.hold.is_none() && around.pushes.is_empty() {
            return None;
        }
        around.before = Some(motion);
        let motion = before.map_or(motion, |before| motion.half_a_step_on(&before));
        let origin = frame.translation.vector;
        let mut wrench =
            around.hold.as_ref().map(|held| held.wrench(frame, &motion, time)).unwrap_or_default();
        for (begin, push) in &around.pushes {
            let arm = frame.rotation * Vector3::from(push.point);
            wrench.add(&(Vector3::from(push.force) * push.fraction(time - begin)), &arm);
        }
        let center = (frame * Point3::from(tip.center)).coords;
        for (wall, anchor) in self.walls.iter().zip(&mut around.anchors) {
            let point = center - Vector3::from(wall.normal).normalize() * tip.radius;
            let arm = point - origin;
            let velocity = motion.linear + motion.angular.cross(&arm);
            let (force, depth) = wall.force(&point, &velocity, anchor);
            wrench.add(&force, &arm);
            around.wall_force += force * fraction;
            around.depth = around.depth.max(depth);
        }
        wrench = Wrench { force: wrench.force * fraction, torque: wrench.torque * fraction };
        let back = frame.rotation.inverse();
        around.felt = Wrench { force: back * wrench.force, torque: back * wrench.torque };
        around.sum.0.force += wrench.force;
        around.sum.0.torque += wrench.torque;
        around.sum.1 += around.wall_force;
        Some(wrench)
    }
}
