//! External forces on the tips: walls, holds and pushes.
//!
//! Forces are computed from the state at the start of a sub-step, to which the leapfrog's angles belong, so
//! springs are exact to second order. Velocities are half a sub-step old at that time, so dampers use their
//! extrapolation. Springs are stable up to `4 m / h²` and dampers up to `m / h`, with the sub-step `h` and
//! the effective mass `m` of the tip; at 1 ms and 0.5 kg that is 2 MN/m and 500 N·s/m.

use rapier3d::na::{Isometry3, Point3, UnitQuaternion, Vector3};
use tesaki_supervisor::trajectory::minimum_jerk;

use super::convert::isometry;
use super::end_effector::Tip;
use super::error::{PlantError, check};
use super::motion::Motion;
use super::push::Push;

/// An elastic plane: a spring and a damper along its normal, and friction along its surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// A point on its surface, in the frame of the base [m].
    pub point: [f64; 3],
    /// Outward normal of the wall, in the frame of the base; of any length.
    pub normal: [f64; 3],
    /// Stiffness along the normal, and along the surface while friction sticks [N/m].
    pub stiffness: f64,
    /// Damping along normal and surface [N·s/m]. The wall never pulls along its normal.
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

    /// Returns the force on a moving point, and its penetration; `anchor` is the point where it sticks.
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
        let sticking = -along(point - *stuck) * self.stiffness - along(*velocity) * self.damping;
        let friction = sticking.cap_magnitude(self.friction * push);
        if friction != sticking {
            // The point slides: the anchor follows at the deflection that friction allows.
            *stuck = point + (friction + along(*velocity) * self.damping) / self.stiffness;
        }
        (normal * push + friction, depth)
    }
}

/// A hold on a tip: it moves the tip to a pose within a given time and keeps it there. Springs and dampers
/// act between the tip's frame and a frame in minimum-jerk motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// Final position of the tip's frame, in the base frame [m].
    pub position: [f64; 3],
    /// Its final orientation: a unit quaternion `[x, y, z, w]`.
    pub orientation: [f64; 4],
    /// Duration of the motion [s].
    pub ramp: f64,
    /// Translational stiffness [N/m].
    pub stiffness: f64,
    /// Translational damping [N·s/m].
    pub damping: f64,
    /// Rotational stiffness [N·m/rad]; 0 leaves the orientation free.
    pub rotational_stiffness: f64,
    /// Rotational damping [N·m·s/rad].
    pub rotational_damping: f64,
}

impl Hold {
    /// Returns a firm hold for a hand of half a kilogram: 20 kN/m and 100 N·m/rad.
    pub const fn firm(position: [f64; 3], orientation: [f64; 4], ramp: f64) -> Self {
        let (stiffness, damping) = (20_000.0, 150.0);
        let (rotational_stiffness, rotational_damping) = (100.0, 1.0);
        Self { position, orientation, ramp, stiffness, damping, rotational_stiffness, rotational_damping }
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
            ("hold.rotational_stiffness", self.rotational_stiffness),
            ("hold.rotational_damping", self.rotational_damping),
        ];
        rest.iter().try_for_each(|(field, value)| check(field, &[*value], not_negative, "at least 0"))
    }

    fn end(&self) -> Isometry3<f64> {
        isometry(self.position, self.orientation)
    }
}

fn not_negative(value: f64) -> bool {
    value.is_finite() && value >= 0.0
}

