//! Disturbances: pushes on an object or a tip, and weights on an object.

use rapier3d::na::{Matrix3, Point3, Vector3};
use tesaki_description::urdf::point_inertia;

use super::error::PlantError;
use super::rigid_body::{FreeBody, MassDistribution};
use tesaki_description::object::ObjectValues;

/// A force on an object or a tip that rises, holds and falls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// Largest value of the force, in the frame of the base [N].
    pub force: [f64; 3],
    /// Point of application on the object or the tip, in its frame [m].
    pub point: [f64; 3],
    /// Time to rise, and to fall [s].
    pub ramp: f64,
    /// Time between them [s]; infinite for a permanent force.
    pub hold: f64,
}

/// A weight that is put on the object and stays on it, as a point mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Mass [kg].
    pub mass: f64,
    /// Its position on the object, in the object's frame [m].
    pub point: [f64; 3],
    /// Time over which it is put on [s].
    pub ramp: f64,
}

impl Push {
    pub(super) fn validate(&self) -> Result<(), PlantError> {
        finite("push.force", &self.force)?;
        finite("push.point", &self.point)?;
        duration("push.ramp", self.ramp, self.ramp.is_finite())?;
        duration("push.hold", self.hold, true)
    }

    /// Returns the fraction of the force, `time` after its start.
    pub(super) fn fraction(&self, time: f64) -> f64 {
        let left = 2.0 * self.ramp + self.hold - time;
        if time < 0.0 || left <= 0.0 {
            0.0
        } else if self.ramp > 0.0 {
            (time / self.ramp).min(left / self.ramp).min(1.0)
        } else {
            1.0
        }
    }

    /// Returns whether it has ended, `time` after its start.
    pub(super) fn is_over(&self, time: f64) -> bool {
        time >= 2.0 * self.ramp + self.hold
    }
}

impl Load {
    pub(super) fn validate(&self) -> Result<(), PlantError> {
        finite("load.point", &self.point)?;
        duration("load.mass", self.mass, self.mass.is_finite())?;
        duration("load.ramp", self.ramp, self.ramp.is_finite())
    }
}

fn finite(field: &str, values: &[f64]) -> Result<(), PlantError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(PlantError::Value { field: field.to_owned(), value, expected: "finite" }),
        None => Ok(()),
    }
}

fn duration(field: &str, value: f64, good: bool) -> Result<(), PlantError> {
    if good && value >= 0.0 {
        return Ok(());
    }
    Err(PlantError::Value { field: field.to_owned(), value, expected: "at least 0" })
}

/// A weight whose mass changes from one value to another.
struct Weight {
    point: Vector3<f64>,
    from: f64,
    to: f64,
    begin: f64,
    ramp: f64,
}

impl Weight {
    fn mass(&self, time: f64) -> f64 {
        let fraction = if self.ramp > 0.0 { ((time - self.begin) / self.ramp).clamp(0.0, 1.0) } else { 1.0 };
        self.from + (self.to - self.from) * fraction
    }
}

/// An object's mass with weights, and the pushes on it.
pub struct Disturbances {
    /// Of the object alone: mass [kg], centre [m], inertia about the centre [kg·m²].
    own: (f64, Vector3<f64>, Matrix3<f64>),
    pushes: Vec<(f64, Push)>,
    weights: Vec<Weight>,
    /// Bits of the mass of all weights in the last sub-step, and their number: with the same, the object has
    /// the same mass distribution.
    known: (u64, usize),
}

impl Disturbances {
    pub fn new(object: &ObjectValues) -> Self {
        let (center, inertia) = object.inertia();
        Self { own: (object.mass, center, inertia), pushes: Vec::new(), weights: Vec::new(), known: (0, 0) }
    }

    pub fn push(&mut self, push: Push, time: f64) {
        self.pushes.push((time, push));
    }

    pub fn load(&mut self, load: Load, time: f64) {
        let point = Vector3::from(load.point);
        self.weights.push(Weight { point, from: 0.0, to: load.mass, begin: time, ramp: load.ramp });
    }

    /// Removes all weights.
    pub fn unload(&mut self, ramp: f64, time: f64) {
        self.weights.retain(|weight| weight.to > 0.0 || weight.mass(time) > 0.0);
        for weight in &mut self.weights {
            (weight.from, weight.to) = (weight.mass(time), 0.0);
            (weight.begin, weight.ramp) = (time, ramp);
        }
    }

    /// Mass of all weights [kg].
    pub fn mass(&self, time: f64) -> f64 {
        self.weights.iter().fold(0.0, |sum, weight| sum + weight.mass(time))
    }

    /// Applies all disturbances to the object in the sub-step around `time`, scaled by `fraction`.
    pub fn act(&mut self, body: &mut FreeBody, time: f64, fraction: f64) {
        body.release();
        let weights = (self.mass(time).to_bits(), self.weights.len());
        if weights != self.known {
            self.known = weights;
            body.set_mass(self.mass_distribution(time));
        }
        for (begin, push) in &self.pushes {
            let force = Vector3::from(push.force) * (push.fraction(time - begin) * fraction);
            let point = body.pose * Point3::from(Vector3::from(push.point));
            body.add_force(&force, &point.coords);
        }
    }

    /// Mass distribution of the object with all weights.
    pub fn mass_distribution(&self, time: f64) -> MassDistribution {
        let (own, center, inertia) = &self.own;
        let mut parts = vec![(*own, *center)];
        parts.extend(self.weights.iter().map(|weight| (weight.mass(time), weight.point)));
        let mass: f64 = parts.iter().map(|(mass, _)| mass).sum();
        let common = parts.iter().map(|(mass, place)| place * *mass).sum::<Vector3<f64>>() / mass;
        let around = parts.iter().map(|(mass, place)| point_inertia(*mass, &(place - common)));
        MassDistribution { mass, center: common, inertia: inertia + around.sum::<Matrix3<f64>>() }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_push_rises_stays_and_falls() {
        let push = Push { force: [1.0, 0.0, 0.0], point: [0.0; 3], ramp: 0.3, hold: 0.4 };
        for (time, fraction) in [(-0.1, 0.0), (0.15, 0.5), (0.3, 1.0), (0.6, 1.0), (0.85, 0.5), (1.1, 0.0)] {
            assert!((push.fraction(time) - fraction).abs() < 1e-12, "{time}");
        }
        let sudden = Push { ramp: 0.0, hold: f64::INFINITY, ..push };
        assert!(sudden.fraction(-0.1) < 0.5 && sudden.fraction(0.0) > 0.5 && sudden.fraction(1e9) > 0.5);
        let lasting = Push { hold: f64::INFINITY, ..push };
        assert!((lasting.fraction(0.03) - 0.1).abs() < 1e-12 && (lasting.fraction(1e9) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn weights_go_on_and_off() {
        let values =
            ObjectValues::from_toml("shape = 'box'\nsize = [0.1, 0.2, 0.3]\nmass = 0.1\nfriction = 0.5");
        let mut all = Disturbances::new(&values.unwrap());
        all.load(Load { mass: 0.1, point: [0.0; 3], ramp: 0.3 }, 1.0);
        assert!((all.mass(1.15) - 0.05).abs() < 1e-12);
        all.unload(0.3, 2.0);
        all.load(Load { mass: 0.2, point: [0.0; 3], ramp: 0.3 }, 2.0);
        assert!((all.mass(2.15) - 0.15).abs() < 1e-12 && (all.mass(3.0) - 0.2).abs() < 1e-12);
    }
}
