//! A rigid body that moves freely.

use rapier3d::na::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

use super::motion::Motion;

/// A free rigid body. Vectors are in the frame of the base unless stated otherwise.
pub struct FreeBody {
    /// Pose of the body's own frame.
    pub pose: Isometry3<f64>,
    /// Velocity of the centre of mass [m/s], and angular velocity [rad/s].
    pub linear: Vector3<f64>,
    pub angular: Vector3<f64>,
    pub mass: MassDistribution,
    /// Force [N] and moment about the centre of mass [N·m] of the next sub-step, without gravity.
    force: Vector3<f64>,
    moment: Vector3<f64>,
}

/// Mass [kg], centre of mass [m], and inertia about it [kg·m²], in the frame of the body.
pub struct MassDistribution {
    pub mass: f64,
    pub center: Vector3<f64>,
    pub inertia: Matrix3<f64>,
}

impl FreeBody {
    /// Creates a body at rest.
    pub fn new(pose: Isometry3<f64>, mass: MassDistribution) -> Self {
        let zero = Vector3::zeros();
        Self { pose, linear: zero, angular: zero, mass, force: zero, moment: zero }
    }

    /// Centre of mass.
    pub fn center(&self) -> Vector3<f64> {
        (self.pose * Point3::from(self.mass.center)).coords
    }

    /// Inverse of the inertia about the centre of mass.
    pub fn inverse_inertia(&self) -> Matrix3<f64> {
        let turn = self.pose.rotation.to_rotation_matrix();
        // A valid object has a volume.
        let inverse = self.mass.inertia.try_inverse().unwrap_or_else(Matrix3::zeros);
        turn.matrix() * inverse * turn.matrix().transpose()
    }

    /// Motion of a point of the body.
    pub fn motion_at(&self, point: &Vector3<f64>) -> Motion {
        let linear = self.linear + self.angular.cross(&(point - self.center()));
        Motion { linear, angular: self.angular }
    }

    /// Clears all forces.
    pub fn release(&mut self) {
        (self.force, self.moment) = (Vector3::zeros(), Vector3::zeros());
    }

    /// Adds a force [N] on a point of the body for the next sub-step.
    pub fn add_force(&mut self, force: &Vector3<f64>, point: &Vector3<f64>) {
        self.force += force;
        self.moment += (point - self.center()).cross(force);
    }

    /// Sets the mass distribution; the velocity of each point of the body is kept.
    pub fn set_mass(&mut self, mass: MassDistribution) {
        let before = self.center();
        self.mass = mass;
        self.linear += self.angular.cross(&(self.center() - before));
    }

    /// Accelerates for `step` [s] under the forces and gravity.
    pub fn accelerate(&mut self, gravity: &Vector3<f64>, step: f64) {
        self.linear += (self.force / self.mass.mass + gravity) * step;
        // Without a moment, the angular momentum keeps its length: an explicit step alone would add energy.
        let rotation = self.pose.rotation;
        let spin = rotation.inverse() * self.angular;
        let momentum = self.mass.inertia * spin;
        let turned = momentum - spin.cross(&momentum) * step;
        let turned = turned.try_normalize(0.0).unwrap_or_default() * momentum.norm();
        self.angular = self.inverse_inertia() * (rotation * turned + self.moment * step);
    }

    /// Moves for `step` [s].
    pub fn advance(&mut self, step: f64) {
        let center = self.center() + self.linear * step;
        let turned = UnitQuaternion::new(self.angular * step) * self.pose.rotation;
        // Rounding must not accumulate.
        let turned = UnitQuaternion::new_normalize(turned.into_inner());
        let place = Translation3::from(center - turned * self.mass.center);
        self.pose = Isometry3::from_parts(place, turned);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's box, which turns about an axis between those of its inertia.
    #[test]
    fn a_body_in_free_flight_gains_no_energy() {
        let inertia = Matrix3::from_diagonal(&Vector3::new(8.98e-5, 2.53e-5, 1.013e-4));
        let mass = MassDistribution { mass: 0.023, center: Vector3::zeros(), inertia };
        let mut body = FreeBody::new(Isometry3::identity(), mass);
        body.angular = Vector3::new(30.0, 30.0, 30.0);
        let energy = |body: &FreeBody| {
            let spin = body.pose.rotation.inverse() * body.angular;
            0.5 * spin.dot(&(body.mass.inertia * spin))
        };
        let before = energy(&body);
        for _ in 0..10_000 {
            body.accelerate(&Vector3::zeros(), 1e-3);
            body.advance(1e-3);
        }
        assert!(energy(&body) < before && energy(&body) > 0.3 * before, "{} {before}", energy(&body));
    }
}