/// A hold that has begun.
struct Held {
    hold: Hold,
    /// Pose of the tip at the start, and time of the start [s].
    from: Isometry3<f64>,
    begin: f64,
    /// Time of its end [s].
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
        let displacement = to.translation.vector - from.translation.vector;
        let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
        let place = from.translation.vector + displacement * fraction;
        let turned = UnitQuaternion::new(turn * fraction) * from.rotation;
        let off = (turned * frame.rotation.inverse()).scaled_axis();
        Wrench {
            force: (place - frame.translation.vector) * hold.stiffness
                + (displacement * rate - motion.linear) * hold.damping,
            torque: off * hold.rotational_stiffness
                + (turn * rate - motion.angular) * hold.rotational_damping,
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
    fn add(&mut self, force: &Vector3<f64>, lever: &Vector3<f64>) {
        self.force += force;
        self.torque += lever.cross(force);
    }
}

/// The external forces on a tip.
#[derive(Default)]
pub struct ExternalForces {
    hold: Option<Held>,
    pushes: Vec<(f64, Push)>,
    /// The point where the tip sticks to each wall.
    anchors: Vec<Option<Vector3<f64>>>,
    /// Motion one sub-step ago.
    before: Option<Motion>,
    /// Wrench of the last sub-step, in the frame of the tip, for its force sensor.
    pub wrench: Wrench,
    /// Force of the walls, and largest penetration, in the last sub-step.
    pub wall_force: Vector3<f64>,
    pub depth: f64,
    sum: (Wrench, Vector3<f64>, f64),
}

impl ExternalForces {
    /// Mean wrench, and mean force of the walls, since the last [`Environment::begin_means`].
    pub fn means(&self) -> (Wrench, Vector3<f64>) {
        let (wrench, walls, steps) = &self.sum;
        let steps = steps.max(1.0);
        (Wrench { force: wrench.force / steps, torque: wrench.torque / steps }, walls / steps)
    }
}

/// The environment of the tips.
#[derive(Default)]
pub struct Environment {
    walls: Vec<Wall>,
    tips: Vec<ExternalForces>,
    /// Whether a force acted in the last sub-step, or was added since.
    pub active: bool,
}

impl Environment {
    pub fn new(tips: usize) -> Self {
        Self { tips: (0..tips).map(|_| ExternalForces::default()).collect(), ..Self::default() }
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

    /// Stiffness of the stiffest wall [N/m]; 0 without walls.
    pub fn stiffness(&self) -> f64 {
        self.walls.iter().fold(0.0, |stiffness, wall| wall.stiffness.max(stiffness))
    }

    /// Begins to hold a tip whose frame is at `from`.
    pub fn hold(&mut self, tip: usize, hold: Hold, from: Isometry3<f64>, begin: f64) {
        self.active = true;
        if let Some(tip) = self.tips.get_mut(tip) {
            tip.hold = Some(Held { hold, from, begin, end: f64::INFINITY });
        }
    }

    /// Whether a tip is held.
    pub fn holds(&self) -> bool {
        self.tips.iter().any(|tip| tip.hold.is_some())
    }

    /// Releases the tip at `time`.
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

    /// Begins a new averaging interval.
    pub fn begin_means(&mut self) {
        self.tips.iter_mut().for_each(|tip| tip.sum = Default::default());
    }

    pub fn of_tip(&self, tip: usize) -> Option<&ExternalForces> {
        self.tips.get(tip)
    }

    /// Returns the wrench on a tip in the sub-step around `time`, scaled by `fraction`; `None` without
    /// external forces.
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
        (around.wrench, around.wall_force, around.depth) = (Wrench::default(), Vector3::zeros(), 0.0);
        around.sum.2 += 1.0;
        if self.walls.is_empty() && around.hold.is_none() && around.pushes.is_empty() {
            return None;
        }
        around.before = Some(motion);
        let motion = before.map_or(motion, |before| motion.extrapolated(&before));
        let origin = frame.translation.vector;
        let mut wrench =
            around.hold.as_ref().map(|held| held.wrench(frame, &motion, time)).unwrap_or_default();
        for (begin, push) in &around.pushes {
            let lever = frame.rotation * Vector3::from(push.point);
            wrench.add(&(Vector3::from(push.force) * push.fraction(time - begin)), &lever);
        }
        let center = (frame * Point3::from(tip.center)).coords;
        for (wall, anchor) in self.walls.iter().zip(&mut around.anchors) {
            let point = center - Vector3::from(wall.normal).normalize() * tip.radius;
            let lever = point - origin;
            let velocity = motion.linear + motion.angular.cross(&lever);
            let (force, depth) = wall.force(&point, &velocity, anchor);
            wrench.add(&force, &lever);
            around.wall_force += force * fraction;
            around.depth = around.depth.max(depth);
        }
        wrench = Wrench { force: wrench.force * fraction, torque: wrench.torque * fraction };
        let back = frame.rotation.inverse();
        around.wrench = Wrench { force: back * wrench.force, torque: back * wrench.torque };
        around.sum.0.force += wrench.force;
        around.sum.0.torque += wrench.torque;
        around.sum.1 += around.wall_force;
        Some(wrench)
    }
}
